"""Visibility: which parts of the lens see which elements.

The lens is looked through at a number of points. From each of them the elements appear shifted
by their parallax, and cover each other from the nearest to the farthest; what they leave free
is what the point sees of those behind. None of it depends on where the lens is focused.
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

from .fragments import BIN, MOST_BINS, SHARE, Elements

TOLERANCE = 2
"""Bins within which elements do not cover each other: those of one slanted surface."""

CONNECTED = 0.5
"""Elements in squares side by side are of one surface where their parallaxes differ by no more, in
squares: where a lens point sees them apart, there is no gap between them."""

MOST_STEPS = 128
"""Most steps in which elements cover others, each of as many bins as it takes."""

MEMORY = 1 << 26
"""Most squares, of all the pictures of what is covered, that are kept at once."""


def visibility(
    elements: Elements, scale: float, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What of the elements the points of a lens see.

    ``scale`` is the parallax in squares per unit of vergence of a lens point at radius 1,
    ``points``, (M, 2), are in units of that radius.

    Returns the elements, bool (N,), of which some point may not see all; and of these, in their
    order, what each point sees, uint8 (n, M), from none to 255. What is less than
    a step and ``TOLERANCE`` bins behind the first surface of its square is seen from nowhere.
    """
    coverable = _has_beside(elements, np.ones(len(elements), dtype=bool), scale)
    coverable |= elements.front > 0
    covering = _has_beside(elements, coverable, -scale)
    ends = elements.vergence.min(), elements.vergence.max()
    middle = (ends[0] + ends[1]) / 2
    margin = math.ceil(scale * (ends[1] - ends[0]) / 2) + 3
    width, height = elements.width + 2 * margin, elements.height + 2 * margin
    at_once = max(1, MEMORY // (width * height))
    covers = _Covers.of(elements, scale).chosen(covering)
    behind, before = (
        _Shifted(elements.chosen(mask), margin, middle, scale) for mask in (coverable, covering)
    )
    result = np.empty((behind.count, len(points)), dtype=np.uint8)
    for first in range(0, len(points), at_once):
        part = points[first : first + at_once].astype(np.float32)
        result[:, first : first + at_once] = _seen_from(part, behind, before, covers, width, height)
    front = elements.front[coverable]
    least = _bins_of_a_step(behind) + TOLERANCE
    result[(front > 0) & (front < least * elements.step)] = 0
    return coverable, result


class Turns:
    """An arrangement of a lens's points of its own for each element.

    Each turns them by an angle, and moves them outwards or inwards within their cells, unlike its
    neighbours: so they leave no pattern where the light of many elements adds up. Points of an
    aperture that is not round are moved together, by no more than the radius of a cell.
    """

    def __init__(self, elements: Elements, cell: float = 0.0) -> None:
        mixed = elements.x.astype(np.uint32) * np.uint32(0x9E3779B1)
        mixed ^= elements.y.astype(np.uint32) * np.uint32(0x85EBCA77)
        mixed = (mixed ^ (mixed >> np.uint32(15))) * np.uint32(0x2C1B3C6D)
        mixed ^= mixed >> np.uint32(13)
        angle = (mixed & np.uint32(0xFFFF)) * (2 * math.pi / 65536)
        self.cosine, self.sine = (mi.Float(f(angle).astype(np.float32)) for f in (np.cos, np.sin))
        self.outwards = mi.Float((mixed >> np.uint32(16)).astype(np.float32) / 65536)
        self.cell = cell

    def points(
        self, u: mi.Float, v: mi.Float, point: mi.UInt32, element: mi.UInt32
    ) -> tuple[mi.Float, mi.Float]:
        """Where points (u, v), of these numbers, are for these elements."""
        cosine, sine, outwards = (
            dr.gather(mi.Float, column, element)
            for column in (self.cosine, self.sine, self.outwards)
        )
        if self.cell > 0:
            size = dr.opaque(mi.Float, self.cell) * dr.sqrt(outwards)
            return dr.fma(size, cosine, u), dr.fma(size, sine, v)
        size = dr.sqrt((mi.Float(point) + outwards) / (mi.Float(point) + 0.5))
        return size * (cosine * u - sine * v), size * (sine * u + cosine * v)


def visibility_of_few(
    elements: Elements, few: Elements, scale: float, points: np.ndarray, cell: float = 0.0
) -> np.ndarray:
    """What each point sees of each of a ``few`` elements, uint8 (n, M), from none to 255.

    For many points, arranged by :class:`Turns` with that ``cell``, and few elements: it follows
    each way from an element to a lens point past the nearest of the ``elements`` in each square.
    """
    if len(few) == 0:
        return np.empty((0, len(points)), dtype=np.uint8)
    width, height = elements.width, elements.height
    square = elements.y.astype(np.int64) * width + elements.x
    parallax = elements.vergence * np.float32(scale)
    nearest = np.full(width * height, -np.inf, dtype=np.float32)
    np.maximum.at(nearest, square, parallax)
    same = parallax > nearest[square] - 1
    share = np.bincount(square[same], _coverage(elements)[same], width * height)
    parallaxes, shares = mi.Float(nearest), mi.Float(share)
    end = dr.opaque(mi.Float, float(nearest.max()))
    count = dr.opaque(mi.UInt32, len(points))
    lane = dr.arange(mi.UInt32, len(few) * len(points))
    element = lane // count
    point = lane - element * count
    u, v = (
        dr.gather(mi.Float, mi.Float(np.ascontiguousarray(column, np.float32)), point)
        for column in points.T
    )
    u, v = Turns(few, cell).points(u, v, point, element)
    x, y = (
        dr.gather(mi.Float, mi.Float(column + np.float32(0.5)), element)
        for column in (few.x, few.y)
    )
    own = dr.gather(mi.Float, mi.Float(few.vergence * np.float32(scale)), element)
    wide, high = dr.opaque(mi.Int32, width), dr.opaque(mi.Int32, height)

    def step(way: mi.Float, free: mi.Float) -> tuple[mi.Float, mi.Float]:
        column = mi.Int32(dr.floor(dr.fma(-way, u, x)))
        row = mi.Int32(dr.floor(dr.fma(-way, v, y)))
        inside = (column >= 0) & (row >= 0) & (column < wide) & (row < high)
        place = mi.UInt32(row * wide + column)
        parallax = dr.gather(mi.Float, parallaxes, place, inside) - own
        meets = inside & (dr.abs(parallax - way) <= 0.75)
        share = dr.gather(mi.Float, shares, place, meets)
        return way + 1, dr.minimum(free, 1 - dr.minimum(share, 1))

    start = TOLERANCE * BIN + 0.5
    way, free = dr.full(mi.Float, start, dr.width(lane)), dr.full(mi.Float, 1, dr.width(lane))
    _, free = dr.while_loop((way, free), lambda way, free: (way < end - own + 1) & (free > 0), step)
    return np.array(_as_byte(free)).reshape(len(few), len(points))


def _coverage(elements: Elements) -> np.ndarray:
    """How much of its square each element covers, float32 (N,).

    Its share of what the pinhole sees in the square: where chance has put fewer samples, that
    is no hole.
    """
    square = elements.y.astype(np.int64) * elements.width + elements.x
    share, first = elements.values[:, SHARE], elements.front == 0
    total = np.bincount(square[first], share[first], elements.width * elements.height)[square]
    return (share / np.where(total > 0, total, 1)).astype(np.float32)


def _has_beside(elements: Elements, others: np.ndarray, scale: float) -> np.ndarray:
    """Elements, bool (N,), over which parallax may move one of ``others``, bool (N,), in front.

    With a negative ``scale`` those under which one may be moved.
    """
    height, width = elements.height, elements.width
    square = elements.y.astype(np.int64) * width + elements.x
    parallax = elements.vergence * np.float32(scale)
    nearest = np.full(height * width, -np.inf, dtype=np.float32)
    np.maximum.at(nearest, square[others], parallax[others])
    result = np.zeros(len(elements), dtype=bool)
    distance, before = 1, 0
    largest = float(nearest.max()) - float(parallax.min())
    while before <= min(largest + 1, max(height, width)):
        beside = scipy.ndimage.maximum_filter(nearest.reshape(height, width), 2 * distance + 1)
        result |= beside.ravel()[square] - parallax >= max(before - 1, TOLERANCE * BIN)
        distance, before = math.ceil(1.5 * (distance + 1)), distance
    return result


@dataclasses.dataclass(frozen=True)
class _Covers:
    """How much elements cover, and how far they reach to the right and downwards.

    An element ends where the next of its surface begins. So no gaps open where a lens point sees
    a slanted surface stretched. Where chance has put no sample in a square, those beside it reach
    over it. ``right`` and ``below`` are parallaxes, in squares, at the end of the element from
    that at its beginning, ``wide`` and ``high`` its size in squares, 1 or 2.
    """

    share: np.ndarray
    right: np.ndarray
    below: np.ndarray
    wide: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, elements: Elements, scale: float) -> _Covers:
        """Those of all elements; ``scale`` is the parallax in squares per unit of vergence."""
        height, width = elements.height, elements.width
        place = elements.y.astype(np.int64) * (width + 1) + elements.x
        parallax = elements.vergence * np.float32(scale)
        # A row and a column more: what is beyond the window is not connected, nor empty.
        shape = (height + 1) * (width + 1)
        nearest = np.full(shape, -np.inf, dtype=np.float32)
        farthest = np.full(shape, np.inf, dtype=np.float32)
        np.maximum.at(nearest, place, parallax)
        np.minimum.at(farthest, place, parallax)
        empty = np.isinf(nearest)
        empty.reshape(height + 1, width + 1)[:, -1] = False
        empty.reshape(height + 1, width + 1)[-1] = False
        ends, sizes = [], []
        for beside in (place + 1, place + width + 1):
            apart = [by_square[beside] - parallax for by_square in (nearest, farthest)]
            apart = np.where(np.abs(apart[0]) < np.abs(apart[1]), *apart)
            ends.append(np.where(np.abs(apart) <= CONNECTED, apart, np.float32(0)))
            sizes.append(empty[beside].astype(np.float32) + 1)
        return cls(_coverage(elements), *ends, *sizes)

    def chosen(self, mask: np.ndarray) -> _Covers:
        """Those that ``mask``, bool (N,), has."""
        return _Covers(*(getattr(self, field.name)[mask] for field in dataclasses.fields(self)))

    @functools.cached_property
    def on_device(self) -> dict[str, mi.Float]:
        """The columns as Dr.Jit arrays."""
        return {
            field.name: mi.Float(getattr(self, field.name)) for field in dataclasses.fields(self)
        }


