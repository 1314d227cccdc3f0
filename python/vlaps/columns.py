"""Structured arrays as flat columns, for tables."""

from __future__ import annotations

from fnmatch import fnmatchcase
from math import prod
from typing import Any, Iterable

import numpy as np
from numpy.typing import NDArray

#: Name of the column with the time of recording.
RECORDED_S = "recorded_s"


def flat(array: NDArray[Any], patterns: Iterable[str] | None = None) -> dict[str, NDArray[Any]]:
    """One column for each number of a message, `[count]`, or for each array, `[count, length]`.

    Names of nested fields have a dot. `patterns` keeps the columns that match one of them, as
    file names do.

    >>> rows = np.zeros(2, [("at", [("x_m", "f8"), ("y_m", "f8")]), ("map", "u1", 3)])
    >>> {name: column.shape for name, column in flat(rows).items()}
    {'at.x_m': (2,), 'at.y_m': (2,), 'map': (2, 3)}
    >>> list(flat(rows, ["at.*"]))
    ['at.x_m', 'at.y_m']
    """
    columns: dict[str, NDArray[Any]] = {}
    _collect(array, "", columns)
    if patterns is None:
        return columns
    wanted = [patterns] if isinstance(patterns, str) else list(patterns)
    for pattern in wanted:
        if not any(fnmatchcase(name, pattern) for name in columns):
            raise KeyError(f"no column matches {pattern!r}; there are {_some(columns)}")
    keep = {name: any(fnmatchcase(name, pattern) for pattern in wanted) for name in columns}
    return {name: column for name, column in columns.items() if keep[name]}


def _collect(array: NDArray[Any], name: str, into: dict[str, NDArray[Any]]) -> None:
    if array.dtype.names is None:
        # The length is said, since an empty table has it, too.
        into[name] = array if array.ndim == 1 else array.reshape(len(array), prod(array.shape[1:]))
        return
    for field in array.dtype.names:
        _collect(array[field], f"{name}.{field}" if name else field, into)


def _some(columns: dict[str, Any], most: int = 12) -> str:
    names = list(columns)
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def arrow_batch(times: NDArray[np.float64], array: NDArray[Any], patterns: Iterable[str] | None) -> Any:
    """The rows as a record batch of Arrow; an array becomes a list of fixed size."""
    pyarrow = needed("pyarrow", "Arrow tables")
    columns = {RECORDED_S: times, **flat(array, patterns)}
    arrays = []
    for column in columns.values():
        numbers = pyarrow.array(np.ascontiguousarray(column).reshape(-1))
        if column.ndim > 1:
            numbers = pyarrow.FixedSizeListArray.from_arrays(numbers, column.shape[1])
        arrays.append(numbers)
    return pyarrow.RecordBatch.from_arrays(arrays, names=list(columns))


def needed(package: str, what: str) -> Any:
    """Imports an optional package, or says how to install it."""
    import importlib

    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise ImportError(f"{what} need {package}: pip install {package}") from error
