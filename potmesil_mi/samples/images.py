"""Pictures with depth, of any program, as columns of samples."""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np

from .._validation import require_choice, require_flag, require_number
from ..optics.camera import Camera
from ..optics.depth import (
    CLIPS,
    Clip,
    camera_of,
    depth_from_ndc,
    depth_from_ray_length,
    depth_from_vergence,
    require_planes,
)

DepthKind = Literal["z", "distance", "inverse", "ndc"]
"""What the numbers of a depth mean."""

MOST_IDS = (1 << 32) - 1
"""The largest id of a surface."""

DEPTH_KINDS: tuple[DepthKind, ...] = get_args(DepthKind)


def columns_of_image(
    rgb: Any,
    depth: Any,
    camera: Camera | float,
    depth_kind: DepthKind,
    near: float | None,
    far: float,
    clip: Clip,
    reverse: bool,
    background: float | None,
    surface: Any,
) -> tuple[Camera, dict[str, Any]]:
    """The camera of a picture and the columns of its samples, in the order of its rows.

    The parameters, and what is raised, are those of :meth:`PointSamples.from_image`.
    """
    rgb, depth = np.asarray(rgb, np.float32), np.asarray(depth, np.float64)
    if rgb.ndim != 3 or rgb.shape[2] not in (3, 4) or rgb.size == 0:
        raise ValueError(f"rgb: its shape is {rgb.shape}, must be (height, width, 3 or 4)")
    size = rgb.shape[:2]
    if depth.shape != size:
        raise ValueError(f"depth: its shape is {depth.shape}, must be {size}, as that of rgb")
    camera = _camera(camera, size)
    require_choice("depth_kind", depth_kind, DEPTH_KINDS)
    if background is not None:
        require_number("background", background)
        if background <= 0:
            raise ValueError(f"background={background}: must be > 0 scene units")
    _require_planes_of(depth_kind, near, far, clip, reverse)
    x, y = np.meshgrid(*(np.arange(n) + 0.5 for n in size[::-1]))
    x, y = x + camera.crop_offset[0], y + camera.crop_offset[1]
    if depth_kind == "ndc":
        assert near is not None
        _require_each_pixel(depth, np.isfinite(depth), "finite")
        z = depth_from_ndc(depth, near, far, clip=clip, reverse=reverse)
    elif depth_kind == "inverse":
        _require_each_pixel(depth, (depth >= 0) & np.isfinite(depth), ">= 0 and finite")
        z = depth_from_vergence(depth)
    else:
        _require_each_pixel(depth, depth > 0, "> 0, or inf where nothing was hit")
        z = depth if depth_kind == "z" else depth_from_ray_length(depth, x, y, camera)
    z = np.where(z >= (math.inf if background is None else background), np.inf, z)
    ids = np.isfinite(z) if surface is None else np.asarray(surface)
    if ids.shape != size:
        raise ValueError(f"surface: its shape is {ids.shape}, must be {size}, as that of rgb")
    if not np.issubdtype(ids.dtype, np.integer) and ids.dtype != bool:
        raise TypeError(f"surface: its type is {ids.dtype}, must be whole numbers")
    if ids.min() < 0 or ids.max() > MOST_IDS:
        raise ValueError(f"surface: {ids.min()} to {ids.max()}: must be 0 to {MOST_IDS}")
    count = depth.size
    return camera, {
        "x": x.ravel(),
        "y": y.ravel(),
        "rgb": rgb[..., :3].reshape(count, 3),
        "alpha": rgb[..., 3].ravel() if rgb.shape[2] == 4 else np.isfinite(z).ravel(),
        "z": z.ravel(),
        "surface": ids.ravel(),
        "weight": np.ones(count),
    }


def _camera(camera: Camera | float, size: tuple[int, ...]) -> Camera:
    """The camera of a picture of a ``size``, height and width."""
    height, width = size
    if not isinstance(camera, Camera):
        require_number("camera", camera)
        return camera_of(float(camera), (width, height))
    if tuple(camera.crop_size) != (width, height):
        raise ValueError(
            f"camera: its picture has {camera.crop_size} pixels across and down, must have "
            f"{(width, height)}, as rgb"
        )
    if camera.projection != "perspective":
        raise ValueError(f"camera: its projection is {camera.projection}, must be perspective")
    return camera


def _require_planes_of(
    depth_kind: DepthKind, near: float | None, far: float, clip: Clip, reverse: bool
) -> None:
    """Raise unless there are planes, and what is told of them, for NDC depth alone."""
    require_choice("clip", clip, CLIPS)
    require_flag("reverse", reverse)
    if depth_kind == "ndc":
        if near is None:
            raise ValueError("near=None: must be the near plane, in scene units, of an NDC depth")
        require_planes(near, far)
    elif near is not None or far != math.inf or reverse or clip != "opengl":
        raise ValueError(
            f"near={near}, far={far}, clip={clip}, reverse={reverse}: are only of an NDC depth; "
            f"depth_kind is {depth_kind}"
        )


def _require_each_pixel(depth: np.ndarray, valid: np.ndarray, allowed: str) -> None:
    """Raise for a depth that is not valid everywhere, and tell where."""
    if valid.all():
        return
    row, column = np.argwhere(~valid)[0]
    raise ValueError(
        f"depth: {np.count_nonzero(~valid)} of {depth.size} pixels are out of bounds, the first at "
        f"row {row}, column {column}: {depth[row, column]}; must be {allowed}"
    )
