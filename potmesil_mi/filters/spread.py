"""What filters share: light above a threshold, and how it is taken, spread and put back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .._validation import require_number, shown
from ..optics.lens import ThinLens
from ..optics.summed_area import summed_area


def frame_width(lens: ThinLens, pixels_per_mm: float) -> float:
    """Width in pixels of the whole frame."""
    return float(lens.frame_width) * pixels_per_mm


def light_above(threshold: float, picture: np.ndarray) -> np.ndarray:
    """RGB of what is above ``threshold`` in each pixel's brightest channel, of the same hue."""
    rgb = np.maximum(picture[..., :3], 0)
    brightest = rgb.max(axis=-1, keepdims=True)
    return rgb * np.maximum(1 - threshold / np.where(brightest > 0, brightest, np.inf), 0)


def with_light_moved(picture: np.ndarray, light: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """The picture with ``light`` (H, W, 3) taken from it and put back spread by a kernel."""
    moved = picture.copy()
    moved[..., :3] += np.maximum(spread(light, kernel), 0) - light
    return moved


def spread(picture: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Convolution with a kernel (2K+1, 2L+1, C or 1), divided by what of it is in the picture."""
    from ..optics.convolution import convolve_by_spectrum, kernel_spectrum, padded_shape

    height, width = picture.shape[:2]
    frame = padded_shape((height, width), kernel.shape[:2])
    result = np.empty_like(picture)
    for channel in range(picture.shape[-1]):
        if channel < kernel.shape[-1]:
            spectrum = kernel_spectrum(kernel[..., channel], frame)
            inside = _share_inside(kernel[..., channel], (height, width))
        result[..., channel] = convolve_by_spectrum(picture[..., channel], spectrum, frame) / inside
    return result


def _share_inside(kernel: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """How much of the kernel around each pixel meets a picture of ``size``, (H, W)."""
    integral = summed_area(kernel)
    for axis, n in enumerate(size):
        reach = kernel.shape[axis] // 2
        place = np.arange(n)
        above = np.minimum(place + reach + 1, 2 * reach + 1)
        below = np.maximum(place - n + 1 + reach, 0)
        integral = integral.take(above, axis) - integral.take(below, axis)
    return integral


def three_numbers(
    name: str, values: Any, least: float, most: float = math.inf
) -> tuple[float, float, float]:
    """Three numbers, each checked."""
    if not isinstance(values, (tuple, list, np.ndarray)):
        raise TypeError(f"{name}={shown(values)}: must be three numbers")
    if len(values) != 3:
        raise ValueError(f"{name}={shown(values)}: must be three numbers")
    for value in values:
        require_number(name, value, least, most)
    red, green, blue = (float(value) for value in values)
    return red, green, blue
