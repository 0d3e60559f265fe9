"""Small circles: those hardly larger than a subpixel, of what is nearly in focus.

How much light they take out of a subpixel depends on how near its edges the light is. Fragments
tell that by their detail: moments, see :mod:`.moments`, along each axis. What subpixels around get
of a fragment is the sum of these, each times what they get of light of its shape.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import drjit as dr
import numpy as np

from .. import _backend as jit
from ..optics.aperture import Aperture
from .detail import Detail
from .moments import NODES, legendre

STEP = 1 / 48
"""Radii, in subpixels, for which it is known how light is spread are that far apart."""

LARGEST = 1.75
"""The largest of them: what is nearly in focus has circles up to about sqrt(2)."""

LEVELS = math.ceil(LARGEST / STEP)
"""Radii of either sign, without 0."""

BESIDE = (-1, 1, -2, 2)
"""Steps to the subpixels that get light, across and down; what these do not get stays."""

REACH = max(BESIDE)
"""The farthest of them."""

NEAR = 1.0
"""Circles up to this radius reach the next subpixels only."""

FINER = 16
"""Cells in a subpixel in which it is found out how light is spread."""

RADII_IN_CELLS = tuple(level * STEP * FINER for level in range(-LEVELS, LEVELS + 1))
"""All the radii, in cells."""


class SmallCircles(NamedTuple):
    """The table of the ``detail`` of fragments, and what subpixels around get of each order of it.

    ``responses`` are those of :func:`responses_of`.
    """

    detail: Detail
    responses: np.ndarray


@functools.lru_cache(maxsize=32)
def responses_of(aperture: Aperture, squeeze: float, degree: int) -> np.ndarray:
    """What subpixels around get of light: float32 (2 ``LEVELS`` + 1, 2, ``degree`` + 1, 4).

    Its axes are the signed radius, from ``-LEVELS`` to ``LEVELS`` times ``STEP``; across or down;
    the order of the Legendre polynomial that has the shape of the light in its subpixel; and the
    steps ``BESIDE``. Circles are taken to be products of what they are across and down.
    """
    found = responses_in_double(aperture, squeeze, degree).astype(np.float32)
    found.setflags(write=False)
    return found


def responses_in_double(aperture: Aperture, squeeze: float, degree: int) -> np.ndarray:
    """What :func:`responses_of` has, in float64; it is not kept."""
    of_steps = of_impulses(degree)
    profiles = aperture.profiles(RADII_IN_CELLS, squeeze)
    return np.array([[centred(of_steps, len(of)) @ of for of in pair] for pair in profiles])


@functools.cache
def of_impulses(degree: int) -> np.ndarray:
    """What subpixels around get where light is moved by a number of cells: (degree + 1, 4, n).

    The moves are those from one end of the largest circle to the other.
    """
    longest = 2 * math.ceil(RADII_IN_CELLS[-1]) + 1
    cells = [_in_cells(order) for order in range(degree + 1)]
    moved = [[_beside(np.convolve(of, move)) for move in np.eye(longest)] for of in cells]
    return np.moveaxis(np.array(moved), 2, 1)


def centred(of_steps: np.ndarray, length: int) -> np.ndarray:
    """The part of :func:`of_impulses` that moves by no more than a profile of a length does."""
    left = (of_steps.shape[-1] - length) // 2
    return of_steps[..., left : left + length]


def _in_cells(order: int) -> np.ndarray:
    """Light in the cells of a subpixel, (``FINER``,): its moment of an ``order`` is 1, others 0."""
    at, weight = np.polynomial.legendre.leggauss(NODES)
    places = (2 * np.arange(FINER)[:, None] + 1 + at) / FINER - 1
    return (
        (2 * order + 1) / (2 * FINER) * (weight * legendre(order, places) + 0 * places).sum(axis=1)
    )


def _beside(cells: np.ndarray) -> np.ndarray:
    """The sums, for the subpixels ``BESIDE``, of light in cells around a subpixel; (4,)."""
    around = (2 * REACH + 1) * FINER - len(cells)
    cells = np.pad(cells, around // 2) if around > 0 else cells[-around // 2 : around // 2 or None]
    return cells.reshape(-1, FINER).sum(axis=1)[REACH + np.array(BESIDE)]


@dataclasses.dataclass(frozen=True)
class Share:
    """What the subpixels some steps ``across`` and ``down`` get, of those that are ``active``."""

    across: int
    down: int
    light: Any
    active: jit.Bool


def shared(
    light: Sequence[Any], radius: jit.Float, table: jit.Float, *, between: bool = False
) -> Iterator[Share]:
    """What the subpixels of fragments and those around get of their ``light``.

    ``light`` are their values, and their detail. ``radius`` is signed, in subpixels. ``table`` are
    the numbers of :func:`responses_of`. Subpixels get
    no less than nothing, and together all of the light, or hardly more. What is known of some radii
    is taken of the nearest, or, smoothly, ``between`` two.
    """
    degree = len(light) // 2
    at = dr.clip(radius / STEP, -LEVELS, LEVELS) + LEVELS
    level = jit.UInt32(dr.round(at))

    def row(level: jit.UInt32, axis: int, order: int) -> jit.Array4f:
        return dr.gather(jit.Array4f, table, (level * 2 + axis) * (degree + 1) + order)

    def beside(axis: int, order: int) -> jit.Array4f:
        if not between:
            return row(level, axis, order)
        first = dr.minimum(jit.UInt32(dr.detach(at)), 2 * LEVELS - 1)
        return dr.lerp(row(first, axis, order), row(first + 1, axis, order), at - first)

    across, down = (
        [_Row(beside(axis, order), order) for order in range(degree + 1)] for axis in (0, 1)
    )
    left = light[0]
    for i, j in itertools.product((0, *BESIDE), repeat=2):
        if i == j == 0:
            continue
        x, y = [row.at(i) for row in across], [row.at(j) for row in down]
        even = x[0] * y[0] * light[0]
        detail = sum(
            x[order] * y[0] * light[order] + x[0] * y[order] * light[degree + order]
            for order in range(1, degree + 1)
        )
        # What one fragment in a corner has may be too much for moments to tell.
        share = dr.maximum(even + detail, dr.minimum(even, 0))
        active = dr.abs(radius) > (NEAR if max(abs(i), abs(j)) > 1 else 0)
        left = left - dr.select(active, share, 0)
        yield Share(i, j, share, active)
    yield Share(0, 0, dr.maximum(left, dr.minimum(light[0], 0)), jit.Bool(True))


class _Row(NamedTuple):
    """What subpixels ``beside`` get, along one axis, of light of an ``order``."""

    beside: jit.Array4f
    order: int

    def at(self, step: int) -> jit.Float:
        """What the subpixel a ``step`` away gets: 0 for their own, which keeps the rest."""
        if step == 0:
            return (1 if self.order == 0 else 0) - dr.sum(self.beside)
        return self.beside[BESIDE.index(step)]
