"""Point-spread functions: how a lens spreads the light of one point over the film.

Section 3.2 of Potmesil & Chakravarty (1981), figure 9: the focus processor asks a point-spread
function for its table, the integrals of the intensity over the squares of a grid.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .lens import ThinLens

SHARP = 1e-6
"""Least radius of a circle, in grid squares: a sharp point is a circle of this size."""


class PointSpreadFunction(Protocol):
    """What the focus stage asks of a distribution of intensity."""

    def table(
        self,
        lens: ThinLens,
        depth: float,
        squares_per_mm: float,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """Integrals of the intensity of a point at ``depth`` over the squares of a grid.

        ``depth`` is in scene units (``inf`` is allowed), ``squares_per_mm`` the number of grid
        squares in a millimetre of film, ``offset`` the position (x, y) of the point in its
        square, from 0 (the left or upper edge) to 1; an array (..., 2) asks for many tables.
        Returns float64 of shape (..., 2K+1, 2L+1), rows and columns, whose middle element is the
        point's own square; each table sums to 1. ``largest`` bounds (L, K): what lies farther
        out is left out, for a grid of so many columns and rows cannot see it.
        """
        ...


class Disc:
    """Uniform intensity over the circle of confusion, equation 8: geometric optics."""

    def table(
        self,
        lens: ThinLens,
        depth: float,
        squares_per_mm: float,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """See :meth:`PointSpreadFunction.table`."""
        diameter = abs(float(lens.circle_of_confusion(depth))) * squares_per_mm
        return disc_table(diameter / 2, offset, largest)

    def __repr__(self) -> str:
        return "Disc()"


def disc_table(
    radius: float,
    offset: ArrayLike = (0.5, 0.5),
    largest: tuple[int, int] | None = None,
) -> np.ndarray:
    """The table, as of :class:`PointSpreadFunction`, of a disc of ``radius`` squares."""
    radius = max(radius, SHARP)
    x, y = np.moveaxis(np.asarray(offset, dtype=np.float64), -1, 0)
    reach = math.ceil(radius)
    reach_x, reach_y = (reach, reach) if largest is None else (min(reach, n) for n in largest)
    area = disc_corner_area(
        (np.arange(-reach_x, reach_x + 2) - x[..., None])[..., None, :] / radius,
        (np.arange(-reach_y, reach_y + 2) - y[..., None])[..., :, None] / radius,
    )
    return np.maximum(np.diff(np.diff(area, axis=-2), axis=-1), 0.0) / math.pi


def disc_corner_area(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Area of the unit disc that lies left of ``x`` and above ``y``, in closed form.

    The part of any axis-aligned rectangle inside a disc is the second difference of this.
    """
    x, y = np.broadcast_arrays(np.clip(x, -1.0, 1.0), np.clip(y, -1.0, 1.0))
    inside = x * x + y * y < 1
    # Twice the area left of x, under the chord's arc: the disc's own half-plane areas.
    half_x = x * np.sqrt(1 - x * x) + np.arcsin(x) + math.pi / 2
    half_y = y * np.sqrt(1 - y * y) + np.arcsin(y) + math.pi / 2
    corner_inside = (half_x + half_y) / 2 + x * y - math.pi / 4
    # A corner outside the circle cuts off nothing more than its two half-planes do.
    both = np.where((x > 0) & (y > 0), half_x + half_y - math.pi, 0.0)
    one_x = np.where((x <= 0) & (y > 0), half_x, 0.0)
    one_y = np.where((x > 0) & (y <= 0), half_y, 0.0)
    return np.where(inside, corner_inside, both + one_x + one_y)