class _Shifted:
    """Elements as lens points see them, on a grid with a margin around the window."""

    def __init__(self, elements: Elements, margin: int, middle: float, scale: float) -> None:
        self.count = len(elements)
        self.bin = elements.bin
        self.x = mi.Float(elements.x + np.float32(margin + 0.5))
        self.y = mi.Float(elements.y + np.float32(margin + 0.5))
        self.parallax = mi.Float((elements.vergence - middle) * np.float32(scale))

    def part(self, bins: range) -> tuple[int, int]:
        """First and last but one of the elements in some bins."""
        start, stop = np.searchsorted(self.bin, np.array([bins.start, bins.stop], np.int32))
        return int(start), int(stop)

    def seen(self, part: tuple[int, int], points: tuple[mi.Float, mi.Float]) -> _Seen:
        """Each element of a part, as many times as there are points; and where each sees it."""
        count = dr.opaque(mi.UInt32, len(points[0]))
        lane = dr.arange(mi.UInt32, (part[1] - part[0]) * len(points[0]))
        element = lane // count
        point = lane - element * count
        element += dr.opaque(mi.UInt32, part[0])
        parallax = dr.gather(mi.Float, self.parallax, element)
        u, v = (dr.gather(mi.Float, column, point) for column in points)
        x = dr.fma(parallax, u, dr.gather(mi.Float, self.x, element))
        y = dr.fma(parallax, v, dr.gather(mi.Float, self.y, element))
        return _Seen(element, point, u, v, x, y)


