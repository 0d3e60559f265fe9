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

    ``share`` is the part of the light of a ray that goes by a lesser lobe, 0 where there is none,
    and empty unless lobes were asked for. They are float32, uint64, float32 and float32, (N,) each.
    """

    through: np.ndarray
    visibility: np.ndarray
    depth: np.ndarray
    share: np.ndarray

    def chosen(self, which: np.ndarray) -> SeenThrough:
        """Those of the samples of which ``which``, bool (N,), is true."""
        return SeenThrough(*(column[which] for column in self))


def seen_through(
    x: np.ndarray,
    y: np.ndarray,
    rays: PrimaryRays,
    lens: LensRays,
    start: np.ndarray | None = None,
    lesser: np.ndarray | None = None,
    which: np.ndarray | None = None,
) -> SeenThrough:
    """Through what primary rays show what they do, and which points of the ``lens`` see that.

    ``x``, ``y``, float32 (N,), are the rays' positions in pixels of the film, and ``start`` where
    on them they begin, in scene units, if it is not at the pinhole. Of what is seen directly all of
    it is 0. With ``lesser``, uint32 (N,), it is what they show by way of the lesser lobe of such a
    number, see :func:`potmesil_mi.tracing.virtual_depth.trace_visible`. Only the rays ``which``,
    int (n,), are followed, if they are given.
    """
    through, visibility = np.zeros(len(x), np.float32), np.zeros(len(x), np.uint64)
    depth = np.zeros(len(x), np.float32)
    share = np.zeros(0 if lesser is None else len(x), np.float32)
    for part in track(wavefronts(len(x) if which is None else len(which), 1), LABEL):
        number = np.arange(part.start, part.stop) if which is None else which[part]
        begins = np.zeros(len(number), np.float32) if start is None else start[number]
        at_x, at_y, at = (from_numpy(mi.Float, of) for of in (x[number], y[number], begins))
        ray = rays.begun_at(mi.Point2f(at_x, at_y), at)
        lobe = None if lesser is None else from_numpy(mi.UInt32, lesser[number])
        visible = rays.visible(ray, lobe)
        image = VirtualImage.of(ray, visible, rays)
        through_window, first = visible.through_window, rays.depth(visible.first)
        if lesser is not None:
            through_window = through_window & visible.by_lesser
        own_share = dr.select(visible.by_lesser, visible.share, 0)
        dr.eval(through_window, first, visible.depth, image, own_share)
        if lesser is not None:
            share[number], depth[number] = np.array(own_share), np.array(visible.depth)
        index = dr.compress(through_window)
        if dr.width(index) == 0:
            continue
        there = number[np.array(index)]
        through[there] = np.array(dr.gather(mi.Float, first, index))
        depth[there] = np.array(dr.gather(mi.Float, visible.depth, index))
        cell = cells_of(x[there], y[there], CELL_SAMPLES)
        image = dr.gather(VirtualImage, image, index)
        visibility[there] = visibility_of(image, x[there], y[there], cell, lens)
    return SeenThrough(through, visibility, depth, share)
