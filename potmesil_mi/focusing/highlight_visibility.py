"""Which points of the lens see highlights: few fragments, from many points.

What is in the way from each to each point of the lens is looked up, past the nearest of the other
fragments in every subpixel that it crosses.
"""

from __future__ import annotations

import math

import drjit as dr
import numpy as np

from .. import _backend as jit
from .fragments import BIN_RADIUS, Fragments
from .opacity import optical_depth
from .visibility import SLANT_BINS, as_byte

STEP_PARALLAX = 0.75
"""Largest distance in parallax, in subpixels, from a step towards a lens point at which what is in
the way there blocks it; half a step and a quarter for rounding."""


class Jitter:
    """An arrangement of the lens points of its own for each fragment.

    Each fragment turns the points of a round lens by an angle and moves them outwards or inwards
    within their cells, unlike its neighbours, so that they leave no pattern where the light of
    many fragments adds up. Points of an aperture that is not round are moved together, by at most
    the radius of a ``cell``, in radii of the aperture; ``cell`` is 0 for a round one.
    """

    def __init__(self, fragments: Fragments, cell: float = 0.0) -> None:
        x, y = fragments.x + fragments.left, fragments.y + fragments.top
        mixed = x.astype(np.uint32) * np.uint32(0x9E3779B1)
        mixed ^= y.astype(np.uint32) * np.uint32(0x85EBCA77)
        mixed = (mixed ^ (mixed >> np.uint32(15))) * np.uint32(0x2C1B3C6D)
        mixed ^= mixed >> np.uint32(13)
        angle = (mixed & np.uint32(0xFFFF)) * (2 * math.pi / 65536)
        self.cosine, self.sine = (jit.from_numpy(jit.Float, f(angle)) for f in (np.cos, np.sin))
        self.outwards = jit.from_numpy(jit.Float, (mixed >> np.uint32(16)) / 65536)
        self.cell = cell

    def reaches(self, radii: np.ndarray) -> np.ndarray:
        """How far out points are moved, (M,), that are so far from the middle of the lens."""
        if self.cell > 0:
            return radii + self.cell
        point = np.arange(len(radii))
        return radii * np.sqrt((point + 1) / (point + 0.5))

    def moved(
        self, u: jit.Float, v: jit.Float, point: jit.UInt32, fragment: jit.UInt32
    ) -> tuple[jit.Float, jit.Float]:
        """Where the points (u, v), whose numbers are ``point``, are for each ``fragment``."""
        cosine, sine, outwards = (
            dr.gather(jit.Float, column, fragment)
            for column in (self.cosine, self.sine, self.outwards)
        )
        if self.cell > 0:
            size = dr.opaque(jit.Float, self.cell) * dr.sqrt(outwards)
            return dr.fma(size, cosine, u), dr.fma(size, sine, v)
        size = dr.sqrt((jit.Float(point) + outwards) / (jit.Float(point) + 0.5))
        return size * (cosine * u - sine * v), size * (sine * u + cosine * v)


def visibility_of_highlights(
    fragments: Fragments,
    highlights: Fragments,
    radius_per_vergence: float,
    points: np.ndarray,
    cell: float = 0.0,
) -> np.ndarray:
    """What each lens point sees of each highlight, uint8 (n, M), 0 for nothing to 255 for all.

    This is for many points, arranged by :class:`Jitter` with that ``cell``, and few fragments: it
    follows the way from each highlight to each lens point past the nearest of the ``fragments`` in
    every subpixel that it crosses.
    """
    if len(highlights) == 0:
        return np.empty((0, len(points)), dtype=np.uint8)
    width, height = fragments.width, fragments.height
    subpixel = fragments.subpixel
    parallax = fragments.vergence * np.float32(radius_per_vergence)
    nearest = np.full(width * height, -np.inf, dtype=np.float32)
    np.maximum.at(nearest, subpixel, parallax)
    same = _nearest_thing(fragments, parallax)
    depth = np.bincount(subpixel[same], optical_depth(fragments)[same], width * height)
    parallaxes, depths = (jit.from_numpy(jit.Float, of) for of in (nearest, depth))
    end = dr.opaque(jit.Float, float(nearest.max()))
    count = dr.opaque(jit.UInt32, len(points))
    lane = dr.arange(jit.UInt32, len(highlights) * len(points))
    fragment = lane // count
    point = lane - fragment * count
    u, v = (dr.gather(jit.Float, jit.from_numpy(jit.Float, column), point) for column in points.T)
    u, v = Jitter(highlights, cell).moved(u, v, point, fragment)
    x, y = (
        dr.gather(jit.Float, jit.from_numpy(jit.Float, column + np.float32(first + 0.5)), fragment)
        for column, first in ((highlights.x, highlights.left), (highlights.y, highlights.top))
    )
    own = jit.from_numpy(jit.Float, highlights.vergence * np.float32(radius_per_vergence))
    own = dr.gather(jit.Float, own, fragment)
    left, top, wide, high = (
        dr.opaque(jit.Int32, of) for of in (fragments.left, fragments.top, width, height)
    )

    def step(way: jit.Float, free: jit.Float) -> tuple[jit.Float, jit.Float]:
        column = jit.Int32(dr.floor(dr.fma(-way, u, x))) - left
        row = jit.Int32(dr.floor(dr.fma(-way, v, y))) - top
        inside = (column >= 0) & (row >= 0) & (column < wide) & (row < high)
        place = jit.UInt32(row * wide + column)
        parallax = dr.gather(jit.Float, parallaxes, place, inside) - own
        meets = inside & (dr.abs(parallax - way) <= STEP_PARALLAX)
        depth = dr.gather(jit.Float, depths, place, meets)
        return way + 1, dr.minimum(free, dr.exp(-depth))

    start = SLANT_BINS * BIN_RADIUS + 0.5
    way, free = dr.full(jit.Float, start, dr.width(lane)), dr.full(jit.Float, 1, dr.width(lane))
    _, free = dr.while_loop((way, free), lambda way, free: (way < end - own + 1) & (free > 0), step)
    return np.array(as_byte(free)).reshape(len(highlights), len(points))


def _nearest_thing(fragments: Fragments, parallax: np.ndarray) -> np.ndarray:
    """Which fragments, bool (N,), are of the nearest thing that the pinhole sees in a subpixel.

    It goes on as far as the next fragment is less than a subpixel of ``parallax``, (N,), away.
    """
    subpixel = fragments.subpixel
    result = fragments.first
    size = fragments.width * fragments.height
    several = result & (np.bincount(subpixel[result], minlength=size)[subpixel] > 1)
    order = np.flatnonzero(several)[::-1]
    order = order[np.argsort(subpixel[order], kind="stable")]
    begins = np.diff(subpixel[order], prepend=-1) != 0
    apart = np.cumsum(~begins & (np.diff(parallax[order], prepend=0) < -1))
    result[order] = apart == apart[begins][np.cumsum(begins) - 1]
    return result
