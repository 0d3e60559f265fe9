"""Projections: perspective and parallel, as formulas and as homogeneous matrices.

Camera points are those of ``axes`` (see :mod:`.basis`): by default right-handed with -z in view, as
in both texts; what comes out has x to the right and y up in either case.

**Two notations of one map.** *Camera Models* (``camera-models.txt``, section 5.7) writes f and F
for the z of the near and of the far plane, both negative, and has M_p with pseudodepth. Juenemann
(``junemann-view-pipeline.txt``) writes n and f for their distances, both positive, and has Q_ndc.
With n = -f and f = -F they are one matrix but for the scale of x and y,
Q_ndc = diag(2/w_n, 2/h_n, 1, 1) n M_p, and so they are here: :func:`perspective_clip_from_camera`
calls :func:`pseudodepth_perspective`. Parameters ``near`` and ``far`` are distances, positive.

**Clip space** is what these matrices give before the perspective division. Its last component w is
positive in front of the camera in every matrix here; near becomes -1 and far 1 by the division.
What :func:`perspective_divide` and the like say of points that have no image is their ``behind``.
"""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np

from ..._validation import require_choice
from .basis import CAMERA_AXES, HALF_TURN, CameraAxes, camera_from_world, convert_axes, orientation
from .vectors import (
    absolute,
    assemble,
    assemble_matrix,
    components,
    compose,
    dot,
    entries,
    leaf_of,
    number,
    require,
    unit,
    where,
)

Behind = Literal["refuse", "nan"]
"""What becomes of points at or behind the camera: ``refuse``, an error that names the first of
them; or ``nan``, without a look at the values, so also in a symbolic loop of Dr.Jit."""

BEHIND: tuple[Behind, ...] = get_args(Behind)
"""The choices of ``Behind``."""


# ---------------------------------------------------------------- projections of points


def image_from_camera(
    points: Any, focal_length: Any, axes: CameraAxes = "opengl", behind: Behind = "refuse"
) -> Any:
    """Perspective projection: image points (..., 2) of camera points (..., 3).

    x* = f p_x/p_z, y* = f p_y/p_z for the image plane z = f = -``focal_length``, in the units of
    ``focal_length`` (equation 1 of *Camera Models*, section 5.3).

    Raises ``ValueError`` for a focal length that is not > 0 and, unless ``behind="nan"``, for a
    point at or behind the camera.
    """
    leaf = leaf_of(points, focal_length)
    f = _positive("focal_length", focal_length, leaf)
    x, y, z = components("points", _as_opengl(points, axes), 3, leaf)
    return _quotients([x * f, y * f], -z, "points", [x, y, z], behind)


def orthographic_image(points: Any, scale: Any = 1.0, axes: CameraAxes = "opengl") -> Any:
    """Parallel projection: image points (..., 2) of camera points (..., 3), x = α p_x, y = α p_y.

    ``scale`` is α; the depth has no influence (section 5.4 of *Camera Models*).
    """
    leaf = leaf_of(points, scale)
    x, y, _ = components("points", _as_opengl(points, axes), 3, leaf)
    alpha = number("scale", scale, leaf)
    return assemble([x * alpha, y * alpha])


def vanishing_point(directions: Any, focal_length: Any, axes: CameraAxes = "opengl") -> Any:
    """Where the images (..., 2) of all lines in a direction (..., 3) meet.

    It is the image of the point at infinity (section 5.3 of *Camera Models*). Lines parallel to the
    image plane stay parallel and meet nowhere: ``ValueError``.
    """
    leaf = leaf_of(directions, focal_length)
    f = _positive("focal_length", focal_length, leaf)
    x, y, z = components("directions", _as_opengl(directions, axes), 3, leaf)
    require("directions", [x, y, z], absolute(z) > 0, "not parallel to the image plane")
    return assemble([-f * x / z, -f * y / z])


