"""Convolution: how images are spread by kernels. Each function is linear in the images."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
import scipy.fft

ROWS = 32
"""Rows of an image that are worked on at once: they stay in the processor's cache."""


def fast_size(size: int) -> int:
    """The least number from ``size`` on for which a transform is quick."""
    return scipy.fft.next_fast_len(size, real=True)


def convolve_fully(image: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """The whole convolution of two float64 arrays (H, W) and (K, L): (H + K - 1, W + L - 1)."""
    shape = [a + b - 1 for a, b in zip(image.shape, kernel.shape, strict=True)]
    padded = [fast_size(size) for size in shape]
    with scipy.fft.set_workers(os.cpu_count() or 1):
        spectrum = scipy.fft.rfftn(image, padded) * scipy.fft.rfftn(kernel, padded)
        return scipy.fft.irfftn(spectrum, padded)[: shape[0], : shape[1]]


def convolve_cyclically(images: Sequence[np.ndarray], kernels: Sequence[np.ndarray]) -> np.ndarray:
    """The sum of images, each spread by its kernel, by one inverse transform.

    Images are float32 (H, W, C), with C channels; kernels (K, L), of odd sizes up to (H, W), whose
    middle is the pixel's own. What leaves the frame on one side comes in on the other. Images may
    be overwritten.
    """
    height, width = images[0].shape[:2]
    total = np.zeros(0, dtype=np.complex64)
    with scipy.fft.set_workers(os.cpu_count() or 1):
        for image, kernel in zip(images, kernels, strict=True):
            spectrum = scipy.fft.rfft2(image, axes=(0, 1), overwrite_x=True)
            spectrum *= _spectrum(kernel, height, width)[..., None]
            total = np.add(total, spectrum, out=total) if total.size else spectrum
        return scipy.fft.irfft2(total, (height, width), axes=(0, 1), overwrite_x=True)


def _spectrum(kernel: np.ndarray, height: int, width: int) -> np.ndarray:
    """The transform, complex64, of a kernel whose middle is moved to the frame's first pixel."""
    rows, columns = kernel.shape
    across = np.zeros((rows, width), dtype=np.float32)
    across[:, :columns] = kernel
    across = scipy.fft.rfft(np.roll(across, -(columns // 2), axis=1))
    spectrum = np.zeros((height, across.shape[1]), dtype=np.complex64)
    spectrum[: rows - rows // 2] = across[rows // 2 :]
    spectrum[height - rows // 2 :] = across[: rows // 2]
    return scipy.fft.fft(spectrum, axis=0, overwrite_x=True)


def add_spread_by_row(total: np.ndarray, image: np.ndarray, row: np.ndarray) -> None:
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
