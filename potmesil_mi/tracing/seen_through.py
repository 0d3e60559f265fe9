"""What is seen through windows: how deep these are, and which points of the lens see it.

The image in a mirror may be in focus where the mirror's rim is not. Who covers whom depends on the
rim, and a point of the lens sees the image where the ray towards it, reflected and refracted as the
pinhole's was, ends where that did. That cannot be inferred from other samples, so it is kept.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.ndimage
import scipy.optimize

from .._backend import from_numpy
from .._progress import track
from ..optics.disc import lens_points
from ..samples.columns import (
    ELSEWHERE,
    VISIBILITY_POINTS,
    Columns,
    points_that_see,
    visibility_points,
)
from ..samples.raster import Window
from .buffers import Shown, to_host
from .lens_rays import TURN, LensRays
from .passes import wavefronts
from .patterns import sampler_cells
from .peeling import cells_of
from .rays import PrimaryRays
from .virtual_depth import Visible
from .windows import Chain, meets_end

LABEL = "Windows"
"""What is said of the progress."""

TOLERANCE = 4.0
"""How far rays of the lens may miss what they are aimed at, in pixels: only plane mirrors show all
of the lens the same image."""

FEW_POINTS = 4
"""So many of the points are tried first, others for each sample in turn. What they see in a cell of
the film is seen by all."""

TRIED_IN_A_PIXEL = 256
"""So many are tried by all samples of a pixel in the other cells, others by each in turn, and
``FEW_POINTS`` by each at least. What a point sees that is not tried is what one near it sees."""

CELL_SAMPLES = 64
"""Samples, at least, of such a cell on the average."""

MOST_SHIFTED = 0.95
"""How far images are shifted that are sought: as far as this part of those that are known."""

FINDERS = 2
"""Rays by which what the pinhole does not see is looked for, for each of its samples. Most find
nothing new, and are not shaded."""

ALL = 2**VISIBILITY_POINTS - 1
"""``visibility`` of what all points of the lens see."""


class SeenThrough(NamedTuple):
    """The columns ``through`` and ``visibility`` of samples, and the ``depth`` of the images.

    They are float32, uint64 and float32, (N,) each.
    """

    through: np.ndarray
    visibility: np.ndarray
    depth: np.ndarray

    def followed_by(self, other: SeenThrough) -> SeenThrough:
        """Those of these samples and then those of ``other``."""
        return SeenThrough(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


def seen_through(
    x: np.ndarray, y: np.ndarray, start: np.ndarray, rays: PrimaryRays, lens: LensRays
) -> SeenThrough:
    """Through what primary rays show what they do, and which points of the ``lens`` see that.

    ``x``, ``y``, float32 (N,), are the rays' positions in pixels of the film, and ``start`` where
    on them they begin, in scene units. Of what is seen directly all of it is 0.
    """
    through, visibility = np.zeros(len(x), np.float32), np.zeros(len(x), np.uint64)
    depth = np.zeros(len(x), np.float32)
    for part in track(wavefronts(len(x), 1), LABEL):
        place = (from_numpy(mi.Float, column[part]) for column in (x, y, start))
        at_x, at_y, begins = place
        ray = rays.begun_at(mi.Point2f(at_x, at_y), begins)
        visible = rays.visible(ray)
        image = _Image.of(ray, visible, rays)
        through_window, first = visible.through_window, rays.depth(visible.first)
        dr.eval(through_window, first, visible.depth, image)
        index = dr.compress(through_window)
        if dr.width(index) == 0:
            continue
        there = np.array(index).astype(np.int64) + part.start
        through[there] = np.array(dr.gather(mi.Float, first, index))
        depth[there] = np.array(dr.gather(mi.Float, visible.depth, index))
        cell = cells_of(x[there], y[there], CELL_SAMPLES)
        visibility[there] = _visibility(dr.gather(_Image, image, index), cell, lens)
    return SeenThrough(through, visibility, depth)


def seen_elsewhere(
    rays: PrimaryRays, lens: LensRays, window: Window, columns: Columns
) -> list[Columns]:
    """What the lens sees in windows and the pinhole does not: samples of layer ``ELSEWHERE``.

    Rays of the points of the lens show it. Its place is where the pinhole would see the image.
    What several of the points see is found from each of them, so that a sample there stands for
    less. ``columns`` are the samples that there are.
    """
    assert columns.through is not None
    images = columns.through > 0
    vergence = float(np.median(1 / columns.z[images]))
    each = FINDERS * rays.passes.spp
    finder = _Finder(rays, lens, window, vergence)
    around = _around(window, lens, columns)
    parts = [
        cells.chosen(cells.touch(around, window)) for cells in sampler_cells(rays.crop, window)
    ]
    passes = [cells[part] for cells in parts for part in wavefronts(len(cells), each)]
    found = []
    for cells in track(passes, LABEL):
        rays.passes.begin(len(cells) * each)
        position, _ = cells.positions(rays.passes.sampler.next_2d(), each)
        found.append(finder.found(position, np.repeat(cells.area / each, each)))
    return [part for part in found if part is not None]


def _around(window: Window, lens: LensRays, columns: Columns) -> np.ndarray:
    """The pixels of ``window``, bool (H, W), in which there may be images the pinhole does not see.

    There is one as far from an image that some points of the lens do not see as these are shifted.
    """
    assert columns.through is not None
    assert columns.visibility is not None
    partly = (columns.through > 0) & (columns.layer == 0) & (columns.visibility != ALL)
    found = np.zeros(window.size, dtype=bool)
    found[window.pixel_of(columns.x[partly], columns.y[partly])] = True
    if not found.any():
        return found.reshape(window.shape)
    apart = np.quantile(np.abs(1 / columns.through[partly] - 1 / columns.z[partly]), MOST_SHIFTED)
    reach = math.ceil(min(apart * lens.parallax, max(window.shape))) + 1
    return scipy.ndimage.maximum_filter(found.reshape(window.shape), 2 * reach + 1)


class _Finder:
    """Finds in windows what points of the lens see and the pinhole does not.

    Their rays go to where those of the pinhole are at a ``vergence``, so that most of what they
    find is seen near there.
    """

    def __init__(self, rays: PrimaryRays, lens: LensRays, window: Window, vergence: float) -> None:
        self.rays, self.lens, self.window = rays, lens, window
        self.vergence = dr.opaque(mi.Float, vergence)
        self.u, self.v = (
            from_numpy(mi.Float, column) for column in visibility_points(lens.radius).T
        )

    def found(self, position: mi.Point2f, area: np.ndarray) -> Columns | None:
        """What is found by rays by way of each ``position`` on the film; ``None`` for nothing.

        ``area``, (N,), is what of the film each of them stands for, in pixels.
        """
        # Each has its turn, in an order without a pattern.
        turn = dr.arange(mi.UInt32, dr.width(position)) * mi.UInt32(TURN)
        point = turn >> mi.UInt32(32 - int(math.log2(VISIBILITY_POINTS)))
        ray, _ = self._ray(position, point)
        visible = self.rays.visible(mi.Ray3f(ray))
        image = _Image.of(ray, visible, self.rays)
        new = visible.through_window
        new &= ~image.seen_from(mi.Float(0), mi.Float(0), self.lens, new)
        x, y = self._place(image)
        new &= (x >= self.window.left) & (x < self.window.right)
        new &= (y >= self.window.top) & (y < self.window.bottom)
        depth, surface = self.rays.depth(visible.first), self.rays.surface_of(visible.hit)
        known = x, y, visible.depth, depth, surface
        dr.eval(new, image, position, known)
        index = dr.compress(new)
        if dr.width(index) == 0:
            return None
        visibility = np.array(
            _bits(
                dr.gather(_Image, image, index),
                dr.gather(mi.UInt32, point, index),
                self.lens,
                _tried(self.rays),
            )
        )
        own = np.array(dr.gather(mi.UInt32, point, index)).astype(np.uint64)
        sees = (visibility >> own & np.uint64(1)) > 0
        share = VISIBILITY_POINTS / np.maximum(points_that_see(visibility), 1)
        shown = self._shown(
            dr.gather(mi.Point2f, position, index), dr.gather(mi.UInt32, point, index)
        )
        x, y, z, through, surface = (np.array(dr.gather(type(of), of, index)) for of in known)
        found = Columns(
            x=x,
            y=y,
            rgb=shown.rgb,
            alpha=shown.alpha,
            z=z,
            surface=surface,
            weight=area[np.array(index)] * share,
            layer=np.full(len(x), ELSEWHERE, np.uint8),
            through=through,
            visibility=visibility,
        )
        return found.chosen(sees & found.is_valid())

    def _ray(
        self, position: mi.Point2f, point: mi.UInt32
    ) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """The ray of each ``point`` by way of each ``position``, and its weight."""
        ray, weight = self.rays.sampled(position)
        axis, origin = self.lens.axis, self.lens.origin
        per_depth = ray.d / dr.dot(ray.d, axis)
        u, v = dr.gather(mi.Float, self.u, point), dr.gather(mi.Float, self.v, point)
        step = u * self.lens.across[0] + v * self.lens.across[1]
        near = dr.dot(ray.o - origin, axis)
        ray.o += step * (1 - near * self.vergence)
        ray.d = dr.normalize(per_depth - step * self.vergence)
        ray.has_differentials = False
        return ray, weight

    def _place(self, image: _Image) -> tuple[mi.Float, mi.Float]:
        """Where on the film the pinhole would see images, in pixels."""
        camera = self.rays.sensor.camera()
        apart = dr.select(image.is_near, image.point - self.lens.origin, image.direction)
        scale = camera.focal_length_pixels / dr.dot(apart, self.lens.axis)
        x, y = (
            dr.opaque(mi.Float, middle) - scale * dr.dot(apart, across)
            for middle, across in zip(camera.principal_point, self.lens.across, strict=True)
        )
        return x, y

    def _shown(self, position: mi.Point2f, point: mi.UInt32) -> Shown:
        """What the rays by way of each ``position`` show."""
        count = dr.width(position)
        lanes = self.rays.passes.begin_for(count)
        lane = dr.minimum(dr.arange(mi.UInt32, lanes), count - 1)
        ray, weight = self._ray(
            dr.gather(mi.Point2f, position, lane), dr.gather(mi.UInt32, point, lane)
        )
        nothing = dr.zeros(mi.Float, lanes), dr.zeros(mi.UInt32, lanes)
        traced = self.rays.shaded(ray, weight, *nothing, self.rays.sensor.get_medium())
        return to_host(traced)[0][:count]


@dataclasses.dataclass
class _Image:
    """Images, as Dr.Jit arrays.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``point``                     where the image is, if it ``is_near``
    ``direction``                 unit direction of it from the pinhole
    ``is_near``                   whether it is nearer than infinity
    ``chain``                     how the rays of the pinhole get from there to their end
    ``tolerance``                 that of :func:`meets_end`
    ============================  ==========================================================
    """

    point: mi.Point3f
    direction: mi.Vector3f
    is_near: mi.Bool
    chain: Chain
    tolerance: mi.Float

    @classmethod
    def of(cls, ray: mi.Ray3f, visible: Visible, rays: PrimaryRays) -> _Image:
        """The images that primary rays show."""
        is_near = dr.isfinite(visible.depth)
        distance = dr.select(is_near, rays.distance(ray, visible.depth), 0)
        tolerance = TOLERANCE / rays.sensor.camera().focal_length_pixels
        chain = Chain.of(visible)
        return cls(ray(distance), mi.Vector3f(ray.d), is_near, chain, mi.Float(tolerance))

    def seen_from(self, u: mi.Float, v: mi.Float, lens: LensRays, active: mi.Bool) -> mi.Bool:
        """Which images points of the lens see; (u, v) to the left and upwards, in scene units."""
        origin = lens.origin + u * lens.across[0] + v * lens.across[1]
        direction = dr.select(self.is_near, dr.normalize(self.point - origin), self.direction)
        ray = mi.Ray3f(origin, direction)
        return meets_end(lens.rays.scene, ray, self.chain, self.tolerance, active)


def _visibility(image: _Image, cell: np.ndarray, lens: LensRays) -> np.ndarray:
    """Which points of the lens see each image, uint64 (N,).

    ``cell``, (N,), is the number of the cell of the film in which each is.
    """
    number = dr.arange(mi.UInt32, len(cell))
    few, count = np.array(_bits(image, number, lens, FEW_POINTS)), _tried(lens.rays)
    _, cell = np.unique(cell, return_inverse=True)
    is_partly = np.bincount(cell, few != ALL) > 0
    found, partly = np.full(len(cell), ALL, np.uint64), np.flatnonzero(is_partly[cell])
    found[partly] = few[partly]
    for part in wavefronts(len(partly), count) if count > FEW_POINTS else []:
        index = from_numpy(mi.UInt32, partly[part])
        there = dr.gather(_Image, image, index)
        found[partly[part]] = np.array(_bits(there, index, lens, count))
    return found


def _tried(rays: PrimaryRays) -> int:
    """How many points of the lens are tried for each sample, a power of 2."""
    count = 2 ** round(math.log2(TRIED_IN_A_PIXEL / rays.passes.spp))
    return min(max(count, FEW_POINTS), VISIBILITY_POINTS)


def _bits(image: _Image, number: mi.UInt32, lens: LensRays, count: int) -> mi.UInt64:
    """Which points of the lens see each image: ``count`` are tried, others see what these do.

    The ``number`` of the image tells which: that of a point of the lens is one of those tried.
    """
    u, v = (from_numpy(mi.Float, column) for column in visibility_points(lens.radius).T)
    stride = VISIBILITY_POINTS // count
    groups = from_numpy(mi.UInt64, _groups(stride))
    first = number % stride

    def look(step: mi.UInt32, found: mi.UInt64) -> tuple[mi.UInt32, mi.UInt64]:
        point = step * stride + first
        at = dr.gather(mi.Float, u, point), dr.gather(mi.Float, v, point)
        sees = image.seen_from(*at, lens, mi.Bool(True))
        group = dr.gather(mi.UInt64, groups, point)
        return step + 1, found | dr.select(sees, group, mi.UInt64(0))

    end, lanes = dr.opaque(mi.UInt32, count), dr.width(number)
    state = dr.zeros(mi.UInt32, lanes), dr.zeros(mi.UInt64, lanes)
    return dr.while_loop(state, lambda step, _: step < end, look)[1]


@functools.cache
def _groups(stride: int) -> np.ndarray:
    """For each point of the lens the bits of as many that are near it, uint64 (64,).

    Each ``stride``-th point stands for that many, so that all of them count the same.
    """
    points, groups = lens_points(VISIBILITY_POINTS), np.zeros(VISIBILITY_POINTS, np.uint64)
    for first in range(stride):
        chosen = np.repeat(np.arange(first, VISIBILITY_POINTS, stride), stride)
        apart = ((points[:, None] - points[chosen]) ** 2).sum(axis=-1)
        point, place = scipy.optimize.linear_sum_assignment(apart)
        np.bitwise_or.at(groups, chosen[place], np.uint64(1) << point.astype(np.uint64))
    return groups
