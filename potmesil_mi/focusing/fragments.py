"""Elements: point samples gathered by square of the picture and depth.

What the lens does to a picture it does alike to all that is at one depth, so samples of a square
and a depth become one. They are kept in order of depth and then of place, so that those between
two depths, which are spread by nearly the same circle, follow each other in memory.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..samples.point_samples import PointSamples

BIN = 0.25
"""Samples of a square are gathered where their circles' radii differ less, in squares."""

MOST_BINS = 4095

AT_ONCE = 1 << 22
"""Most samples that are gathered at once; it bounds the memory of a step."""

SHARE = 3
"""Column of ``Elements.values`` with the share of the square's area."""


@dataclasses.dataclass(frozen=True)
class Elements:
    """N elements, in order of ``bin``, then of place.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``width``, ``height``         squares of the window
    ``x``, ``y``                  int32 (N,), column and row of the element's square
    ``vergence``                  float32 (N,), 1/z in 1/scene units
    ``values``                    float32 (N, 4 or 5), light: R, G, B times the share of the
                                  square's area, that share, and alpha times it if asked for
    ``front``                     float32 (N,), how far in vergence the first surface of the
                                  square stands before a hidden one; 0 for a visible one
    ``bin``                       int32 (N,), nearest last
    ``least``, ``step``           vergence where the bins begin, and their width
    ``offset``                    float32 (N, 2), where the middle of the light that the
                                  pinhole sees in the square is, from that of the square, in
                                  squares; only if it was asked for
    ============================  ==========================================================
    """

    width: int
    height: int
    x: np.ndarray
    y: np.ndarray
    vergence: np.ndarray
    values: np.ndarray
    front: np.ndarray
    bin: np.ndarray
    least: float
    step: float
    offset: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.x)

    @classmethod
    def of(
        cls, samples: PointSamples, per_pixel: int, scale: float, alpha: bool = False
    ) -> Elements:
        """Samples gathered on ``per_pixel`` x ``per_pixel`` squares a pixel.

        ``scale`` is the circle's radius in squares per unit of vergence.
        """
        left, top, columns, rows = samples.window
        width, height = columns * per_pixel, rows * per_pixel
        samples = _pieces(samples, per_pixel)
        ends = 1 / samples.z.max(), 1 / samples.z.min()
        least = float(ends[0])
        # Where depths are many circles apart they are gathered more coarsely.
        step = max(BIN / scale, float(ends[1] - ends[0]) / MOST_BINS)
        parts = [slice(i, i + AT_ONCE) for i in range(0, len(samples), AT_ONCE)]

        def located(part: slice) -> tuple[mi.UInt32, mi.Float, mi.UInt32, mi.Bool]:
            """Square, vergence and bin of samples, and which the pinhole sees."""
            x = (mi.Float(samples.x[part]) - left) * per_pixel
            y = (mi.Float(samples.y[part]) - top) * per_pixel
            column = mi.UInt32(dr.clip(mi.Int32(dr.floor(x)), 0, width - 1))
            row = mi.UInt32(dr.clip(mi.Int32(dr.floor(y)), 0, height - 1))
            vergence = dr.rcp(mi.Float(samples.z[part]))
            bin_ = mi.UInt32(dr.maximum((vergence - least) * dr.opaque(mi.Float, 1 / step), 0))
            visible = mi.UInt8(samples.layer[part]) == 0
            return row * width + column, vergence, dr.minimum(bin_, MOST_BINS), visible

        nearest = dr.zeros(mi.UInt32, width * height)
        farthest = dr.full(mi.UInt32, MOST_BINS, width * height)
        for part in parts:
            square, _, bin_, visible = located(part)
            dr.scatter_reduce(dr.ReduceOp.Max, nearest, bin_, square, visible)
            dr.scatter_reduce(dr.ReduceOp.Min, farthest, bin_, square, visible)
            dr.eval(nearest, farthest)
        # Most squares show one depth: their samples need no sorting.
        single = nearest - farthest <= 1
        light = dr.zeros(mi.Float, width * height * 4)
        other = dr.zeros(mi.Float, width * height * 2)
        rest = []
        mode = scatter_mode()
        for part in parts:
            square, vergence, bin_, visible = located(part)
            weight = mi.Float(samples.weight[part]) * per_pixel**2
            alone = visible & dr.gather(mi.Bool, single, square)
            red, green, blue = dr.unravel(mi.Vector3f, mi.Float(samples.rgb[part].ravel()))
            values = mi.Vector4f(weight * red, weight * green, weight * blue, weight)
            dr.scatter_add(light, values, square, alone, mode=mode)
            values = mi.Vector2f(weight * mi.Float(samples.alpha[part]), weight * vergence)
            dr.scatter_add(other, values, square, alone, mode=mode)
            dr.eval(light, other)
            left_over = dr.compress(~alone)
            index = np.array(left_over).astype(np.int64) + part.start
            where = [dr.gather(mi.UInt32, column, left_over) for column in (square, bin_)]
            rest.append((index, *(np.array(column).astype(np.int64) for column in where)))

        summed_light = np.array(light).reshape(-1, 4)
        place = np.flatnonzero(summed_light[:, SHARE])
        summed = [*summed_light[place].T, *np.array(other).reshape(-1, 2)[place].T]
        index, squares, bins = (np.concatenate(columns) for columns in zip(*rest, strict=True))
        key = (squares * 256 + samples.layer[index]) * (MOST_BINS + 1) + bins
        keys, same = np.unique(key, return_inverse=True)
        weight = samples.weight[index].astype(np.float64) * per_pixel**2
        sums = [
            np.bincount(same, weight * column, len(keys))
            for column in (
                *samples.rgb[index].T,
                np.ones_like(weight),
                samples.alpha[index],
                1 / samples.z[index],
            )
        ]
        summed = [np.concatenate(columns) for columns in zip(summed, sums, strict=True)]
        key = keys // (MOST_BINS + 1)
        place = np.concatenate([place, key // 256])
        hidden = np.concatenate([np.zeros(len(place) - len(keys), dtype=bool), key % 256 > 0])
        mean = summed.pop() / summed[SHARE]
        front = np.zeros(len(mean))
        first = least + (np.array(nearest)[place[hidden]] + 0.5) * step
        front[hidden] = np.maximum(first - mean[hidden], step * 1e-3)
        values = np.stack(summed if alpha else summed[:-1], axis=1)
        return _ordered(
            width, height, place % width, place // width, mean, values, front, least, step
        )

    def placed(self, samples: PointSamples, per_pixel: int) -> Elements:
        """The same elements, of these samples, with their ``offset``."""
        samples = _pieces(samples, per_pixel).visible()
        light = (samples.weight * samples.rgb.max(axis=1)).astype(np.float64)
        places, offsets = [], []
        for at, start, count in (
            (samples.x, samples.window[0], self.width),
            (samples.y, samples.window[1], self.height),
        ):
            fine = (at.astype(np.float64) - start) * per_pixel
            places.append(np.clip(np.floor(fine), 0, count - 1))
            offsets.append(fine - places[-1] - 0.5)
        square = (places[1] * self.width + places[0]).astype(np.int64)
        size = self.width * self.height
        total = np.bincount(square, light, size)
        own = self.y.astype(np.int64) * self.width + self.x
        middle = [
            np.bincount(square, light * offset, size)[own] / np.where(total > 0, total, 1)[own]
            for offset in offsets
        ]
        offset = np.clip(np.stack(middle, axis=1), -0.5, 0.5).astype(np.float32)
        return dataclasses.replace(self, offset=offset)

    def coarser(self, factor: int) -> tuple[Elements, np.ndarray]:
        """Elements on squares, and in bins, ``factor`` times as large; and which became which.

        The light of ``factor``² squares is that of one; its density stays the same.
        """
        return self._gathered(factor, self.x // factor, self.y // factor)

    def coarser_linearly(self, factor: int) -> Elements:
        """The same, but each is shared by the four squares around it: so it stays in its place."""
        places = [(at + np.float32(0.5)) / factor - 0.5 for at in (self.x, self.y)]
        last = [-(-size // factor) - 1 for size in (self.width, self.height)]
        parts = []
        for corner in itertools.product((0, 1), (0, 1)):
            squares = [np.floor(at) + step for at, step in zip(places, corner, strict=True)]
            share = np.prod(
                [1 - np.abs(at - square) for at, square in zip(places, squares, strict=True)],
                axis=0,
            )
            x, y = (
                np.clip(square, 0, end).astype(np.int32)
                for square, end in zip(squares, last, strict=True)
            )
            parts.append(self._gathered(factor, x, y, share)[0])
        names = ("x", "y", "vergence", "values", "front", "bin")
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(p, name) for p in parts]) for name in names
        }
        together = dataclasses.replace(parts[0], **columns)
        return together._gathered(1, together.x, together.y)[0]

    def _gathered(
        self, factor: int, x: np.ndarray, y: np.ndarray, share: np.ndarray | None = None
    ) -> tuple[Elements, np.ndarray]:
        """Shares (all) of the elements gathered in squares (x, y), and bins, so much larger.

        Returns what became of them, and which became which.
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
        coarse = _ordered(
            width,
            height,
            keys % width,
            keys // width % height,
            mean(self.vergence),
            np.stack(light, axis=1) / factor**2,
            mean(self.front),
            self.least,
            self.step * factor,
            keys // (width * height),
        )
        return coarse, index

    def between(self, first: int, end: int) -> slice:
        """The elements of the bins from ``first`` on that come before bin ``end``."""
        # Of the same type as the bins, or they would all be converted.
        start, stop = np.searchsorted(self.bin, np.array([first, end], dtype=np.int32))
        return slice(int(start), int(stop))

    def chosen(self, mask: np.ndarray) -> Elements:
        """Those elements that ``mask``, bool (N,), has."""
        return dataclasses.replace(
            self,
            x=self.x[mask],
            y=self.y[mask],
            vergence=self.vergence[mask],
            values=self.values[mask],
            front=self.front[mask],
            bin=self.bin[mask],
            offset=None if self.offset is None else self.offset[mask],
        )


def _pieces(samples: PointSamples, per_pixel: int) -> PointSamples:
    """Samples of which each lies in one square: those of a lattice lie on the edges of several."""
    if samples.lattice == 0:
        return samples
    nudge = 0.25 / max(samples.lattice, per_pixel)
    quarters = [
        samples.replace(x=samples.x + dx, y=samples.y + dy, weight=samples.weight / 4)
        for dx in (-nudge, nudge)
        for dy in (-nudge, nudge)
    ]
    left, top, width, height = samples.window
    names = ("x", "y", "rgb", "alpha", "z", "surface", "weight", "layer")
    columns = {name: np.concatenate([getattr(q, name) for q in quarters]) for name in names}
    inside = (columns["x"] >= left) & (columns["x"] < left + width)
    inside &= (columns["y"] >= top) & (columns["y"] < top + height)
    return samples.replace(**{name: column[inside] for name, column in columns.items()})


def scatter_mode() -> dr.ReduceMode:
    """How sums are best scattered: by default LLVM chooses ``Local``, several times slower."""
    llvm = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
    return dr.ReduceMode.Expand if llvm else dr.ReduceMode.Auto


def _ordered(
    width: int,
    height: int,
    x: np.ndarray,
    y: np.ndarray,
    vergence: np.ndarray,
    values: np.ndarray,
    front: np.ndarray,
    least: float,
    step: float,
    bin_: np.ndarray | None = None,
) -> Elements:
    if bin_ is None:
        bin_ = np.maximum((vergence - least) / step, 0).astype(np.int64)
    order = np.argsort((bin_ * height + y) * width + x, kind="stable")
    return Elements(
        width,
        height,
        x[order].astype(np.int32),
        y[order].astype(np.int32),
        vergence[order].astype(np.float32),
        np.ascontiguousarray(values[order], dtype=np.float32),
        front[order].astype(np.float32),
        bin_[order].astype(np.int32),
        least,
        step,
    )
