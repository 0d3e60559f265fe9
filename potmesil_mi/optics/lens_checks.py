"""Checks of the parameters of a thin lens, which numbers, NumPy and Dr.Jit arrays may be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .._units import f_number_of, length_of
from .._validation import shown
from .arithmetic import on_host, positive_finite, require_each, single

IN_MILLIMETERS = ("focal_length", "frame_width")
IN_SCENE_UNITS = ("focus_distance", "aperture_radius")
"""Parameters that are lengths, in what they are where no unit is said."""


def in_numbers(parameters: Mapping[str, Any], millimeters_per_unit: Any) -> dict[str, Any]:
    """The parameters of a lens, with texts such as ``1.2m`` and ``f/2.8`` as what they say.

    Raises ``ValueError`` that names the parameter whose text says nothing.
    """
    found = dict(parameters)
    for name in (*IN_MILLIMETERS, *IN_SCENE_UNITS):
        if isinstance(found.get(name), str):
            of_scene = name in IN_SCENE_UNITS
            unit = single("millimeters_per_unit", millimeters_per_unit) if of_scene else 1.0
            found[name] = length_of(name, found[name], unit)
    if isinstance(found.get("f_number"), str):
        try:
            found["f_number"] = f_number_of(found["f_number"])
        except ValueError as error:
            raise ValueError(f"f_number={error}") from None
    return found


def require_unit(millimeters_per_unit: Any) -> None:
    """Raise unless it can be the size of a scene unit."""
    require_each("millimeters_per_unit", millimeters_per_unit, "> 0 and finite", positive_finite)


def require_distance(focus_distance: Any) -> None:
    """Raise unless it can be a focus distance in scene units."""
    require_each("focus_distance", focus_distance, "> 0 scene units", lambda x: x > 0)


def distance_in_mm(focus_distance: Any, millimeters_per_unit: Any) -> Any:
    """A focus distance in millimetres. Raise ``ValueError`` or ``TypeError`` where it is none."""
    require_unit(millimeters_per_unit)
    require_distance(focus_distance)
    return focus_distance * millimeters_per_unit


def require_length(name: str, value: Any) -> None:
    """Raise unless it can be a length in millimetres."""
    require_each(name, value, "> 0 mm and finite", positive_finite)


def require_one_opening(f_number: Any, aperture_radius: Any) -> None:
    """Raise ``ValueError`` unless one of the two is given, and not both."""
    if (f_number is None) == (aperture_radius is None):
        raise ValueError(
            f"f_number={shown(f_number)}, aperture_radius={shown(aperture_radius)}: exactly one "
            "of them must be given"
        )


def require_focus(focus_distance: Any, focal_length: Any, millimeters_per_unit: Any) -> None:
    """Raise unless the focused plane is beyond the focal length."""
    require_distance(focus_distance)
    require_each(
        "focus_distance",
        focus_distance,
        f"beyond the focal length of {shown(focal_length)} mm (focal_length), a scene unit being "
        f"{shown(millimeters_per_unit)} mm (millimeters_per_unit)",
        lambda x: (
            x * on_host(millimeters_per_unit) - on_host(focal_length)
            > 1e-12 * on_host(focal_length)
        ),
    )