def pseudodepth(z: Any, near: Any, far: Any, axes: CameraAxes = "opengl") -> Any:
    """The third of the normalised device coordinates, of a camera-space z.

    g(z) = (f + n)/(f - n) + 2 n f/((f - n) z), which is -1 at z = -n and 1 at z = -f (Juenemann,
    exercise 5), and z* = (f/p_z)(a p_z + b) of section 5.7 of *Camera Models*. It grows with the
    distance from the camera. ``far`` may be infinite.
    """
    leaf = leaf_of(z, near, far)
    a, b = (number("near", x, leaf) for x in pseudodepth_coefficients(near, far))
    n, camera_z = number("near", near, leaf), number("z", z, leaf)
    sign = -1.0 if _checked(axes) == "opengl" else 1.0
    return n * (b / (sign * camera_z) - a)


def pseudodepth_coefficients(near: Any, far: Any) -> tuple[Any, Any]:
    """The coefficients a and b of section 5.7 of *Camera Models*, for the distances of the planes.

    a = -(1/f)(f + F)/(f - F) and b = 2 F/(f - F) for f = -``near`` and F = -``far``; times ``near``
    they are Juenemann's (n + f)/(n - f) and 2 n f/(n - f). ``far`` may be infinite.

    Raises ``ValueError`` unless 0 < near < far.
    """
    n, ratio = _planes(near, far)
    a = -(1.0 + ratio) / (1.0 - ratio) / n
    b = -2.0 / (1.0 - ratio)
    return a, b


# ---------------------------------------------------------------- matrices


def homogeneous_perspective(focal_length: Any) -> Any:
    """The homogeneous perspective matrix M_p of section 5.6 of *Camera Models*, (..., 4, 4).

    M_p p = (p_x, p_y, p_z, p_z/f) for f = -``focal_length``; divided by the last it is the point
    where the ray through p meets the image plane.
    """
    f = _positive("focal_length", focal_length, leaf_of(focal_length))
    return _perspective_matrix(1.0, 0.0, f)


def pseudodepth_perspective(near: Any, far: Any) -> Any:
    """M_p with pseudodepth, (..., 4, 4): sections 5.7 and 5.8 of *Camera Models*.

    Its rows are (1 0 0 0), (0 1 0 0), (0 0 a b) and (0 0 1/f 0). The image plane is the near plane:
    x* and y* come out in scene units on it, and z* as -1 at ``near`` and 1 at ``far``.

    Raises ``ValueError`` unless 0 < near < far; ``far`` may be infinite.
    """
    a, b = pseudodepth_coefficients(near, far)
    return _perspective_matrix(a, b, number("near", near, leaf_of(near, far)))


def perspective_clip_from_camera(
    left: Any, right: Any, bottom: Any, top: Any, near: Any, far: Any, axes: CameraAxes = "opengl"
) -> Any:
    """Q_ndc, (..., 4, 4): camera points to homogeneous clip space (Juenemann, NDC).

    ``left`` to ``top`` are the sides of the near plane in scene units, x to the right and y up. In
    the middle of it, -left = right = w_n/2 and -bottom = top = h_n/2, this is the text's matrix;
    elsewhere it is that of a view off the axis, as OpenGL's ``glFrustum`` and three.js'
    ``Matrix4.makePerspective`` have it.

    Raises ``ValueError`` unless 0 < near < far (``far`` may be infinite) and for a width or height
    of 0.
    """
    _checked(axes)
    leaf = leaf_of(left, right, bottom, top, near, far)
    x, y, width, height = _sides(left, right, bottom, top, leaf)
    n = number("near", near, leaf)
    window = [
        [2 * n / width, 0.0, 0.0, -n * x / width],
        [0.0, 2 * n / height, 0.0, -n * y / height],
        [0.0, 0.0, n, 0.0],
        [0.0, 0.0, 0.0, n],
    ]
    return _from(axes, compose(assemble_matrix(window), pseudodepth_perspective(near, far)))


def orthographic_clip_from_camera(
    left: Any, right: Any, bottom: Any, top: Any, near: Any, far: Any, axes: CameraAxes = "opengl"
) -> Any:
    """Camera points to normalised device coordinates in parallel projection, (..., 4, 4).

    The box of these sides, between the distances ``near`` and ``far`` (which may be negative),
    becomes the cube [-1, 1]^3; z is affine. three.js' ``OrthographicCamera``.

    Raises ``ValueError`` unless near < far, both finite, and for a width or height of 0.
    """
    _checked(axes)
    leaf = leaf_of(left, right, bottom, top, near, far)
    x, y, width, height = _sides(left, right, bottom, top, leaf)
    n, f = number("near", near, leaf), number("far", far, leaf)
    require(
        "near",
        n,
        (absolute(n) < math.inf) & (absolute(f) < math.inf) & (n < f),
        f"finite and less than far={far}, which must be finite",
    )
    depth = f - n
    box = [
        [2.0 / width, 0.0, 0.0, -x / width],
        [0.0, 2.0 / height, 0.0, -y / height],
        [0.0, 0.0, -2.0 / depth, -(f + n) / depth],
        [0.0, 0.0, 0.0, 1.0],
    ]
    return _from(axes, assemble_matrix(box))


