"""Gathering: point samples become fragments, by subpixel of the window and by depth."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import drjit as dr
import numpy as np

from .. import _backend as jit
from ..samples.point_samples import PointSamples
from ..samples.raster import Window
from .fragments import BIN_RADIUS, MAX_BINS, SHARE, Fragments, scatter_mode
from .moments import legendre, orders

GATHERED_AT_ONCE = 1 << 22
"""Most samples that are gathered at once; it bounds the memory of a step."""


def gather(
    samples: PointSamples,
    subpixels: int,
    radius_per_vergence: float,
    alpha: bool = False,
    degree: int = 0,
) -> Fragments:
    """Samples gathered on ``subpixels`` x ``subpixels`` subpixels of a pixel.

    ``radius_per_vergence`` is the circle's radius in subpixels per unit of vergence; with ``alpha``
    the values have a fifth column. The fragments have moments up to a ``degree``.
    """
    samples = one_subpixel_each(samples, subpixels)
    raster = samples.window.subdivided(subpixels)
    bins = _Bins.of(samples, radius_per_vergence)
    parts = [slice(i, i + GATHERED_AT_ONCE) for i in range(0, len(samples), GATHERED_AT_ONCE)]
    located = functools.partial(_located, samples, subpixels, raster, bins)

    nearest = dr.zeros(jit.UInt32, raster.size)
    farthest = dr.full(jit.UInt32, MAX_BINS, raster.size)
    for part in parts:
        at = located(part)
        for op, ends in ((dr.ReduceOp.Max, nearest), (dr.ReduceOp.Min, farthest)):
            dr.scatter_reduce(op, ends, at.bin, at.subpixel, at.visible, mode=scatter_mode())
        dr.eval(nearest, farthest)
    # Most subpixels show one depth: their samples need no sorting.
    one_depth = nearest - farthest <= 1

    sums_alone = _SumsAlone(raster.size, alpha, degree)
    others = []
    for part in parts:
        at = located(part)
        alone = at.visible & dr.gather(jit.Bool, one_depth, at.subpixel)
        sums_alone.add(samples, part, subpixels, at, alone)
        left_over = dr.compress(~alone)
        columns = (at.subpixel, at.bin, at.across, at.down)
        where = [np.array(dr.gather(type(c), c, left_over)) for c in columns]
        others.append([np.array(left_over).astype(np.int64) + part.start, *where])

    place, alone_sums = sums_alone.found()
    other_place, other_layer, other_sums = _sorted_sums(
        samples, subpixels, alpha, degree, *(np.concatenate(c) for c in zip(*others, strict=True))
    )
    sums = [np.concatenate(columns) for columns in zip(alone_sums, other_sums, strict=True)]
    hidden = np.concatenate([np.zeros(len(place), dtype=bool), other_layer > 0])
    place = np.concatenate([place, other_place])
    vergence = sums.pop() / sums[SHARE]
    gap = np.zeros(len(vergence))
    first = bins.vergence_min + (np.array(nearest)[place[hidden]] + 0.5) * bins.width
    gap[hidden] = np.maximum(first - vergence[hidden], bins.width * 1e-3)
    light = np.stack(sums, axis=1).reshape(len(place), -1, SHARE + 1 + alpha)
    found = Fragments(
        raster.width,
        raster.height,
        place % raster.width,
        place // raster.width,
        vergence,
        light[:, 0],
        gap,
        np.maximum((vergence - bins.vergence_min) / bins.width, 0).astype(np.int64),
        bins.vergence_min,
        bins.width,
        moments=light[:, 1:] if degree > 0 else None,
    )
    return found.in_order()


def with_offsets(fragments: Fragments, samples: PointSamples, subpixels: int) -> Fragments:
    """Fragments of ``samples``, some or all that :func:`gather` made, with their ``offset``."""
    samples = one_subpixel_each(samples, subpixels)
    size = fragments.width * fragments.height
    own, first = fragments.subpixel, fragments.gap_in_front == 0
    asked = np.zeros(size, dtype=bool)
    asked[own[first]] = True
    left, top = samples.window[:2]
    # Of many samples few are asked for: the others cost no more than their places.
    fine = [(at - np.float32(of)) * subpixels for at, of in ((samples.x, left), (samples.y, top))]
    places = [
        np.clip(np.floor(at), 0, count - 1).astype(np.int32)
        for at, count in zip(fine, (fragments.width, fragments.height), strict=True)
    ]
    subpixel = places[1].astype(np.int64) * fragments.width + places[0]
    these = np.flatnonzero(asked[subpixel])
    these = these[samples.layer[these] == 0]
    subpixel = subpixel[these]
    light = (samples.weight[these] * samples.rgb[these].max(axis=1)).astype(np.float64)
    total = np.bincount(subpixel, light, size)[own]
    offset = [
        np.bincount(subpixel, light * (at[these] - place[these] - 0.5), size)[own]
        / np.where(total > 0, total, 1)
        for at, place in zip(fine, places, strict=True)
    ]
    offset = np.clip(np.stack(offset, axis=1), -0.5, 0.5) * first[:, None]
    return dataclasses.replace(fragments, offset=offset.astype(np.float32))


def one_subpixel_each(samples: PointSamples, subpixels: int) -> PointSamples:
    """Samples of which each lies in one subpixel.

    Samples of a lattice lie on the edges of several: each is replaced by four of a quarter of its
    weight, of which those outside the window are left out.
    """
    if samples.lattice == 0:
        return samples
    nudge = 0.25 / max(samples.lattice, subpixels)
    quarters = [
        samples.replace(x=samples.x + dx, y=samples.y + dy, weight=samples.weight / 4)
        for dx in (-nudge, nudge)
        for dy in (-nudge, nudge)
    ]
    names = ("x", "y", "rgb", "alpha", "z", "surface", "weight", "layer")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(q, name) for q in quarters]) for name in names
    }
    inside = samples.window.contains(columns["x"], columns["y"])
    return samples.replace(**{name: column[inside] for name, column in columns.items()})


class _Bins(NamedTuple):
    """Where the bins of vergence begin, and how wide they are."""

    vergence_min: float
    width: float

    @classmethod
    def of(cls, samples: PointSamples, radius_per_vergence: float) -> _Bins:
        ends = 1 / samples.z.max(), 1 / samples.z.min()
        # Where depths are many circles apart, the bins are wider.
        width = max(BIN_RADIUS / radius_per_vergence, float(ends[1] - ends[0]) / MAX_BINS)
        return cls(float(ends[0]), width)


class _Located(NamedTuple):
    """Subpixel, vergence and bin of samples, and which of them the pinhole sees.

    ``across`` and ``down``, from -1 to 1, tell where in the subpixel they are.
    """

    subpixel: jit.UInt32
    vergence: jit.Float
    bin: jit.UInt32
    visible: jit.Bool
    across: jit.Float
    down: jit.Float


def _located(
    samples: PointSamples, subpixels: int, raster: Window, bins: _Bins, part: slice
) -> _Located:
    left, top = samples.window[:2]
    x = (jit.Float(samples.x[part]) - left) * subpixels
    y = (jit.Float(samples.y[part]) - top) * subpixels
    column = dr.clip(jit.Int32(dr.floor(x)), 0, raster.width - 1)
    row = dr.clip(jit.Int32(dr.floor(y)), 0, raster.height - 1)
    vergence = dr.rcp(jit.Float(samples.z[part]))
    from_first = (vergence - bins.vergence_min) * dr.opaque(jit.Float, 1 / bins.width)
    return _Located(
        jit.UInt32(row * raster.width + column),
        vergence,
        dr.minimum(jit.UInt32(dr.maximum(from_first, 0)), MAX_BINS),
        jit.UInt8(samples.layer[part]) == 0,
        dr.clip(2 * (x - jit.Float(column)) - 1, -1, 1),
        dr.clip(2 * (y - jit.Float(row)) - 1, -1, 1),
    )


class _SumsAlone:
    """Sums over the samples of subpixels that show one depth, for each subpixel.

    They are R, G, B, share, and alpha if asked for, then their moments, and last vergence.
    """

    def __init__(self, size: int, alpha: bool, degree: int) -> None:
        self.orders = [(0, 0), *orders(degree)]
        self.light = [dr.zeros(jit.Float, size * 4) for _ in self.orders]
        self.alpha = [dr.zeros(jit.Float, size) for _ in self.orders if alpha]
        self.vergence = dr.zeros(jit.Float, size)

    def add(
        self, samples: PointSamples, part: slice, subpixels: int, at: _Located, alone: jit.Bool
    ) -> None:
        """Add the samples ``part`` that are ``alone``."""
        mode = scatter_mode()
        all_weight = jit.Float(samples.weight[part]) * subpixels**2
        red, green, blue = dr.unravel(jit.Array3f, jit.Float(samples.rgb[part].ravel()))
        for k, (i, j) in enumerate(self.orders):
            weight = all_weight * legendre(i, at.across) * legendre(j, at.down)
            values = jit.Array4f(weight * red, weight * green, weight * blue, weight)
            dr.scatter_add(self.light[k], values, at.subpixel, alone, mode=mode)
            if self.alpha:
                values = weight * jit.Float(samples.alpha[part])
                dr.scatter_add(self.alpha[k], values, at.subpixel, alone, mode=mode)
        dr.scatter_add(self.vergence, all_weight * at.vergence, at.subpixel, alone, mode=mode)
        dr.eval(self.light, self.alpha, self.vergence)

    def found(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """The subpixels that have some, and the sums of each."""
        light = [np.array(of).reshape(-1, 4) for of in self.light]
        place = np.flatnonzero(light[0][:, SHARE])
        sums: list[np.ndarray] = []
        for k, of in enumerate(light):
            sums += [*of[place].T, *(np.array(alpha)[place] for alpha in self.alpha[k : k + 1])]
        return place, [*sums, np.array(self.vergence)[place]]


def _sorted_sums(
    samples: PointSamples,
    subpixels: int,
    alpha: bool,
    degree: int,
    index: np.ndarray,
    places: np.ndarray,
    bins: np.ndarray,
    across: np.ndarray,
    down: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Samples ``index`` summed by subpixel, depth layer and bin, by sorting.

    Returns subpixel and layer of each sum, and the sums as :class:`_SumsAlone` has them.
    """
    key = places.astype(np.int64) * 256 + samples.layer[index]
    keys, same = np.unique(key * (MAX_BINS + 1) + bins, return_inverse=True)
    all_weight = samples.weight[index].astype(np.float64) * subpixels**2
    columns = [*samples.rgb[index].T, 1.0, *([samples.alpha[index]] if alpha else [])]
    sums = []
    for i, j in [(0, 0), *orders(degree)]:
        weight = all_weight * legendre(i, across) * legendre(j, down)
        sums += [np.bincount(same, weight * column, len(keys)) for column in columns]
    sums.append(np.bincount(same, all_weight / samples.z[index], len(keys)))
    place_and_layer = keys // (MAX_BINS + 1)
    return place_and_layer // 256, place_and_layer % 256, sums
