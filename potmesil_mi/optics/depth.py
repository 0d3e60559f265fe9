"""Depth in the forms that other renderers give it in: NDC depth, disparity, length of the ray.

Depth is z along the camera's axis, positive before the camera; the z of the two lecture texts,
whose cameras look along -z, is its negative. Between it and the bits of a depth buffer
(:mod:`potmesil_mi.optics.depth_buffer`) lie two steps:

- **Stored depth**, 0 to 1, is affine in vergence: (1 - n/z) / (1 - n/f), with the near plane n at
  0 and the far plane f at 1; with *reversed z* n is at 1 and f at 0. The far plane may be ``inf``.
- **NDC depth** is the same (``direct3d``: Direct3D, Metal, Vulkan, WebGPU) or twice that less 1
  (``opengl``: OpenGL, WebGL and the two texts). So it is the g(z) of Jünemann, "Normalized Device
  Coordinates", exercise 5, and the pseudodepth z* of camera-models section 5.7.

Numbers, NumPy arrays and Dr.Jit arrays of any shape are taken alike. Results have their kind and,
on Dr.Jit, gradients. Nothing here needs Mitsuba.
"""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np

from .._validation import require_choice
from .arithmetic import clamp_at_zero, is_drjit, on_host, positive_finite, reciprocal, require_each
from .camera import Camera

Clip = Literal["opengl", "direct3d"]
"""What NDC depth is between the planes: -1 to 1, or 0 to 1."""

DepthKind = Literal["z", "distance", "inverse", "ndc"]
"""What the numbers of a depth mean: z along the axis, the length of the ray, 1/z, or NDC depth."""

DEPTH_KINDS: tuple[DepthKind, ...] = get_args(DepthKind)

CLIPS: tuple[Clip, ...] = get_args(Clip)
"""The two intervals of NDC depth."""

ROUNDING = 1e-6
"""By how much n/z may be less than 0, and still mean infinity: the rounding of float32."""


# ---------------------------------------------------------------- between depth and NDC


def stored_from_depth(depth: Any, near: Any, far: Any = math.inf, *, reverse: bool = False) -> Any:
    """The stored depth, (1 - n/z) / (1 - n/f), of ``depth`` > 0 in scene units.

    It is 0 on the plane ``near`` and 1 on ``far``, with ``reverse`` 1 and 0. Depths that are not
    between the planes, ``inf`` included, give what lies outside 0 to 1. Raises ``ValueError`` for
    a point at or behind the camera, and unless 0 < near < far.
    """
    require_planes(near, far)
    require_each("depth", depth, "> 0 scene units, before the camera", lambda z: z > 0)
    ratio = near * reciprocal(far)
    if reverse:
        return (near / depth - ratio) / (1 - ratio)
    return (1 - near / depth) / (1 - ratio)


def depth_from_stored(stored: Any, near: Any, far: Any = math.inf, *, reverse: bool = False) -> Any:
    """The depth in scene units that is kept as ``stored``: inverse of :func:`stored_from_depth`.

    z = n / (1 - stored (1 - n/f)). Raises ``ValueError`` for a stored depth beyond that of
    infinity, and unless 0 < near < far.
    """
    require_planes(near, far)
    return near * reciprocal(_near_over_depth("stored", stored, stored, near, far, reverse))


def ndc_from_stored(stored: Any, clip: Clip = "opengl") -> Any:
    """NDC depth: 2 stored - 1 (``opengl``), or ``stored`` as it is (``direct3d``)."""
    require_choice("clip", clip, CLIPS)
    return 2 * stored - 1 if clip == "opengl" else stored


def stored_from_ndc(ndc: Any, clip: Clip = "opengl") -> Any:
    """Stored depth: (ndc + 1) / 2 (``opengl``), or ``ndc`` as it is (``direct3d``)."""
    require_choice("clip", clip, CLIPS)
    return (ndc + 1) / 2 if clip == "opengl" else ndc


def ndc_from_depth(
    depth: Any, near: Any, far: Any = math.inf, *, clip: Clip = "opengl", reverse: bool = False
) -> Any:
    """The NDC depth of ``depth`` > 0 in scene units.

    With ``opengl`` that is g(z) = (f+n)/(f-n) + 2nf/(f-n) / z of Jünemann, exercise 5, at
    z = -depth: -1 on the plane ``near``, 1 on ``far``. With ``direct3d`` it is 0 and 1;
    ``reverse`` swaps the two. Raises what :func:`stored_from_depth` raises.
    """
    return ndc_from_stored(stored_from_depth(depth, near, far, reverse=reverse), clip)


def depth_from_ndc(
    ndc: Any, near: Any, far: Any = math.inf, *, clip: Clip = "opengl", reverse: bool = False
) -> Any:
    """The depth in scene units of an NDC depth: inverse of :func:`ndc_from_depth`.

    With ``opengl`` z = 2nf / ((f+n) - ndc (f-n)). Raises ``ValueError`` for an NDC depth beyond
    that of infinity, and unless 0 < near < far.
    """
    require_planes(near, far)
    stored = stored_from_ndc(ndc, clip)
    return near * reciprocal(_near_over_depth("ndc", ndc, stored, near, far, reverse))


# ---------------------------------------------------------------- vergence and disparity


def vergence_from_depth(depth: Any) -> Any:
    """Vergence (inverse depth), 1/depth, per scene unit; 0 at infinity. ``depth`` must be > 0."""
    require_each("depth", depth, "> 0 scene units, before the camera", lambda z: z > 0)
    return reciprocal(depth)


