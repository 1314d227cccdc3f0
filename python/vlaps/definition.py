"""NumPy types of ROS 2 message definitions, as a recording holds them.

A message of VLAPS is a C struct without padding, which is its own encoding. So its type
follows from its definition alone; a field that is added appears by itself.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

#: Types of ROS 2 with a fixed size, little-endian.
SCALARS = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "int64": "<i8",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
}
#: A field: type, length of an array, name.
_FIELD = re.compile(r"([A-Za-z][\w/]*)(?:\[(\d+)\])?\s+([A-Za-z]\w*)$")
#: Deepest nesting that is followed.
_DEPTH_MAX = 16


class NoFixedSize(TypeError):
    """A definition without a fixed size, or whose encoding has padding."""


def dtype_of(definition: str, schema: str) -> np.dtype[Any]:
    """The type of a message from its definition, in the format `ros2msg`.

    >>> text = "uint32 tick\\nuint8[4] map\\nvlaps_msgs/Point at\\n" + "=" * 80
    >>> text += "\\nMSG: vlaps_msgs/Point\\nfloat64 x_m\\n"
    >>> dtype_of(text, "vlaps_msgs/msg/Example")
    dtype([('tick', '<u4'), ('map', 'u1', (4,)), ('at', [('x_m', '<f8')])])
    """
    first, *others = re.split(r"^={20,}\s*$", definition, flags=re.MULTILINE)
    known: dict[str, str] = {}
    for text in others:
        head, _, body = text.strip().partition("\n")
        known[head.removeprefix("MSG:").strip().replace("/msg/", "/")] = body
    found = _struct(first, known, schema, 0)
    _check_alignment(found, 0, schema)
    return found


def _struct(text: str, known: dict[str, str], schema: str, depth: int) -> np.dtype[Any]:
    fields: list[tuple[Any, ...]] = []
    for line in text.splitlines():
        line = line.partition("#")[0].strip()
        # A constant takes no bytes.
        if not line or "=" in line:
            continue
        match = _FIELD.match(line)
        if match is None:
            raise NoFixedSize(f"{schema}: the field {line!r} has no fixed size")
        word, length, name = match.groups()
        element = _element(word, known, schema, depth)
        fields.append((name, element, (int(length),)) if length else (name, element))
    return np.dtype(fields)


def _element(word: str, known: dict[str, str], schema: str, depth: int) -> np.dtype[Any]:
    if word in SCALARS:
        return np.dtype(SCALARS[word])
    package = schema.partition("/")[0]
    body = known.get(word.replace("/msg/", "/"), known.get(f"{package}/{word}"))
    if body is None or depth > _DEPTH_MAX:
        raise NoFixedSize(f"{schema}: the type {word!r} has no fixed size, or no definition")
    return _struct(body, known, schema, depth + 1)


def _check_alignment(dtype: np.dtype[Any], offset: int, schema: str) -> None:
    """Each number must lie where CDR aligns it; otherwise there is padding."""
    if dtype.subdtype is not None:
        element, shape = dtype.subdtype
        # The second element shows whether the distance between two keeps the alignment.
        for number in range(min(2, int(np.prod(shape)))):
            _check_alignment(element, offset + number * element.itemsize, schema)
    elif dtype.fields is not None:
        for field in dtype.fields.values():
            _check_alignment(field[0], offset + field[1], schema)
    elif offset % dtype.itemsize:
        raise NoFixedSize(f"{schema}: its encoding has padding, which messages of vlaps have not")
