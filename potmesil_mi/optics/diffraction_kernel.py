"""Kernels of diffraction patterns: the light of I(u, v) on the pixels of a raster.

The light of a ring around the middle of a pattern is known in closed form
(:func:`.diffraction.encircled_energy`), so no fringe is too fine for a grid.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike

from .diffraction import encircled_energy
from .summed_area import interpolated, summed_area

TAIL = 1 / 400
"""Share of the light, at most, that a diffraction pattern has beyond its kernel. What the kernel
has is divided by its sum, so that none is lost."""

MOST_PARTS = 1 << 20
"""Parts, at most, into which the pixels of a diffraction pattern's kernel are divided, in all."""

MOST_A_SIDE = 16
"""Parts, at most, on a side of a pixel of a diffraction pattern's kernel."""

CORE = 8
"""Pixels around the middle of a diffraction pattern, on each side, with parts of ``FINE``."""

FINE = 0.25
"""Size, in v, of the parts in the middle of a diffraction pattern."""


def diffraction_kernel(
    u: float,
    v_per_pixel: float,
    end: float,
    offset: ArrayLike,
    largest: tuple[int, int] | None,
) -> np.ndarray:
    """The kernel of I(u, v), float64 (..., 2K+1, 2L+1), rows and columns.

    ``v_per_pixel`` is v a pixel from the middle; the pattern ends ``end`` pixels from it, which
    may be ``inf``. ``offset`` and ``largest`` are those of
    :meth:`potmesil_mi.PointSpreadFunction.table`. Kernels are kept: do not write into them.
    """
    places = np.asarray(offset, dtype=np.float64)
    if places.shape == (2,):
        return _one_kernel(u, v_per_pixel, end, tuple(places.tolist()), largest)
    return _kernels(u, v_per_pixel, end, places, largest)


@functools.lru_cache(maxsize=256)
def _one_kernel(
    u: float,
    v_per_pixel: float,
    end: float,
    offset: tuple[float, float],
    largest: tuple[int, int] | None,
) -> np.ndarray:
    kernel = _kernels(u, v_per_pixel, end, np.array(offset), largest)
    kernel.setflags(write=False)
    return kernel


def _kernels(
    u: float,
    v_per_pixel: float,
    end: float,
    offset: np.ndarray,
    largest: tuple[int, int] | None,
) -> np.ndarray:
    reach, integral, parts, whole = _pattern_integral(u, v_per_pixel, end, largest)
    reach_x, reach_y = (reach, reach) if largest is None else (min(reach, n) for n in largest)
    x, y = np.moveaxis(offset, -1, 0)
    middle = (reach + 1) * parts
    columns = (np.arange(-reach_x, reach_x + 2) - x[..., None])[..., None, :] * parts + middle
    rows = (np.arange(-reach_y, reach_y + 2) - y[..., None])[..., :, None] * parts + middle
    kernel = np.diff(np.diff(interpolated(integral, columns, rows), axis=-2), axis=-1)
    return np.maximum(kernel, 0) / whole


@functools.lru_cache(maxsize=4)
def _pattern_integral(
    u: float, v_per_pixel: float, end: float, largest: tuple[int, int] | None
) -> tuple[int, np.ndarray, int, float]:
    """How far the pattern reaches, what is left of and above a corner, parts a pixel, the whole.

    The light of a ring is known in closed form, so each part of a pixel, whatever the fringes
    in it, gets the mean of the ring that goes through it.
    """
    farthest = math.inf if largest is None else math.hypot(*largest) + 1
    limit = min(_reach(u, v_per_pixel), end)
    radius = min(limit, farthest)
    reach = max(math.ceil(radius), 1)
    if largest is not None:
        reach = min(reach, max(largest))
    parts = min(
        int(math.sqrt(MOST_PARTS) / (2 * reach + 2)), MOST_A_SIDE, math.ceil(v_per_pixel / FINE)
    )
    parts = max(parts // 2 * 2, 2)
    farthest = (reach + 1) * math.sqrt(2)
    # Finer parts and rings in the middle, where the pattern is steepest.
    core = min(CORE, reach + 1)
    finer = math.ceil(min(v_per_pixel / (parts * FINE), math.sqrt(MOST_PARTS) / (2 * core * parts)))
    finest = 0.5 / (parts * finer)
    radii = np.arange(0, math.ceil((core + 1) * math.sqrt(2) / finest)) * finest
    beyond = np.arange(radii[-1] + 0.5 / parts, farthest + 2 / parts, 0.5 / parts)
    radii = np.concatenate([radii, beyond])
    energy = encircled_energy(u, np.minimum(radii, end) * v_per_pixel)

    def quarter(pixels: int, parts: int) -> np.ndarray:
        """The light of the parts of so many pixels left of and above the middle."""
        axis = (np.arange(pixels * parts) + 0.5) / parts - pixels
        distance, half = np.hypot(axis[:, None], axis[None, :]), 0.5 / parts
        inner, outer = np.maximum(distance - half, 0), distance + half
        light = np.interp(outer, radii, energy) - np.interp(inner, radii, energy)
        light *= 1 / (math.pi * (outer**2 - inner**2) * parts**2)
        light[distance > limit + 2 * half] = 0
        return light

    light = quarter(reach + 1, parts)
    middle = quarter(core, parts * finer).reshape(core * parts, finer, core * parts, finer)
    light[-core * parts :, -core * parts :] = middle.sum(axis=(1, 3))
    light = np.concatenate([light, light[:, ::-1]], axis=1)
    light = np.concatenate([light, light[::-1]], axis=0)
    integral = summed_area(light)
    whole = float(encircled_energy(u, limit * v_per_pixel))
    if limit <= reach:  # What the rings' approximation makes of it.
        whole = float(integral[-1, -1])
    return reach, integral, parts, whole


def _reach(u: float, v_per_pixel: float) -> float:
    """Pixels beyond which the pattern has no more than ``TAIL`` of its light."""
    v = u + 2 ** np.arange(1, 24, 0.25)
    beyond = 1 - encircled_energy(u, v)
    within = np.flatnonzero(beyond <= TAIL)
    return float(v[within[0] if len(within) else -1]) / v_per_pixel
