"""What the OpenEXR standard has attributes for, of a camera and a lens.

https://openexr.com/en/latest/StandardAttributes.html
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from .._image import OWN_LENS
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens

RIGHT_UP_FORWARD = np.diag([-1.0, 1.0, 1.0, 1.0])
"""The standard's axes of a camera, from those of Mitsuba's, whose x goes to the left."""


def standard_attributes(camera: Camera, lens: ThinLens | TelecentricLens) -> dict[str, Any]:
    """The attributes of a picture: numbers, pairs, matrices (4, 4), text, and its two windows.

    ``aperture`` (f-number), ``focus`` (m), ``nominalFocalLength`` (mm), ``sensorOverallDimensions``
    (mm), ``screenWindowWidth`` and ``screenWindowCenter`` (in the plane at distance 1), and
    ``worldToCamera``, which acts on rows; beside them ``potmesil:millimeters_per_unit`` and
    ``potmesil:lens``, the lens as JSON.
    An orthographic camera and its lens have the last two and ``worldToCamera`` alone. The windows
    are left, top, width and height.
    """
    plain = lens.plain()
    view = (RIGHT_UP_FORWARD @ np.asarray(camera.camera_from_world())).T
    width, height = camera.film_size
    found: dict[str, Any] = {
        "worldToCamera": view,
        OWN_LENS: json.dumps(lens.to_dict()),
        "displayWindow": (0, 0, width, height),
        "dataWindow": (*camera.crop_offset, *camera.crop_size),
    }
    if not isinstance(plain, ThinLens):
        return found
    window = 2 * math.tan(math.radians(camera.x_fov) / 2)
    across, down = camera.principal_point_offset
    found |= {
        "focus": plain.focus_distance * plain.millimeters_per_unit / 1000,
        "nominalFocalLength": plain.focal_length,
        "sensorOverallDimensions": (plain.frame_width, plain.frame_width * height / width),
        "screenWindowWidth": window,
        "screenWindowCenter": (across * window, -down * window * height / width),
        "potmesil:millimeters_per_unit": plain.millimeters_per_unit,
    }
    if math.isfinite(plain.f_number):
        found["aperture"] = plain.f_number
    return found
