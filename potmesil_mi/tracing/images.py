"""Images in mirrors and glass, and which points of the lens see them."""

from __future__ import annotations

import dataclasses
import functools
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.optimize

from .._backend import from_numpy
from ..optics.disc import lens_points
from ..samples.columns import VISIBILITY_POINTS, visibility_points
from ..samples.grouping import grouped
from .lens_rays import TURN, LensRays
from .passes import wavefronts
from .rays import PrimaryRays
from .virtual_depth import Visible
from .windows import Chain, meets_end

TOLERANCE = 4.0
"""How far rays of the lens may miss what they are aimed at, in pixels: only plane mirrors show all
of the lens the same image."""

FEW_POINTS = 4
"""So many of the points are tried first, others for each sample in turn. What they see in a cell of
the film is seen by all."""

TRIED_IN_A_PIXEL = 256
"""So many are tried by all samples of a pixel in the other cells, others by each in turn, and
``FEW_POINTS`` by each at least."""

KEYS_AT_ONCE = 1 << 12
"""So many groups of images are looked at together: memory is bounded."""

ALL = 2**VISIBILITY_POINTS - 1
"""``visibility`` of what all points of the lens see."""


@dataclasses.dataclass
class VirtualImage:
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
    def of(cls, ray: mi.Ray3f, visible: Visible, rays: PrimaryRays) -> VirtualImage:
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


def visibility_of(
    image: VirtualImage, x: np.ndarray, y: np.ndarray, cell: np.ndarray, lens: LensRays
) -> np.ndarray:
    """Which points of the lens see each image, uint64 (N,).

    ``x``, ``y``, (N,), are where the images are on the film in pixels, and ``cell``, (N,), is the
    number of the cell in which that is: where a few points see all of a cell, all do.
    """
    number = np.arange(len(x), dtype=np.uint32)
    few = seen_by_some(image, number, lens, FEW_POINTS)
    cell, _ = grouped(cell)
    is_partly = np.bincount(cell, few != _tried(number, FEW_POINTS)) > 0
    found, partly = np.full(len(x), ALL, np.uint64), np.flatnonzero(is_partly[cell])
    if len(partly) > 0:
        there = dr.gather(VirtualImage, image, from_numpy(mi.UInt32, partly))
        columns = x[partly], y[partly], number[partly]
        found[partly] = seen_by(there, *columns, lens, TRIED_IN_A_PIXEL, few[partly])
    return found


def seen_by(
    image: VirtualImage,
    x: np.ndarray,
    y: np.ndarray,
    number: np.ndarray,
    lens: LensRays,
    in_a_pixel: int,
    few: np.ndarray | None = None,
) -> np.ndarray:
    """Which points of the lens see each image, uint64 (N,); ``x``, ``y`` as above.

    Some of the points are tried, others by each image in turn, whose ``number`` tells which; as
    many ``in_a_pixel`` with a sample for each of the pinhole's. What the rest sees is told by the
    images that the same surfaces show in the same pixel. ``few`` is what ``FEW_POINTS`` of them
    see, if that is known.
    """
    count = 2 ** round(math.log2(in_a_pixel / lens.rays.passes.spp))
    count = min(max(count, FEW_POINTS), VISIBILITY_POINTS)
    if few is not None and count == FEW_POINTS:
        seen = few
    else:
        seen = np.empty(len(x), np.uint64)
        for part in wavefronts(len(x), count):
            index = dr.arange(mi.UInt32, part.stop - part.start) + dr.opaque(mi.UInt32, part.start)
            there = dr.gather(VirtualImage, image, index)
            seen[part] = seen_by_some(there, number[part], lens, count)
    if count == VISIBILITY_POINTS:
        return seen
    chain = image.chain
    surfaces = mi.UInt64(chain.shape) << 32 | mi.UInt64(chain.lobes << 6 | chain.turns)
    column, row = (np.floor(at - at.min()).astype(np.uint64) for at in (x, y))
    pixel = row * (column.max() + 1) + column
    pixel, _ = grouped(pixel)
    kind, _ = grouped(np.array(surfaces))
    return _told(seen, number, count, pixel * (int(kind.max()) + 1) + kind)


def _tried(number: np.ndarray, count: int) -> np.ndarray:
    """The ``count`` points of the lens that images of a ``number`` try, as bits, uint64 (N,)."""
    stride = VISIBILITY_POINTS // count
    every = sum(1 << point for point in range(0, VISIBILITY_POINTS, stride))
    return np.uint64(every) << (number % stride).astype(np.uint64)


