"""Pictures in files: read, and written whole or not at all."""

from __future__ import annotations

import contextlib
import glob
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

PICTURES = (".exr", ".png", ".jpg", ".jpeg")
"""Suffixes of the files that :func:`write_picture` writes."""

JPEG_QUALITY = 90
"""Quality of JPEG files, 1 to 100."""


def require_suffix(path: Path, suffixes: Iterable[str]) -> Path:
    """The path, if its name ends in one of ``suffixes``; raises ``ValueError`` where not."""
    suffixes = tuple(suffixes)
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: the name must end in one of {', '.join(suffixes)}")
    return path


def require_writable(path: str | os.PathLike[str], suffixes: Iterable[str]) -> Path:
    """The path, if a file of one of ``suffixes`` can be written there.

    Raises ``ValueError`` for another suffix, ``FileNotFoundError``, ``IsADirectoryError`` or
    ``PermissionError`` for a place where no file can be made.
    """
    path = require_suffix(Path(path), suffixes)
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder, not a file")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.parent}")
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise PermissionError(f"{path}: cannot write to {path.parent}: {error.strerror}") from None
    return path


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A temporary name beside ``path``, which takes its place when the block has succeeded."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        if not temporary.is_file():
            raise OSError(f"{path}: could not be written")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def remove_leftovers(path: Path) -> None:
    """Remove what programs that were killed have left of a file of :func:`written_whole`."""
    for leftover in path.parent.glob(f".{glob.escape(path.stem)}.[0-9]*{path.suffix}"):
        leftover.unlink(missing_ok=True)


def read_luminance(path: str | os.PathLike[str]) -> np.ndarray:
    """The linear luminance of a picture that Mitsuba can read, float64 (H, W), rows from the top.

    Raises ``FileNotFoundError`` where there is none.
    """
    import mitsuba as mi

    if not os.path.exists(path):
        raise FileNotFoundError(f"filename={os.fspath(path)!r}: there is no such file")
    bitmap = mi.Bitmap(os.fspath(path)).convert(
        mi.Bitmap.PixelFormat.Y, mi.Struct.Type.Float32, srgb_gamma=False
    )
    values = np.array(bitmap, dtype=np.float64)  # Its size has a type that needs a variant.
    return values.reshape(values.shape[:2])


def read_srgb(path: str | os.PathLike[str]) -> np.ndarray:
    """A picture that :func:`write_picture` wrote, in 8-bit sRGB without alpha: uint8 (H, W, 3)."""
    import mitsuba as mi

    bitmap = mi.Bitmap(os.fspath(path))
    if bitmap.component_format() != mi.Struct.Type.UInt8:  # Clipped, see write_picture.
        bitmap = mi.Bitmap(np.clip(np.array(bitmap, dtype=np.float32), 0, 1))
    return np.array(bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True))


def write_picture(image: Any, path: str | os.PathLike[str]) -> None:
    """Write linear RGB (A), (H, W, 3 or 4): ``.exr`` in float32, else in 8-bit sRGB."""
    import mitsuba as mi

    path = require_writable(path, PICTURES)
    values = np.ascontiguousarray(image, dtype=np.float32)
    linear = path.suffix.lower() == ".exr"
    # Clipped, for Mitsuba's conversion makes black of some thousands.
    bitmap = mi.Bitmap(values if linear else np.clip(values, 0, 1))
    if not linear:
        keep_alpha = path.suffix.lower() == ".png" and bitmap.has_alpha()
        pixel_format = mi.Bitmap.PixelFormat.RGBA if keep_alpha else mi.Bitmap.PixelFormat.RGB
        bitmap = bitmap.convert(pixel_format, mi.Struct.Type.UInt8, srgb_gamma=True)
    with written_whole(path) as temporary:
        bitmap.write(str(temporary), quality=JPEG_QUALITY if "jp" in path.suffix.lower() else -1)
