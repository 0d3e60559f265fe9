"""What a lens sees that its pinhole does not: behind near edges, and beyond the frame.

Two depths move against each other by up to R f |1/z_1 - 1/z_2| pixels as one looks from the
points of the lens one after the other, whatever is in focus; R f is the radius per vergence of
:mod:`potmesil_mi.optics.blur`.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.ndimage

from ..optics.blur import widest_radius_per_vergence
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..samples.raster import Window

MOST_OVERSCAN = 4
"""Most pixels of a window with overscan, per pixel of the crop window."""

SMALL_WINDOW = 1 << 16
"""Pixels that a window with overscan may have however small the crop window is."""

GROWTH = 1.5
"""Ratio of the distances at which silhouettes are looked for."""


def disoccluded(
    nearest: np.ndarray, farthest: np.ndarray, radius_per_vergence: float
) -> np.ndarray:
    """Pixels in which a lens may see something that is hidden from the pinhole.

    ``nearest`` and ``farthest`` are depths, (H, W), of what each pixel shows;
    ``radius_per_vergence`` is that of the lens, in pixels. What is hidden in a pixel shows where
    a farther surface is seen within the parallax of the two depths. Returns bool (H, W).
    """
    near, far = (
        np.float32(radius_per_vergence) / depth.astype(np.float32) for depth in (nearest, farthest)
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


def overscan(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    spacing: float,
    crop: Window,
    lens: ThinLens,
    camera: Camera,
) -> Window:
    """The window beyond which nothing can spread light into the crop window.

    ``x``, ``y`` (N,) are positions in pixels of the film, ``spacing`` apart, and ``z`` the depths
    that rays through them meet; ``crop`` is the crop window. Every focus between the depths in
    the crop window is counted, and the lens's own. The window has at most ``MOST_OVERSCAN`` times
    the pixels of the crop window, or ``SMALL_WINDOW``.
    """
    beyond = (crop.left - x, x - crop.right, crop.top - y, y - crop.bottom)
    distance = np.hypot(
        np.maximum(np.maximum(beyond[0], beyond[1]), 0.0),
        np.maximum(np.maximum(beyond[2], beyond[3]), 0.0),
    )
    vergence = 1 / z.astype(np.float64)
    inside = vergence[distance == 0]
    focused = 1 / float(lens.plain().focus_distance)
    least = min(focused, float(inside.min(initial=focused)))
    most = max(focused, float(inside.max(initial=focused)))
    scale = widest_radius_per_vergence(lens, camera, 1 / most if most > 0 else math.inf)
    reaches = scale * np.maximum(vergence - least, most - vergence) >= distance
    sides = []
    for outwards in beyond:
        reaching = outwards[reaches & (outwards > 0)]
        sides.append(math.ceil(float(reaching.max()) + spacing) if reaching.size else 0)
    return _bounded(crop, sides)


def _bounded(crop: Window, sides: list[int]) -> Window:
    """The crop window with overscan of so many pixels left, right, above and below, or fewer."""
    most = max(MOST_OVERSCAN * crop.size, SMALL_WINDOW)
    while True:
        left, right, above, below = sides
        width, height = crop.width + left + right, crop.height + above + below
        if width * height <= most:
            return Window(crop.left - left, crop.top - above, width, height)
        sides = [side * 3 // 4 for side in sides]
