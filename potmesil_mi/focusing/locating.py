"""Where samples are: subpixels of the window, and bins of depth."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import drjit as dr
import numpy as np

from .. import _backend as jit
from ..samples.columns import Columns
from ..samples.point_samples import PointSamples
from ..samples.raster import Window
from .fragments import BIN_RADIUS, MAX_BINS

GATHERED_AT_ONCE = 1 << 22
"""Most samples that are gathered at once; it bounds the memory of a step."""


def parts_of(
    count: int, which: np.ndarray | None = None
) -> Iterator[tuple[slice | np.ndarray, jit.Bool]]:
    """The samples, of ``count``, that are gathered at once, from the first to the last.

    A part is a slice of them and which of these are meant, or indices: ``which``, bool (N,), has
    those that are.
    """
    for begin in range(0, count, GATHERED_AT_ONCE):
        part = slice(begin, min(begin + GATHERED_AT_ONCE, count))
        if which is None or which[part].all():
            yield part, jit.Bool(True)
        elif 2 * np.count_nonzero(which[part]) > part.stop - begin:
            yield part, jit.from_numpy(jit.Bool, which[part])
        elif which[part].any():
            yield begin + np.flatnonzero(which[part]), jit.Bool(True)


def index_of(which: jit.Bool, part: slice | np.ndarray) -> np.ndarray:
    """Index, int64 (n,), of the samples of a ``part`` of which ``which`` is true."""
    there = np.array(dr.compress(which)).astype(np.int64)
    return there + part.start if isinstance(part, slice) else part[there]


def places_of(
    located: Callable[[np.ndarray], Located], index: np.ndarray, bins: Bins | None = None
) -> list[np.ndarray]:
    """Of the samples ``index`` the subpixel, where in it they are across and down, and the bin.

    The last is left out without ``bins``.
    """
    if len(index) == 0:
        return [np.empty(0, np.int64)] * (3 if bins is None else 4)
    at = located(index)
    columns: list[Any] = [at.subpixel, at.across, at.down]
    if bins is not None:
        columns.append(bins.of_vergence(at.vergence))
    dr.eval(columns)
    return [np.array(column) for column in columns]


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
    columns = Columns.joined(quarters)
    inside = samples.window.contains(columns.x, columns.y)
    return samples.replace(**vars(columns.chosen(inside)), lattice=0)


class Bins(NamedTuple):
    """Where the bins of vergence begin, and how wide they are."""

    vergence_min: float
    width: float

    @classmethod
    def of(cls, depths: np.ndarray, radius_per_vergence: float, *others: np.ndarray) -> Bins:
        """Those of ``depths``, with circles of that radius in subpixels per unit of vergence."""
        every = depths, *others
        ends = 1 / max(of.max() for of in every), 1 / min(of.min() for of in every)
        # Where depths are many circles apart, the bins are wider.
        width = max(BIN_RADIUS / radius_per_vergence, float(ends[1] - ends[0]) / MAX_BINS)
        return cls(float(ends[0]), width)

    def gap_behind(self, nearest: np.ndarray, vergence: np.ndarray) -> np.ndarray:
        """By how much things of a ``vergence`` are behind the middles of the ``nearest`` bins.

        It is more than 0.
        """
        first = self.vergence_min + (nearest + 0.5) * self.width
        return np.maximum(first - vergence, self.width * 1e-3)

    def of_vergence(self, vergence: jit.Float) -> jit.UInt32:
        """The bins of samples."""
        from_first = (vergence - dr.opaque(jit.Float, self.vergence_min)) * dr.opaque(
            jit.Float, 1 / self.width
        )
        return dr.minimum(jit.UInt32(dr.maximum(from_first, 0)), MAX_BINS)


class Raster(NamedTuple):
    """The subpixels on which samples are gathered: those of a picture, or of a tile of it.

    A tile's samples fall into the subpixels into which they fall in the whole picture, to the last
    digit: places are counted from where that begins.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``window``                    subpixels, counted from the first of the whole picture's window
    ``left``, ``top``             first column and row of that window, in pixels of the film
    ============================  ==========================================================
    """

    window: Window
    left: int
    top: int

    @classmethod
    def of(cls, samples: PointSamples, subpixels: int, whole: Window | None = None) -> Raster:
        """That of ``samples``, of a tile if the window of the ``whole`` picture is given."""
        whole = whole or samples.window
        window = samples.window.relative_to(whole).subdivided(subpixels)
        return cls(window, whole.left, whole.top)

    @property
    def size(self) -> int:
        """How many subpixels it has."""
        return self.window.size


@dataclasses.dataclass(frozen=True)
class Located:
    """Subpixel and vergence of samples, and which of them the pinhole sees.

    ``across`` and ``down``, from -1 to 1, tell where in the subpixel they are.
    """

    subpixel: jit.UInt32
    vergence: jit.Float
    visible: jit.Bool
    across: jit.Float
    down: jit.Float


def located_in(
    samples: PointSamples, subpixels: int, raster: Raster, part: slice | np.ndarray
) -> Located:
    """Where the samples of a ``part``, or those of its indices, are on a ``raster``."""
    left, top, times = (dr.opaque(jit.Float, of) for of in (raster.left, raster.top, subpixels))
    first_column, first_row, width, height = (dr.opaque(jit.Int32, of) for of in raster.window)
    x = (jit.from_numpy(jit.Float, samples.x[part]) - left) * times
    y = (jit.from_numpy(jit.Float, samples.y[part]) - top) * times
    column = dr.clip(jit.Int32(dr.floor(x)) - first_column, 0, width - 1)
    row = dr.clip(jit.Int32(dr.floor(y)) - first_row, 0, height - 1)
    return Located(
        jit.UInt32(row * width + column),
        dr.rcp(jit.from_numpy(jit.Float, samples.z[part])),
        jit.from_numpy(jit.UInt8, samples.layer[part]) == 0,
        dr.clip(2 * (x - jit.Float(column + first_column)) - 1, -1, 1),
        dr.clip(2 * (y - jit.Float(row + first_row)) - 1, -1, 1),
    )
