"""Depths that were filtered as colours are: at silhouettes they are of neither surface.

Half of a pixel at 1 m and half at 9 m give 5 m, where nothing is. Each such depth becomes that of
the surface which takes more of it.
"""

from __future__ import annotations

import numpy as np
import scipy.ndimage

from .around import Around

REACH = 5
"""Pixels on a side of what a filter mixes; Mitsuba's Gaussian has a radius of 2 of them."""

STEEPER = 3.0
"""How many times as much depth changes within that reach at a silhouette as beside it."""

PURE = 0.1
"""Part of the way from the near depth to the far one up to which a depth is that of a surface."""

LEAST_RATIO = 1.02
"""Ratio of two depths that a silhouette is between, at least."""


def unfiltered(depth: np.ndarray, alpha: np.ndarray | None) -> np.ndarray:
    """The depths of surfaces, (H, W): ``inf`` where there is none, which ``depth`` has as 0.

    ``alpha`` is how much of each pixel anything covers. Without it what is beside nothing has the
    depth of the farthest around, or none.
    """
    depth = np.asarray(depth, np.float64)
    if alpha is not None:
        covered = np.where(alpha > 0, depth / np.maximum(alpha, 1e-6), 0)
        nothing = (alpha < 0.5) | (covered <= 0)
    else:
        covered = depth
        around = scipy.ndimage.maximum_filter(depth, REACH, mode="nearest")
        beside = scipy.ndimage.minimum_filter(depth, REACH, mode="nearest") <= 0
        nothing = (depth <= 0) | (beside & (depth < around / 2))
        covered = np.where(beside & ~nothing, around, depth)
    near, far = (
        of(np.where(nothing, otherwise, covered), REACH, mode="nearest")
        for of, otherwise in (
            (scipy.ndimage.minimum_filter, np.inf),
            (scipy.ndimage.maximum_filter, 0.0),
        )
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.where(far > 0, far / near, 1.0)
        part = np.where(far > near, (covered - near) / (far - near), 0.0)
    usual = scipy.ndimage.minimum_filter(change, 2 * REACH - 1, mode="nearest")
    edge = (change - 1 > STEEPER * (usual - 1)) & (change > LEAST_RATIO) & ~nothing
    mixed = edge & (np.minimum(part, 1 - part) > PURE)
    covered[mixed] = _of_one_surface(covered, mixed, ~nothing, near, far)
    return np.where(nothing, np.inf, covered)


def _of_one_surface(
    depth: np.ndarray, mixed: np.ndarray, there: np.ndarray, near: np.ndarray, far: np.ndarray
) -> np.ndarray:
    """The depths of ``mixed`` pixels: of the nearest one that shows the side which has more of it.

    Each has a depth ``near`` and one ``far`` around it; pixels ``there`` show something. Where none
    shows that side alone, the pixel keeps its depth.
    """
    row, column = np.nonzero(mixed)
    around = Around.of(row, column, depth.shape, REACH // 2)
    least, most, own = near[mixed], far[mixed], depth[mixed]
    beside = depth[around.at]
    part = (beside - least) / (most - least)
    nearer = own < (least + most) / 2
    pure = np.where(nearer, part <= PURE, part >= 1 - PURE)
    index = around.first(around.inside & there[around.at] & pure)
    return np.where(index >= 0, beside[index, np.arange(len(row))], own)
