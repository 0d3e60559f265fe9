"""Camera moves: where the camera stands and looks from frame to frame."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._validation import require_kind, require_number
from ..optics.camera import Camera, angles_of, look_at, orientation
from .track import Track, VectorTrack, require_tracks, tracks_of

ANGLES = ("pan", "tilt", "swing")

KINDS: dict[str, type[Track] | type[VectorTrack]] = {
    **dict.fromkeys(("origin", "target", "up"), VectorTrack),
    **dict.fromkeys((*ANGLES, "zoom"), Track),
}
"""What each field is a track of."""


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
    ``zoom``                      how many times as large it shows what is in the middle, > 0,
                                  as with its own field of view; not of an orthographic camera
    ============================  ==========================================================

    What is not given is the camera's own; ``target`` takes the place of the angles, and it is
    wrong to give both, or ``up`` without it: then ``ValueError`` is raised.
    """

    origin: VectorTrack | None = None
    target: VectorTrack | None = None
    up: VectorTrack | None = None
    pan: Track | None = None
    tilt: Track | None = None
    swing: Track | None = None
    zoom: Track | None = None

    def __post_init__(self) -> None:
        require_tracks(self, KINDS)
        for name in ANGLES:
            if self.target is not None and getattr(self, name) is not None:
                raise ValueError(f"{name}: must not be given with target, which says the same")
        if self.up is not None and self.target is None:
            raise ValueError("up: must be given with target alone")
        for key in () if self.zoom is None else self.zoom.keys:
            if not key.value > 0:
                raise ValueError(f"zoom={key.value}: must be > 0")

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> CameraMove:
        """The move of a TOML table. Raises ``ValueError`` or ``TypeError`` that names a field."""
        return cls(**tracks_of(values, KINDS))

    def at(self, camera: Camera, frame: float) -> Camera:
        """A ``camera`` where it stands at a frame; its scale, if it has one, stays.

        Raises ``ValueError`` for a target where the camera stands, or along ``up``.
        """
        require_kind("camera", camera, Camera, "a Camera")
        require_number("frame", frame)
        own = camera.world_from_camera()
        scale = np.linalg.norm(own[:3, :3], axis=0)
        origin = own[:3, 3] if self.origin is None else self.origin.at(frame)
        if self.target is not None:
            up = np.array([0.0, 1.0, 0.0]) if self.up is None else self.up.at(frame)
            rotation = look_at(origin, self.target.at(frame), up, axes="mitsuba")[:3, :3]
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
        camera = dataclasses.replace(camera, to_world=tuple(map(tuple, matrix.tolist())))
        return camera if self.zoom is None else _zoomed(camera, self.zoom.at(frame))


def _zoomed(camera: Camera, zoom: float) -> Camera:
    """A camera that shows the middle of its picture so many times as large."""
    if camera.projection != "perspective":
        raise ValueError(f"zoom={zoom}: must not be given for an orthographic camera")
    half = math.atan(math.tan(math.radians(camera.x_fov) / 2) / zoom)
    return dataclasses.replace(camera, x_fov=math.degrees(2 * half))