class _Seen(NamedTuple):
    """Elements, points of the lens (u, v), and where in the grid these see those."""

    element: mi.UInt32
    point: mi.UInt32
    u: mi.Float
    v: mi.Float
    x: mi.Float
    y: mi.Float

    def place(self, width: int, size: int) -> mi.UInt32:
        """The place in one picture of ``size`` squares for each point."""
        row = mi.UInt32(self.y) * dr.opaque(mi.UInt32, width) + mi.UInt32(self.x)
        return self.point * dr.opaque(mi.UInt32, size) + row


def _cover(covered: mi.Float, seen: _Seen, covers: _Covers, width: int, size: int) -> None:
    """Add to ``covered`` what elements cover of the squares in which points see them."""
    columns = {
        name: dr.gather(mi.Float, values, seen.element) for name, values in covers.on_device.items()
    }
    place = seen.place(width, size)
    end = dr.floor(seen.x + dr.fma(columns["right"], seen.u, columns["wide"]))
    right = end - dr.floor(seen.x) > 1
    end = dr.floor(seen.y + dr.fma(columns["below"], seen.v, columns["high"]))
    below = end - dr.floor(seen.y) > 1
    down = dr.opaque(mi.UInt32, width)
    for target, active in (
        (place, mi.Bool(True)),
        (place + 1, right),
        (place + down, below),
        (place + down + 1, right & below),
    ):
        dr.scatter_add(covered, columns["share"], target, active, mode=dr.ReduceMode.Direct)


