"""What the sliders of a viewer reach: distances to focus on, and apertures."""

from __future__ import annotations

import math
from collections.abc import Iterable

from .._units import said_length
from ..optics.lens import ThinLens
from ..optics.telecentric import WIDEST_HALF_ANGLE
from ..samples.depth_range import DepthRange
from ..samples.point_samples import PointSamples
from ..samples.provenance import widest_of
from ..stacks.foci import Lens, closest_focus, equal_circles

STEPS = 240
"""Steps of the focus: each changes the circles of confusion by as much."""

OPENINGS_A_STOP = 3
STOPS = 8
"""Apertures in a stop, and stops from the widest to the narrowest."""

WIDER = 2.0
"""By how much the aperture may be wider than the lens's, where samples do not say what they serve:
two stops."""


def opening_of(lens: Lens) -> str:
    """The parameter that says how wide a lens is open, of those of which it has one."""
    if not isinstance(lens, ThinLens):
        return "half_angle"
    return "f_number" if "f_number" in lens.parameters() else "aperture_radius"


def foci(samples: PointSamples, lens: Lens) -> list[float]:
    """Distances from the nearest to the farthest that is in sight, at equal steps of the circle.

    The sky is at infinity, and the lens's own distance is within reach.
    """
    ends = DepthRange.of(samples).ends(samples.camera)
    own = float(lens.focus_distance)
    if not isinstance(lens, ThinLens):
        near, far = min([own, *ends]), max([own, *ends])
        if not near < far:
            near, far = near - 1, far + 1
        return equal_circles(lens, near, far, STEPS + 1)
    least = closest_focus(lens)
    nearest = min(filter(math.isfinite, ends), default=least)
    near, far = min(own, max(least, nearest)), max([own, *ends])
    if not near < far:
        near, far = near - 0.5 * max(near - least, 0.0), 2 * near
    return equal_circles(lens, near, far, STEPS + 1)


def openings(samples: PointSamples, lens: Lens) -> list[float]:
    """Apertures from the widest that ``samples`` serve, in thirds of a stop.

    They are numbers of the parameter :func:`opening_of`. Raises ``ValueError`` where there is
    nothing but a pinhole.
    """
    name = opening_of(lens)
    ratios = [2 ** (k / (2 * OPENINGS_A_STOP)) for k in range(STOPS * OPENINGS_A_STOP + 1)]
    width = {"f_number": "widest_diameter", "aperture_radius": "widest_radius"}.get(
        name, "widest_half_angle"
    )
    own = widest_of(lens)[width]
    served = samples.provenance.get(width)
    widest = max(own, float(served)) if isinstance(served, (int, float)) else WIDER * own
    if not widest > 0:
        raise ValueError(
            "lens: is a pinhole, and so is that for which the samples were taken; must be one of "
            "some aperture, such as samples.lens.replace(f_number=2.8)"
        )
    if isinstance(lens, ThinLens):
        if name == "f_number":
            least = lens.focal_length / (widest * lens.millimeters_per_unit)
            return _rounded(least * ratio for ratio in ratios)
        return _rounded(widest / ratio for ratio in ratios)
    slope = math.tan(math.radians(min(widest, WIDEST_HALF_ANGLE)))
    return _rounded(math.degrees(math.atan(slope / ratio)) for ratio in ratios)


def _rounded(values: Iterable[float]) -> list[float]:
    """Numbers that one can read where a lens is copied."""
    return [float(f"{value:.4g}") for value in values]


def opening_text(lens: Lens, opening: float) -> str:
    """How a page calls an aperture."""
    name = opening_of(lens)
    if name == "f_number":
        return f"f/{opening:.3g}"
    if isinstance(lens, ThinLens):
        return f"radius {said_length(opening, lens.millimeters_per_unit)}"
    return f"{opening:.3g}°"


def focus_text(lens: Lens, distance: float) -> str:
    """How a page calls a focused distance."""
    unit = lens.millimeters_per_unit if isinstance(lens, ThinLens) else None
    return said_length(distance, unit)
