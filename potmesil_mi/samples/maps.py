"""Maps of what the pinhole sees: depth, circle of confusion, surface and the like of each pixel.

Other programs take them beside the picture: Nuke's and Fusion's depth of field, mattes. One number
for a pixel is that of the sample nearest to its middle, without antialiasing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np

from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens, require_fitting
from .choosing import require_samples
from .circles import circle_diameter, in_units_of
from .point_samples import PointSamples

MapName = Literal["depth", "coc", "id", "albedo", "normal", "aovs"]
"""Maps that are written into further channels of an EXR; see :func:`maps_of`."""

MAPS: tuple[MapName, ...] = get_args(MapName)

UNFOCUSED = "unfocused.{}"
"""Names of channels of AOVs that no lens has blurred, as the colours beside them are."""


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

    It is positive of what is nearer than the focused plane, and negative of what is beyond;
    ``-inf`` of what a telecentric lens sees at infinity. ``lens`` is by default the samples' own.
    Raises ``TypeError`` for other than samples and a lens, ``ValueError`` for a lens of another
    camera.
    """
    require_samples(samples)
    lens = samples.lens if lens is None else lens
    require_fitting(samples.camera, lens)
    return circles_of(depth_map(samples), in_units_of(samples, lens), samples.camera)


def circles_of(depth: np.ndarray, lens: ThinLens | TelecentricLens, camera: Camera) -> np.ndarray:
    """The diameters of the circles of confusion at depths, as :func:`circle_map` has them."""
    found: np.ndarray = circle_diameter(lens, camera, depth.astype(np.float64))
    return found.astype(np.float32)


def normal_map(samples: PointSamples) -> np.ndarray:
    """The shading normal in the world of each pixel of the crop window, float32 (H, W, 3).

    0 where nothing was hit or there is no sample. Raises ``ValueError`` for samples without
    normals.
    """
    return np.stack([*maps_of(samples, ("normal",)).values()], axis=-1)


def maps_of(
    samples: PointSamples,
    names: list[MapName] | tuple[MapName, ...],
    lens: ThinLens | TelecentricLens | None = None,
) -> dict[str, np.ndarray]:
    """Several maps by the names of their channels.

    They are ``Z``, ``coc``, ``id``, ``albedo.R`` and so on, ``N.X`` and so on, and of AOVs
    ``UNFOCUSED`` ones. Raises ``ValueError`` for ids that single precision, in which maps are
    written, has not, and for what the samples do not have.
    """
    made: dict[MapName, Callable[[], dict[str, np.ndarray]]] = {
        "depth": lambda: {"Z": depth_map(samples)},
        "coc": lambda: {"coc": circle_map(samples, lens)},
        "id": lambda: {"id": _in_single_precision(surface_map(samples))},
        "albedo": lambda: _planes(samples, "albedo", [f"albedo.{last}" for last in "RGB"]),
        "normal": lambda: _planes(samples, "normal", [f"N.{last}" for last in "XYZ"]),
        "aovs": lambda: _planes(samples, "aovs", list(map(UNFOCUSED.format, samples.aov_names))),
    }
    return {channel: plane for name in names for channel, plane in made[name]().items()}


def aov_maps(samples: PointSamples) -> dict[str, np.ndarray]:
    """The AOVs of each pixel of the crop window, by their names, float32 (H, W) each.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``samples``                   point samples, of which those have AOVs that come from an
                                  integrator with some, such as Mitsuba's ``aov``
    ============================  ==========================================================

    They are those of the visible sample nearest to the middle of the pixel, so that ids and depths
    are not mixed, and 0 where there is none; no lens blurs them. See
    :func:`potmesil_mi.focus_aovs` for what does. Without AOVs there are no maps. Raises
    ``TypeError`` for other than samples.
    """
    require_samples(samples)
    return _planes(samples, "aovs", samples.aov_names) if samples.aov_names else {}


def _planes(
    samples: PointSamples, column: MapName, channels: Sequence[str]
) -> dict[str, np.ndarray]:
    """The maps of a column of several numbers, by the names of their ``channels``."""
    values: np.ndarray | None = getattr(samples, column)
    if values is None:
        source = "an integrator aov" if column == "aovs" else "Sampling(features=True)"
        raise ValueError(f"{column}: the samples have none, which {source} would give them")
    planes = _of_middles(samples, values, 0)
    return {name: planes[..., i] for i, name in enumerate(channels)}


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
