"""What a notebook shows of a lens and of a camera."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from .._html import card
from .._units import said_length

if TYPE_CHECKING:
    from .aperture import Aperture

APERTURE_PIXELS = 64
"""Width and height of the picture of an aperture."""


def html_of_thin_lens(lens: Any) -> str:
    """A card of a :class:`potmesil_mi.ThinLens` of plain numbers, with its aperture's picture."""
    title = f"ThinLens: {opening_of(lens)}"
    return card(title, thin_lens_facts(lens), _picture_of(lens.plain().aperture))


def html_of_telecentric_lens(lens: Any) -> str:
    """A card of a :class:`potmesil_mi.TelecentricLens`, with its aperture's picture."""
    facts = {
        "focused at": f"{lens.focus_distance:.4g}",
        "circles": f"{2 * lens.slope:.4g} wider for each unit of depth",
        **_special(lens, lens.shape),
    }
    return card(f"TelecentricLens: {opening_of(lens)}", facts, _picture_of(lens.shape))


def html_of_camera(camera: Any) -> str:
    """A card of a :class:`potmesil_mi.Camera`."""
    width, height = camera.film_size
    to_world = np.array(camera.to_world)
    facts = {"film": f"{width}×{height} pixels"}
    if tuple(camera.crop_size) != tuple(camera.film_size):
        left, top = camera.crop_offset
        right, bottom = left + camera.crop_size[0], top + camera.crop_size[1]
        facts["crop window"] = f"{left} to {right} across, {top} to {bottom} down"
    facts["sees"] = view_of(camera)
    facts["stands at"] = _vector(to_world[:3, 3])
    facts["looks along"] = _vector(to_world[:3, 2])
    return card(f"Camera: {camera.projection}", facts)


def opening_of(lens: Any) -> str:
    """How wide a lens of either kind is, as one says it."""
    plain = lens.plain()
    if "half_angle" in plain.parameters():
        return f"{plain.half_angle:g}°"
    if plain.aperture_radius == 0:
        return "a pinhole"
    return f"{plain.focal_length:.4g} mm, f/{plain.f_number:.3g}"


def thin_lens_facts(lens: Any) -> dict[str, str]:
    """Facts of a thin lens, by their names."""
    plain = lens.plain()
    unit = plain.millimeters_per_unit
    near, far = plain.depth_of_field()
    facts = {"focused at": said_length(plain.focus_distance, unit)}
    if plain.aperture_radius > 0:
        facts["depth of field"] = f"{said_length(near, unit)} to {said_length(far, unit)}"
        facts["hyperfocal"] = said_length(plain.hyperfocal_distance(), unit)
        facts["diameter"] = f"{plain.lens_diameter:.4g} mm"
    facts["frame"] = f"{plain.frame_width:.4g} mm wide, {plain.fov:.4g}° across"
    return {**facts, **_special(plain, plain.aperture)}


def view_of(camera: Any) -> str:
    """How much a camera sees across."""
    if camera.projection == "orthographic":
        return f"{camera.film_width:.4g} across, in parallel"
    return f"{camera.x_fov:.4g}° across"


def _special(lens: Any, aperture: Aperture) -> dict[str, str]:
    """What is not so of every lens."""
    facts = {"aperture": _shortened(aperture.describe())}
    if lens.squeeze != 1:
        facts["squeeze"] = f"{lens.squeeze:g}"
    if getattr(lens, "vignetting", 0) != 0:
        facts["vignetting"] = f"{lens.vignetting:g}"
    return facts


def _shortened(text: str, most: int = 60) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _picture_of(aperture: Aperture) -> np.ndarray:
    """What an aperture lets through, as it is seen from behind the camera."""
    through = aperture.transmission(APERTURE_PIXELS)
    return np.repeat(through[..., None], 3, axis=2)


def _vector(numbers: np.ndarray) -> str:
    return ", ".join(f"{0.0 if math.isclose(n, 0, abs_tol=5e-4) else n:.3g}" for n in numbers)
