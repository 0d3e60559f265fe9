"""What is told of a stack and of each of its pictures: JSON for those who learn from them."""

from __future__ import annotations

import math
from typing import Any

from ..optics.blur import radius_per_vergence
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..samples.circles import circle_diameter
from ..samples.depth_range import DepthRange
from ..samples.point_samples import PointSamples
from .foci import Lens

AXES = "x to the left, y up, z along the view; pixels from the top left corner of the picture"
"""Those of a camera in what is told of it."""

DEPTH_KIND = "z along the axis, scene units; inf where nothing was hit"

METRES = "z along the axis, metres; nearest and farthest in scene units"
"""What depths are, in one layout and in the other."""

CIRCLES = {
    "ThinLens": "diameter in pixels = scale * (1/z - 1/focus_distance), positive nearer than focus",
    "TelecentricLens": "diameter in pixels = scale * (focus_distance - z), positive nearer than "
    "focus",
}
"""How circles of confusion follow from depth, by the kind of the lens."""


def camera_told(samples: PointSamples) -> dict[str, Any]:
    """The camera of the samples: intrinsics in pixels of the picture, and where it stands."""
    camera = samples.camera
    (left, top), (x, y) = camera.crop_offset, camera.principal_point
    told: dict[str, Any] = {
        "projection": camera.projection,
        "image_size": camera.crop_size,
        "film_size": camera.film_size,
        "crop_offset": camera.crop_offset,
        "camera_to_world": camera.to_world,
        "axes": AXES,
        "camera_to_world_opengl": camera.world_from_camera("opengl").tolist(),
        "near_clip": camera.near_clip,
        "far_clip": camera.far_clip,
    }
    if camera.projection == "orthographic":
        return {**told, "film_width": camera.film_width, "pixels_per_unit": camera.pixels_per_unit}
    focal = camera.focal_length_pixels
    fov = [math.degrees(2 * math.atan(size / (2 * focal))) for size in camera.film_size]
    return {
        **told,
        "intrinsics": {"fx": focal, "fy": focal, "cx": x - left, "cy": y - top},
        "field_of_view_degrees": dict(zip("xy", fov, strict=True)),
    }


def lens_told(lens: Lens, camera: Camera, ends: tuple[float, float]) -> dict[str, Any]:
    """A lens before a camera that sees depths between two ``ends``, in scene units.

    The field of view is the camera's, and with it the size of a pixel on the film.
    """
    plain = lens.plain()
    told = {"focus_distance": float(plain.focus_distance), "lens": plain.to_dict()}
    if not isinstance(plain, ThinLens):
        scale = 2 * plain.slope * camera.pixels_per_unit
    else:
        scale = 2 * radius_per_vergence(plain, camera)
        pitch = float(plain.film_distance) / camera.focal_length_pixels
        unit = float(plain.millimeters_per_unit)
        told |= {
            "focus_distance_m": float(plain.focus_distance) * unit / 1000,
            "millimeters_per_unit": unit,
            "f_number": float(plain.f_number),
            "focal_length_mm": float(plain.focal_length),
            "aperture_diameter_mm": float(plain.lens_diameter),
            "aperture_radius": float(plain.aperture_radius),
            "pixel_pitch_mm": pitch,
            "sensor_size_mm": [pitch * size for size in camera.film_size],
        }
    told["circle_of_confusion"] = {
        "formula": CIRCLES[type(plain).__name__],
        "scale": scale,
        "largest_pixels": max(abs(float(circle_diameter(plain, camera, end))) for end in ends),
    }
    return told


def samples_told(samples: PointSamples) -> dict[str, Any]:
    """How many samples a stack is formed of, and how they were made."""
    return {
        "count": len(samples),
        "spp": samples.spp,
        "provenance": dict(samples.provenance),
    }


def ends_of_depth(samples: PointSamples) -> tuple[float, float]:
    """The nearest and the farthest depth that the pinhole sees in the picture, in scene units.

    The farthest is ``inf`` where it sees something of which there is none; of an orthographic
    camera what hit nothing does not count.
    """
    ends = DepthRange.of(samples).ends(samples.camera)
    return min(ends, default=math.inf), max(ends, default=math.inf)
