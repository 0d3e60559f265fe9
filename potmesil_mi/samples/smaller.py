"""Samples of a smaller film: for pictures that are formed quickly, while one looks for a lens."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from .._validation import require_whole
from ..optics.camera import Camera
from .point_samples import PointSamples
from .raster import Window

PER_PIXEL = 16
"""Samples of each pixel of the smaller film, about, of the visible ones. Where there are more,
chance chooses."""

MOST_TIMES = 64
"""By how many times a film becomes smaller at most."""


def smaller(samples: PointSamples, times: int) -> PointSamples:
    """Samples as a film of so many ``times`` fewer pixels on a side has them, 1 to 64.

    A lens forms the same picture of them, with larger pixels and more noise. Their crop window is
    that of ``samples`` in these pixels, grown to whole ones. AOVs are left out.
    """
    require_whole("times", times, 1, MOST_TIMES)
    share = min(1.0, PER_PIXEL / max(samples.spp * times**2, 1))
    chosen = samples.replace(aovs=None, aov_names=())
    if share < 1:
        chance = np.random.default_rng(0).random(len(samples), dtype=np.float32)
        chosen = chosen.chosen(np.flatnonzero(chance < share))
    motion = chosen.motion
    if motion is not None:
        motion = motion / np.array([times, times, 1], np.float32)
    return chosen.replace(
        x=chosen.x / np.float32(times),
        y=chosen.y / np.float32(times),
        weight=chosen.weight / np.float32(times**2 * share),
        motion=motion,
        camera=_smaller_camera(samples.camera, times),
        window=_smaller_window(samples.window, times),
        lattice=0,
    )


def _smaller_camera(camera: Camera, times: int) -> Camera:
    """The same camera with larger pixels; its film and its crop window end with whole ones."""
    width, height = (-(-side // times) for side in camera.film_size)
    crop = _smaller_window(Window(*camera.crop_offset, *camera.crop_size), times)
    changes: dict[str, Any] = {
        "film_size": (width, height),
        "crop_offset": (crop.left, crop.top),
        "crop_size": (crop.width, crop.height),
    }
    if camera.projection == "orthographic":
        per_unit = camera.pixels_per_unit / times
        return dataclasses.replace(camera, **changes, film_width=width / per_unit)
    slope = width * times / (2 * camera.focal_length_pixels)
    x, y = camera.principal_point
    return dataclasses.replace(
        camera,
        **changes,
        x_fov=2 * math.degrees(math.atan(slope)),
        principal_point_offset=(0.5 - x / (times * width), 0.5 - y / (times * height)),
    )


def _smaller_window(window: Window, times: int) -> Window:
    left, top = window.left // times, window.top // times
    right = -(-(window.left + window.width) // times)
    bottom = -(-(window.top + window.height) // times)
    return Window(left, top, right - left, bottom - top)
