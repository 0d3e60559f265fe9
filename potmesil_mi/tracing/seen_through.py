"""What is seen through windows: how deep these are, and which points of the lens see it.

The image in a mirror may be in focus where the mirror's rim is not. Who covers whom depends on the
rim, and a point of the lens sees the image where the ray towards it, reflected and refracted as the
pinhole's was, ends where that did. That cannot be inferred from other samples, so it is kept.
"""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import from_numpy
from .._progress import track
from .images import VirtualImage, visibility_of
from .lens_rays import LensRays
from .passes import wavefronts
from .peeling import cells_of
from .rays import PrimaryRays

LABEL = "Windows"
"""What is said of the progress."""

CELL_SAMPLES = 64
"""Samples, at least, of such a cell on the average."""


class SeenThrough(NamedTuple):
    """The columns ``through`` and ``visibility`` of samples, and the ``depth`` of the images.

    ``share`` is the part of the light of a ray that goes by a lesser lobe, 0 where there is none.
    They are float32, uint64, float32 and float32, (N,) each.
    """

    through: np.ndarray
    visibility: np.ndarray
    depth: np.ndarray
    share: np.ndarray

    def chosen(self, which: np.ndarray) -> SeenThrough:
        """Those of the samples of which ``which``, bool (N,), is true."""
        return SeenThrough(*(column[which] for column in self))

    def among(self, count: int, which: np.ndarray) -> SeenThrough:
        """Those of ``count`` samples, of which they are the samples ``which``, int (N,)."""
        every = SeenThrough(*(np.zeros(count, column.dtype) for column in self))
        for column, own in zip(every, self, strict=True):
            column[which] = own
        return every

    def followed_by(self, other: SeenThrough) -> SeenThrough:
        """Those of these samples and then those of ``other``."""
        return SeenThrough(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


def seen_through(
    x: np.ndarray,
    y: np.ndarray,
    start: np.ndarray,
    rays: PrimaryRays,
    lens: LensRays,
    lesser: np.ndarray | None = None,
) -> SeenThrough:
    """Through what primary rays show what they do, and which points of the ``lens`` see that.

    ``x``, ``y``, float32 (N,), are the rays' positions in pixels of the film, and ``start`` where
    on them they begin, in scene units. Of what is seen directly all of it is 0. With ``lesser``,
    uint32 (N,), it is what they show by way of the lesser lobe of such a number, see
    :func:`potmesil_mi.tracing.virtual_depth.trace_visible`.
    """
    through, visibility = np.zeros(len(x), np.float32), np.zeros(len(x), np.uint64)
    depth, share = np.zeros(len(x), np.float32), np.zeros(len(x), np.float32)
    for part in track(wavefronts(len(x), 1), LABEL):
        place = (from_numpy(mi.Float, column[part]) for column in (x, y, start))
        at_x, at_y, begins = place
        ray = rays.begun_at(mi.Point2f(at_x, at_y), begins)
        lobe = None if lesser is None else from_numpy(mi.UInt32, lesser[part])
        visible = rays.visible(ray, lobe)
        image = VirtualImage.of(ray, visible, rays)
        through_window, first = visible.through_window, rays.depth(visible.first)
        if lesser is not None:
            through_window = through_window & visible.by_lesser
        own_share = dr.select(visible.by_lesser, visible.share, 0)
        dr.eval(through_window, first, visible.depth, image, own_share)
        if lesser is not None:
            share[part], depth[part] = np.array(own_share), np.array(visible.depth)
        index = dr.compress(through_window)
        if dr.width(index) == 0:
            continue
        there = np.array(index).astype(np.int64) + part.start
        through[there] = np.array(dr.gather(mi.Float, first, index))
        depth[there] = np.array(dr.gather(mi.Float, visible.depth, index))
        cell = cells_of(x[there], y[there], CELL_SAMPLES)
        image = dr.gather(VirtualImage, image, index)
        visibility[there] = visibility_of(image, x[there], y[there], cell, lens)
    return SeenThrough(through, visibility, depth, share)