def seen_by_some(image: VirtualImage, number: np.ndarray, lens: LensRays, count: int) -> np.ndarray:
    """Which of ``count`` points of the lens see each image, as bits, uint64 (N,).

    They are the point of the image's ``number``, uint32 (N,), modulo 64, and others evenly apart.
    """
    u, v = (from_numpy(mi.Float, column) for column in visibility_points(lens.radius).T)
    stride = dr.opaque(mi.UInt32, VISIBILITY_POINTS // count)
    first = from_numpy(mi.UInt32, number) % stride

    def look(step: mi.UInt32, found: mi.UInt64) -> tuple[mi.UInt32, mi.UInt64]:
        point = step * stride + first
        at = dr.gather(mi.Float, u, point), dr.gather(mi.Float, v, point)
        sees = image.seen_from(*at, lens, mi.Bool(True))
        return step + 1, found | dr.select(sees, mi.UInt64(1) << mi.UInt64(point), mi.UInt64(0))

    end, lanes = dr.opaque(mi.UInt32, count), len(number)
    state = dr.zeros(mi.UInt32, lanes), dr.zeros(mi.UInt64, lanes)
    return np.array(dr.while_loop(state, lambda step, _: step < end, look)[1])


def _told(seen: np.ndarray, number: np.ndarray, count: int, key: np.ndarray) -> np.ndarray:
    """Which points of the lens see images, uint64 (N,), of which each has tried ``count``.

    What those with the same ``key`` have ``seen`` by a point that an image has not tried is true of
    as large a part of them. What none of them has tried is as at the next point that it has.
    """
    result, order = np.empty_like(seen), np.argsort(key, kind="stable")
    begins = np.flatnonzero(np.diff(key[order], prepend=-1))
    stride = VISIBILITY_POINTS // count
    for first in range(0, len(begins), KEYS_AT_ONCE):
        groups = begins[first : first + KEYS_AT_ONCE]
        end = begins[first + KEYS_AT_ONCE] if first + KEYS_AT_ONCE < len(begins) else len(order)
        rows = order[groups[0] : end]
        sees, tried = _bits(seen[rows]), _bits(_tried(number[rows], count))
        here = groups - groups[0]
        of_key = np.repeat(np.arange(len(here)), np.diff(here, append=len(rows)))
        tries = np.add.reduceat(tried, here, axis=0, dtype=np.float32)[of_key]
        part = np.add.reduceat(sees, here, axis=0, dtype=np.float32)[of_key] / np.maximum(tries, 1)
        # Each image has a threshold of its own for each point, without a pattern.
        turn = np.arange(len(rows), dtype=np.uint32)[:, None]
        turn = turn + np.arange(VISIBILITY_POINTS, dtype=np.uint32) * np.uint32(stride)
        turn *= np.uint32(TURN)
        told = part > (turn >> 8).astype(np.float32) * np.float32(2**-24)
        nearest = np.take_along_axis(sees, _nearest(stride)[number[rows] % stride], axis=1)
        told = np.where(tries > 0, told, nearest)
        found = np.where(tried, sees, told)
        result[rows] = np.packbits(found, axis=1, bitorder="little").view(np.uint64).ravel()
    return result


def _bits(numbers: np.ndarray) -> np.ndarray:
    """The bits of numbers, uint64 (N,): bool (N, 64)."""
    numbers = np.ascontiguousarray(numbers).astype("<u8")[:, None]
    return np.unpackbits(numbers.view(np.uint8), axis=1, bitorder="little").view(bool)


@functools.cache
def _nearest(stride: int) -> np.ndarray:
    """The point of the lens next to each of which every ``stride``-th is tried, int (stride, 64).

    A row is for those from one of the first ``stride`` points on. Each of them is next to as many.
    """
    points = lens_points(VISIBILITY_POINTS)
    nearest = np.empty((stride, VISIBILITY_POINTS), np.int64)
    for first in range(stride):
        chosen = np.repeat(np.arange(first, VISIBILITY_POINTS, stride), stride)
        apart = ((points[:, None] - points[chosen]) ** 2).sum(axis=-1)
        point, place = scipy.optimize.linear_sum_assignment(apart)
        nearest[first, point] = chosen[place]
    return nearest
