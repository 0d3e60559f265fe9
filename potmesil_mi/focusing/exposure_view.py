"""What the lens sees during an exposure in which things move.

Each part of the exposure has samples of its own, and lens points that look at it. What all of them
see is smeared along its path; of the rest each point sees what it meets at its own time.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np

from ..samples.point_samples import PointSamples
from .density import evened
from .fragments import Fragments
from .gathering import gather_with_known
from .highlight_visibility import Jitter
from .lens_points import LensPoints
from .lens_view import LensView, Occluded, ViewPyramid
from .locating import Bins, Raster, located_in, one_subpixel_each, places_of
from .smearing import smeared

LEAST_BINS = 64
"""Bins from the nearest to the farthest depth, at least."""

LEAST_POINTS = 8
"""Lens points that look at each part of an exposure, at least."""

MORE_POINTS = 2
"""How many times as many as at something still look at all parts together."""


def view_of_exposure(
    samples: PointSamples,
    subpixels: int,
    radius_per_vergence: float,
    alpha: bool,
    lens_points: LensPoints,
    single_points: bool,
) -> ViewPyramid:
    """The view of samples of an exposure, gathered on ``subpixels`` x ``subpixels`` of a pixel.

    The other parameters are those of :func:`potmesil_mi.focusing.gathering.gather` and of
    :meth:`LensView.of`.
    """
    parts = samples.at_instants()
    each = max(LEAST_POINTS, MORE_POINTS * len(lens_points.points) // len(parts))
    bins = _bins(samples, radius_per_vergence)
    views, densities = [], []
    for part, points in zip(parts, lens_points.at_instants(len(parts), each), strict=True):
        gathered = gather_with_known(part, subpixels, radius_per_vergence, alpha, 0, bins)
        fragments = _with_motion(gathered.fragments, part, subpixels)
        found = evened(fragments, subpixels)
        densities.append(found.density)
        seen = gathered.seen
        if seen is not None:
            seen = points.nearest(seen, part, radius_per_vergence, subpixels)
        views.append(
            LensView.of(
                found.fragments, radius_per_vergence, points, single_points, seen_of_known=seen
            )
        )
    density = None
    if any(of is not None for of in densities):
        every = [1 if of is None else of for of in densities]
        density = (sum(every) / np.float32(len(every))).astype(np.float32)
    return ViewPyramid(_joined(views), density, None)


def _with_motion(fragments: Fragments, samples: PointSamples, subpixels: int) -> Fragments:
    """Fragments of ``samples``, as :func:`gather` made them, with their ``motion``.

    It is the mean of that of the samples at the same place and depth.
    """
    motion = np.zeros((len(fragments), 3), np.float32)
    if samples.motion is not None:
        samples = one_subpixel_each(samples, subpixels)
        assert samples.motion is not None
        raster = Raster.of(samples, subpixels)
        bins = Bins(fragments.vergence_min, fragments.bin_width)
        located = functools.partial(located_in, samples, subpixels, raster)
        subpixel, _, _, bin_ = places_of(located, np.arange(len(samples)), bins)
        own = fragments.bin.astype(np.int64) * raster.size + fragments.subpixel
        keys, index = np.unique(own, return_inverse=True)
        of_samples = bin_.astype(np.int64) * raster.size + subpixel
        number = np.minimum(np.searchsorted(keys, of_samples), len(keys) - 1)
        met = keys[number] == of_samples
        number, weight = number[met], samples.weight[met].astype(np.float64)
        total = np.bincount(number, weight, len(keys))
        paths = samples.motion[met].astype(np.float64)
        # Where z changes by dz, 1/z does by about -dz/z^2, and from end to end exactly so.
        z = samples.z[met].astype(np.float64)
        deeper = paths[:, 2] / 2
        with np.errstate(invalid="ignore"):
            change = np.where(deeper != 0, 1 / (z + deeper) - 1 / (z - deeper), 0)
        columns = paths[:, 0] * subpixels, paths[:, 1] * subpixels, change
        for i, column in enumerate(columns):
            sums = np.bincount(number, weight * column, len(keys))
            motion[:, i] = (sums / np.where(total > 0, total, 1))[index]
    return dataclasses.replace(fragments, motion=motion)


def _bins(samples: PointSamples, radius_per_vergence: float) -> Bins:
    """Bins for all depths that samples have while they move.

    What moves hides what is behind it before a small lens, too: there are at least ``LEAST_BINS``.
    """
    ends = [samples.z]
    if samples.motion is not None:
        ends += [samples.z + side * samples.motion[:, 2] for side in (-0.5, 0.5)]
    if samples.through is not None:
        ends.append(np.where(samples.through > 0, samples.through, samples.z))
    bins = Bins.of(ends[0], radius_per_vergence, *ends[1:])
    depths = max(float(np.max(1 / of)) for of in ends) - bins.vergence_min
    if depths > 0:
        bins = bins._replace(width=min(bins.width, depths / LEAST_BINS))
    return bins


def _joined(views: Sequence[LensView]) -> LensView:
    """The view of an exposure, of those of its parts, whose light is as much of it each."""
    share = 1 / len(views)

    def scaled(fragments: Fragments) -> Fragments:
        return fragments.scaled(np.full(len(fragments), share))

    occluded, highlights = (
        _with_instants([getattr(view, kind) for view in views], scaled)
        for kind in ("occluded", "highlights")
    )
    return LensView(smeared([scaled(view.unoccluded) for view in views]), occluded, highlights)


def _with_instants(kinds: Sequence[Occluded], scaled: Callable[[Fragments], Fragments]) -> Occluded:
    """Fragments of all parts, each of which lens points of its own look at."""
    parts = [
        dataclasses.replace(
            scaled(of.fragments), instant=np.full(len(of.fragments), instant, np.int32)
        )
        for instant, of in enumerate(kinds)
    ]
    together = parts[0].and_others(*parts[1:])
    order = together.order
    seen = np.concatenate([of.seen for of in kinds])[order]
    points = np.concatenate([of.points for of in kinds])
    fragments = together.in_order()
    jitter = None
    if kinds[0].jitter is not None:
        jitter = Jitter(fragments, kinds[0].jitter.cell)
    return Occluded(fragments, seen, points, kinds[0].times, jitter)
