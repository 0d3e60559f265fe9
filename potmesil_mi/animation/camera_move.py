"""Camera moves: where the camera stands and looks from frame to frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..optics.camera import Camera, angles_of, look_at, orientation
from .track import Key, Track, is_list_of_keys

AXES = 3
"""Numbers of a point or a direction."""

VECTORS = ("origin", "target", "up")
ANGLES = ("pan", "tilt", "swing")

Vector = tuple[Track, Track, Track]
"""A point or a direction that changes from frame to frame."""


@dataclasses.dataclass(frozen=True)
class CameraMove:
    """Where a camera stands and looks from frame to frame.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``origin``                    where it stands, in scene units
    ``target``, ``up``            a point in the middle of its picture, and a direction that
                                  is upwards in it (default +y)
    ``pan``, ``tilt``, ``swing``  or the paper's angles in degrees, as of the sensor
                                  ``potmesil``
    ============================  ==========================================================

    What is not given is the camera's own; ``target`` takes the place of the angles, and it is
    wrong to give both, or ``up`` without it: then ``ValueError`` is raised.
    """

    origin: Vector | None = None
    target: Vector | None = None
    up: Vector | None = None
    pan: Track | None = None
    tilt: Track | None = None
    swing: Track | None = None

    def __post_init__(self) -> None:
        for name in ANGLES:
            if self.target is not None and getattr(self, name) is not None:
                raise ValueError(f"{name}: must not be given with target, which says the same")
        if self.up is not None and self.target is None:
            raise ValueError("up: must be given with target alone")

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> CameraMove:
        """The move of a TOML table. Raises ``ValueError`` or ``TypeError`` that names a field."""
        fields: dict[str, Any] = {}
        for name, value in values.items():
            try:
                if name in VECTORS:
                    fields[name] = _vector(value)
                elif name in ANGLES:
                    fields[name] = Track.of(value)
                else:
                    raise ValueError(f"unknown, must be one of {', '.join((*VECTORS, *ANGLES))}")
            except (ValueError, TypeError) as error:
                raise type(error)(f"{name}: {error}") from error
        return cls(**fields)

    def at(self, camera: Camera, frame: float) -> Camera:
        """A ``camera`` where it stands at a frame; its scale, if it has one, stays.

        Raises ``ValueError`` for a target where the camera stands, or along ``up``.
        """
        own = camera.world_from_camera()
        scale = np.linalg.norm(own[:3, :3], axis=0)
        origin = own[:3, 3] if self.origin is None else _at(self.origin, frame)
        if self.target is not None:
            up = (0.0, 1.0, 0.0) if self.up is None else _at(self.up, frame)
            rotation = look_at(origin, _at(self.target, frame), up, axes="mitsuba")[:3, :3]
        else:
            angles = angles_of(own[:3, :3] / scale)
            tracks = (getattr(self, name) for name in ANGLES)
            rotation = orientation(
                *(
                    float(angle) if track is None else track.at(frame)
                    for angle, track in zip(angles, tracks, strict=True)
                )
            )
        matrix = np.eye(4)
        matrix[:3, :3] = rotation * scale
        matrix[:3, 3] = origin
        return dataclasses.replace(camera, to_world=tuple(map(tuple, matrix.tolist())))


def _vector(value: Any) -> Vector:
    """The track of three numbers, or of keys ``[frame, [x, y, z]]`` or with an easing."""
    wrong = TypeError(
        f"{value!r}: must be three numbers, or a list of keys such as [[0, [0, 1, 5]], [24, [1, 1, "
        "5], 'ease']]"
    )
    if not isinstance(value, list) or not value:
        raise wrong
    if not is_list_of_keys(value):
        if len(value) != AXES:
            raise wrong
        x, y, z = (Track.of(number) for number in value)
        return x, y, z
    if not all(
        2 <= len(key) <= 3 and isinstance(key[1], list) and len(key[1]) == AXES for key in value
    ):
        raise wrong
    x, y, z = (
        Track(tuple(Key(frame, point[axis], *easing) for frame, point, *easing in value))
        for axis in range(AXES)
    )
    return x, y, z


def _at(vector: Vector, frame: float) -> tuple[float, ...]:
    return tuple(track.at(frame) for track in vector)
