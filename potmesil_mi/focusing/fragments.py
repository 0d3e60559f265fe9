"""Fragments: point samples gathered by subpixel of the window and by depth.

A lens does the same to everything at one depth, so samples of one subpixel and one depth become
one fragment. Fragments are kept in order of depth and then of place: those between two depths,
which are spread by nearly the same circle, follow each other in memory.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import Any, NamedTuple

import drjit as dr
import numpy as np

from .. import _backend as jit
from ..samples.point_samples import PointSamples
from ..samples.raster import Window

BIN_RADIUS = 0.25
"""Samples of a subpixel are one fragment where their circles' radii differ by less (subpixels)."""

MAX_BINS = 4095
"""Most bins of vergence between the nearest and the farthest sample, less one."""

GATHERED_AT_ONCE = 1 << 22
"""Most samples that are gathered at once; it bounds the memory of a step."""

SHARE = 3
"""Column of ``Fragments.values`` with the share of the subpixel's area."""


@dataclasses.dataclass(frozen=True)
class Fragments:
    """N fragments, in order of ``bin``, then of place.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``width``, ``height``         subpixels of the window
    ``x``, ``y``                  int32 (N,), column and row of the fragment's subpixel
    ``vergence``                  float32 (N,), 1/z in 1/scene units
    ``values``                    float32 (N, 4 or 5), light: R, G, B times the share of the
                                  subpixel's area, that share, and alpha times it if asked for
    ``gap_in_front``              float32 (N,), by how much vergence the first surface of the
                                  subpixel is nearer than a hidden fragment; 0 for a visible one
    ``bin``                       int32 (N,), the bin of vergence; the nearest comes last
    ``vergence_min``              vergence at which bin 0 begins
    ``bin_width``                 width of a bin in vergence
    ``offset``                    float32 (N, 2), from the middle of the subpixel to the middle
                                  of the light that the pinhole sees in it, in subpixels;
                                  ``None`` unless it was asked for
    ============================  ==========================================================
    """

    width: int
    height: int
    x: np.ndarray
    y: np.ndarray
    vergence: np.ndarray
    values: np.ndarray
    gap_in_front: np.ndarray
    bin: np.ndarray
    vergence_min: float
    bin_width: float
    offset: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.x)

    @property
    def subpixel(self) -> np.ndarray:
        """Index of each fragment's subpixel, row by row, int64 (N,)."""
        return self.y.astype(np.int64) * self.width + self.x

    @property
    def nbytes(self) -> int:
        """Memory of the columns in bytes."""
        return sum(column.nbytes for column in self._columns().values())

    def _columns(self) -> dict[str, np.ndarray]:
        values = ((field.name, getattr(self, field.name)) for field in dataclasses.fields(self))
        return {name: value for name, value in values if isinstance(value, np.ndarray)}

    def chosen(self, which: np.ndarray) -> Fragments:
        """The fragments of which ``which``, bool (N,), is true; or those of its indices, (n,)."""
        return dataclasses.replace(self, **{k: v[which] for k, v in self._columns().items()})

    def and_others(self, *others: Fragments) -> Fragments:
        """These, then ``others`` of the same raster and bins; not in their order."""
        columns: dict[str, Any] = {
            name: np.concatenate([column, *(getattr(other, name) for other in others)])
            for name, column in self._columns().items()
        }
        return dataclasses.replace(self, **columns)

    def in_order(self) -> Fragments:
        """The fragments in their order, with columns of their types."""
        keys = self.bin.astype(np.int64) * (self.height * self.width) + self.subpixel
        order = np.argsort(keys, kind="stable")
        return dataclasses.replace(
            self,
            x=self.x[order].astype(np.int32),
            y=self.y[order].astype(np.int32),
            vergence=self.vergence[order].astype(np.float32),
            values=np.ascontiguousarray(self.values[order], dtype=np.float32),
            gap_in_front=self.gap_in_front[order].astype(np.float32),
            bin=self.bin[order].astype(np.int32),
        )

    def between(self, first: int, end: int) -> slice:
        """The fragments of the bins from ``first`` on that come before bin ``end``."""
        # The keys have the type of the bins, which would all be converted otherwise.
        start, stop = np.searchsorted(self.bin, np.array([first, end], dtype=np.int32))
        return slice(int(start), int(stop))

    def coarser(self, factor: int) -> tuple[Fragments, np.ndarray]:
        """Fragments on subpixels, and in bins, ``factor`` times as large.

        The light of ``factor`` x ``factor`` subpixels becomes that of one; its density stays. Also
        returns the index of the new fragment that each old one is part of, int64 (N,).
        """
        return self._regathered(factor, self.x // factor, self.y // factor)

    def coarser_linearly(self, factor: int) -> Fragments:
        """The same, but the four subpixels around a fragment share it, so it stays in its place."""
        places = [(at + np.float32(0.5)) / factor - 0.5 for at in (self.x, self.y)]
        last = [-(-size // factor) - 1 for size in (self.width, self.height)]
        parts = []
        for corner in itertools.product((0, 1), (0, 1)):
            subpixels = [np.floor(at) + step for at, step in zip(places, corner, strict=True)]
            share = np.prod(
                [1 - np.abs(at - there) for at, there in zip(places, subpixels, strict=True)],
                axis=0,
            )
            x, y = (
                np.clip(there, 0, end).astype(np.int32)
                for there, end in zip(subpixels, last, strict=True)
            )
            parts.append(self._regathered(factor, x, y, share)[0])
        together = parts[0].and_others(*parts[1:])
        return together._regathered(1, together.x, together.y)[0]

    def _regathered(
        self, factor: int, x: np.ndarray, y: np.ndarray, share: np.ndarray | None = None
    ) -> tuple[Fragments, np.ndarray]:
        """Fragments at subpixels (x, y) that are, like the bins, ``factor`` times as large.

        ``share`` is the part of each that goes there; by default all of it. Also returns which
        became which, as :meth:`coarser` does.
        """
        width, height = -(-self.width // factor), -(-self.height // factor)
        bins = self.bin.astype(np.int64) // factor
        keys, index = np.unique((bins * height + y) * width + x, return_inverse=True)
        values = self.values if share is None else self.values * share[:, None]
        weight = values[:, SHARE].astype(np.float64)
        total = np.bincount(index, weight, len(keys))

        def mean(column: np.ndarray) -> np.ndarray:
            return np.bincount(index, weight * column, len(keys)) / total

        light = [np.bincount(index, column, len(keys)) for column in values.T]
        coarse = Fragments(
            width,
            height,
            keys % width,
            keys // width % height,
            mean(self.vergence),
            np.stack(light, axis=1) / factor**2,
            mean(self.gap_in_front),
            keys // (width * height),
            self.vergence_min,
            self.bin_width * factor,
        )
        return coarse.in_order(), index

    @functools.cached_property
    def on_device(self) -> FragmentColumns:
        """The columns as Dr.Jit arrays."""
        return FragmentColumns.of(self, self.values)


@dataclasses.dataclass(frozen=True)
class FragmentColumns:
    """Columns of :class:`Fragments` as Dr.Jit arrays; ``values`` are RGB and share, interleaved."""

    x: jit.Int32
    y: jit.Int32
    vergence: jit.Float
    bin: jit.UInt32
    values: jit.Float
    alpha: jit.Float | None

    @classmethod
    def of(cls, fragments: Fragments, values: np.ndarray) -> FragmentColumns:
        """Those of ``fragments``, with ``values``, float32 (N, 4 or 5), in place of their own."""
        has_alpha = values.shape[1] > SHARE + 1
        return cls(
            x=jit.Int32(fragments.x),
            y=jit.Int32(fragments.y),
            vergence=jit.Float(fragments.vergence),
            bin=jit.UInt32(fragments.bin),
            values=jit.Float(np.ascontiguousarray(values[:, :4]).ravel()),
            alpha=jit.Float(np.ascontiguousarray(values[:, 4])) if has_alpha else None,
        )


def gather(
    samples: PointSamples, subpixels: int, radius_per_vergence: float, alpha: bool = False
) -> Fragments:
    """Samples gathered on ``subpixels`` x ``subpixels`` subpixels of a pixel.

    ``radius_per_vergence`` is the circle's radius in subpixels per unit of vergence; with ``alpha``
    the values have a fifth column.
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

    light = dr.zeros(jit.Float, raster.size * 4)
    alpha_and_vergence = dr.zeros(jit.Float, raster.size * 2)
    others = []
    for part in parts:
        at = located(part)
        alone = at.visible & dr.gather(jit.Bool, one_depth, at.subpixel)
        _scatter_alone(light, alpha_and_vergence, samples, part, subpixels, at, alone)
        left_over = dr.compress(~alone)
        index = np.array(left_over).astype(np.int64) + part.start
        where = [dr.gather(jit.UInt32, column, left_over) for column in (at.subpixel, at.bin)]
        others.append((index, *(np.array(column).astype(np.int64) for column in where)))

    summed_light = np.array(light).reshape(-1, 4)
    place = np.flatnonzero(summed_light[:, SHARE])
    alone_sums = [*summed_light[place].T, *np.array(alpha_and_vergence).reshape(-1, 2)[place].T]
    index, places, sample_bins = (np.concatenate(c) for c in zip(*others, strict=True))
    other_place, other_layer, other_sums = _sorted_sums(
        samples, subpixels, index, places, sample_bins
    )
    sums = [np.concatenate(columns) for columns in zip(alone_sums, other_sums, strict=True)]
    hidden = np.concatenate([np.zeros(len(place), dtype=bool), other_layer > 0])
    place = np.concatenate([place, other_place])
    vergence = sums.pop() / sums[SHARE]
    gap = np.zeros(len(vergence))
    first = bins.vergence_min + (np.array(nearest)[place[hidden]] + 0.5) * bins.width
    gap[hidden] = np.maximum(first - vergence[hidden], bins.width * 1e-3)
    found = Fragments(
        raster.width,
        raster.height,
        place % raster.width,
        place // raster.width,
        vergence,
        np.stack(sums if alpha else sums[:-1], axis=1),
        gap,
        np.maximum((vergence - bins.vergence_min) / bins.width, 0).astype(np.int64),
        bins.vergence_min,
        bins.width,
    )
    return found.in_order()


def with_offsets(fragments: Fragments, samples: PointSamples, subpixels: int) -> Fragments:
    """The fragments of ``samples``, as :func:`gather` made them, with their ``offset``."""
    samples = one_subpixel_each(samples, subpixels).visible()
    light = (samples.weight * samples.rgb.max(axis=1)).astype(np.float64)
    left, top = samples.window[:2]
    places, offsets = [], []
    for at, start, count in (
        (samples.x, left, fragments.width),
        (samples.y, top, fragments.height),
    ):
        fine = (at.astype(np.float64) - start) * subpixels
        places.append(np.clip(np.floor(fine), 0, count - 1))
        offsets.append(fine - places[-1] - 0.5)
    subpixel = (places[1] * fragments.width + places[0]).astype(np.int64)
    size = fragments.width * fragments.height
    total = np.bincount(subpixel, light, size)
    own = fragments.subpixel
    middle = [
        np.bincount(subpixel, light * offset, size)[own] / np.where(total > 0, total, 1)[own]
        for offset in offsets
    ]
    offset = np.clip(np.stack(middle, axis=1), -0.5, 0.5).astype(np.float32)
    return dataclasses.replace(fragments, offset=offset)


def scatter_mode() -> dr.ReduceMode:
    """The mode in which sums are scattered fastest, and right.

    With LLVM Dr.Jit would choose ``Local`` for large targets, which is several times slower.
    ``Expand`` gives each of Dr.Jit's threads a copy of the target, and one copy to all of Python's
    threads: any that waits for arrays works along, so with several of them sums get lost.
    """
    if dr.backend_v(jit.Float) != dr.JitBackend.LLVM:
        return dr.ReduceMode.Auto
    return dr.ReduceMode.Expand if jit.evaluates_alone() else dr.ReduceMode.Direct


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
    """Subpixel, vergence and bin of samples, and which of them the pinhole sees."""

    subpixel: jit.UInt32
    vergence: jit.Float
    bin: jit.UInt32
    visible: jit.Bool


def _located(
    samples: PointSamples, subpixels: int, raster: Window, bins: _Bins, part: slice
) -> _Located:
    left, top = samples.window[:2]
    x = (jit.Float(samples.x[part]) - left) * subpixels
    y = (jit.Float(samples.y[part]) - top) * subpixels
    column = jit.UInt32(dr.clip(jit.Int32(dr.floor(x)), 0, raster.width - 1))
    row = jit.UInt32(dr.clip(jit.Int32(dr.floor(y)), 0, raster.height - 1))
    vergence = dr.rcp(jit.Float(samples.z[part]))
    from_first = (vergence - bins.vergence_min) * dr.opaque(jit.Float, 1 / bins.width)
    bin_ = dr.minimum(jit.UInt32(dr.maximum(from_first, 0)), MAX_BINS)
    visible = jit.UInt8(samples.layer[part]) == 0
    return _Located(row * raster.width + column, vergence, bin_, visible)


def _scatter_alone(
    light: jit.Float,
    alpha_and_vergence: jit.Float,
    samples: PointSamples,
    part: slice,
    subpixels: int,
    at: _Located,
    alone: jit.Bool,
) -> None:
    """Add the samples of subpixels that show one depth: R, G, B, share; and alpha, vergence."""
    mode = scatter_mode()
    weight = jit.Float(samples.weight[part]) * subpixels**2
    red, green, blue = dr.unravel(jit.Array3f, jit.Float(samples.rgb[part].ravel()))
    values = jit.Array4f(weight * red, weight * green, weight * blue, weight)
    dr.scatter_add(light, values, at.subpixel, alone, mode=mode)
    values = jit.Array2f(weight * jit.Float(samples.alpha[part]), weight * at.vergence)
    dr.scatter_add(alpha_and_vergence, values, at.subpixel, alone, mode=mode)
    dr.eval(light, alpha_and_vergence)


def _sorted_sums(
    samples: PointSamples,
    subpixels: int,
    index: np.ndarray,
    places: np.ndarray,
    bins: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Samples ``index`` summed by subpixel, depth layer and bin, by sorting.

    Returns subpixel and layer of each sum, and the sums of R, G, B, share, alpha, vergence.
    """
    key = (places * 256 + samples.layer[index]) * (MAX_BINS + 1) + bins
    keys, same = np.unique(key, return_inverse=True)
    weight = samples.weight[index].astype(np.float64) * subpixels**2
    sums = [
        np.bincount(same, weight * column, len(keys))
        for column in (
            *samples.rgb[index].T,
            np.ones_like(weight),
            samples.alpha[index],
            1 / samples.z[index],
        )
    ]
    place_and_layer = keys // (MAX_BINS + 1)
    return place_and_layer // 256, place_and_layer % 256, sums