def perspective_divide(clip: Any, behind: Behind = "refuse") -> Any:
    """Homogeneous points (..., n + 1) divided by their last component: (..., n).

    Of clip space they become normalised device coordinates. Raises ``ValueError`` for a last
    component that is not > 0, a point at or behind the camera, unless ``behind="nan"``.
    """
    *parts, w = components("clip", clip)
    return _quotients(parts, w, "clip", [*parts, w], behind)


# ---------------------------------------------------------------- the paper's matrix


def image_from_world_matrix(
    pan: Any, tilt: Any, swing: Any, lens_center: Any, focal_length: Any
) -> Any:
    """The paper's camera transformation matrix, 4x3 (..., 4, 3): section 2.1 and Figure 1.

    It stands on the right of row vectors, as in the paper's time: (X, Y, Z, 1) M = (w x, w y, w),
    where x and y are on the image plane in the unit of ``focal_length``, x to the right and y up,
    and w is the depth in scene units. Angles are in degrees, of :func:`orientation`;
    ``lens_center`` (..., 3) is in the global coordinate system. :func:`image_from_world` applies
    the matrix. The size of the frame bounds the viewing pyramid and is not in the matrix:
    :meth:`Frustum.from_lens`.

    The paper prints no matrix. This is the one that its text describes.
    """
    leaf = leaf_of(pan, tilt, swing, lens_center, focal_length)
    f = _positive("focal_length", focal_length, leaf)
    rotation = orientation(pan, tilt, swing, axes="opengl")
    camera = entries("camera", camera_from_world(rotation, lens_center), leaf)
    right, up, backwards = camera[:3]
    columns = [[f * x for x in right], [f * x for x in up], [-x for x in backwards]]
    return assemble_matrix(list(zip(*columns, strict=True)))


def image_from_world(points: Any, matrix: Any, behind: Behind = "refuse") -> Any:
    """Image points (..., 2) of world points (..., 3), by the paper's 4x3 ``matrix``."""
    leaf = leaf_of(points, matrix)
    point = [*components("points", points, 3, leaf), 1.0]
    columns = list(zip(*entries("matrix", matrix, leaf), strict=True))
    x, y, w = (dot(point, column) for column in columns)
    return _quotients([x, y], w, "points", point[:3], behind)


# ---------------------------------------------------------------- projections onto any plane


def plane_through(point: Any, normal: Any) -> Any:
    """The plane (n, d), (..., 4), through a point (..., 3): n·p + d = 0 with n of length 1."""
    leaf = leaf_of(point, normal)
    n = unit("normal", components("normal", normal, None, leaf))
    return assemble([*n, -dot(n, components("point", point, len(n), leaf))])


def plane_projection(normal: Any, distance: Any) -> Any:
    """Q_{n,d} = [d E, 0; -n^T, 0]: perspective projection from the origin onto a plane.

    ``normal`` (..., 3), or (..., 2) for a line in the plane, points from the plane to the camera
    and need not have length 1; ``distance`` d is that of the plane from the camera, > 0. Juenemann,
    Projection as a matrix operation. Q·Q = d Q.

    Raises ``ValueError`` for a distance that is not > 0 and a normal of length 0.
    """
    leaf = leaf_of(normal, distance)
    n = unit("normal", components("normal", normal, None, leaf))
    d = _positive("distance", distance, leaf)
    return _projection([*n, d], [*(0.0 for _ in n), 1.0])