def depth_from_vergence(vergence: Any) -> Any:
    """Depth in scene units, 1/vergence; ``inf`` for 0. ``vergence`` must be >= 0."""
    require_each("vergence", vergence, ">= 0 per scene unit", lambda v: v >= 0)
    return reciprocal(vergence)


def disparity_from_depth(depth: Any, baseline: Any, focal_length_pixels: Any) -> Any:
    """By how many pixels a point at ``depth`` moves between two parallel cameras: B f / z.

    ``baseline``, B > 0, is the distance of the cameras in scene units; ``focal_length_pixels``,
    f > 0, is that of a :class:`potmesil_mi.Camera`. Where the cameras' principal points are
    apart (``doffs`` of the Middlebury data), that is to be added. Raises ``ValueError`` for what
    is not > 0.
    """
    _require_stereo(baseline, focal_length_pixels)
    return baseline * focal_length_pixels * vergence_from_depth(depth)


def depth_from_disparity(disparity: Any, baseline: Any, focal_length_pixels: Any) -> Any:
    """Depth in scene units, B f / disparity: inverse of :func:`disparity_from_depth`.

    ``inf`` for a disparity of 0. Raises ``ValueError`` for a negative one.
    """
    _require_stereo(baseline, focal_length_pixels)
    require_each("disparity", disparity, ">= 0 pixels", lambda d: d >= 0)
    return baseline * focal_length_pixels * reciprocal(disparity)


# ---------------------------------------------------------------- length of the ray


def camera_of(
    x_fov: float,
    film_size: tuple[int, int],
    principal_point_offset: tuple[float, float] = (0.0, 0.0),
) -> Camera:
    """A camera at the origin, for those who know its field of view and its film alone.

    ``x_fov`` is the horizontal field of view in degrees, ``film_size`` width and height in pixels,
    ``principal_point_offset`` a share of the film, as in :class:`potmesil_mi.Camera`, whose
    errors are raised.
    """
    straight_on = tuple(tuple(float(i == j) for j in range(4)) for i in range(4))
    return Camera(
        film_size,
        (0, 0),
        film_size,
        x_fov,
        straight_on,
        principal_point_offset=principal_point_offset,
    )


def ray_length_per_depth(x: Any, y: Any, camera: Camera) -> Any:
    """Length of the ray through the film at (``x``, ``y``) per depth: 1 / cos, >= 1.

    x and y are pixels of the whole film from its top left corner; the middle of the first pixel is
    (0.5, 0.5). The ray meets the plane at depth 1 in ((x - x_0) / f, (y - y_0) / f), with f the
    focal length in pixels and (x_0, y_0) the principal point: the middle of the film less the
    camera's ``principal_point_offset``, as in Mitsuba's ``perspective``.
    """
    square: Any = 1.0
    for name, position, size, offset in zip(
        "xy", (x, y), camera.film_size, camera.principal_point_offset, strict=True
    ):
        require_each(name, position, "a finite number of pixels", np.isfinite)
        slope = (position - (0.5 - offset) * size) / camera.focal_length_pixels
        square = square + slope * slope
    return _square_root(square)


def ray_length_from_depth(depth: Any, x: Any, y: Any, camera: Camera) -> Any:
    """Distance along the ray of a point at ``depth`` that is seen at (``x``, ``y``).

    Both in scene units; x and y are those of :func:`ray_length_per_depth`.
    """
    require_each("depth", depth, "> 0 scene units, before the camera", lambda z: z > 0)
    return depth * ray_length_per_depth(x, y, camera)


def depth_from_ray_length(ray_length: Any, x: Any, y: Any, camera: Camera) -> Any:
    """Depth of a point that a ray through (``x``, ``y``) meets after ``ray_length``.

    Both in scene units; x and y are those of :func:`ray_length_per_depth`. The inverse of
    :func:`ray_length_from_depth`.
    """
    require_each("ray_length", ray_length, "> 0 scene units, before the camera", lambda z: z > 0)
    return ray_length / ray_length_per_depth(x, y, camera)


# ---------------------------------------------------------------- checks and arithmetic


def require_planes(near: Any, far: Any) -> None:
    """Raise ``ValueError`` or ``TypeError`` unless 0 < ``near`` < ``far`` and near is finite."""
    require_each("near", near, "> 0 scene units and finite", positive_finite)
    require_each("far", far, f"> near={near} scene units", lambda plane: plane > on_host(near))


def _require_stereo(baseline: Any, focal_length_pixels: Any) -> None:
    require_each("baseline", baseline, "> 0 scene units and finite", positive_finite)
    require_each("focal_length_pixels", focal_length_pixels, "> 0 and finite", positive_finite)


def _near_over_depth(name: str, value: Any, stored: Any, near: Any, far: Any, reverse: bool) -> Any:
    """n/z, 0 at infinity, of a stored depth; raises under ``name`` for what is beyond."""
    ratio = near * reciprocal(far)
    share = stored * (1 - ratio) + ratio if reverse else 1 - stored * (1 - ratio)
    before = on_host(share) >= -ROUNDING
    require_each(name, value, "a depth no farther than infinity", lambda _: before)
    return clamp_at_zero(share)


def _square_root(value: Any) -> Any:
    if is_drjit(value):
        import drjit as dr

        return dr.sqrt(value)
    return np.sqrt(value)
