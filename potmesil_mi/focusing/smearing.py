"""Smearing: light of fragments is spread along their paths, before a lens spreads it.

A fragment that all of the lens sees for all of its part of an exposure has its light all along its
path: equation 20's sum over samples becomes one over places of them. None of it depends on where
the lens is focused, so it is done once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import drjit as dr
import numpy as np

from .. import _backend as jit
from ..samples.point_samples import PointSamples
from .fragments import MAX_BINS, SHARE, Fragments

SLOTS = 8
"""Depths that are told apart in a subpixel, between the nearest and the farthest that passes it."""

MOST_ON_A_PATH = 16
"""Most samples that stand for one on its path."""

STANDS_STILL = 1e-3
"""Length of a path in subpixels up to which a fragment stays where it is."""


def smeared(parts: Sequence[Fragments]) -> Fragments:
    """The fragments of the parts of an exposure, of one raster and its bins, as one that is over.

    The light of each is spread evenly along its ``motion``, between subpixels linearly. What leaves
    the window is lost.
    """
    first = parts[0]
    size = first.width * first.height
    nearest = dr.zeros(jit.UInt32, size)
    farthest = dr.full(jit.UInt32, MAX_BINS, size)

    def reach(of: _Passing) -> None:
        lit = of.share > 0
        for op, ends in ((dr.ReduceOp.Max, nearest), (dr.ReduceOp.Min, farthest)):
            dr.scatter_reduce(op, ends, of.bin, of.place, lit, mode=dr.ReduceMode.Direct)

    _pass(parts, reach, nearest, farthest)
    has_alpha = first.values.shape[1] > SHARE + 1
    light = dr.zeros(jit.Float, 4 * SLOTS * size)
    alpha = dr.zeros(jit.Float, SLOTS * size) if has_alpha else None
    vergence = dr.zeros(jit.Float, SLOTS * size)

    def add(of: _Passing) -> None:
        lit = of.share > 0
        far = dr.gather(jit.UInt32, farthest, of.place, lit)
        depths = dr.gather(jit.UInt32, nearest, of.place, lit) - far + 1
        slot = dr.minimum((of.bin - far) * SLOTS // dr.maximum(depths, 1), SLOTS - 1)
        there, mode = of.place * SLOTS + slot, dr.ReduceMode.Direct
        dr.scatter_add(light, of.values * of.share, there, lit, mode=mode)
        dr.scatter_add(vergence, of.values.w * of.share * of.vergence, there, lit, mode=mode)
        if alpha is not None:
            dr.scatter_add(alpha, of.alpha * of.share, there, lit, mode=mode)

    _pass(parts, add, light, vergence, alpha)
    return _found(first, light, alpha, vergence)


class _Passing(NamedTuple):
    """Fragments as they pass subpixels: which share of each is there, and how deep it then is."""

    place: jit.UInt32
    share: jit.Float
    bin: jit.UInt32
    vergence: jit.Float
    values: jit.Array4f
    alpha: jit.Float


def _pass(
    parts: Sequence[Fragments],
    scatter: Callable[[_Passing], None],
    *sums: jit.Float | jit.UInt32 | None,
) -> None:
    """Have ``scatter`` see what passes each subpixel, and add it to the ``sums``.

    Along the longer side of its path a fragment passes subpixels one by one, and lies between two
    of them across.
    """
    for fragments in parts:
        if len(fragments) == 0:
            continue
        path = _Path.of(fragments)

        def step(at: jit.Int32, path: _Path = path) -> tuple[jit.Int32]:
            for beside in (0, 1):
                scatter(path.passing(at, beside))
            return (at + 1,)

        dr.while_loop((-path.reach,), lambda at, path=path: at <= path.reach, step)
        # One kernel for each part: one for all of them would take minutes to compile.
        dr.eval(sums)


class _Path(NamedTuple):
    """Where fragments go, each on a lane.

    ``major`` and ``minor`` are the longer and the shorter side of their paths, in subpixels, of
    which the former is ``across`` the window or down; ``deeper`` is the change of vergence, and
    ``reach`` how many subpixels they pass on each side of their own.
    """

    width: jit.Int32
    height: jit.Int32
    vergence_min: jit.Float
    bins_per_vergence: jit.Float
    x: jit.Int32
    y: jit.Int32
    vergence: jit.Float
    values: jit.Array4f
    alpha: jit.Float
    across: jit.Bool
    major: jit.Float
    minor: jit.Float
    deeper: jit.Float
    reach: jit.Int32

    @classmethod
    def of(cls, fragments: Fragments) -> _Path:
        """Those of all of some fragments."""
        columns = fragments.on_device
        motion = columns.motion or [dr.zeros(jit.Float, len(fragments)) for _ in range(3)]
        across = dr.abs(motion[0]) >= dr.abs(motion[1])
        major, minor = (dr.select(across, motion[i], motion[1 - i]) for i in (0, 1))
        moves = dr.abs(major) >= STANDS_STILL
        values = dr.unravel(jit.Array4f, columns.values[0])
        return cls(
            dr.opaque(jit.Int32, fragments.width),
            dr.opaque(jit.Int32, fragments.height),
            dr.opaque(jit.Float, fragments.vergence_min),
            dr.opaque(jit.Float, 1 / fragments.bin_width),
            columns.x,
            columns.y,
            columns.vergence,
            values,
            columns.alpha[0] if columns.alpha else dr.zeros(jit.Float, len(fragments)),
            across,
            dr.select(moves, major, 0),
            dr.select(moves, minor, 0),
            motion[2],
            dr.select(moves, jit.Int32(dr.ceil(dr.abs(major) / 2)), 0),
        )

    def passing(self, at: jit.Int32, beside: int) -> _Passing:
        """What passes the subpixels ``at`` along the longer side, on one side of the path."""
        along, length = jit.Float(at), dr.abs(self.major)
        inverse = 1 / dr.maximum(length, STANDS_STILL)
        share = (_within(length / 2 - along) - _within(-length / 2 - along)) * inverse
        share = dr.select(length > 0, share, 1)
        time = dr.mulsign(dr.clip(along * inverse, -0.5, 0.5), self.major)
        between = time * self.minor
        before = dr.floor(between)
        beyond = between - before
        share *= beyond if beside else 1 - beyond
        steps = at, jit.Int32(before) + beside
        x = self.x + dr.select(self.across, *steps)
        y = self.y + dr.select(self.across, *steps[::-1])
        inside = (x >= 0) & (y >= 0) & (x < self.width) & (y < self.height)
        vergence = dr.fma(time, self.deeper, self.vergence)
        bin_ = (vergence - self.vergence_min) * self.bins_per_vergence
        return _Passing(
            jit.UInt32(dr.select(inside, y * self.width + x, 0)),
            dr.select(inside, share, 0),
            dr.minimum(jit.UInt32(dr.maximum(bin_, 0)), MAX_BINS),
            vergence,
            self.values,
            self.alpha,
        )


def _within(x: jit.Float) -> jit.Float:
    """How much of a subpixel's linear share lies before ``x``: 0 at -1, 1/2 at 0, 1 at 1."""
    x = dr.clip(x, -1, 1)
    return 0.5 + x - 0.5 * x * dr.abs(x)


