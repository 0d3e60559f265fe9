"""Gathering: point samples become fragments, by subpixel of the window and by depth."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import drjit as dr
import numpy as np

from .. import _backend as jit
from ..samples.columns import ELSEWHERE, VISIBILITY_POINTS, points_that_see
from ..samples.point_samples import PointSamples
from ..samples.raster import Window
from .detail import Detail, along_axes, joined
from .fragments import (
    COVERS,
    INFERRED,
    MAX_BINS,
    SHARE,
    Fragments,
    among_few,
    as_column,
    scatter_mode,
)
from .locating import (
    Bins,
    Located,
    Raster,
    index_of,
    located_in,
    one_subpixel_each,
    parts_of,
    places_of,
)
from .moments import legendre, orders


def gather(
    samples: PointSamples,
    subpixels: int,
    radius_per_vergence: float,
    alpha: bool = False,
    degree: int = 0,
    bins: Bins | None = None,
    which: np.ndarray | None = None,
) -> Fragments:
    """Samples gathered on ``subpixels`` x ``subpixels`` subpixels of a pixel.

    ``radius_per_vergence`` is the circle's radius in subpixels per unit of vergence; with ``alpha``
    the values have a fifth column. The fragments have moments up to a ``degree``. ``bins`` are
    those of all depths of the samples, unless they are given. Only samples of which ``which``,
    bool (N,), is true are gathered, if it is given.
    """
    terms = Terms.of(degree)
    bins = bins or Bins.of(samples.z, radius_per_vergence)
    return _gather(samples, subpixels, alpha, terms, bins, which)[0]


class Terms(NamedTuple):
    """Of which orders moments are summed.

    ``every`` has those of the film first, without which there is no ``degree``; ``detail`` tells
    which are those of the detail.
    """

    degree: int
    every: list[tuple[int, int]]
    detail: list[int]

    @classmethod
    def of(cls, degree: int, detail_degree: int = 0) -> Terms:
        """Those of the degrees of the film and of the detail."""
        every, needed = [(0, 0), *orders(degree)], along_axes(detail_degree)
        every += [order for order in needed if order not in every]
        return cls(degree, every, [every.index(order) for order in needed])

    @property
    def of_film(self) -> int:
        """How many of them, from the first, the film asks for."""
        return 1 + len(orders(self.degree))


def _gather(
    samples: PointSamples,
    subpixels: int,
    alpha: bool,
    terms: Terms,
    bins: Bins,
    which: np.ndarray | None,
    whole: Window | None = None,
) -> tuple[Fragments, Detail | None]:
    """What :func:`gather` returns, and the table of its detail."""
    if samples.lattice > 0:
        samples = one_subpixel_each(samples if which is None else samples.chosen(which), subpixels)
        which = None
    raster = Raster.of(samples, subpixels, whole)
    located = functools.partial(located_in, samples, subpixels, raster)

    room = among_few(raster.size)
    nearest, farthest = ends_of_bins(len(samples), located, bins, room, which)
    # Most subpixels show one depth: their samples need no sorting.
    one_depth = nearest - farthest <= 1

    sums_alone = _SumsAlone(room, alpha, terms)
    others = [np.empty(0, np.int64)]
    for part, chosen in parts_of(len(samples), which):
        at = located(part)
        alone = at.visible & dr.gather(jit.Bool, one_depth, at.subpixel)
        sums_alone.add(samples, part, subpixels, at, alone & chosen)
        others.append(index_of(~alone & chosen, part))

    index = np.concatenate(others)
    chosen = Chosen(samples, index, samples.layer[index], samples.weight[index])
    other_place, other_layer, other_vergence, other_light, _ = sorted_sums(
        chosen, subpixels, alpha, terms, *places_of(located, index, bins)
    )
    place, vergence, light = sums_alone.found(len(other_place))
    light[len(place) :] = other_light[:, : terms.of_film]
    rows = np.concatenate([place, room + np.arange(len(other_place))])
    hidden = np.concatenate([np.zeros(len(place), dtype=bool), other_layer > 0])
    place = np.concatenate([place, other_place])
    vergence = np.concatenate([vergence, other_vergence])
    gap = np.zeros(len(vergence))
    gap[hidden] = bins.gap_behind(np.array(nearest)[place[hidden]], vergence[hidden])
    found = fragments_of(raster, bins, place, vergence, light)
    found = dataclasses.replace(found, gap_in_front=gap)
    detail = None
    if terms.detail:
        found = dataclasses.replace(found, detail=rows)
        detail = sums_alone.detail().and_others(Detail.of(other_light[:, terms.detail]))
    return found.in_order(), detail


def ends_of_bins(
    count: int,
    located: Callable[[slice | np.ndarray], Located],
    bins: Bins,
    room: int,
    which: np.ndarray | None = None,
) -> tuple[jit.UInt32, jit.UInt32]:
    """The nearest and the farthest bin of what the pinhole sees of ``count`` samples.

    There is one of each for every subpixel, of which there are at most ``room``.
    """
    nearest = dr.zeros(jit.UInt32, room)
    farthest = dr.full(jit.UInt32, MAX_BINS, room)
    for part, chosen in parts_of(count, which):
        at = located(part)
        bin_ = bins.of_vergence(at.vergence)
        for op, ends in ((dr.ReduceOp.Max, nearest), (dr.ReduceOp.Min, farthest)):
            dr.scatter_reduce(op, ends, bin_, at.subpixel, at.visible & chosen, mode=scatter_mode())
        dr.eval(nearest, farthest)
    return nearest, farthest


class Gathered(NamedTuple):
    """Fragments, and what the lens sees of those of which it is known.

    ``seen``, uint8 (n, 64), is what each of ``PointSamples.visibility_points`` sees of them, 0 for
    nothing to 255 for all, a row for each number in ``fragments.known``; ``None`` where all is to
    be inferred. ``detail`` is the table of that of the fragments, if it was asked for.
    """

    fragments: Fragments
    seen: np.ndarray | None = None
    detail: Detail | None = None


def gather_with_known(
    samples: PointSamples,
    subpixels: int,
    radius_per_vergence: float,
    alpha: bool = False,
    degree: int = 0,
    bins: Bins | None = None,
    detail_degree: int = 0,
    whole: Window | None = None,
    some_known: bool | None = None,
) -> Gathered:
    """Samples gathered as by :func:`gather`, those of known visibility apart from the others.

    ``detail_degree`` is that of the moments that tell their detail. Those of known visibility that
    are on rays of the pinhole cover what is behind them, or behind the mirror or pane that they are
    seen through. ``whole`` is the window of the picture that the samples are a tile of, if they
    are, and ``some_known`` says whether there are any of known visibility in that.
    """
    terms = Terms.of(degree, detail_degree)
    bins = bins or bins_of(samples, radius_per_vergence)
    if not (has_known(samples) if some_known is None else some_known):
        found, detail = _gather(samples, subpixels, alpha, terms, bins, None, whole)
        return Gathered(found, None, detail)
    samples = one_subpixel_each(samples, subpixels)
    known, depth = np.asarray(samples.visibility) != 0, depth_of_covers(samples)
    fragments, detail, seen = _gathered_known(
        samples, np.flatnonzero(known), subpixels, bins, alpha, terms, whole
    )
    parts = [(fragments, detail)]
    covers = samples if samples.through is None else samples.replace(z=depth)
    without = Terms.of(degree)
    for which, kind, of in (
        (~known, INFERRED, terms),
        (known & (samples.layer != ELSEWHERE), COVERS, without),
    ):
        if which.any():
            found, detail = _gather(covers, subpixels, alpha, of, bins, which, whole)
            found = dataclasses.replace(found, known=np.full(len(found), kind, np.int32))
            parts.append((found, detail))
    fragments, detail = joined(parts)
    return Gathered(_with_gaps(fragments.in_order()), seen, detail)


def has_known(samples: PointSamples) -> bool:
    """Whether there are samples of known visibility."""
    return samples.visibility is not None and bool(samples.visibility.any())


def bins_of(samples: PointSamples, radius_per_vergence: float) -> Bins:
    """The bins in which :func:`gather_with_known` gathers samples, by default."""
    if not has_known(samples):
        return Bins.of(samples.z, radius_per_vergence)
    return Bins.of(samples.z, radius_per_vergence, depth_of_covers(samples))


def depth_of_covers(samples: PointSamples) -> np.ndarray:
    """The depth at which samples cover others: that of the mirror or pane of what one shows."""
    if samples.through is None:
        return samples.z
    return np.where(samples.through > 0, samples.through, samples.z)


def _gathered_known(
    samples: PointSamples,
    index: np.ndarray,
    subpixels: int,
    bins: Bins,
    alpha: bool,
    terms: Terms,
    whole: Window | None,
) -> tuple[Fragments, Detail | None, np.ndarray]:
    """Samples ``index``, of known visibility: their light, its detail, and what the lens sees.

    See ``Gathered``; the first row of what is seen is of all that all points of the lens see. That
    is apart from the rest. Where samples become one fragment, each counts as much of its light as
    there are points that see it.
    """
    assert samples.visibility is not None
    raster = Raster.of(samples, subpixels, whole)
    visibility, area = samples.visibility[index], samples.weight[index]
    seen_by = points_that_see(visibility)
    partly = seen_by < VISIBILITY_POINTS
    chosen = Chosen(samples, index, partly, area * (seen_by / VISIBILITY_POINTS))
    places = places_of(functools.partial(located_in, samples, subpixels, raster), index, bins)
    place, is_partly, vergence, light, same = sorted_sums(chosen, subpixels, alpha, terms, *places)
    # Rows of what is seen in part, after that of what is seen as a whole.
    known = np.cumsum(is_partly, dtype=np.int32) * (is_partly > 0)
    row, count = known[same[partly]], int(known.max(initial=0)) + 1
    visibility, area = visibility[partly], area[partly]
    areas = np.bincount(row, area, count)
    # The whole area that the light has, also where no point sees it.
    seen_areas = np.bincount(row, chosen.weight[partly], count)
    scale = np.divide(areas, seen_areas, out=np.ones(count), where=seen_areas > 0)
    light *= scale[known][:, None, None]
    seen = np.full((count, VISIBILITY_POINTS), 255, np.uint8)
    for point in range(VISIBILITY_POINTS):
        bit = visibility >> np.uint64(point) & np.uint64(1)
        seen[1:, point] = np.rint(255 * np.bincount(row, area * bit, count)[1:] / areas[1:])
    fragments = fragments_of(raster, bins, place, vergence, light[:, : terms.of_film])
    fragments = dataclasses.replace(fragments, known=known)
    if not terms.detail:
        return fragments, None, seen
    rows = np.arange(len(fragments))
    fragments = dataclasses.replace(fragments, detail=rows)
    return fragments, Detail.of(light[:, terms.detail]), seen


def fragments_of(
    raster: Raster,
    bins: Bins,
    place: np.ndarray,
    vergence: np.ndarray,
    light: np.ndarray,
) -> Fragments:
    """Fragments, not in order, of sums by subpixel and depth; nothing is known to be hidden."""
    left, top, width, height = raster.window
    return Fragments(
        width,
        height,
        place % width,
        place // width,
        vergence,
        light[:, 0],
        np.zeros(len(place)),
        np.maximum((vergence - bins.vergence_min) / bins.width, 0).astype(np.int64),
        bins.vergence_min,
        bins.width,
        moments=light[:, 1:] if light.shape[1] > 1 else None,
        left=left,
        top=top,
    )


def _with_gaps(fragments: Fragments) -> Fragments:
    """Fragments of several, each gathered without the others, with their gaps in front of them."""
    nearest = np.zeros(fragments.width * fragments.height, np.int32)
    first = fragments.first
    np.maximum.at(nearest, fragments.subpixel[first], fragments.bin[first])
    bins = Bins(fragments.vergence_min, fragments.bin_width)
    gap = bins.gap_behind(nearest[fragments.subpixel], fragments.vergence)
    return dataclasses.replace(fragments, gap_in_front=np.where(first, 0, gap).astype(np.float32))


def with_offsets(
    fragments: Fragments, samples: PointSamples, subpixels: int, whole: Window | None = None
) -> Fragments:
    """Fragments of ``samples``, some or all that :func:`gather` made, with their ``offset``."""
    samples = one_subpixel_each(samples, subpixels)
    raster = Raster.of(samples, subpixels, whole)
    located = functools.partial(located_in, samples, subpixels, raster)
    own, first = fragments.subpixel, fragments.first
    asked = np.zeros(raster.size, dtype=np.uint8)
    asked[own[first]] = 1
    is_asked = jit.from_numpy(jit.UInt8, asked)
    found = [np.empty(0, np.int64)]
    for part, _ in parts_of(len(samples)) if first.any() else []:
        at = located(part)
        found.append(index_of(at.visible & (dr.gather(jit.UInt8, is_asked, at.subpixel) > 0), part))
    these = np.concatenate(found)
    subpixel, *places = places_of(located, these)
    light = (samples.weight[these] * samples.rgb[these].max(axis=1)).astype(np.float64)
    total = np.bincount(subpixel, light, raster.size)[own]
    offset = [
        np.bincount(subpixel, light * place / 2, raster.size)[own] / np.where(total > 0, total, 1)
        for place in places
    ]
    offset = np.clip(np.stack(offset, axis=1), -0.5, 0.5) * first[:, None]
    return dataclasses.replace(fragments, offset=offset.astype(np.float32))


class _SumsAlone:
    """Sums over the samples of subpixels that show one depth, for each subpixel.

    They are R, G, B, share, and alpha if asked for, their moments, and vergence; what there is
    room for beyond the subpixels stays empty.
    """

    def __init__(self, room: int, alpha: bool, terms: Terms) -> None:
        self.terms = terms
        self.light = [dr.zeros(jit.Float, room * 4) for _ in terms.every]
        self.alpha = [dr.zeros(jit.Float, room) for _ in terms.every if alpha]
        self.vergence = dr.zeros(jit.Float, room)

    def add(
        self,
        samples: PointSamples,
        part: slice | np.ndarray,
        subpixels: int,
        at: Located,
        alone: jit.Bool,
    ) -> None:
        """Add the samples ``part`` that are ``alone``."""
        mode, area = scatter_mode(), dr.opaque(jit.Float, subpixels**2)
        all_weight = jit.from_numpy(jit.Float, samples.weight[part]) * area
        red, green, blue = dr.unravel(jit.Array3f, as_column(samples.rgb[part]))
        for k, (i, j) in enumerate(self.terms.every):
            weight = all_weight * legendre(i, at.across) * legendre(j, at.down)
            values = jit.Array4f(weight * red, weight * green, weight * blue, weight)
            dr.scatter_add(self.light[k], values, at.subpixel, alone, mode=mode)
            if self.alpha:
                values = weight * jit.from_numpy(jit.Float, samples.alpha[part])
                dr.scatter_add(self.alpha[k], values, at.subpixel, alone, mode=mode)
        dr.scatter_add(self.vergence, all_weight * at.vergence, at.subpixel, alone, mode=mode)
        dr.eval(self.light, self.alpha, self.vergence)

    def found(self, more: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The subpixels that have some, their mean vergence, and the sums of each.

        The sums are float32 (n + ``more``, 1 + moments, 4 or 5), of which the last are left empty;
        the moments are those that the film asks for.
        """
        values = np.array(self.light[0]).reshape(-1, 4)
        place = np.flatnonzero(values[:, SHARE])
        channels = values.shape[1] + bool(self.alpha)
        count = self.terms.of_film
        light = np.empty((len(place) + more, count, channels), np.float32)
        own = light[: len(place)]
        for k, of in enumerate(self.light[:count]):
            own[:, k, :4] = np.array(of).reshape(-1, 4)[place]
        for k, of in enumerate(self.alpha[:count]):
            own[:, k, 4] = np.array(of)[place]
        vergence = np.array(self.vergence)[place].astype(np.float64) / own[:, 0, SHARE]
        return place, vergence, light

    def detail(self) -> Detail:
        """The detail of each subpixel."""
        colours, alpha = (
            [of[term] for term in self.terms.detail if of] for of in (self.light, self.alpha)
        )
        return Detail(colours, alpha)


