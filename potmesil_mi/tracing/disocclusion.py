"""What a lens sees that its pinhole does not: behind near edges, and beyond the frame.

Point P at depth z appears through the lens point u (in the unit disc) at
x + R f (1/z - 1/U) u pixels, where R is the aperture's radius, f the distance of the film in
pixels and U the focused distance. So two depths move against each other by up to
R f |1/z_1 - 1/z_2| pixels, whatever is in focus.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.ndimage

from ..optics.blur import widest_radius_per_vergence
from ..optics.camera import Camera
from ..optics.lens import ThinLens

MOST_OVERSCAN = 4
"""Most pixels of a window with overscan, per pixel of the crop window."""

GROWTH = 1.5
"""Ratio of the distances at which silhouettes are looked for."""


def disoccluded(nearest: np.ndarray, farthest: np.ndarray, scale: float) -> np.ndarray:
    """Pixels in which a lens may see something that is hidden from the pinhole.

    ``nearest`` and ``farthest`` are depths, (H, W), of what each pixel shows; ``scale`` is that of
    :func:`potmesil_mi.optics.blur.radius_per_vergence`. What is hidden in a pixel shows where a
    farther surface is seen within the parallax of the two depths. Returns bool (H, W).
    """
    near, far = (np.float32(scale) / depth.astype(np.float32) for depth in (nearest, farthest))
    result = np.zeros(near.shape, dtype=bool)
    distance, before = 1, 0.0
    largest = float(near.max() - far.min())
    while before <= largest + 1 and before < max(near.shape):
        behind = scipy.ndimage.minimum_filter(far, 2 * distance + 1, mode="nearest")
        # Within a pixel there is no silhouette of less than half a pixel's parallax to be seen.
        result |= near - behind >= max(before - 1, 0.5)
        before = distance
        distance = max(distance + 1, math.ceil(distance * GROWTH))
    return result


def overscan(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    spacing: float,
    crop: tuple[int, int, int, int],
    lens: ThinLens,
    camera: Camera,
) -> tuple[int, int, int, int]:
    """The window beyond which nothing can spread light into the crop window.

    ``x``, ``y`` (N,) are positions in pixels of the film, ``spacing`` apart, and ``z`` the depths
    seen there; ``crop`` and the result are left, top, width and height in pixels. Counted is
    every focus between the depths in the crop window, and that of the lens.
    """
    left, top, width, height = crop
    beside = np.maximum(np.maximum(left - x, x - (left + width)), 0.0)
    above = np.maximum(np.maximum(top - y, y - (top + height)), 0.0)
    distance = np.hypot(beside, above)
    vergence = 1 / z.astype(np.float64)
    inside = vergence[distance == 0]
    focused = 1 / float(lens.plain().focus_distance)
    least = min(focused, float(inside.min(initial=focused)))
    most = max(focused, float(inside.max(initial=focused)))
    scale = widest_radius_per_vergence(lens, camera, 1 / most if most > 0 else math.inf)
    reaches = scale * np.maximum(vergence - least, most - vergence) >= distance
    sides = []
    for beyond in (left - x, x - (left + width), top - y, y - (top + height)):
        seen = beyond[reaches & (beyond > 0)]
        sides.append(math.ceil(float(seen.max()) + spacing) if seen.size else 0)
    most = max(MOST_OVERSCAN * width * height, 1 << 16)
    while (width + sides[0] + sides[1]) * (height + sides[2] + sides[3]) > most:
        sides = [side * 3 // 4 for side in sides]
    return (
        left - sides[0],
        top - sides[2],
        width + sides[0] + sides[1],
        height + sides[2] + sides[3],
    )
