"""Visibility: which points of the lens see which fragments.

From each lens point the fragments appear shifted by their parallax, and they cover each other from
the nearest to the farthest. Each lets a part of what is behind it through, 1 less its opacity; what
all the nearer ones let through is what the lens point sees of those behind. Optical depth is the
negative logarithm of such a part, so that it adds up. None of it depends on where the lens is
focused.

The decision for a fragment and a lens point is one line of :func:`_seen_from`:
``free = dr.exp(-covered)``.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import NamedTuple

import drjit as dr
import numpy as np
import scipy.ndimage

from .. import _backend as jit
from ..samples.raster import Window
from .fragments import BIN_RADIUS, MAX_BINS, Fragments, columns_of
from .lens_images import EdgeFinder, FromPoint, ImageFrame
from .opacity import optical_depth

SLANT_BINS = 2
"""Fragments less than so many bins apart do not cover each other: one slanted surface has them."""

CONNECTED_PARALLAX = 0.5
"""Largest difference of parallax, in subpixels, of neighbouring fragments of one surface. Where a
lens point sees them farther apart than that, there is no gap between them."""

MAX_STEPS = 128
"""Most steps from near to far in which fragments cover others; a step may have several bins."""

MAX_COVERED = 1 << 26
"""Most subpixels, of all lens points' images of what is covered, that are kept at once."""


