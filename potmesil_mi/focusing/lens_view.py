"""What the points of a lens see of fragments: :class:`LensView`.

It is found once for an aperture, before the lens is focused.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .. import _backend as jit
from ..samples.raster import Window
from .detail import Detail
from .fragments import COVERS, MAX_BINS, SHARE, FragmentColumns, Fragments, as_column
from .highlight_visibility import Jitter, visibility_of_highlights
from .highlights import HighlightLimits, is_highlight, parted
from .lens_points import LensPoints
from .visibility import SightLimits, visibility

COARSER_PARTS = 3
"""Parts of a coarser view that are made before the whole is."""

GOLDEN = (math.sqrt(5) - 1) / 2
"""Of the golden section, whose multiples fill a time evenly, however many there are."""

LEAST_SEEN = 8
"""What the innermost lens point sees at least, of 255, of what the pinhole sees."""


@dataclasses.dataclass(frozen=True)
class OccludedColumns:
    """Columns of :class:`Occluded` as Dr.Jit arrays; ``u``, ``v`` are the lens points.

    ``time`` is when these look, if anything moves, and ``seen_sum``, (N,), the sum of what all lens
    points see of each fragment.
    """

    fragments: FragmentColumns
    seen: jit.UInt8
    seen_sum: jit.Float
    u: jit.Float
    v: jit.Float
    time: jit.Float | None


@dataclasses.dataclass(frozen=True)
class Occluded:
    """Fragments of which some lens points see nothing, or not all.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``fragments``                 N fragments; their values are not multiplied by ``seen``
    ``seen``                      uint8 (N, M), what each lens point sees of each, 0 to 255
    ``points``                    float64 (T, M, 2), the lens points, see :class:`LensPoints`,
                                  that look at each of T parts of an exposure
    ``times``                     float64 (M,), when in a part they look, or ``None``
    ``jitter``                    the arrangement of the points for each fragment, or ``None``
    ============================  ==========================================================
    """

    fragments: Fragments
    seen: np.ndarray
    points: np.ndarray
    times: np.ndarray | None = None
    jitter: Jitter | None = None

    @property
    def count(self) -> int:
        """Lens points that look at each fragment."""
        return self.points.shape[1]

    def coarser(self, factor: int) -> Occluded:
        """The same on subpixels, and in bins of depth, ``factor`` times as large."""
        fragments, index = self.fragments.coarser(factor)
        weight = self.fragments.values[:, SHARE].astype(np.float64)
        total = np.bincount(index, weight, len(fragments))
        seen = [np.bincount(index, weight * column, len(fragments)) for column in self.seen.T]
        mean = np.rint(np.stack(seen, axis=1) / total[:, None])
        return Occluded(fragments, mean.astype(np.uint8), self.points, self.times)

    def between(self, bins: range) -> Occluded:
        """Those of some ``bins``; their points are not arranged anew."""
        part = self.fragments.between(bins.start, bins.stop)
        return Occluded(self.fragments.chosen(part), self.seen[part], self.points, self.times)

    @functools.cached_property
    def reach(self) -> float:
        """How far from the middle of a circle, in its radii, its lens points are at most."""
        reach = np.hypot(self.points[..., 0], self.points[..., 1]).max(axis=0)
        return float((reach if self.jitter is None else self.jitter.reaches(reach)).max())

    @property
    def nbytes(self) -> int:
        """Memory in bytes of the columns on the host."""
        return self.fragments.nbytes + self.seen.nbytes

    @functools.cached_property
    def on_device(self) -> OccludedColumns:
        """The columns as Dr.Jit arrays.

        The values are scaled: multiplied by what a lens point sees, they are its share.
        """
        share = np.float32(1 / (255 * self.count))
        u, v = (as_column(column) for column in self.points.reshape(-1, 2).T)
        return OccludedColumns(
            FragmentColumns.of(self.fragments.scaled(np.full(len(self.fragments), share))),
            jit.from_numpy(jit.UInt8, self.seen.ravel()),
            as_column(self.seen.sum(axis=1, dtype=np.float32)),
            u,
            v,
            None if self.times is None else as_column(self.times),
        )


class ViewLimits(NamedTuple):
    """What the view of a tile takes from the whole picture."""

    sight: SightLimits
    highlights: HighlightLimits


@dataclasses.dataclass(frozen=True)
class LensView:
    """Fragments, parted by what the lens sees of them, before it is focused.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``unoccluded``                fragments that all lens points see
    ``occluded``                  fragments of which some lens points see nothing, or not all
    ``highlights``                the colours, without the shares, by which the brightest of
                                  both kinds exceed what is beside them: they show the shape of
                                  the lens and how it is cut, are looked at from more points,
                                  and are the same in all coarser views
    ``single``                    the limits of single points, of the picture that the view is of
                                  a tile of; ``None`` where it is of a picture itself
    ============================  ==========================================================
    """

    unoccluded: Fragments
    occluded: Occluded
    highlights: Occluded
    single: HighlightLimits | None = None

    @classmethod
    def of(
        cls,
        fragments: Fragments,
        radius_per_vergence: float,
        lens_points: LensPoints,
        single_points: bool = True,
        located: Callable[[Fragments], Fragments] = lambda highlights: highlights,
        seen_of_known: np.ndarray | None = None,
        limits: ViewLimits | None = None,
        lit: Window | None = None,
    ) -> LensView:
        """The view of ``fragments`` from the ``lens_points``.

        ``radius_per_vergence`` is the radius of the circle in subpixels per unit of vergence.
        Without ``single_points`` only fragments that are seen in part can be highlights.
        ``located`` gives highlights their offsets. ``seen_of_known``, uint8 (n, M), is what the
        points see of fragments of which that is known: a row for each number in their ``known``.
        ``limits`` are those of the picture that they are a tile of, if they are, and the view then
        is of the fragments that are ``lit``.
        """
        covers = covers_of(fragments)
        points, times = lens_points.points, lens_points.times
        sight, bright_ones = (None, None) if limits is None else limits
        coverable, seen = visibility(covers, radius_per_vergence, points, times, sight, lit)
        leave_a_trace(covers, coverable, seen)
        if seen_of_known is not None:
            fragments, coverable, seen = _with_known(fragments, coverable, seen, seen_of_known)
        if lens_points.has_rim:
            coverable, seen, fragments = within_rim(fragments, coverable, seen, lens_points)
        all_seen, some_seen = seen.min(axis=1) == 255, seen.any(axis=1)
        unoccluded, occluded = ~coverable, np.zeros(len(fragments), dtype=bool)
        unoccluded[coverable], occluded[coverable] = all_seen, some_seen & ~all_seen
        bright = is_highlight(fragments, bright_ones) & ((unoccluded & single_points) | occluded)
        if fragments.known is not None:
            bright &= fragments.known < 0
        fragments, highlights = parted(fragments, bright)
        if lit is not None:
            highlights = highlights.chosen(lit.contains(highlights.x, highlights.y))
            unoccluded &= lit.contains(fragments.x, fragments.y)
            occluded &= lit.contains(fragments.x, fragments.y)
        chosen, more = located(highlights), lens_points.highlight_points
        seen_of_chosen = visibility_of_highlights(
            covers, chosen, radius_per_vergence, more, lens_points.cell
        )
        if lens_points.has_rim:
            seen_of_chosen *= lens_points.inside_rim(chosen, more)
        return cls(
            fragments.chosen(unoccluded),
            Occluded(
                dataclasses.replace(fragments.chosen(occluded), detail=None),
                seen[occluded[coverable]],
                points[None],
                times,
            ),
            Occluded(
                chosen,
                seen_of_chosen,
                more[None],
                None if times is None else (np.arange(len(more)) * GOLDEN) % 1 - 0.5,
                Jitter(chosen, lens_points.cell),
            ),
        )

    def between(self, bins: range) -> LensView:
        """The view of some ``bins``, with all highlights."""
        part = self.unoccluded.between(bins.start, bins.stop)
        unoccluded, occluded = self.unoccluded.chosen(part), self.occluded.between(bins)
        return LensView(unoccluded, occluded, self.highlights)

    def coarser(self, factor: int) -> LensView:
        """The same on subpixels, and in bins of depth, ``factor`` times as large."""
        unoccluded = self.unoccluded.coarser_linearly(factor)
        return LensView(unoccluded, self.occluded.coarser(factor), self.highlights)

    @property
    def kinds(self) -> tuple[Fragments, Fragments, Fragments]:
        """The fragments that are unoccluded, occluded, and highlights."""
        return self.unoccluded, self.occluded.fragments, self.highlights.fragments

    @functools.cached_property
    def counts(self) -> np.ndarray:
        """How many fragments each bin has, int64 (bins,)."""
        counts = [np.bincount(fragments.bin) for fragments in self.kinds]
        longest = max(len(count) for count in counts)
        return np.sum([np.pad(count, (0, longest - len(count))) for count in counts], axis=0)

    @functools.cached_property
    def vergences(self) -> tuple[np.ndarray, np.ndarray]:
        """The bins that have unoccluded fragments, and the mean vergence of these."""
        counts = np.bincount(self.unoccluded.bin)
        bins = np.flatnonzero(counts)
        sums = np.bincount(self.unoccluded.bin, self.unoccluded.vergence)
        return bins, sums[bins] / counts[bins]

    @functools.cached_property
    def single_points(self) -> np.ndarray:
        """Index, (n,), of unoccluded fragments so bright that their place in a subpixel shows."""
        if self.unoccluded.offset is None:
            return np.empty(0, dtype=np.int64)
        return np.flatnonzero(is_highlight(self.unoccluded, self.single))


class ViewPyramid:
    """A view, and coarser ones that are made when they are first asked for.

    ``density``, ``moments`` and ``detail`` are those of the samples, see
    :class:`potmesil_mi.focusing.density.Evened`.
    """

    def __init__(
        self,
        finest: LensView,
        density: np.ndarray | None,
        moments: np.ndarray | None,
        detail: Detail | None = None,
    ) -> None:
        self.finest = finest
        self.density, self.moments, self.detail = density, moments, detail
        self._coarser: dict[int, dict[range, LensView]] = {}

    def at(self, factor: int, bins: range) -> LensView:
        """The view of some ``bins``, on subpixels, and in bins of depth, ``factor`` times as large.

        It may have others, too. A single picture needs few of the coarser ones, so parts are made
        of what is asked for; where more and more is asked for, the whole is.
        """
        if factor == 1:
            return self.finest
        parts = self._coarser.setdefault(factor, {})
        for of, view in parts.items():
            if bins.start >= of.start and bins.stop <= of.stop:
                return view
        if len(parts) >= COARSER_PARTS:
            parts.clear()
            bins = range(MAX_BINS + 1)
        else:
            bins = range(bins.start // factor * factor, -(-bins.stop // factor) * factor)
        parts[bins] = self.finest.between(bins).coarser(factor)
        return parts[bins]

    def of_tile(self, single: HighlightLimits | None) -> ViewPyramid:
        """The same with the limits of single points that all of the picture has."""
        finest = dataclasses.replace(self.finest, single=single)
        return ViewPyramid(finest, self.density, self.moments, self.detail)

    @property
    def nbytes(self) -> int:
        """Memory in bytes: the columns of all levels, each on the host and on the device."""
        # Another thread may be forming a picture meanwhile.
        coarser = [view for of in list(self._coarser.values()) for view in list(of.values())]
        views = [self.finest, *coarser]
        kinds = [(view.unoccluded.nbytes, view.occluded.nbytes) for view in views]
        of_samples = sum(
            of.nbytes for of in (self.density, self.moments, self.detail) if of is not None
        )
        return 2 * (self.finest.highlights.nbytes + sum(map(sum, kinds))) + of_samples


def covers_of(fragments: Fragments) -> Fragments:
    """The fragments that may hide others, and of which what lens points see is inferred."""
    return fragments if fragments.known is None else fragments.chosen(fragments.known < 0)


def as_lit(fragments: Fragments, lens_points: LensPoints) -> Fragments:
    """The fragments that have light, as bright as a :class:`LensView` has them."""
    if fragments.known is not None:
        fragments = fragments.chosen(fragments.known != COVERS)
    return _inside_rim(fragments, lens_points)[1] if lens_points.has_rim else fragments


def _with_known(
    fragments: Fragments, coverable: np.ndarray, seen: np.ndarray, seen_of_known: np.ndarray
) -> tuple[Fragments, np.ndarray, np.ndarray]:
    """What lens points see of all fragments, by inference or because it is known.

    ``coverable`` and ``seen`` are those of the fragments that are not known. Returns the fragments
    without those that only cover others, and the same of these.
    """
    assert fragments.known is not None
    is_known = fragments.known >= 0
    rows = seen_of_known[fragments.known[is_known]]
    partly = rows.min(axis=1) < 255
    of_all = np.zeros(len(fragments), dtype=bool)
    of_all[~is_known], of_all[is_known] = coverable, partly
    seen_of_all = np.empty((np.count_nonzero(of_all), rows.shape[1]), np.uint8)
    there = is_known[of_all]
    seen_of_all[~there], seen_of_all[there] = seen, rows[partly]
    lit = fragments.known != COVERS
    return fragments.chosen(lit), of_all[lit], seen_of_all[lit[of_all]]


def leave_a_trace(fragments: Fragments, coverable: np.ndarray, seen: np.ndarray) -> None:
    """Have the innermost lens point see something of what the pinhole sees.

    ``seen`` is what points see of the ``coverable`` of the fragments. Without a trace of the others
    there might be black holes: the pinhole does see its samples.
    """
    first = fragments.gap_in_front[coverable] == 0
    seen[first, 0] = np.maximum(seen[first, 0], LEAST_SEEN)


def within_rim(
    fragments: Fragments, coverable: np.ndarray, seen: np.ndarray, lens_points: LensPoints
) -> tuple[np.ndarray, np.ndarray, Fragments]:
    """What lens points see of all fragments where the rim of the lens lets through a part only.

    That part becomes brighter.
    """
    inside, brighter = _inside_rim(fragments, lens_points)
    count = len(lens_points.points)
    seen_of_all = np.full((len(fragments), count), 255, dtype=np.uint8)
    seen_of_all[coverable] = seen
    seen_of_all *= inside
    unseen = ~seen_of_all.any(axis=1) & fragments.first
    seen_of_all[unseen, inside[unseen].argmax(axis=1)] = LEAST_SEEN
    every_one = np.ones(len(fragments), dtype=bool)
    return every_one, seen_of_all, brighter


def _inside_rim(fragments: Fragments, lens_points: LensPoints) -> tuple[np.ndarray, Fragments]:
    """What the rim lets through to each lens point, bool (N, M), and the fragments, brighter.

    What the rim takes changes shapes and not the exposure.
    """
    inside = lens_points.inside_rim(fragments, lens_points.points)
    inside[~inside.any(axis=1), 0] = True
    return inside, fragments.scaled(len(lens_points.points) / inside.sum(axis=1))
