"""The pixels around some of a picture."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np


class Around(NamedTuple):
    """The pixels around n others, m of each, nearest first.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``at``                        their rows and columns, (m, n) each: indices of a picture
    ``inside``                    bool (m, n): not so beyond the picture, where the pixel itself
                                  stands in its place
    ``apart``                     (m, 1), how far away they are
    ============================  ==========================================================
    """

    at: tuple[np.ndarray, np.ndarray]
    inside: np.ndarray
    apart: np.ndarray

    @classmethod
    def of(cls, row: np.ndarray, column: np.ndarray, shape: tuple[int, ...], reach: int) -> Around:
        """Those up to ``reach`` rows and columns away in a picture of a ``shape``."""
        each = range(-reach, reach + 1)
        steps = np.array(sorted(itertools.product(each, repeat=2), key=lambda at: math.hypot(*at)))
        down, across = steps[1:, :1], steps[1:, 1:]
        rows, columns = row + down, column + across
        inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
        at = np.where(inside, rows, row), np.where(inside, columns, column)
        return cls(at, inside, np.hypot(down, across))

    def first(self, which: np.ndarray) -> np.ndarray:
        """The index, of m, of the nearest of which ``which``, bool (m, n), is true; -1 for none."""
        index = np.argmax(which, axis=0)
        return np.where(which[index, np.arange(which.shape[1])], index, -1)
