"""Overscan: how far beyond the crop window lies what a lens sees of it, and what covers its view.

Rays go from points of the lens through pixels of the crop window, as the picture's do. What one
meets first counts, wherever it is and however near, and there the pinhole has to look. On the ray
of the lens point u through pixel q, focused at U, a point at depth z is in the pinhole's pixel
q + f u (1/z - 1/U), and with parallel rays of slope u in q + u (z - U) pixels_per_unit.
"""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import from_numpy
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens, as_thin_lens
from ..samples.raster import Window
from .rays import PrimaryRays

MOST_OVERSCAN = 16
"""Most pixels of a window with overscan, per pixel of the crop window. Far from the crop window
there is a sample for many pixels only, see :func:`potmesil_mi.tracing.patterns.sampler_cells`."""

MOST_OVERSCAN_OF_GRIDS = 4
"""The same where every pixel of the window is sampled."""

SMALL_WINDOW = 1 << 16
"""Pixels that a window with overscan may have however small the crop window is."""

DEPTHS = 128
"""Rays on a side of the crop window that look for the depths on which the lens may be focused."""

RIM = 24
"""Points on the rim of the lens, from which one sees farthest."""

WITHIN = 24
"""Points within the rim."""

BORDER = 64
"""Pixels on each side of the border of the crop window, beyond which one sees farthest."""

ACROSS = 20
"""Pixels on a side of a grid within the border."""

LEAST_BEYOND = 0.25
"""Pixels from the crop window from which on what lies beyond it makes a difference."""

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
"""Angle between points on a spiral that leaves no pattern."""


def overscan(rays: PrimaryRays, lens: ThinLens | TelecentricLens, most: int) -> Window:
    """The window beyond which nothing is seen by ``lens`` that is in the crop window's picture.

    Every focus between the depths in the crop window is counted, and the lens's own. The window has
    at most ``most`` times the pixels of the crop window, or ``SMALL_WINDOW``; where more would be
    needed, a ``UserWarning`` says how much of what the lens sees is missing.
    """
    crop, lens = rays.crop, lens.plain()
    if (lens.slope if isinstance(lens, TelecentricLens) else lens.aperture_radius) == 0:
        return crop
    pinhole = _FocusedRays(_grid(crop, DEPTHS), np.zeros((2, 1)), [_Focus(0.0, 0.0, 0.0)])
    depths = np.stack(_met(rays, pinhole))
    points = _lens_points() / np.array([[lens.squeeze], [1.0]])
    lens_rays = _FocusedRays(_pixels(crop), points, _foci(lens, depths))
    every = [
        _landed(lens_rays, of, depths, lens, rays.sensor.camera()) for of in _met(rays, lens_rays)
    ]
    x, y = np.concatenate(every, axis=1)
    window, missing = covering(crop, x, y, max(most * crop.size, SMALL_WINDOW))
    if missing > 0:
        needed, _ = covering(crop, x, y, None)
        margin = max(
            crop.left - needed.left,
            crop.top - needed.top,
            needed.right - crop.right,
            needed.bottom - crop.bottom,
        )
        warnings.warn(
            f"overscan: {missing:.2g} of what the lens sees, at its focus or at another depth of "
            f"the scene, is beyond the window of {window.width}x{window.height} pixels that is "
            f"sampled, and missing in pictures; overscan={margin} samples all of it",
            UserWarning,
            stacklevel=4,
        )
    return window


def covering(crop: Window, x: np.ndarray, y: np.ndarray, most: int | None) -> tuple[Window, float]:
    """The least window around ``crop`` of the positions (x, y), (N,), in pixels of the film.

    It has at most ``most`` pixels, and then leaves out as few of the positions as may be; their
    share is returned, too.
    """
    beyond = [crop.left - x, x - crop.right, crop.top - y, y - crop.bottom]
    farthest = [np.sort(side[side > LEAST_BEYOND])[::-1] for side in beyond]
    # An edge may be a little beyond the outermost position.
    apart = max(crop.width, crop.height) / (4 * BORDER)

    def leaving_out(count: int) -> Window:
        """The window but for the ``count`` positions that are farthest on each side."""
        left, right, above, below = (
            math.ceil(side[count] + apart) if count < len(side) else 0 for side in farthest
        )
        return Window(
            crop.left - left,
            crop.top - above,
            crop.width + left + right,
            crop.height + above + below,
        )

    least, enough = 0, max(map(len, farthest))
    if most is None or leaving_out(least).size <= most:
        return leaving_out(least), 0.0
    while enough - least > 1:
        middle = (least + enough) // 2
        least, enough = (least, middle) if leaving_out(middle).size <= most else (middle, enough)
    window = leaving_out(enough)
    return window, float(np.mean(~window.contains(x, y)))


# ---------------------------------------------------------------- rays of the lens


class _Focus(NamedTuple):
    """A focus of a lens. At depth z a ray is ``(start + slope z) radius u`` beside the pinhole's.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``radius``                    of the lens in scene units; of a telecentric one the slope of
                                  its outermost rays
    ``start``, ``slope``          1 and -1/U; of a telecentric lens -U and 1
    ============================  ==========================================================
    """

    radius: float
    start: float
    slope: float


class _FocusedRays(NamedTuple):
    """F x N x M rays: at each focus through each pixel from each point of the lens.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``pixels``                    float64 (2, N), x and y in pixels of the film
    ``points``                    float64 (2, M), to the right and downwards, in radii
    ``foci``                      F of them
    ============================  ==========================================================
    """

    pixels: np.ndarray
    points: np.ndarray
    foci: list[_Focus]


