"""Motion: what moves in a scene while a picture of it is exposed.

Potmesil & Chakravarty (1981, section 3.1) keep the surface of each sample "to be used in motion
blur"; a rigid motion of the surface then tells the path of the sample through the picture.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._validation import require_kind, require_number, shown
from ..optics.camera import Camera
from .camera_move import CameraMove
from .shape_move import ShapeMove
from .shutter import Shutter
from .toml import read_toml, table_of
from .track import at_frame, named, require_known


class Moves:
    """How camera and shapes move from frame to frame; what has the two fields can tell."""

    camera: CameraMove | None
    shapes: Mapping[str, ShapeMove]
    shutter: Shutter | None

    def _require_moves(self) -> None:
        """Raise ``TypeError`` for a field of another kind."""
        for name, value, kind in (
            ("camera", self.camera, CameraMove),
            ("shutter", self.shutter, Shutter),
        ):
            if value is not None:
                require_kind(name, value, kind, f"a {kind.__name__} or None")
        require_kind("shapes", self.shapes, Mapping, "a mapping, of ids to a ShapeMove each")
        for name, move in self.shapes.items():
            require_kind(f"shapes.{name}", move, ShapeMove, "a ShapeMove")

    def camera_at(self, camera: Camera, frame: float) -> Camera:
        """Where a ``camera`` stands at a frame. Raises ``ValueError`` that names the frame."""
        require_kind("camera", camera, Camera, "a Camera")
        with at_frame(frame, ": camera"):
            return camera if self.camera is None else self.camera.at(camera, frame)

    def transforms_at(
        self, centres: Mapping[str, np.ndarray], frame: float
    ) -> dict[str, np.ndarray]:
        """The matrices (4, 4) of the world that move shapes, by their ids, at a frame.

        ``centres``, (3,) each, are the middles of their bounding boxes. Raises ``ValueError`` that
        names the frame and the shape.
        """
        require_kind("centres", centres, Mapping, "a mapping, of ids to (3,) each")
        transforms = {}
        for name, move in self.shapes.items():
            if name not in centres:
                raise ValueError(
                    f"centres={shown(centres)}: must have all of {', '.join(self.shapes)}"
                )
            with at_frame(frame, f": shapes.{name}"):
                transforms[name] = move.at(frame, centres[name])
        return transforms


@dataclasses.dataclass(frozen=True)
class Motion(Moves):
    """What moves in a scene, and when the shutter is open.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``camera``                    how the camera moves, a :class:`CameraMove`; ``None``
                                  (default): it stands still
    ``shapes``                    how shapes move, by their ids: a :class:`ShapeMove` each
    ``shutter``                   a :class:`Shutter`; ``None`` (default): that of the sensor,
                                  whose ``shutter_open`` and ``shutter_close`` are in frames
    ``frame``                     the frame of the picture (default 0), from which the shutter
                                  counts
    ============================  ==========================================================
    """

    camera: CameraMove | None = None
    shapes: Mapping[str, ShapeMove] = dataclasses.field(default_factory=dict)
    shutter: Shutter | None = None
    frame: float = 0.0

    def __post_init__(self) -> None:
        self._require_moves()
        require_number("frame", self.frame)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Motion:
        """Read a TOML file; ``docs/howto/motion-blur.md`` has its form.

        Raises ``OSError`` where it cannot be read, and ``ValueError`` or ``TypeError`` that names
        the file and what in it is wrong.
        """
        return read_toml(path, cls.from_dict)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Motion:
        """The motion that a TOML file describes, of its tables ``camera``, ``shapes``, ``shutter``.

        Raises ``ValueError`` or ``TypeError`` that names what is unknown or wrong.
        """
        require_known(values, MOTION_TABLES)
        return cls(**moves_of(values))

    def during(self, shutter: Shutter) -> Motion:
        """The same motion before another shutter."""
        return dataclasses.replace(self, shutter=shutter)

    def shutter_of(self, camera: Camera) -> Shutter:
        """The shutter, or that of the ``camera`` where there is none."""
        require_kind("camera", camera, Camera, "a Camera")
        return self.shutter or Shutter(camera.shutter_open, camera.shutter_close)


MOTION_TABLES = ("camera", "shapes", "shutter")
"""The tables of a TOML file that describe a motion."""


def moves_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a :class:`Motion` that the tables of a TOML file give.

    Raises ``ValueError`` or ``TypeError`` that names the table.
    """
    moves: dict[str, Any] = {"shapes": {}}
    for name, kind in (("camera", CameraMove), ("shutter", Shutter)):
        table = table_of(values, name)
        if name in values:
            with named(name):
                moves[name] = kind.from_dict(table)
    for name, move in table_of(values, "shapes").items():
        with named(f"shapes.{name}"):
            if not isinstance(move, Mapping):
                raise TypeError(f"{move!r}: must be a table")
            moves["shapes"][name] = ShapeMove.from_dict(move)
    return moves
