"""What a lens sees that its pinhole does not: behind near edges.

Two depths move against each other by up to R f |1/z_1 - 1/z_2| pixels as one looks from the
points of the lens one after the other, whatever is in focus; R f is the radius per vergence of
:mod:`potmesil_mi.optics.blur`.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.ndimage

APART = 1.01
"""Ratio of depths from which on two surfaces are counted as one before the other."""

GROWTH = 1.25
"""Ratio of the distances at which silhouettes are looked for."""


def disoccluded(
    nearest: np.ndarray, farthest: np.ndarray, radius_per_vergence: float
) -> np.ndarray:
    """Pixels in which a lens may see something that is hidden from the pinhole.

    ``nearest`` and ``farthest`` are depths, (H, W), of what each pixel shows: ``inf`` and 0 where
    it has no sample. ``radius_per_vergence`` is that of the lens, in pixels. What is hidden in a
    pixel shows where a farther surface is seen within the parallax of the two depths. Returns bool
    (H, W).
    """
    with np.errstate(divide="ignore"):
        near, far = (
            np.float32(radius_per_vergence) / depth.astype(np.float32)
            for depth in (nearest, farthest)
        )
    result = np.zeros(near.shape, dtype=bool)
    distance, before = 1, 0.0
    largest = float(near.max() - far.min())
    while before <= largest + 1 and before < max(near.shape):
        behind = scipy.ndimage.minimum_filter(far, 2 * distance + 1, mode="nearest")
        # Within a pixel, the silhouette of a parallax below half a pixel is not to be seen.
        result |= near - behind >= max(before - 1, 0.5)
        before = distance
        distance = max(distance + 1, math.ceil(distance * GROWTH))
    return result


def uncovered(nearest: np.ndarray, farthest: np.ndarray, reach: float) -> np.ndarray:
    """Pixels in which motion of up to ``reach`` pixels may uncover what is hidden, bool (H, W).

    ``nearest`` and ``farthest`` are as in :func:`disoccluded`. It does where a farther surface is
    seen within reach.
    """
    behind = scipy.ndimage.maximum_filter(farthest, 2 * math.ceil(reach) + 1, mode="nearest")
    return behind > nearest * np.float32(APART)
