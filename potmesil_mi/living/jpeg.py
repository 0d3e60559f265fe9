"""JPEG as living pictures have it: a colour for each pixel, in no more bytes than it takes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._image import encoded_jpeg

QUALITIES = (30, 98)
"""The least and the best quality that is tried."""


POSTER = 80
"""Quality of what is seen before anything is decoded."""


class Jpeg(NamedTuple):
    """A picture in JPEG: its bytes, and what they show, uint8 (H, W, 3)."""

    data: bytes
    shown: np.ndarray


def encoded(picture: np.ndarray, quality: int) -> Jpeg:
    """A picture, uint8 (H, W, 3) in sRGB, in JPEG of that ``quality``, 1 to 100."""
    return Jpeg(*encoded_jpeg(picture, quality))


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