@dataclasses.dataclass(frozen=True)
class Chosen:
    """Samples ``index`` of ``samples``, with the layers and weights, (n,), that they count with."""

    samples: PointSamples
    index: np.ndarray | slice
    layer: np.ndarray
    weight: np.ndarray


def sorted_sums(
    chosen: Chosen,
    subpixels: int,
    alpha: bool,
    terms: Terms,
    places: np.ndarray,
    across: np.ndarray | float,
    down: np.ndarray | float,
    bins: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Samples summed by subpixel, depth layer and bin, by sorting.

    Returns subpixel, layer and mean vergence of each sum, the sums as :class:`_SumsAlone` has
    them, float64, and which sum each sample is in.
    """
    samples, index = chosen.samples, chosen.index
    key = places.astype(np.int64) * 256 + chosen.layer
    keys, same = np.unique(key * (MAX_BINS + 1) + bins, return_inverse=True)
    all_weight = chosen.weight.astype(np.float64) * subpixels**2
    columns = [*samples.rgb[index].T, 1.0, *([samples.alpha[index]] if alpha else [])]
    light = np.empty((len(keys), len(terms.every), len(columns)))
    for k, (i, j) in enumerate(terms.every):
        weight = all_weight * legendre(i, across) * legendre(j, down)
        for channel, column in enumerate(columns):
            light[:, k, channel] = np.bincount(same, weight * column, len(keys))
    vergence = np.bincount(same, all_weight / samples.z[index], len(keys)) / light[:, 0, SHARE]
    place_and_layer = keys // (MAX_BINS + 1)
    return place_and_layer // 256, place_and_layer % 256, vergence, light, same