class SightLimits(NamedTuple):
    """What all fragments of a picture say of how lens points see them.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``width``, ``height``         subpixels of its window
    ``farthest``, ``nearest``     the least and the greatest vergence
    ``last_bin``                  the nearest of the bins of what may be covered
    ============================  ==========================================================
    """

    width: int
    height: int
    farthest: np.float32
    nearest: np.float32
    last_bin: int

    @property
    def bins_per_step(self) -> int:
        """How many bins make a step, so that there are at most ``MAX_STEPS`` steps."""
        return max(1, -(-self.last_bin // MAX_STEPS))


def visibility(
    fragments: Fragments,
    radius_per_vergence: float,
    points: np.ndarray,
    times: np.ndarray | None = None,
    limits: SightLimits | None = None,
    lit: Window | None = None,
    edges: EdgeFinder | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """What each of the lens ``points`` sees of the fragments.

    ``points``, (M, 2), are in units of the lens's radius; ``radius_per_vergence`` is the parallax,
    in subpixels per unit of vergence, of a lens point at radius 1. ``times``, (M,), from -0.5 to
    0.5, are when in the part of an exposure that fragments stand for the points look; without them
    nothing moves. ``limits`` are those of the picture that the fragments are a tile of, if they
    are; what is not ``lit`` then only covers others.

    Returns which fragments, bool (N,), some lens point may not see as a whole; and for these, in
    their order, what each point sees of them, uint8 (n, M), 0 for nothing to 255 for all. Hidden
    fragments less than one step and ``SLANT_BINS`` bins behind the first surface of their subpixel
    are seen from nowhere. What is so near that it leaves the largest frame, see :func:`_frame_of`,
    is seen from there whatever is nearer still: hardly anything of it is in the picture. ``edges``
    is told of the images, if it is given.
    """
    if times is None or fragments.motion is None:
        times = np.zeros(len(points))
        fragments = dataclasses.replace(fragments, motion=None)
    coverable = may_be_covered(fragments, radius_per_vergence)
    if lit is not None:
        coverable &= lit.contains(fragments.x, fragments.y)
    apart = _relative_path(fragments.motion)
    covering = _may_cover(fragments, coverable, -radius_per_vergence, apart)
    limits = limits or limits_of(fragments, coverable)
    frame, middle = _frame_of(fragments, radius_per_vergence, limits)
    at_once = max(1, MAX_COVERED // frame.size)
    covers = _Covers.of(fragments, radius_per_vergence).chosen(covering)
    behind, before = (
        _Shifted(fragments.chosen(mask), frame.margin, middle, radius_per_vergence)
        for mask in (coverable, covering)
    )
    looks = np.column_stack([points, times]).astype(np.float32)
    seen = np.empty((behind.count, len(points)), dtype=np.uint8)
    for first in range(0, len(points), at_once):
        part = looks[first : first + at_once]
        if edges is not None:
            edges.begin(coverable, covering, first, frame.size * len(part))
        step = limits.bins_per_step
        seen[:, first : first + at_once] = _seen_from(
            part, behind, before, covers, frame, step, edges
        )
    gap = fragments.gap_in_front[coverable]
    least = limits.bins_per_step + SLANT_BINS
    seen[(gap > 0) & (gap < least * fragments.bin_width)] = 0
    return coverable, seen


def may_be_covered(fragments: Fragments, radius_per_vergence: float) -> np.ndarray:
    """The fragments, bool (N,), that some lens point may not see as a whole."""
    every_one = np.ones(len(fragments), dtype=bool)
    apart = _relative_path(fragments.motion)
    coverable = _may_cover(fragments, every_one, radius_per_vergence, apart)
    coverable |= fragments.gap_in_front > 0
    return coverable


def limits_of(fragments: Fragments, coverable: np.ndarray) -> SightLimits:
    """The limits of all fragments of a picture, of which some, bool (N,), are ``coverable``."""
    return SightLimits(
        fragments.width,
        fragments.height,
        fragments.vergence.min(),
        fragments.vergence.max(),
        int(fragments.bin[coverable].max(initial=0)),
    )


def _frame_of(
    fragments: Fragments, radius_per_vergence: float, limits: SightLimits
) -> tuple[ImageFrame, np.floating]:
    """The frame of lens points' images, and the vergence that all of them see at the same place.

    Its margin is as wide as parallax moves fragments against the middle of their vergences. Where
    some are so near that it would have more than ``MAX_COVERED`` subpixels, it is narrower, and the
    margin of what is farthest.
    """
    width, height, *ends = limits[:4]
    along, _ = fragments.path_reach
    half = radius_per_vergence * (float(ends[1]) - float(ends[0])) / 2
    margin = half + along + 3
    # Of (width + 2 margin) (height + 2 margin) = MAX_COVERED, but as wide as the window at least.
    apart = (width - height) / 2
    most = (math.sqrt(apart**2 + MAX_COVERED) - (width + height) / 2) / 2
    most = max(most, width, height)
    window = Window(fragments.left, fragments.top, fragments.width, fragments.height)
    if margin <= most:
        return ImageFrame(window, math.ceil(margin), False), (ends[0] + ends[1]) / 2
    middle = ends[0] + max(most - along - 3, 0) / radius_per_vergence
    return ImageFrame(window, math.ceil(most), True), middle


def _relative_path(motion: np.ndarray | None) -> float:
    """How far things may move before each other, in subpixels."""
    if motion is None or len(motion) == 0:
        return 0.0
    return float(np.hypot(*np.ptp(motion[:, :2], axis=0)))


def _may_cover(
    fragments: Fragments, others: np.ndarray, radius_per_vergence: float, apart: float
) -> np.ndarray:
    """Fragments, bool (N,), in front of which parallax may move one of ``others``, bool (N,).

    Motion may move them before each other by ``apart`` subpixels. With a negative
    ``radius_per_vergence``: fragments that may move in front of one of the others.
    """
    height, width = fragments.height, fragments.width
    subpixel = fragments.subpixel
    parallax = fragments.vergence * np.float32(radius_per_vergence)
    nearest = np.full(height * width, -np.inf, dtype=np.float32)
    np.maximum.at(nearest, subpixel[others], parallax[others])
    result = np.zeros(len(fragments), dtype=bool)
    distance, before = 1, 0
    bin_radius = fragments.bin_width * abs(radius_per_vergence)
    slant = SLANT_BINS * min(BIN_RADIUS, bin_radius)
    largest = float(nearest.max()) - float(parallax.min())
    while before <= min(largest + 1 + apart, max(height, width)):
        around = scipy.ndimage.maximum_filter(nearest.reshape(height, width), 2 * distance + 1)
        least = max(before - 1 - apart, slant)
        result |= around.ravel()[subpixel] - parallax >= least
        distance, before = math.ceil(1.5 * (distance + 1)), distance
    return result


@dataclasses.dataclass(frozen=True)
class _CoverColumns:
    """The columns of :class:`_Covers` as Dr.Jit arrays."""

    depth: jit.Float
    right: jit.Float
    below: jit.Float


@dataclasses.dataclass(frozen=True)
class _Covers:
    """How much fragments cover, and how far they reach to the right and downwards.

    A fragment ends where the next one of its surface begins, so that no gaps open where a lens
    point sees a slanted surface stretched.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``depth``                     float32 (N,), optical depth
    ``right``, ``below``          float32 (N,), parallax in subpixels at the fragment's end less
                                  that at its beginning
    ============================  ==========================================================
    """

    depth: np.ndarray
    right: np.ndarray
    below: np.ndarray

    @classmethod
    def of(cls, fragments: Fragments, radius_per_vergence: float) -> _Covers:
        """Those of all fragments."""
        height, width = fragments.height, fragments.width
        place = fragments.y.astype(np.int64) * (width + 1) + fragments.x
        parallax = fragments.vergence * np.float32(radius_per_vergence)
        # A row and a column more: what lies beyond the window is not connected.
        shape = (height + 1) * (width + 1)
        nearest = np.full(shape, -np.inf, dtype=np.float32)
        farthest = np.full(shape, np.inf, dtype=np.float32)
        np.maximum.at(nearest, place, parallax)
        np.minimum.at(farthest, place, parallax)
        ends = []
        for neighbour in (place + 1, place + width + 1):
            apart = [by_place[neighbour] - parallax for by_place in (nearest, farthest)]
            apart = np.where(np.abs(apart[0]) < np.abs(apart[1]), *apart)
            ends.append(np.where(np.abs(apart) <= CONNECTED_PARALLAX, apart, np.float32(0)))
        return cls(optical_depth(fragments), *ends)

    def chosen(self, mask: np.ndarray) -> _Covers:
        """Those of which ``mask``, bool (N,), is true."""
        return _Covers(*(getattr(self, field.name)[mask] for field in dataclasses.fields(self)))

    @functools.cached_property
    def on_device(self) -> _CoverColumns:
        """The columns as Dr.Jit arrays."""
        return _CoverColumns(
            *(
                jit.from_numpy(jit.Float, getattr(self, field.name))
                for field in dataclasses.fields(self)
            )
        )


class _Shifted:
    """Fragments as lens points see them, in a frame with a ``margin`` around the window.

    ``middle`` is the vergence that all lens points see at the same place.
    """

    def __init__(
        self,
        fragments: Fragments,
        margin: int,
        middle: np.floating,
        radius_per_vergence: float,
    ) -> None:
        self.count = len(fragments)
        self.bin = fragments.bin
        left, top = fragments.left + margin, fragments.top + margin
        self.x = jit.from_numpy(jit.Float, fragments.x + np.float32(left + 0.5))
        self.y = jit.from_numpy(jit.Float, fragments.y + np.float32(top + 0.5))
        parallax = (fragments.vergence - middle) * np.float32(radius_per_vergence)
        self.parallax = jit.from_numpy(jit.Float, parallax)
        self.motion = columns_of(fragments.motion)
        self.per_vergence = radius_per_vergence

    def part(self, bins: range) -> tuple[int, int]:
        """The fragments of some bins: index of the first, and of the first behind the last."""
        start, stop = np.searchsorted(self.bin, np.array([bins.start, bins.stop], np.int32))
        return int(start), int(stop)

    def from_points(
        self, part: tuple[int, int], points: tuple[jit.Float, jit.Float, jit.Float]
    ) -> FromPoint:
        """Every pair of a fragment of ``part`` and one of the ``points``, (u, v) at a time."""
        count = dr.opaque(jit.UInt32, len(points[0]))
        lane = dr.arange(jit.UInt32, (part[1] - part[0]) * len(points[0]))
        fragment = lane // count
        point = lane - fragment * count
        fragment += dr.opaque(jit.UInt32, part[0])
        parallax = dr.gather(jit.Float, self.parallax, fragment)
        u, v, time = (dr.gather(jit.Float, column, point) for column in points)
        x, y = (dr.gather(jit.Float, column, fragment) for column in (self.x, self.y))
        if self.motion is not None:
            moved = [dr.gather(jit.Float, of, fragment) * time for of in self.motion]
            x, y = x + moved[0], y + moved[1]
            parallax = dr.fma(moved[2], dr.opaque(jit.Float, self.per_vergence), parallax)
        x, y = dr.fma(parallax, u, x), dr.fma(parallax, v, y)
        return FromPoint(fragment, point, u, v, x, y)


def _cover(
    depth: jit.Float,
    seen: FromPoint,
    covers: _Covers,
    frame: ImageFrame,
    edges: EdgeFinder | None,
) -> None:
    """Add that of fragments to the optical ``depth`` of subpixels in which the points see them."""
    columns = covers.on_device
    own, right_end, below_end = (
        dr.gather(jit.Float, getattr(columns, field.name), seen.fragment)
        for field in dataclasses.fields(columns)
    )
    place = seen.place(frame)
    end = dr.floor(dr.fma(right_end, seen.u, seen.x + 1))
    right = end - dr.floor(seen.x) > 1
    end = dr.floor(dr.fma(below_end, seen.v, seen.y + 1))
    below = end - dr.floor(seen.y) > 1
    down = dr.opaque(jit.UInt32, frame.width)
    inside = seen.inside(frame)
    for target, active in (
        (place, inside),
        (place + 1, right & inside),
        (place + down, below & inside),
        (place + down + 1, right & below & inside),
    ):
        dr.scatter_add(depth, own, target, active, mode=dr.ReduceMode.Direct)
        if edges is not None:
            edges.cover(seen.fragment, target, active)


def _seen_from(
    points: np.ndarray,
    behind: _Shifted,
    before: _Shifted,
    covers: _Covers,
    frame: ImageFrame,
    step: int,
    edges: EdgeFinder | None,
) -> np.ndarray:
    """What each of the ``points``, (M, 3) with their times, sees of ``behind``, uint8 (N, M).

    From the nearest ``step``, of so many bins, to the farthest: fragments of ``before`` that are at
    least ``SLANT_BINS`` bins nearer than a step's are added to the optical depth, then those of the
    step are looked up.
    """
    count = len(points)
    u, v, time = (jit.from_numpy(jit.Float, column) for column in points.T)
    on_device = u, v, time
    depth = dr.zeros(jit.Float, frame.size * count)
    seen = dr.zeros(jit.UInt8, behind.count * count)
    if behind.count == 0:
        return np.array(seen).reshape(0, count)
    last = int(behind.bin[-1])
    added = MAX_BINS + 1
    for bin_ in range(last - last % step, -1, -step):
        nearer = before.part(range(bin_ + step - 1 + SLANT_BINS, added))
        added = bin_ + step - 1 + SLANT_BINS
        if nearer[0] < nearer[1]:
            _cover(depth, before.from_points(nearer, on_device), covers, frame, edges)
        here = behind.part(range(bin_, bin_ + step))
        if here[0] < here[1]:
            looking = behind.from_points(here, on_device)
            covered = dr.gather(jit.Float, depth, looking.place(frame), looking.inside(frame))
            free = dr.exp(-covered)
            lane = dr.arange(jit.UInt32, (here[1] - here[0]) * count)
            dr.scatter(seen, as_byte(free), lane + dr.opaque(jit.UInt32, here[0] * count))
            dr.eval(seen)
            if edges is not None:
                edges.look(looking, depth, frame)
            # What still refers to the optical depths makes Dr.Jit copy them all before the next
            # step adds to them.
            del free, covered
    return np.array(seen).reshape(behind.count, count)


def as_byte(share: jit.Float) -> jit.UInt8:
    """A share from 0 to 1 as a whole number from 0 to 255."""
    return jit.UInt8(jit.UInt32(dr.fma(share, 255, 0.5)))
