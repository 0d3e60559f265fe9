"""Which blocks of a slice's images have light: found before it is scattered, on the host."""

from __future__ import annotations

import itertools
import math

import numpy as np
import scipy.ndimage

from ..samples.raster import Window
from .blocks import BLOCK
from .slices import CirclePlan, DepthSlice, PointPlan
from .small_circles import REACH

CELL = 8
"""Pixels on a side of the cells, parts of blocks, from which light of lens points is followed."""

ROUNDING = 1e-4
"""Part by which radii on the host may differ from those of the splatted light."""

BESIDE = 2
"""Pixels farther than its lens point that light may be: it is shared between two, and rounded."""


def lit_by_circles(circles: CirclePlan, box: Window) -> np.ndarray:
    """Which blocks of the images of unoccluded fragments have light, bool (K, h, w)."""
    lit = dark(len(circles.kernels), box, BLOCK)
    some, part, single = circles.fragments, circles.part, circles.single_points
    before = circles.kernel_of_bin[some.bin[part] - circles.first_bin]
    own = some.x[part] - box.left, some.y[part] - box.top
    mark(lit, before, *own, BLOCK)
    if circles.small is not None:
        for across, down in itertools.product((-REACH, REACH), repeat=2):
            mark(lit, before, own[0] + across, own[1] + down, BLOCK)
    reach = circles.moved_reach
    for across in (-reach, reach):
        for down in (-reach, reach):
            x, y = some.x[single] + (across - box.left), some.y[single] + (down - box.top)
            mark(lit, before[single - part.start], x, y, BLOCK)
    lit[1:] |= lit[:-1].copy()
    return lit


def lit_by_points(depth_slice: DepthSlice, points: PointPlan) -> np.ndarray:
    """Which blocks of the images of occluded fragments may have light, bool (K, h, w).

    The light of a lens point is no farther from the fragment than its circle and its path reach.
    """
    box, blur, count = depth_slice.box, depth_slice.blur, len(points.kernels)
    some, part = points.occluded.fragments, points.part
    radii = np.abs(some.vergence[part] - np.float32(blur.focused_vergence))
    radii *= np.float32(blur.radius_per_vergence)
    along, deeper = some.path_reach
    deeper = np.float32(deeper * blur.radius_per_vergence)
    x, y = (
        of[part] // points.pixel - first for of, first in ((some.x, box.left), (some.y, box.top))
    )
    # Coarse pixels and cells make circles smaller: they may be those of the octave before.
    least, radii = np.maximum(radii - deeper, 0), radii + deeper
    least = least**2 * np.float32(1 - points.cell**2) - np.float32(4 * depth_slice.smeared)
    least = np.sqrt(np.maximum(least, 0))
    edges = np.array(depth_slice.octaves[1:count], np.float32)
    first = np.searchsorted(edges * np.float32(1 + ROUNDING), least, side="right")
    last = np.searchsorted(edges * np.float32(1 - ROUNDING), radii, side="right")
    lit = np.empty((count, *(-(-size // BLOCK) for size in box.shape)), bool)
    for octave in range(count):
        here = (first <= octave) & (octave <= last)
        reach = points.occluded.reach * float(radii[here].max(initial=0))
        lit[octave] = lit_around(x[here], y[here], box, reach + along / points.pixel)
    return lit


def lit_around(x: np.ndarray, y: np.ndarray, box: Window, reach: float) -> np.ndarray:
    """Which blocks of an image have light of the pixels (x, y) or of any within ``reach``.

    bool (h, w).
    """
    cells = dark(1, box, CELL)
    mark(cells, 0, x, y, CELL)
    size = 2 * math.ceil((reach + BESIDE) / CELL) + 1
    near = scipy.ndimage.maximum_filter(cells[0], size, mode="constant")
    down, across = (size // (BLOCK // CELL) for size in near.shape)
    return np.asarray(near.reshape(down, BLOCK // CELL, across, BLOCK // CELL).any(axis=(1, 3)))


def dark(count: int, box: Window, side: int) -> np.ndarray:
    """Parts of ``count`` images, a ``side`` wide, as many as fill the blocks of each; unlit."""
    return np.zeros((count, *(-(-size // BLOCK) * (BLOCK // side) for size in box.shape)), bool)


def mark(lit: np.ndarray, image: np.ndarray | int, x: np.ndarray, y: np.ndarray, side: int) -> None:
    """Mark the parts of images, a ``side`` wide, that pixels are in."""
    _, down, across = lit.shape
    lit.reshape(-1)[(image * np.int32(down) + y // side) * np.int32(across) + x // side] = True
