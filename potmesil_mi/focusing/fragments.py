"""Fragments: point samples gathered by subpixel of the window and by depth.

A lens does the same to everything at one depth, so samples of one subpixel and one depth become
one fragment. Fragments are kept in order of depth and then of place: those between two depths,
which are spread by nearly the same circle, follow each other in memory.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import drjit as dr
import numpy as np

from .. import _backend as jit

T = TypeVar("T")

BIN_RADIUS = 0.25
"""Samples of a subpixel are one fragment where their circles' radii differ by less (subpixels)."""

MAX_BINS = 4095
"""Most bins of vergence between the nearest and the farthest sample, less one."""

INFERRED = -1
"""``Fragments.known`` where what lens points see is to be inferred from the other fragments."""

COVERS = -2
"""The same of a mirror or pane: it covers others, and its light is that of other fragments."""

SPARSE = 0.25
"""Values for each of a target's up to which they are scattered fastest without copies of it."""

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
    ``moments``                   float32 (N, K, 4 or 5), the ``values`` times each of the K
                                  polynomials of :func:`potmesil_mi.focusing.moments.orders`;
                                  ``None`` unless they were asked for, and on coarser subpixels
    ``detail``                    int32 (N,), rows of a table of :class:`.detail.Detail`; ``None``
                                  where it is not known. Light may be scaled only before the
                                  table is evened
    ``known``                     int32 (N,), number of the fragment in a table of what lens
                                  points see, where that is known; else ``INFERRED`` or
                                  ``COVERS``. ``None`` where all is inferred
    ``motion``                    float32 (N, 3), by how much it moves across and down, in
                                  subpixels, and in vergence during the part of the exposure
                                  that it stands for; ``None`` where all stands still
    ``instant``                   int32 (N,), of which part of the exposure it is; ``None``
                                  where there is one
    ``left``, ``top``             first column and row, in subpixels of the whole picture, of the
                                  tile that they are of; 0 where there are no tiles
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
    moments: np.ndarray | None = None
    detail: np.ndarray | None = None
    known: np.ndarray | None = None
    motion: np.ndarray | None = None
    instant: np.ndarray | None = None
    left: int = 0
    top: int = 0

    def __len__(self) -> int:
        return len(self.x)

    @property
    def subpixel(self) -> np.ndarray:
        """Index of each fragment's subpixel, row by row, int64 (N,)."""
        return self.y.astype(np.int64) * self.width + self.x

    @property
    def first(self) -> np.ndarray:
        """The fragments, bool (N,), that fill the subpixels as the pinhole sees them."""
        first = self.gap_in_front == 0
        return first if self.known is None else first & (self.known < 0)

    @functools.cached_property
    def path_reach(self) -> tuple[float, float]:
        """By how many subpixels, and how much vergence, any moves to either side of where it is."""
        if self.motion is None or len(self) == 0:
            return 0.0, 0.0
        across, down, deeper = np.abs(self.motion).max(axis=0) / 2
        return float(max(across, down)), float(deeper)

    @property
    def nbytes(self) -> int:
        """Memory of the columns in bytes."""
        return sum(column.nbytes for column in self._columns().values())

    def _columns(self) -> dict[str, np.ndarray]:
        values = ((field.name, getattr(self, field.name)) for field in dataclasses.fields(self))
        return {name: value for name, value in values if isinstance(value, np.ndarray)}

    def chosen(self, which: np.ndarray | slice) -> Fragments:
        """The fragments that ``which`` has: bool (N,), indices (n,), or a slice of them."""
        columns: dict[str, Any] = {k: v[which] for k, v in self._columns().items()}
        return dataclasses.replace(self, **columns)

    def and_others(self, *others: Fragments) -> Fragments:
        """These, then ``others`` of the same raster and bins; not in their order."""
        columns: dict[str, Any] = {
            name: np.concatenate([column, *(getattr(other, name) for other in others)])
            for name, column in self._columns().items()
        }
        return dataclasses.replace(self, **columns)

    @property
    def order(self) -> np.ndarray:
        """The numbers of the fragments in their order, int64 (N,)."""
        keys = self.bin.astype(np.int64) * (self.height * self.width) + self.subpixel
        return np.argsort(keys, kind="stable")

    def in_order(self) -> Fragments:
        """The fragments in their order, with columns of their types."""
        order = self.order
        return dataclasses.replace(
            self,
            x=self.x[order].astype(np.int32),
            y=self.y[order].astype(np.int32),
            vergence=self.vergence[order].astype(np.float32),
            values=np.ascontiguousarray(self.values[order], dtype=np.float32),
            gap_in_front=self.gap_in_front[order].astype(np.float32),
            bin=self.bin[order].astype(np.int32),
            moments=None if self.moments is None else self.moments[order].astype(np.float32),
            detail=None if self.detail is None else self.detail[order].astype(np.int32),
            known=None if self.known is None else self.known[order],
            motion=None if self.motion is None else self.motion[order].astype(np.float32),
            instant=None if self.instant is None else self.instant[order].astype(np.int32),
        )

    def scaled(self, scale: np.ndarray) -> Fragments:
        """The fragments with their light multiplied by ``scale``, (N,) or (N, 4 or 5)."""
        scale = scale.astype(np.float32).reshape(len(self), *scale.shape[1:] or (1,))
        moments = None if self.moments is None else self.moments * scale[:, None]
        return dataclasses.replace(self, values=self.values * scale, moments=moments)

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
        places = bins * height + y
        if self.instant is not None:
            # Those of each part of the exposure stay apart.
            places += self.instant * (MAX_BINS + 1) * height
        keys, index = np.unique(places * width + x, return_inverse=True)
        values = self.values if share is None else self.values * share[:, None]
        weight = values[:, SHARE].astype(np.float64)
        total = np.bincount(index, weight, len(keys))

        def mean(column: np.ndarray) -> np.ndarray:
            return np.bincount(index, weight * column, len(keys)) / total

        light = [np.bincount(index, column, len(keys)) for column in values.T]
        motion, instant = None, None
        if self.motion is not None:
            motion = np.stack([mean(column) for column in self.motion.T], axis=1)
            motion[:, :2] /= factor
        if self.instant is not None:
            instant, keys = np.divmod(keys, (MAX_BINS + 1) * height * width)
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
            motion=motion,
            instant=instant,
            left=self.left // factor,
            top=self.top // factor,
        )
        return coarse.in_order(), index

    @functools.cached_property
    def on_device(self) -> FragmentColumns:
        """The columns as Dr.Jit arrays."""
        return FragmentColumns.of(self)


