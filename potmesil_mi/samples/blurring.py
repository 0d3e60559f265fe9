"""How a lens blurs samples: numbers by their names, and in words."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

from .._units import said_length
from ..optics.lens import ThinLens
from .circles import largest_circle, sharp_range
from .depth_range import DepthRange
from .point_samples import PointSamples


def about_picture(samples: PointSamples, lens: Any) -> dict[str, Any]:
    """How a lens blurs samples, by names: ``focus_distance`` and other lengths in scene units."""
    plain = lens.plain()
    near, far = sharp_range(plain, samples.camera)
    found: dict[str, Any] = {"focus_distance": float(plain.focus_distance)}
    if isinstance(plain, ThinLens):
        found["f_number"] = float(plain.f_number)
        found["aperture_radius"] = float(plain.aperture_radius)
        found["millimeters_per_unit"] = float(plain.millimeters_per_unit)
    else:
        found["half_angle"] = float(plain.half_angle)
    found["largest_circle_pixels"] = largest_circle(DepthRange.of(samples), plain, samples.camera)
    found["sharp_from"], found["sharp_to"] = near, far
    return found


def sentence(about: Mapping[str, Any]) -> str:
    """What :func:`about_picture` tells, in words."""
    length = functools.partial(said_length, unit=about.get("millimeters_per_unit"))
    aperture = (
        f"f/{about['f_number']:.3g}" if "f_number" in about else f"{about['half_angle']:g} degrees"
    )
    circle = about["largest_circle_pixels"]
    return (
        f"{aperture} focused at {length(about['focus_distance'])}, sharp from "
        f"{length(about['sharp_from'])} to {length(about['sharp_to'])}, circles up to "
        f"{circle:.{1 if circle < 10 else 0}f} pixels"
    )
