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

FOCUS, EVERYTHING, BLURRED, WIDE = "focus", "sharp", "blurred", "bright"
"""What :func:`advice` is about: where the lens is focused, that nothing is blurred, or too much,
and an aperture that no lens has."""

WIDEST_F_NUMBER = 0.5
"""That of a lens in air which takes in light from all of the half-space before the film."""

LARGE = 1 / 8
"""Share of the picture's width from which on circles are too large to be meant. An aperture that no
lens has may be, with smaller ones: it blurs a large scene a little."""

SHORTEST = 2.0
"""Focal length in millimetres under which few lenses are; whoever gives metres is under it."""

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


def in_units_of(samples: PointSamples, lens: ThinLens | TelecentricLens) -> Any:
    """The lens with its lengths in the units of ``samples``; a telecentric one has no other."""
    own = samples.lens
    if isinstance(lens, ThinLens) and isinstance(own, ThinLens):
        return lens.in_units(own.millimeters_per_unit)
    return lens


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

    Sentences by what they are about: ``sharp``, if an open lens blurs nothing, ``blurred``, if a
    circle of confusion is wider than the picture, ``focus``, if nothing is where it is focused, and
    ``bright``, if its f-number is one that no lens has.
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
    largest, unit = largest_circle(depths, lens, camera), ""
    if isinstance(lens, ThinLens):
        said_by = "--units, units of a recipe, millimeters_per_unit"
        unit = f", and a scene unit is taken for {per_unit:g} mm ({said_by})"
        if lens.focal_length < SHORTEST:
            unit += (
                f", the focal length for {lens.focal_length:g} mm (--focal-length, focal_length)"
            )
        wide = "f_number" in lens.parameters() and lens.f_number < WIDEST_F_NUMBER
        if wide and largest > LARGE * max(camera.film_size):
            found[WIDE] = (
                f"f_number={lens.f_number:g}: is wider than f/{WIDEST_F_NUMBER:g}, than which no "
                f"lens in air is wider; circles of confusion are up to {largest:.0f} pixels"
            )
    if largest < EVERYTHING_SHARP:
        found[EVERYTHING] = (
            f"everything is sharp: the largest circle of confusion is {largest:.2g} pixels. The "
            f"scene is at {within}{unit}; a wider aperture blurs more"
        )
    elif largest > max(camera.film_size):
        found[BLURRED] = (
            f"the largest circle of confusion, {largest:.0f} pixels, is wider than the picture. "
            f"The scene is at {within}{unit}"
        )
    return found
