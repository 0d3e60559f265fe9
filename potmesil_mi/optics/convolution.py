"""Convolution by Fourier transforms: how images are spread by kernels.

Kernels have odd sizes, and their middle is the pixel's own. Each function is linear in the images.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import scipy.fft
from numpy.typing import DTypeLike

from .._threads import processors


def fast_size(size: int) -> int:
    """The least number from ``size`` on for which a transform is quick."""
    return scipy.fft.next_fast_len(size, real=True)


def padded_shape(size: tuple[int, int], kernel: tuple[int, int]) -> tuple[int, int]:
    """The frame in which images of ``size`` (H, W) meet nothing that wraps around.

    ``kernel`` is the shape (2K+1, 2L+1) of the kernel: the frame has K rows and L columns more.
    """
    return fast_size(size[0] + kernel[0] // 2), fast_size(size[1] + kernel[1] // 2)


def kernel_spectrum(
    kernel: np.ndarray, frame: tuple[int, int], dtype: DTypeLike = np.float64
) -> np.ndarray:
    """The transform of a kernel (2K+1, 2L+1) whose middle is moved to the frame's first pixel.

    The kernel is at most as large as the frame (H, W); the result, (H, W//2 + 1), is complex of
    the precision of ``dtype``, float32 or float64.
    """
    rows, columns = kernel.shape
    height, width = frame
    across = np.zeros((rows, width), dtype=dtype)
    across[:, :columns] = kernel
    with scipy.fft.set_workers(processors()):
        across = scipy.fft.rfft(np.roll(across, -(columns // 2), axis=1))
        spectrum = np.zeros((height, across.shape[1]), dtype=across.dtype)
        spectrum[: rows - rows // 2] = across[rows // 2 :]
        spectrum[height - rows // 2 :] = across[: rows // 2]
        return scipy.fft.fft(spectrum, axis=0, overwrite_x=True)


def convolve_by_spectrum(
    image: np.ndarray, spectrum: np.ndarray, frame: tuple[int, int]
) -> np.ndarray:
    """An image (H, W), spread by the kernel of a :func:`kernel_spectrum` of the ``frame``.

    What leaves the frame on one side comes in on the other, see :func:`padded_shape`.
    """
    height, width = image.shape
    with scipy.fft.set_workers(processors()):
        light = scipy.fft.rfft2(image, frame) * spectrum
        return scipy.fft.irfft2(light, frame)[:height, :width]


def convolve_fully(image: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """The whole convolution of two float64 arrays (H, W) and (K, L): (H + K - 1, W + L - 1)."""
    shape = [a + b - 1 for a, b in zip(image.shape, kernel.shape, strict=True)]
    padded = [fast_size(size) for size in shape]
    with scipy.fft.set_workers(processors()):
        spectrum = scipy.fft.rfftn(image, padded) * scipy.fft.rfftn(kernel, padded)
        return scipy.fft.irfftn(spectrum, padded)[: shape[0], : shape[1]]


def correlations(
    light: np.ndarray, images: Iterable[np.ndarray], shapes: Sequence[tuple[int, int]]
) -> list[np.ndarray]:
    """The transpose of spreading as a function of kernels: what light has of each kernel's pixels.

    ``light`` and the images are (H, W, C). A kernel (2K+1, 2L+1), of one of the ``shapes``, spreads
    each image; its pixel that moves the image by some steps has the sum of the products of light
    and the image there. The result is float64.
    """
    size = light.shape[0], light.shape[1]
    frame = padded_shape(size, (max(of[0] for of in shapes), max(of[1] for of in shapes)))
    found = []
    with scipy.fft.set_workers(processors()):
        spectrum = scipy.fft.rfft2(light.astype(np.float64), frame, axes=(0, 1))
        for image, (rows, columns) in zip(images, shapes, strict=True):
            own = scipy.fft.rfft2(image.astype(np.float64), frame, axes=(0, 1))
            products = scipy.fft.irfft2((own.conj() * spectrum).sum(axis=2), frame)
            moved = np.roll(products, (rows // 2, columns // 2), axis=(0, 1))
            found.append(moved[:rows, :columns])
    return found


def convolve_cyclically(
    images: Sequence[tuple[np.ndarray, int, np.ndarray]], frame: tuple[int, int], workers: int = 1
) -> np.ndarray:
    """The sum of images, each with the spectrum that spreads it, by one inverse transform.

    Images are float32 (H, W, C), with C channels, and fit into the ``frame`` from the row on that
    is given with each; the frame is filled up with zeros. Spectra, see :func:`kernel_spectrum`,
    have all channels. What leaves the frame on one side comes in on the other.
    """
    total = np.zeros(0, dtype=np.complex64)
    height, width = frame
    with scipy.fft.set_workers(workers):
        for image, top, spectrum in images:
            light = np.zeros((height, width // 2 + 1, image.shape[2]), np.complex64)
            light[top : top + len(image)] = scipy.fft.rfft(image, width, axis=1)
            light = scipy.fft.fft(light, axis=0, overwrite_x=True)
            light *= spectrum
            total = np.add(total, light, out=total) if total.size else light
        return scipy.fft.irfft2(total, frame, axes=(0, 1), overwrite_x=True)


def spectrum_of(image: np.ndarray, frame: tuple[int, int]) -> np.ndarray:
    """The transform of an image, float32 (H, W, C), that fits into the ``frame``; complex64."""
    return scipy.fft.rfft2(image, frame, axes=(0, 1))


def correlate_cyclically(
    spectrum: np.ndarray, kernel: np.ndarray, frame: tuple[int, int]
) -> np.ndarray:
    """What the transpose of spreading by a kernel makes of an image, float32 (H, W, C).

    ``spectrum`` is that of the image, ``kernel`` the :func:`kernel_spectrum` of the ``frame``.
    """
    light = spectrum * np.conj(kernel)[..., None]
    return scipy.fft.irfft2(light, frame, axes=(0, 1), overwrite_x=True)
