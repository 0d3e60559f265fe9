"""Circles of confusion in pixels: how large they become, what is sharp, and what is amiss."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from .._units import length_text
from ..optics.blur import Blur
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens, is_open
from .depth_range import DepthRange
from .point_samples import PointSamples

SHARP = 1.0
"""Largest diameter in pixels of the circle of confusion of what counts as sharp."""

EVERYTHING_SHARP = 0.5
"""Largest diameter in pixels of a picture in which nothing can be seen to be blurred."""

MOST_COLORED = 64.0
"""Diameter in pixels from which on all circles have the same colour."""

SHARP_COLOR = np.array([0.25, 0.25, 0.25])
NEARER = np.array([0.9, 0.3, 0.02])
BEYOND = np.array([0.02, 0.2, 0.9])
"""Linear colours of what is sharp, nearer than the focus, and beyond it."""

FOCUS, EVERYTHING = "focus", "sharp"
"""What :func:`advice` is about: where the lens is focused, and that nothing is blurred."""

SLACK = 1e-3
"""Part of a depth or a radius by which rounding may have changed it."""


def circle_diameter(lens: ThinLens | TelecentricLens, camera: Camera, depth: Any) -> Any:
    """The signed diameter in pixels of the circle of confusion of what is at a ``depth``.

    ``depth`` is a number or an array, in scene units along the axis. It is positive of what is
    nearer than the focused plane, and negative of what is beyond.
    """
    lens = lens.plain()
    if isinstance(lens, TelecentricLens):
        return lens.circle_of_confusion(depth) * camera.pixels_per_unit
    return 2 * Blur.of(lens, camera).radius(1 / depth)


def largest_circle(depths: DepthRange, lens: ThinLens | TelecentricLens, camera: Camera) -> float:
    """The largest diameter in pixels of the circles of confusion of what the pinhole sees."""
    ends = depths.ends(camera)
    return max((abs(float(circle_diameter(lens, camera, end))) for end in ends), default=0.0)


def sharp_range(
    lens: ThinLens | TelecentricLens, camera: Camera, diameter: float = SHARP
) -> tuple[float, float]:
    """The nearest and the farthest depth, in scene units, with circles of at most a ``diameter``.

    The diameter is in pixels; depths are 0 to ``inf``.
    """
    lens = lens.plain()
    focus = float(lens.focus_distance)
    if isinstance(lens, TelecentricLens):
        near, far = lens.depth_of_field(diameter / camera.pixels_per_unit)
        return max(near, 0.0), far
    blur = Blur.of(lens, camera)
    if blur.radius_per_vergence == 0:
        return 0.0, math.inf
    reach = diameter / (2 * blur.radius_per_vergence)
    near, far = 1 / focus + reach, 1 / focus - reach
    return 1 / near, 1 / far if far > 0 else math.inf


class SurfaceDepths(NamedTuple):
    """What is seen of a surface: depths along the axis in scene units.

    ``share`` is that of the picture's area, ``circle`` the diameter in pixels of the circle of
    confusion of its median depth, positive nearer than the focus.
    """

    name: str
    share: float
    nearest: float
    median: float
    farthest: float
    circle: float


def surface_depths(samples: PointSamples) -> list[SurfaceDepths]:
    """How deep the surfaces that the pinhole sees are, those of the largest area first."""
    crop = samples.crop_window
    seen = (samples.layer == 0) & crop.contains(samples.x, samples.y)
    seen &= np.isfinite(samples.z)
    ids, which = np.unique(samples.surface[seen], return_inverse=True)
    z, weight = samples.z[seen].astype(np.float64), samples.weight[seen]
    areas = np.bincount(which, weight, len(ids))
    order = np.lexsort((z, which))
    parts = np.split(z[order], np.searchsorted(which[order], np.arange(1, len(ids))))
    found = []
    for i in np.argsort(-areas, kind="stable"):
        depth, median = parts[i], float(np.median(parts[i]))
        circle = float(circle_diameter(samples.lens, samples.camera, median))
        name = samples.surfaces.get(int(ids[i]), f"id {ids[i]}")
        share = float(areas[i]) / crop.size
        ends = float(depth[0]), median, float(depth[-1])
        found.append(SurfaceDepths(name, share, *ends, circle))
    return found


def circle_colors(diameter: np.ndarray) -> np.ndarray:
    """A map of circles of confusion, in pixels, in linear colours, float32 (H, W, 3).

    Grey is sharp; orange is nearer than the focus and blue beyond it, the stronger the larger the
    circle is, by its logarithm, up to 64 pixels.
    """
    size = np.abs(np.nan_to_num(diameter, posinf=MOST_COLORED, neginf=-MOST_COLORED))
    strength = np.clip(np.log(np.maximum(size, SHARP) / SHARP) / math.log(MOST_COLORED), 0, 1)
    strength = np.where(size > SHARP, 0.15 + 0.85 * strength, 0.0)[..., None]
    color = np.where((diameter > 0)[..., None], NEARER, BEYOND)
    return (SHARP_COLOR + strength * (color - SHARP_COLOR)).astype(np.float32)


def advice(depths: DepthRange, lens: ThinLens | TelecentricLens, camera: Camera) -> dict[str, str]:
    """What is likely not meant by a ``lens`` before a scene of such ``depths``, and what helps.

    Sentences by what they are about: ``sharp``, if an open lens blurs nothing, and ``focus``, if
    nothing is where it is focused.
    """
    lens = lens.plain()
    found: dict[str, str] = {}
    near, far = depths.nearest, depths.farthest
    if near is None or far is None or not is_open(lens):
        return found
    per_unit = lens.millimeters_per_unit if isinstance(lens, ThinLens) else 1000.0
    focus = float(lens.focus_distance)
    within = f"{length_text(near, per_unit)} to {length_text(far, per_unit)}"
    beyond = focus > far * (1 + SLACK) and not (math.isinf(focus) and depths.has_sky)
    if focus < near * (1 - SLACK) or beyond:
        found[FOCUS] = (
            f"focus_distance={focus:g}: nothing is there; what is in sight is at {within}. "
            "--focus-at X,Y and --focus-on NAME, pm.focus_distance_at and pm.focus_distance_of "
            "tell how far away a thing is"
        )
    largest = largest_circle(depths, lens, camera)
    if largest < EVERYTHING_SHARP:
        unit = f", and a scene unit is taken for {per_unit:g} mm (--units, millimeters_per_unit)"
        found[EVERYTHING] = (
            f"everything is sharp: the largest circle of confusion is {largest:.2g} pixels. The "
            f"scene is at {within}{unit if isinstance(lens, ThinLens) else ''}; a wider aperture "
            "blurs more"
        )
    return found
