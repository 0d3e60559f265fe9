"""Maps of what the pinhole sees: depth, circle of confusion and surface of each pixel.

Other programs take them beside the picture: Nuke's and Fusion's depth of field, mattes. One number
for a pixel is that of the sample nearest to its middle, without antialiasing.
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np

from ..optics.blur import Blur
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens
from .point_samples import PointSamples

MapName = Literal["depth", "coc", "id"]
"""Maps that are written into the channels ``Z``, ``coc`` and ``id`` of an EXR."""

MAPS: tuple[MapName, ...] = get_args(MapName)

CHANNELS: dict[MapName, str] = {"depth": "Z", "coc": "coc", "id": "id"}
"""Names of their channels."""


def depth_map(samples: PointSamples) -> np.ndarray:
    """The depth of each pixel of the crop window, float32 (H, W), in scene units along the axis.

    ``inf`` where nothing was hit or there is no sample.
    """
    return _of_middles(samples, samples.z, math.inf)


def surface_map(samples: PointSamples) -> np.ndarray:
    """The id of the surface in each pixel of the crop window, uint32 (H, W); 0 for none."""
    return _of_middles(samples, samples.surface, 0)


def circle_map(samples: PointSamples, lens: ThinLens | TelecentricLens | None = None) -> np.ndarray:
    """The diameter of the circle of confusion of each pixel in pixels, float32 (H, W).

    It is positive of what is nearer than the focused plane, and negative of what is beyond.
    ``lens`` is by default the samples' own.
    """
    return circles_of(depth_map(samples), lens or samples.lens, samples.camera)


def circles_of(depth: np.ndarray, lens: ThinLens | TelecentricLens, camera: Camera) -> np.ndarray:
    """The diameters of the circles of confusion at depths, as :func:`circle_map` has them."""
    depth, lens = depth.astype(np.float64), lens.plain()
    if isinstance(lens, TelecentricLens):
        per_unit = float(lens.slope) * camera.pixels_per_unit
        return (2 * per_unit * (lens.focus_distance - depth)).astype(np.float32)
    return (2 * Blur.of(lens, camera).radius(1 / depth)).astype(np.float32)


def normal_map(samples: PointSamples) -> np.ndarray:
    """The shading normal in the world of each pixel of the crop window, float32 (H, W, 3).

    0 where nothing was hit or there is no sample. Raises ``ValueError`` for samples without
    normals.
    """
    if samples.normal is None:
        raise ValueError(
            "normal: None, the samples have no normals, which Sampling(features=True) keeps"
        )
    return _of_middles(samples, samples.normal, 0)


def maps_of(
    samples: PointSamples,
    names: list[MapName] | tuple[MapName, ...],
    lens: ThinLens | TelecentricLens | None = None,
) -> dict[str, np.ndarray]:
    """Several maps by the names of their channels.

    Raises ``ValueError`` for ids that single precision, in which maps are written, has not.
    """
    made = {
        "depth": lambda: depth_map(samples),
        "coc": lambda: circle_map(samples, lens),
        "id": lambda: _in_single_precision(surface_map(samples)),
    }
    return {CHANNELS[name]: made[name]() for name in names}


def _in_single_precision(ids: np.ndarray) -> np.ndarray:
    """The ids, if single precision, in which they are written, has them all."""
    if ids.max(initial=0) > 1 << np.finfo(np.float32).nmant + 1:
        raise ValueError(f"id: up to {ids.max()}: a map has whole numbers up to 2^24")
    return ids


def _of_middles(samples: PointSamples, column: np.ndarray, otherwise: float) -> np.ndarray:
    """Of each pixel of the crop window what the visible sample nearest to its middle has."""
    crop = samples.crop_window
    inside = (samples.layer == 0) & crop.contains(samples.x, samples.y)
    x, y = samples.x[inside], samples.y[inside]
    pixel = crop.pixel_of(x, y)
    apart = np.hypot(x % 1 - 0.5, y % 1 - 0.5)
    # The last that is written stays: the nearest to the middle and, of several there, the largest.
    order = np.lexsort((samples.weight[inside], -apart))
    found = np.full((crop.size, *column.shape[1:]), otherwise, column.dtype)
    found[pixel[order]] = column[inside][order]
    return found.reshape(*crop.shape, *column.shape[1:])
