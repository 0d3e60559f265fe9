"""Spreading: the images of a slice, each by its kernel, become light. Linear in the images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..optics.convolution import convolve_cyclically

ROWS = 32
"""Rows of an image that are worked on at once: they stay in the processor's cache."""


def spread(images: Sequence[np.ndarray], kernels: Sequence[np.ndarray]) -> np.ndarray:
    """The sum of images, float32 (H, W, C), each spread by its kernel: float32 (H, W, C).

    A kernel is an array (K, L), or a short symmetric row (n,) that spreads along both axes one
    after the other. Around the light, images have empty borders as wide as half their kernels.
    """
    wide = [pair for pair in zip(images, kernels, strict=True) if pair[1].ndim == 2]
    total = convolve_cyclically(*zip(*wide, strict=True)) if wide else np.zeros_like(images[0])
    for image, kernel in zip(images, kernels, strict=True):
        if kernel.ndim == 1:
            _add_spread_by_row(total, image, kernel)
    return total


def _add_spread_by_row(total: np.ndarray, image: np.ndarray, row: np.ndarray) -> None:
    """Add ``image``, (H, W, C), to ``total``, spread by a short symmetric row along both axes.

    The border of the image, as wide as half the row, must be empty.
    """
    middle = len(row) // 2
    weights = row[middle:].astype(image.dtype)
    for start in range(middle, len(image) - middle, ROWS):
        end = min(start + ROWS, len(image) - middle)
        down = image[start:end] * weights[0]
        for step in range(1, middle + 1):
            pair = image[start - step : end - step] + image[start + step : end + step]
            pair *= weights[step]
            down += pair
        if middle == 0:
            total[start:end] += down
            continue
        for step in range(1, middle + 1):
            pair = down[:, : -2 * step] + down[:, 2 * step :]
            pair *= weights[step]
            total[start:end, step:-step] += pair
        down *= weights[0]
        total[start:end] += down