def _found(
    like: Fragments, light: jit.Float, alpha: jit.Float | None, vergence: jit.Float
) -> Fragments:
    """The fragments of sums by subpixel and slot."""
    values = np.array(light).reshape(-1, 4)
    there = np.flatnonzero(values[:, SHARE] > 0)
    values = values[there]
    depth = np.array(vergence)[there] / values[:, SHARE]
    if alpha is not None:
        values = np.column_stack([values, np.array(alpha)[there]])
    place = there // SLOTS
    return Fragments(
        like.width,
        like.height,
        place % like.width,
        place // like.width,
        depth,
        values,
        np.zeros(len(place)),
        np.clip((depth - like.vergence_min) / like.bin_width, 0, MAX_BINS).astype(np.int64),
        like.vergence_min,
        like.bin_width,
    ).in_order()


def samples_along_paths(samples: PointSamples) -> PointSamples:
    """Samples of which each is replaced by some along its path, which do not move.

    They are about a pixel from each other, but no more than ``MOST_ON_A_PATH``.
    """
    if samples.motion is None:
        return samples
    longest = np.abs(samples.motion[:, :2]).max(axis=1)
    counts = np.clip(np.ceil(longest), 1, MOST_ON_A_PATH).astype(np.int64)
    index = np.repeat(np.arange(len(samples)), counts)
    of_sample = np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
    time = (of_sample + 0.5) / counts[index] - 0.5
    dx, dy, dz = (samples.motion[index] * time[:, None]).T
    copies = samples.replace(motion=None).chosen(index)
    return copies.replace(
        x=copies.x + dx,
        y=copies.y + dy,
        z=copies.z + dz,
        weight=copies.weight / counts[index],
    )
