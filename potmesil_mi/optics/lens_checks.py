"""Checks of the parameters of a thin lens, which numbers, NumPy and Dr.Jit arrays may be."""

from __future__ import annotations

from typing import Any

from .._validation import shown
from .arithmetic import on_host, positive_finite, require_each


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
