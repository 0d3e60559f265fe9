"""The camera and the lens of a picture, of what its file says and what is given."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from .._validation import require_number
from ..optics.camera import Camera, horizontal_fov
from ..optics.camera.pinhole import FovAxis
from ..optics.depth import camera_of
from ..optics.lens import ThinLens
from ..pictures.picture import Frame
from ..pictures.programs import BLENDER

OPENINGS = ("f_number", "aperture_radius")


def camera_and_lens(
    frame: Frame,
    name: str,
    camera: Camera | float | None,
    lens: ThinLens | Mapping[str, Any] | None,
) -> tuple[Camera, ThinLens]:
    """The camera and the lens of the picture of a ``frame`` in the file ``name``.

    ``camera``, or its field of view in degrees, and ``lens``, or some of its parameters, are what
    is given; it goes before what the file says. Raises ``ValueError`` that names all that nothing
    says.
    """
    given = {} if lens is None or isinstance(lens, ThinLens) else dict(lens)
    told = len(given)
    optics, missing = frame.optics, []
    focal_length = given.pop("focal_length", None) or optics.focal_length
    frame_width = given.pop("frame_width", None) or optics.frame_width
    # What the file says of its field of view gives way to what is given of the lens alone.
    x_fov = optics.x_fov if len(given) == told else None
    fov = _fov(frame, camera, x_fov, focal_length, frame_width) or optics.x_fov
    if fov is None:
        missing.append("fov, or both focal_length and frame_width")
    if isinstance(lens, ThinLens):
        _require(missing, name)
        return _camera(frame, camera, fov), lens
    if not any(opening in given for opening in OPENINGS):
        given["f_number"] = optics.f_number
        if optics.f_number is None:
            missing.append("f_number, or aperture_radius")
    unit = given.pop("millimeters_per_unit", None) or optics.millimeters_per_unit
    if unit is None and "f_number" in given:
        missing.append("millimeters_per_unit, 1000 for metres")
    unit = 1000.0 if unit is None else unit
    distance = given.pop("focus_distance", None) or optics.focus_distance
    if distance is None and optics.focus_meters is not None:
        distance = optics.focus_meters * 1000 / unit
    if distance is None:
        missing.append("focus_distance")
    _require(missing, name)
    assert fov is not None
    found = ThinLens.of_field_of_view(
        fov,
        focal_length=focal_length,
        frame_width=None if focal_length else frame_width,
        focus_distance=distance,
        millimeters_per_unit=unit,
        **given,
    )
    return _camera(frame, camera, fov), found


def _require(missing: list[str], name: str) -> None:
    if missing:
        raise ValueError(
            f"{name}: the file does not say, and so must be given: {'; '.join(missing)}"
        )


def _fov(
    frame: Frame,
    camera: Camera | float | None,
    x_fov: float | None,
    focal_length: float | None,
    frame_width: float | None,
) -> float | None:
    """The horizontal field of view in degrees of the whole picture, if anything says it."""
    if isinstance(camera, Camera):
        return camera.x_fov
    if camera is not None:
        require_number("camera", camera)
        return float(camera)
    if x_fov is not None:
        return x_fov
    if focal_length and frame_width:
        fov = 2 * math.degrees(math.atan(frame_width / (2 * focal_length)))
        width, height = frame.film_size
        # Blender's sensor fits the longer side.
        axis: FovAxis = "larger" if frame.known is BLENDER else "x"
        return horizontal_fov(fov, axis, width / height)
    return None


def _camera(frame: Frame, camera: Camera | float | None, fov: float | None) -> Camera:
    if isinstance(camera, Camera):
        return camera
    assert fov is not None
    whole = camera_of(fov, frame.film_size)
    return dataclasses.replace(whole, crop_offset=frame.crop_offset, crop_size=frame.size)