@dataclasses.dataclass(frozen=True)
class FragmentColumns:
    """Columns of :class:`Fragments` as Dr.Jit arrays.

    ``values`` are RGB and share, interleaved, of the fragments' own values and then of each moment;
    ``alpha`` is their alpha, and empty unless it was asked for; ``offset`` is across and down;
    ``motion`` across, down and in vergence.
    """

    x: jit.Int32
    y: jit.Int32
    vergence: jit.Float
    bin: jit.UInt32
    values: list[jit.Float]
    alpha: list[jit.Float]
    detail: jit.Int32 | None
    offset: list[jit.Float] | None
    motion: list[jit.Float] | None
    instant: jit.UInt32 | None

    @classmethod
    def of(cls, fragments: Fragments) -> FragmentColumns:
        """Those of ``fragments``."""
        light = [fragments.values]
        if fragments.moments is not None:
            light += list(fragments.moments.swapaxes(0, 1))
        has_alpha = fragments.values.shape[1] > SHARE + 1
        return cls(
            x=jit.from_numpy(jit.Int32, fragments.x),
            y=jit.from_numpy(jit.Int32, fragments.y),
            vergence=as_column(fragments.vergence),
            bin=jit.from_numpy(jit.UInt32, fragments.bin),
            values=[as_column(of[:, :4]) for of in light],
            alpha=[as_column(of[:, 4]) for of in light if has_alpha],
            detail=_optional(jit.Int32, fragments.detail),
            offset=columns_of(fragments.offset),
            motion=columns_of(fragments.motion),
            instant=_optional(jit.UInt32, fragments.instant),
        )


def columns_of(table: np.ndarray | None) -> list[jit.Float] | None:
    """The columns of a table (N, C) as Dr.Jit arrays, if there is one."""
    return None if table is None else [as_column(of) for of in table.T]


def _optional(kind: Callable[..., T], column: np.ndarray | None) -> T | None:
    """A column as a Dr.Jit array, if there is one."""
    return None if column is None else jit.from_numpy(kind, column)


def as_column(values: np.ndarray) -> jit.Float:
    """The values of an array, one after the other."""
    return jit.from_numpy(jit.Float, values.ravel())


def scatter_mode(density: float = math.inf) -> dr.ReduceMode:
    """The mode in which sums are scattered fastest, and right.

    ``density`` is how many values are scattered for each of the target's. With LLVM Dr.Jit would
    choose ``Local`` for large targets, which is several times slower. ``Expand`` gives each of
    Dr.Jit's threads a copy of the target, which takes long where little is scattered. One copy it
    gives to all of Python's threads: any that waits for arrays works along, so with several of them
    sums get lost.
    """
    if dr.backend_v(jit.Float) != dr.JitBackend.LLVM:
        return dr.ReduceMode.Auto
    pays = density > SPARSE and jit.evaluates_alone()
    return dr.ReduceMode.Expand if pays else dr.ReduceMode.Direct


def gathered(
    kind: type[T], source: jit.Float, index: jit.UInt32, active: jit.Bool | bool = True
) -> T:
    """What is at ``index`` of a ``source`` that may have gradients, in the packets of a ``kind``.

    Backwards a gather is a sum, which would by default have the sizes of both in its code, and
    would be compiled anew for each.
    """
    is_llvm = dr.backend_v(jit.Float) == dr.JitBackend.LLVM
    mode = dr.ReduceMode.Local if is_llvm else dr.ReduceMode.Auto
    return dr.gather(kind, source, index, active, mode=mode)


def among_few(count: int, an_octave: int = 4) -> int:
    """The least number from ``count`` on of a few, so many from one power of 2 to the next.

    Where Dr.Jit gives each of its threads a copy of what is scattered to, the size is in the code,
    which is compiled anew for each.
    """
    return math.ceil(2 ** (math.ceil(math.log2(count) * an_octave) / an_octave))