def _bins_of_a_step(behind: _Shifted) -> int:
    """How many bins are looked at together, so that there are no more than ``MOST_STEPS`` steps."""
    return max(1, -(-int(behind.bin.max(initial=0)) // MOST_STEPS))


def _seen_from(
    points: np.ndarray,
    behind: _Shifted,
    before: _Shifted,
    covers: _Covers,
    width: int,
    height: int,
) -> np.ndarray:
    """What each point sees of each element of ``behind``, uint8 (N, M)."""
    count, size = len(points), width * height
    on_device = (
        mi.Float(np.ascontiguousarray(points[:, 0])),
        mi.Float(np.ascontiguousarray(points[:, 1])),
    )
    covered = dr.zeros(mi.Float, size * count)
    seen = dr.zeros(mi.UInt8, behind.count * count)
    if behind.count == 0:
        return np.array(seen).reshape(0, count)
    last, width_of_step = int(behind.bin[-1]), _bins_of_a_step(behind)
    added = MOST_BINS + 1
    for bin_ in range(last - last % width_of_step, -1, -width_of_step):
        nearer = before.part(range(bin_ + width_of_step - 1 + TOLERANCE, added))
        added = bin_ + width_of_step - 1 + TOLERANCE
        if nearer[0] < nearer[1]:
            _cover(covered, before.seen(nearer, on_device), covers, width, size)
        here = behind.part(range(bin_, bin_ + width_of_step))
        if here[0] < here[1]:
            place = behind.seen(here, on_device).place(width, size)
            free = 1 - dr.minimum(dr.gather(mi.Float, covered, place), 1)
            lane = dr.arange(mi.UInt32, (here[1] - here[0]) * count)
            dr.scatter(seen, _as_byte(free), lane + dr.opaque(mi.UInt32, here[0] * count))
            dr.eval(seen)
    return np.array(seen).reshape(behind.count, count)


def _as_byte(share: mi.Float) -> mi.UInt8:
    return mi.UInt8(mi.UInt32(dr.fma(share, 255, 0.5)))
