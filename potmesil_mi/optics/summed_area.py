"""Summed-area tables: sums over any rectangle of a picture from four of their elements."""

from __future__ import annotations

import numpy as np


def summed_area(values: np.ndarray) -> np.ndarray:
    """Sums of ``values`` (H, W) above and left of each corner of its elements, (H+1, W+1)."""
    integral = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    integral[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
    return integral


def interpolated(values: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """``values`` (H, W) at columns x and rows y, beyond the border those of the border."""
    height, width = values.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    column = np.minimum(np.floor(x).astype(int), width - 2)
    row = np.minimum(np.floor(y).astype(int), height - 2)
    fx, fy = x - column, y - row
    upper = values[row, column] * (1 - fx) + values[row, column + 1] * fx
    lower = values[row + 1, column] * (1 - fx) + values[row + 1, column + 1] * fx
    return upper * (1 - fy) + lower * fy
