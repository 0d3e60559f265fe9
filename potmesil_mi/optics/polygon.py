"""Apertures of blades, straight or curved, by geometric optics."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from .._validation import require_number, require_whole
from .attached import DifferentiableAperture
from .disc import GOLDEN_ANGLE

ARC = 0.05
"""Angle in radians, at most, of the straight pieces of which a curved blade is made."""


@dataclasses.dataclass(frozen=True)
class Polygon(DifferentiableAperture):
    """An aperture of blades: its corners lie on the circle of the aperture's radius.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``blades``                    number of blades, 3 to 64 (default 6)
    ``rotation``                  degrees by which it is turned, anticlockwise as seen from
                                  behind the camera; at 0 (default) a corner is at the top
    ``curvature``                 of the blades, from 0 (default), straight, to 1, the circle
    ============================  ==========================================================

    ``rotation`` and ``curvature`` may be Dr.Jit arrays of one number: pictures then have
    derivatives in what has gradients enabled.
    """

    blades: int = 6
    rotation: float = 0.0
    curvature: float = 0.0

    name: ClassVar[str] = "polygon"
    steps: ClassVar[Mapping[str, float]] = {"rotation": 0.01, "curvature": 1e-4}

    def __post_init__(self) -> None:
        require_whole("blades", self.blades, 3, 64)
        self._take_numbers("rotation", "curvature")
        require_number("rotation", self.rotation)
        require_number("curvature", self.curvature, 0, 1)

    @functools.cached_property
    def corners(self) -> np.ndarray:
        """Corners (N, 2), x right and y downwards; a curved blade is of several straight pieces."""
        step = 2 * math.pi / self.blades
        # The blade is an arc through both corners, of a circle whose curvature is the parameter's.
        half, middle = math.sin(step / 2), math.cos(step / 2)
        angle = self.curvature * step / 2
        pieces = self._pieces
        share = np.linspace(-1, 1, pieces, endpoint=False)
        if angle != 0:
            size = half / math.sin(angle)
            x = size * np.sin(share * angle)
            y = middle + size * (np.cos(share * angle) - math.cos(angle))
        else:
            x, y = half * share, np.full(pieces, middle)
        turns = (np.arange(self.blades) + 0.5) * step - math.radians(self.rotation)
        cosine, sine = np.cos(turns)[:, None], np.sin(turns)[:, None]
        # Clockwise from the top, where y is up; then y downwards.
        right, up = x * cosine + y * sine, y * cosine - x * sine
        return np.stack([right.ravel(), -up.ravel()], axis=-1)

    @property
    def _pieces(self) -> int:
        """Straight pieces of which each blade is made."""
        return max(1, math.ceil(self.curvature * (2 * math.pi / self.blades) / ARC))

    def smooth(self) -> Polygon:
        """See :meth:`.DifferentiableAperture.smooth`."""
        if "curvature" not in self.attached:
            return self.without_gradients()
        return _PolygonOfPieces(self.blades, self.rotation, self.curvature)

    def corner_area(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :meth:`Aperture.corner_area`; in closed form, by Green's theorem along the edges."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        area = np.zeros(x.shape)
        ends = np.roll(self.corners, -1, axis=0)
        for (x0, y0), (x1, y1) in zip(self.corners.tolist(), ends.tolist(), strict=True):
            if y0 == y1:
                continue
            # Along the edge above y: the integral over y of the smaller of the edge's x and x.
            t = np.clip((y - y0) / (y1 - y0), 0, 1)
            first, last = (0.0, t) if y1 > y0 else (t, 1.0)
            area += (y1 - y0) * (
                _integral_of_lesser(x0, x1, x, last) - _integral_of_lesser(x0, x1, x, first)
            )
        return area

    def points(self, count: int) -> np.ndarray:
        """See :meth:`Aperture.points`: those of the disc, each sector drawn to the same share."""
        corners = np.concatenate([self.corners, self.corners[:1]])
        x, y = corners.T
        sectors = (x[:-1] * y[1:] - x[1:] * y[:-1]) / 2
        shares = np.concatenate([[0], np.cumsum(sectors)]) / sectors.sum()
        k = np.arange(count)
        turn = (k * GOLDEN_ANGLE / (2 * math.pi)) % 1
        sector = np.minimum(np.searchsorted(shares, turn, side="right") - 1, len(sectors) - 1)
        along = ((turn - shares[sector]) / np.diff(shares)[sector])[:, None]
        edge = corners[sector] * (1 - along) + corners[sector + 1] * along
        return edge * np.sqrt((k + 0.5) / count)[:, None]


@dataclasses.dataclass(frozen=True)
class _PolygonOfPieces(Polygon):
    """A polygon whose blades have as many pieces whatever their curvature, which may be beyond.

    So its shape, and the picture, change smoothly with it.
    """

    def __post_init__(self) -> None:
        pass

    @property
    def _pieces(self) -> int:
        return math.ceil(2 * math.pi / self.blades / ARC)


def _integral_of_lesser(x0: float, x1: float, most: np.ndarray, t: Any) -> np.ndarray:
    """Integral from 0 to ``t`` of the lesser of x0 + (x1 - x0) s and ``most``."""
    slope = x1 - x0
    if slope == 0:
        return np.minimum(x0, most) * t
    crossing = np.clip((most - x0) / slope, 0, t)

    def under(end: Any) -> Any:
        return x0 * end + slope / 2 * end * end

    if slope > 0:
        return under(crossing) + most * (t - crossing)
    return most * crossing + under(t) - under(crossing)
