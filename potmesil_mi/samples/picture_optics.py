"""The camera and the lens of a picture, of what its file says and what is given."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from .._validation import require_field_of_view, require_positive
from ..optics.camera import Camera, horizontal_fov
from ..optics.camera.pinhole import FovAxis
from ..optics.depth import camera_of
from ..optics.lens import ThinLens
from ..optics.usable import require_magnitude
from ..pictures.picture import Frame
from ..pictures.programs import BLENDER
from .header import json_object, lens_of_header

OPENINGS = ("f_number", "aperture_radius")
"""Two parameters of a lens of which one says how wide it is."""

FIELD = ("focal_length", "frame_width")
"""Two that together say the field of view."""

AGREE = 0.02
"""Part by which two fields of view that are given may differ."""

FOV = "the field of view (camera, --fov), or both focal_length and frame_width"
"""What is asked for where there is none."""


def camera_and_lens(
    frame: Frame,
    name: str,
    camera: Camera | float | None,
    lens: ThinLens | Mapping[str, Any] | None,
) -> tuple[Camera, ThinLens]:
    """The camera and the lens of the picture of a ``frame`` in the file ``name``.

    ``camera``, or its field of view in degrees, and ``lens``, or some of its parameters, are what
    is given; it goes before what the file says, but the field of view that a file says stays.
    Raises ``ValueError`` that names all that nothing says, or what contradicts itself.
    """
    if isinstance(camera, Camera):
        require_fitting(camera, frame.size)
    if isinstance(lens, ThinLens):
        of_picture = _fov(frame, camera, {})
        return _camera(frame, camera, lens.fov if of_picture is None else of_picture), lens
    given = dict(lens or {})
    if "half_angle" in given:
        raise ValueError(f"half_angle={given['half_angle']}: is of an orthographic camera")
    said = _said(frame, given)
    fov = _fov(frame, camera, {**said, **given})
    if fov is not None and frame.optics.own_lens is not None:
        # What this package wrote.
        own = lens_of_header(json_object(frame.optics.own_lens, "potmesil:lens"))
        if isinstance(own, ThinLens):
            return _camera(frame, camera, fov), own.replace(**given)
    both = {**said, **given}
    missing = [] if fov is not None else [FOV]
    if not any(opening in both for opening in OPENINGS):
        missing.append("f_number, or aperture_radius")
    in_meters = frame.optics.focus_meters
    if "focus_distance" not in both and in_meters is None:
        missing.append("focus_distance")
    needs_unit = "f_number" in both or "focus_distance" not in both
    if needs_unit and "millimeters_per_unit" not in both:
        missing.append("millimeters_per_unit, 1000 for metres")
    if missing:
        raise ValueError(
            f"{name}: the file does not say, and so must be given: {'; '.join(missing)}"
        )
    assert fov is not None
    unit = both.setdefault("millimeters_per_unit", 1000.0)
    if "focus_distance" not in both and in_meters is not None:
        both["focus_distance"] = in_meters * 1000 / unit
    field = {name: both.pop(name) for name in FIELD if name in both}
    _require_agreement(fov, {name: given[name] for name in FIELD if name in given})
    focal_length = field.get("focal_length")
    width = None if focal_length is not None else field.get("frame_width")
    found = ThinLens.of_field_of_view(fov, focal_length=focal_length, frame_width=width, **both)
    return _camera(frame, camera, fov), found


def _said(frame: Frame, given: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters of the lens that the file says."""
    optics = frame.optics
    said = {
        "focal_length": optics.focal_length,
        "frame_width": optics.frame_width,
        "f_number": optics.f_number,
        "focus_distance": optics.focus_distance,
        "millimeters_per_unit": optics.millimeters_per_unit,
    }
    if "aperture_radius" in given:
        del said["f_number"]
    return {name: value for name, value in said.items() if value is not None}


def _require_agreement(fov: float, field: Mapping[str, Any]) -> None:
    """Raise ``ValueError`` where both that are given say another field of view."""
    if len(field) < len(FIELD):
        return
    ratio = field["frame_width"] / (2 * field["focal_length"])
    if abs(ratio / math.tan(math.radians(fov) / 2) - 1) > AGREE:
        raise ValueError(
            f"focal_length={field['focal_length']}, frame_width={field['frame_width']}: are "
            f"{2 * math.degrees(math.atan(ratio)):.4g} degrees across, and the picture {fov:.4g}; "
            "give one of them"
        )


def _fov(frame: Frame, camera: Camera | float | None, lens: Mapping[str, Any]) -> float | None:
    """The horizontal field of view in degrees of the whole picture, if anything says it."""
    if isinstance(camera, Camera):
        return camera.x_fov
    if camera is not None:
        return given_fov(camera)
    if frame.optics.x_fov is not None:
        return frame.optics.x_fov
    if all(name in lens for name in FIELD):
        for name in FIELD:
            require_positive(name, lens[name], "mm")
        fov = 2 * math.degrees(math.atan(lens["frame_width"] / (2 * lens["focal_length"])))
        width, height = frame.film_size
        # Blender's sensor fits the longer side.
        axis: FovAxis = "larger" if frame.known is BLENDER else "x"
        return horizontal_fov(fov, axis, width / height)
    return None


def given_fov(camera: float) -> float:
    """The field of view in degrees that is given in the place of a camera.

    Raises ``ValueError`` or ``TypeError`` where it is none.
    """
    require_field_of_view("camera", camera)
    require_magnitude("camera", float(camera))
    return float(camera)


def _camera(frame: Frame, camera: Camera | float | None, fov: float) -> Camera:
    if isinstance(camera, Camera):
        return camera
    width, height = frame.film_size
    across, down = frame.optics.principal_point_offset
    whole = camera_of(fov, frame.film_size, (across, down * width / height))
    return dataclasses.replace(whole, crop_offset=frame.crop_offset, crop_size=frame.size)


def require_fitting(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera, if a picture of a ``size``, width and height, may be of it.

    Raises ``ValueError`` for one of another size, and for a parallel projection.
    """
    if tuple(camera.crop_size) != size:
        raise ValueError(
            f"camera: its picture has {camera.crop_size} pixels across and down, must have {size}, "
            "as the picture"
        )
    if camera.projection != "perspective":
        raise ValueError(f"camera: its projection is {camera.projection}, must be perspective")
    return camera
