"""Gradients of a picture and of its depth: samples that copy pixels have those of the pixels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .. import _backend as jit
from .._validation import shown
from ..optics.depth import DepthKind
from .image_layers import LayeredImage


def attached_columns(
    given: Mapping[str, tuple[Any, np.ndarray]],
    image: LayeredImage,
    depth_kind: DepthKind | None,
    depth_scale: float | None,
) -> dict[str, Any]:
    """Columns of samples that are attached to the ``rgb`` and the ``depth`` of an image.

    ``given`` has those that have gradients: Dr.Jit arrays, (H W C,) and (H W,), and their numbers,
    of which ``image`` was made. Which samples there are, what is
    hidden and where, depends on the depth by steps, and has no derivative. Raises
    ``NotImplementedError`` that names what else has none.
    """
    attached = {}
    if "rgb" in given:
        if image.light_of is None:
            raise NotImplementedError(
                "antialiased=True: colours of parts of pixels have no derivatives, and rgb has "
                "gradients enabled; antialiased=False leaves pixels whole"
            )
        rgb, numbers = given["rgb"]
        attached.update(_light(rgb, image.light_of, numbers.shape[2]))
    if "depth" in given:
        if depth_kind != "z":
            raise NotImplementedError(
                f"depth_kind={shown(depth_kind)}: has no derivatives, and depth has "
                "gradients enabled; turn it into the depth along the axis (z) before"
            )
        depth, _ = given["depth"]
        attached["z"] = _depth(depth, image.depth_of, image.columns["z"], depth_scale)
    return attached


def _light(rgb: Any, pixel: np.ndarray, channels: int) -> dict[str, Any]:
    """RGB, and alpha if a picture of so many ``channels`` has it, of samples in some pixels."""
    import drjit as dr

    start = jit.from_numpy(jit.UInt32, pixel) * channels
    own = [dr.gather(jit.Float, rgb, start + i) for i in range(channels)]
    light = {"rgb": jit.TensorXf(dr.ravel(jit.Array3f(*own[:3])), (len(pixel), 3))}
    if channels == 4:
        light["alpha"] = own[3]
    return light


def _depth(depth: Any, pixel: np.ndarray, z: np.ndarray, scale: float | None) -> Any:
    """Depths of samples; where these ``z`` are infinite, as of a background, they have none."""
    import drjit as dr

    own = dr.gather(jit.Float, depth, jit.from_numpy(jit.UInt32, pixel)) * (scale or 1.0)
    is_finite = jit.from_numpy(jit.UInt8, np.isfinite(z)) != 0
    return dr.select(is_finite, own, np.inf)