def projection_onto_plane(plane: Any, center: Any) -> Any:
    """Perspective projection in the world from ``center`` (..., 3) onto a plane, (..., 4, 4).

    With a point light at the centre this maps things to their shadows. ``plane`` is (n, d),
    (..., 4), of :func:`plane_through`, and n points to the side of the centre; so w is positive for
    what lies on the plane's side of the centre. For the centre at the origin it is
    :func:`plane_projection`.

    Raises ``ValueError`` for a centre on the plane or on the side that n points away from.
    """
    leaf = leaf_of(plane, center)
    n, light = components("plane", plane, None, leaf), components("center", center, None, leaf)
    light = [*light, 1.0]
    require(
        "center",
        light[:-1],
        dot(n, light) > 0,
        "on the side of the plane that its normal points to",
    )
    return _projection(n, light)


def parallel_projection_onto_plane(plane: Any, direction: Any) -> Any:
    """Parallel projection along ``direction`` (..., 3) onto a plane (n, d), (..., 4, 4).

    An affine map: its last row is (0 0 0 1). With the direction of the sun's light it maps things
    to their shadows; with the normal it is orthographic projection (Juenemann, Parallel
    Projections).

    Raises ``ValueError`` for a direction along the plane.
    """
    leaf = leaf_of(plane, direction)
    n = components("plane", plane, None, leaf)
    along = unit("direction", components("direction", direction, None, leaf))
    towards = dot(n[:-1], along)
    require("direction", along, absolute(towards) > 0, "not parallel to the plane")
    return _projection(n, [*(x / towards for x in along), 0.0])


def _projection(plane: list[Any], center: list[Any]) -> Any:
    """(π·L) E - L π^T for a plane π and a homogeneous centre L."""
    height = dot(plane, center)
    rows = [
        [(height if i == j else 0.0) - c * p for j, p in enumerate(plane)]
        for i, c in enumerate(center)
    ]
    rows[-1][-1] = dot(plane[:-1], center[:-1])  # height - center[-1] * plane[-1], exactly
    return assemble_matrix(rows)


# ---------------------------------------------------------------- checks and parts


def _perspective_matrix(a: Any, b: Any, focal_length: Any) -> Any:
    return assemble_matrix(
        [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, a, b],
            [0.0, 0.0, -1.0 / focal_length, 0.0],
        ]
    )


def _sides(left: Any, right: Any, bottom: Any, top: Any, leaf: Any) -> tuple[Any, Any, Any, Any]:
    """Sums and differences of the sides of a window; refuses one without a size."""
    x0, x1 = number("left", left, leaf), number("right", right, leaf)
    y0, y1 = number("bottom", bottom, leaf), number("top", top, leaf)
    require("right", x1, absolute(x1 - x0) > 0, f"other than left={left}")
    require("top", y1, absolute(y1 - y0) > 0, f"other than bottom={bottom}")
    return x1 + x0, y1 + y0, x1 - x0, y1 - y0


def _planes(near: Any, far: Any) -> tuple[Any, Any]:
    """The near distance, and its ratio to the far one; refuses what is not 0 < near < far."""
    leaf = leaf_of(near, far)
    n, f = number("near", near, leaf), number("far", far, leaf)
    require("near", n, (n > 0) & (n < f), f"> 0 and less than far={far}")
    return n, n / f


def _positive(name: str, value: Any, leaf: Any) -> Any:
    result = number(name, value, leaf)
    require(name, result, (result > 0) & (result < math.inf), "> 0 and finite")
    return result


def _checked(axes: CameraAxes) -> CameraAxes:
    require_choice("axes", axes, CAMERA_AXES)
    return axes


def _as_opengl(points: Any, axes: CameraAxes) -> Any:
    return points if _checked(axes) == "opengl" else convert_axes(points)


def _from(axes: CameraAxes, matrix: Any) -> Any:
    """A matrix that takes points of OpenGL's axes as one that takes those of ``axes``."""
    return matrix if axes == "opengl" else compose(matrix, HALF_TURN)


def _quotients(parts: list[Any], w: Any, name: str, value: list[Any], behind: Behind) -> Any:
    """``parts`` over ``w``, where it is > 0; what it is not is refused or NaN."""
    require_choice("behind", behind, BEHIND)
    in_front = w > 0
    if behind == "refuse":
        require(name, value, in_front, "in front of the camera (clip it, or say behind='nan')")
    divisor = where(in_front, w, 1.0)
    return assemble([where(in_front, part / divisor, np.nan) for part in parts])
