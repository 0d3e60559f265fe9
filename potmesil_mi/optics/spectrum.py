"""Wavelengths: what an sRGB film takes of each part of the visible spectrum."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

SPECTRUM: Literal["spectrum"] = "spectrum"
"""The word for wavelengths of the whole visible spectrum, in place of numbers."""

BANDS: Mapping[int, tuple[float, float, int]] = {
    0: (560, 680, 9),
    1: (490, 610, 9),
    2: (410, 510, 9),
}
"""Least and greatest wavelength in nm of red, green and blue, and how many between."""


def sensitivity(channel: int) -> tuple[tuple[float, float], ...]:
    """Wavelengths in nm, and which share of a channel of an sRGB film each has.

    The colour matching functions are the analytic fits of Wyman, Sloan and Shirley (2013).
    """
    least, most, count = BANDS[channel]
    wavelength = np.linspace(least, most, count)

    def lobe(height: float, middle: float, left: float, right: float) -> np.ndarray:
        slope = np.where(wavelength < middle, left, right)
        return height * np.exp(-0.5 * np.square((wavelength - middle) * slope))

    x = lobe(0.362, 442.0, 0.0624, 0.0374) + lobe(1.056, 599.8, 0.0264, 0.0323)
    x += lobe(-0.065, 501.1, 0.0490, 0.0382)
    y = lobe(0.821, 568.8, 0.0213, 0.0247) + lobe(0.286, 530.9, 0.0613, 0.0322)
    z = lobe(1.217, 437.0, 0.0845, 0.0278) + lobe(0.681, 459.0, 0.0385, 0.0725)
    to_rgb = ((3.2406, -1.5372, -0.4986), (-0.9689, 1.8758, 0.0415), (0.0557, -0.2040, 1.0570))
    taken = sum(c * f for c, f in zip(to_rgb[channel], (x, y, z), strict=True))
    share = np.maximum(taken, 0) / np.maximum(taken, 0).sum()
    return tuple(zip(wavelength.tolist(), share.tolist(), strict=True))
