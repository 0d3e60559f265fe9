"""JPEG as living pictures have it: a colour for each pixel, in no more bytes than it takes."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .._image import read_srgb

QUALITIES = (30, 98)
"""The least and the best quality that is tried."""


POSTER = 80
"""Quality of what is seen before anything is decoded."""


class Jpeg(NamedTuple):
    """A picture in JPEG: its bytes, and what they show, uint8 (H, W, 3)."""

    data: bytes
    shown: np.ndarray


def encoded(picture: np.ndarray, quality: int) -> Jpeg:
    """A picture, uint8 (H, W, 3) in sRGB, in JPEG of that ``quality``, 1 to 100.

    Colours are not kept for four pixels at once, as JPEG mostly does: edges of lamps would suffer.
    """
    import OpenImageIO as oiio

    height, width, channels = picture.shape
    spec = oiio.ImageSpec(width, height, channels, "uint8")
    spec.attribute("oiio:ColorSpace", "sRGB")
    spec.attribute("jpeg:subsampling", "4:4:4")
    spec.attribute("CompressionQuality", quality)
    with tempfile.TemporaryDirectory() as folder:  # OpenImageIO writes files, and no bytes.
        path = Path(folder) / "picture.jpg"
        output = oiio.ImageOutput.create(str(path))
        written = output.open(str(path), spec) and output.write_image(np.ascontiguousarray(picture))
        if not (output.close() and written):
            raise OSError(f"a JPEG could not be written: {output.geterror()}")
        return Jpeg(path.read_bytes(), read_srgb(path))


def squared_error(found: np.ndarray, expected: np.ndarray) -> float:
    """The mean squared error of a picture, uint8, as a share of the square of the largest value."""
    difference = found.astype(np.int16)
    difference -= expected
    flat = difference.ravel().astype(np.float32)
    return float(np.dot(flat, flat)) / (flat.size * 255.0**2)


def smallest(picture: np.ndarray, error: float) -> Jpeg:
    """The picture in the least quality of ``QUALITIES`` that errs by no more, or in the best.

    ``error`` is a :func:`squared_error`.
    """
    least, best = QUALITIES
    found = None
    while least < best:
        middle = (least + best) // 2
        one = encoded(picture, middle)
        if squared_error(one.shown, picture) <= error:
            best, found = middle, one
        else:
            least = middle + 1
    return found if found is not None and best < QUALITIES[1] else encoded(picture, best)
