"""A lens as texts that one copies: a line of Python, and a sensor of a scene."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np

from ..focusing.methods import Method
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..stacks.foci import Lens

VERSION = "3.0.0"
"""That of the language of scenes."""

CLIPPING = ("near_clip", "far_clip")

DEFAULTS = {"film": "focal", "aperture": "disc", "squeeze": 1.0, "vignetting": 0.0}
"""What is left out of the texts where it is so."""


def as_python(lens: Lens, method: Method) -> str:
    """Lines of Python that form the picture of ``samples`` by a method."""
    values = {name: value for name, value in _numbers(lens).items() if name != "type"}
    texts = (f"{name}={_literal(value)}" for name, value in values.items())
    kind = type(lens).__name__
    return (
        f"lens = pm.{kind}({', '.join(texts)})\n"
        f"image = pm.focus(samples, lens, method={str(method)!r})"
    )


def as_xml(lens: Lens, camera: Camera) -> str:
    """The sensor of a scene in Mitsuba's XML, with the place and the film of a camera.

    ``mi.load_string`` loads it as it is, and it may stand in a scene.
    """
    plugin, matrix = "potmesil", np.array(camera.to_world)
    if isinstance(lens, ThinLens):
        # The field of view is the camera's.
        slope = 2 * math.tan(math.radians(camera.x_fov) / 2)
        lens = lens.replace(frame_width=slope * lens.plain().film_distance)
    else:
        plugin = "potmesil_orthographic"
        half = float(camera.film_width or math.nan) / 2
        matrix = matrix @ np.diag([half, half, 1, 1])
    values = {name: value for name, value in _numbers(lens).items() if name != "type"}
    if "film" in values:  # As `sensor_parameters` calls it, which needs Mitsuba.
        values["image_distance"] = values.pop("film")
    values |= {name: getattr(camera, name) for name in CLIPPING}
    for axis, offset in zip("xy", camera.principal_point_offset, strict=True):
        if offset:
            values[f"principal_point_offset_{axis}"] = offset
    sensor = ET.Element("sensor", version=VERSION, type=plugin)
    for name, value in values.items():
        _put(sensor, "string" if isinstance(value, str) else "float", name, value)
    transform = ET.SubElement(sensor, "transform", name="to_world")
    ET.SubElement(transform, "matrix", value=" ".join(f"{one:.9g}" for one in matrix.ravel()))
    film = ET.SubElement(sensor, "film", type="hdrfilm")
    places = {"width": camera.film_size[0], "height": camera.film_size[1]}
    if camera.crop_size != camera.film_size:
        places |= zip(("crop_offset_x", "crop_offset_y"), camera.crop_offset, strict=True)
        places |= zip(("crop_width", "crop_height"), camera.crop_size, strict=True)
    for name, pixels in places.items():
        _put(film, "integer", name, pixels)
    ET.indent(sensor, "    ")
    return ET.tostring(sensor, encoding="unicode") + "\n"


def _numbers(lens: Lens) -> dict[str, Any]:
    """The parameters of a lens as numbers and text, without what goes without saying."""
    values = lens.plain().to_dict()
    return {name: value for name, value in values.items() if DEFAULTS.get(name) != value}


def _literal(value: Any) -> str:
    """A number or text as Python has it."""
    infinite = isinstance(value, float) and math.isinf(value)
    return f'float("{value}")' if infinite else repr(value)


def _put(parent: ET.Element, kind: str, name: str, value: Any) -> None:
    ET.SubElement(parent, kind, name=name, value=str(value))
