"""The round aperture, by geometric optics: closed forms for the disc."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from .aperture import SHARP, Aperture

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
"""Radians from one point of a sunflower to the next."""


@dataclasses.dataclass(frozen=True)
class Disc(Aperture):
    """A round aperture: uniform intensity over the circle of confusion, equation 8."""

    name: ClassVar[str] = "disc"
    is_round: ClassVar[bool] = True

    def corner_area(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :meth:`Aperture.corner_area`."""
        return disc_corner_area(x, y)

    def points(self, count: int) -> np.ndarray:
        """See :meth:`Aperture.points`."""
        return lens_points(count)


def lens_points(count: int) -> np.ndarray:
    """Points spread evenly over the unit disc, (count, 2): H. Vogel's sunflower (1979)."""
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), k * GOLDEN_ANGLE
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def disc_kernel(
    radius: float,
    offset: ArrayLike = (0.5, 0.5),
    largest: tuple[int, int] | None = None,
) -> np.ndarray:
    """The kernel of a disc of ``radius`` pixels; see :meth:`Aperture.circle_kernel`."""
    offset = np.asarray(offset, dtype=np.float64)
    return Disc().upright_kernel(max(radius, SHARP), 1.0, offset, largest)


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