def _foci(lens: ThinLens | TelecentricLens, depths: np.ndarray) -> list[_Focus]:
    """The focus of ``lens``, and those at the nearest and the farthest of ``depths``, (N,)."""
    ends = np.array([depths.min(), depths.max()], dtype=np.float64)
    if isinstance(lens, TelecentricLens):
        distances = {float(lens.focus_distance), *ends[np.isfinite(ends)].tolist()}
        return [_Focus(lens.slope, -distance, 1.0) for distance in sorted(distances)]
    # It can be focused from twice its focal length on.
    ends = np.maximum(ends, 2 * lens.focal_length / lens.millimeters_per_unit)
    foci = []
    for distance in sorted({float(lens.focus_distance), *ends.tolist()}):
        radius = lens.replace(focus_distance=distance).plain().aperture_radius
        foci.append(_Focus(float(radius), 1.0, -1 / distance))
    return foci


def _met(rays: PrimaryRays, lens_rays: _FocusedRays) -> list[np.ndarray]:
    """The depths of what rays of the lens show, float64 (F, N, M); ``inf`` for nothing.

    Where there are veils, also the depths of what the rays meet first.
    """
    camera, to_world = rays.sensor.camera(), rays.sensor.world_transform()
    left, up, axis = rays.axes()
    pixels, points, foci = lens_rays.pixels, lens_rays.points, np.array(lens_rays.foci).T
    shape = foci.shape[1], pixels.shape[1], points.shape[1]
    lane = dr.arange(mi.UInt32, math.prod(shape))
    rest = lane // dr.opaque(mi.UInt32, shape[2])
    focus = rest // dr.opaque(mi.UInt32, shape[1])
    (x, y), (right, down), (radius, start, slope) = (
        [dr.gather(mi.Float, _on_device(column), index) for column in table]
        for table, index in (
            (pixels, rest - focus * dr.opaque(mi.UInt32, shape[1])),
            (points, lane - rest * dr.opaque(mi.UInt32, shape[2])),
            (foci, focus),
        )
    )
    ray, _ = rays.through(mi.Point2f(x, y), mi.Float(0.5), rays.sensor.shutter_open())
    point = -radius * (right * left + down * up)
    per_depth = ray.d / dr.dot(ray.d, axis)
    at_lens = ray.o - per_depth * dr.dot(ray.o - to_world @ mi.Point3f(0), axis)
    per_depth += slope * point
    length = dr.norm(per_depth)
    near = dr.opaque(mi.Float, camera.near_clip)
    lens_ray = mi.Ray3f(ray)
    lens_ray.o = at_lens + start * point + near * per_depth
    lens_ray.d = per_depth / length
    lens_ray.maxt = dr.opaque(mi.Float, camera.far_clip - camera.near_clip) * length
    visible = rays.visible(lens_ray, coherent=False)
    # Images before glass are all over the place: they count as if they were in it.
    first = rays.depth(visible.first)
    image = dr.select(visible.through_window, dr.maximum(visible.depth, first), visible.depth)
    depths = [image, *([first] if any(rays.veils) else [])]
    dr.eval(depths)
    return [np.array(depth).astype(np.float64).reshape(shape) for depth in depths]


def _on_device(column: np.ndarray) -> mi.Float:
    """The numbers, (N,), and one more: Dr.Jit makes another kernel for a single one."""
    return from_numpy(mi.Float, np.append(column, column[-1]))


def _landed(
    lens_rays: _FocusedRays,
    met: np.ndarray,
    depths: np.ndarray,
    lens: ThinLens | TelecentricLens,
    camera: Camera,
) -> np.ndarray:
    """Where the pinhole sees what rays of the lens meet at depth ``met``, (2, F N M), in pixels.

    ``depths`` are those in the crop window.
    """
    radius, start, slope = np.array(lens_rays.foci).T[..., None, None]
    if isinstance(lens, TelecentricLens):
        # What is infinitely far counts as a little beyond the rest.
        every = np.concatenate([met.ravel(), depths.ravel()])
        met = np.where(np.isfinite(met), met, as_thin_lens(every, lens, camera).reference)
        beside = (start + slope * met) * camera.pixels_per_unit
    else:
        beside = (start / met + slope) * camera.focal_length_pixels
    at = lens_rays.pixels[:, None, :, None] + radius * beside * lens_rays.points[:, None, None]
    return at.reshape(2, -1)


# ---------------------------------------------------------------- where they are sought


def _lens_points() -> np.ndarray:
    """Points on the rim of a round lens and within it, (2, N), in radii."""
    rim, within = (2 * np.pi / RIM) * np.arange(RIM), np.arange(WITHIN)
    angle = np.concatenate([rim, GOLDEN_ANGLE * within])
    radius = np.concatenate([np.ones(RIM), np.sqrt((within + 0.5) / WITHIN)])
    return radius * np.stack([np.cos(angle), np.sin(angle)])


def _pixels(crop: Window) -> np.ndarray:
    """Positions on the border of the crop window and within it, (2, N), in pixels of the film."""
    along = np.linspace(0, 1, BORDER)
    sides = [np.stack(side) for end in (0, 1) for side in ((along, 0 * along + end),)]
    border = np.concatenate([*sides, *(side[::-1] for side in sides)], axis=1)
    corner, size = np.array([[crop.left], [crop.top]]), np.array([[crop.width], [crop.height]])
    return np.concatenate([corner + border * size, _grid(crop, ACROSS)], axis=1)


def _grid(crop: Window, count: int) -> np.ndarray:
    """The middles of ``count`` x ``count`` parts of the crop window, (2, N), pixels of the film."""
    middles = (np.arange(count) + 0.5) / count
    x, y = np.meshgrid(crop.left + middles * crop.width, crop.top + middles * crop.height)
    return np.stack([x.ravel(), y.ravel()])
