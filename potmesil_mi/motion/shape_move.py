"""Shape moves: how a shape is moved from where the scene has it, from frame to frame."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._validation import require_number, require_vector
from .track import Track, VectorTrack, require_tracks, tracks_of

KINDS: dict[str, type[Track] | type[VectorTrack]] = {
    "translate": VectorTrack,
    "angle": Track,
    "axis": VectorTrack,
    "scale": Track,
    "pivot": VectorTrack,
}
"""What each field is a track of."""


@dataclasses.dataclass(frozen=True)
class ShapeMove:
    """How a shape is moved from where the scene has it, from frame to frame.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``translate``                 by how much, in scene units of the world
    ``angle``, ``axis``           a turn in degrees, about a direction (default +y), against
                                  the clock as seen from where it points to
    ``scale``                     of its size, > 0
    ``pivot``                     the point that turns and sizes leave where it is; by default
                                  the middle of the shape's bounding box
    ============================  ==========================================================

    It is scaled, then turned, then shifted.
    """

    translate: VectorTrack | None = None
    angle: Track | None = None
    axis: VectorTrack | None = None
    scale: Track | None = None
    pivot: VectorTrack | None = None

    def __post_init__(self) -> None:
        require_tracks(self, KINDS)
        if self.axis is not None and self.angle is None:
            raise ValueError("axis: must be given with angle")
        for key in () if self.scale is None else self.scale.keys:
            if not key.value > 0:
                raise ValueError(f"scale={key.value}: must be > 0")

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ShapeMove:
        """The move of a TOML table. Raises ``ValueError`` or ``TypeError`` that names a field."""
        return cls(**tracks_of(values, KINDS))

    def at(self, frame: float, centre: np.ndarray) -> np.ndarray:
        """The matrix (4, 4) that moves the world's points of a shape with that ``centre``, (3,).

        Raises ``ValueError`` for an axis of no length.
        """
        require_number("frame", frame)
        centre = require_vector("centre", centre)
        pivot = centre if self.pivot is None else self.pivot.at(frame)
        axis = np.array([0.0, 1.0, 0.0]) if self.axis is None else self.axis.at(frame)
        length = float(np.linalg.norm(axis))
        if length == 0:
            raise ValueError(f"axis={axis.tolist()}: must have a length")
        angle = math.radians(0.0 if self.angle is None else self.angle.at(frame))
        scale = 1.0 if self.scale is None else self.scale.at(frame)
        matrix = np.eye(4)
        matrix[:3, :3] = scale * _rotation(axis / length, angle)
        matrix[:3, 3] = pivot - matrix[:3, :3] @ pivot
        if self.translate is not None:
            matrix[:3, 3] += self.translate.at(frame)
        return matrix


def _rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """The turn about a unit vector (Rodrigues), (3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
