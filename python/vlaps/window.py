"""A window for `render_mode="human"`, and video files for machines without a display."""

from __future__ import annotations

import os
import struct
import sys
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .config import whole


def has_display() -> bool:
    """Whether a window can be expected to open."""
    return sys.platform != "linux" or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


class Window:
    """A window of the pictures' size."""

    def __init__(self, size: tuple[int, int]) -> None:
        if not has_display():
            raise RuntimeError(
                'render_mode="human" needs a display, and DISPLAY is not set: use '
                'render_mode="rgb_array" and vlaps.write_video(path, frames)'
            )
        try:
            import tkinter
        except ImportError as error:
            raise RuntimeError(
                'render_mode="human" needs tkinter (on Debian the package python3-tk)'
            ) from error
        try:
            self._root: Any = tkinter.Tk()
        except tkinter.TclError as error:
            raise RuntimeError(f'render_mode="human" cannot open a window: {error}') from error
        self._root.title("vlaps")
        self._label: Any = tkinter.Label(self._root, width=size[0], height=size[1])
        self._label.pack()

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Shows a picture."""
        import tkinter

        height, width, _ = picture.shape
        image = tkinter.PhotoImage(
            master=self._root, data=b"P6 %d %d 255 " % (width, height) + picture.tobytes()
        )
        # The label does not keep the image alive.
        self._image = image
        self._label.configure(image=image)
        self._root.update()

    def close(self) -> None:
        """Closes the window; further calls do nothing."""
        if self._root is not None:
            self._root.destroy()
            self._root = None


def write_video(path: str | os.PathLike[str], frames: Iterable[NDArray[np.uint8]], fps: int = 10) -> None:
    """Writes pictures `[height, width, 3]` of one size as an animated PNG.

    Browsers and most viewers play it. The path must end in `.png` or `.apng`.
    """
    path = Path(path)
    if path.suffix not in (".png", ".apng"):
        raise ValueError(f"{path}: the video is an animated PNG; its name must end in .png or .apng")
    fps = whole("fps", fps, 1, 2**16 - 1)
    pictures = [_checked(frame) for frame in frames]
    if not pictures:
        raise ValueError("no frames: nothing was written")
    height, width, _ = pictures[0].shape
    chunks = [
        _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        _chunk(b"acTL", struct.pack(">II", len(pictures), 0)),
    ]
    sequence = 0
    for index, picture in enumerate(pictures):
        if picture.shape != (height, width, 3):
            raise ValueError(f"frame {index} has the shape {picture.shape}, not {(height, width, 3)}")
        control = struct.pack(">IIIIIHHBB", sequence, width, height, 0, 0, 1, fps, 0, 0)
        chunks.append(_chunk(b"fcTL", control))
        sequence += 1
        data = zlib.compress(_filtered(picture))
        if index == 0:
            chunks.append(_chunk(b"IDAT", data))
        else:
            chunks.append(_chunk(b"fdAT", struct.pack(">I", sequence) + data))
            sequence += 1
    chunks.append(_chunk(b"IEND", b""))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))


def _checked(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    frame = np.asarray(frame)
    if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3 or not frame.size:
        raise ValueError(f"a frame must be a uint8 array [height, width, 3], not {frame.dtype} {frame.shape}")
    return frame


def _filtered(picture: NDArray[np.uint8]) -> bytes:
    """The rows with the filter "up" (RFC 2083, 6.4), each preceded by its filter byte."""
    height, width, _ = picture.shape
    rows = np.zeros((height, 1 + 3 * width), np.uint8)
    flat = picture.reshape(height, 3 * width)
    rows[:, 0] = 2
    rows[0, 1:] = flat[0]
    rows[1:, 1:] = flat[1:] - flat[:-1]
    return rows.tobytes()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
