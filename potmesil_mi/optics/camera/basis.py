"""Where a camera stands and how it is turned: from gaze and up, from look-at, from three angles.

Two conventions of a camera's axes are known here, both right-handed:

===========  ========================  ========================================================
``axes``     x, y and z point          who has it
===========  ========================  ========================================================
``opengl``   right, up, backwards      both texts, OpenGL, three.js' cameras; the view is along
                                       -z
``mitsuba``  left, up, along the view  Mitsuba, ``Camera``, three.js' ``Object3D.lookAt``
===========  ========================  ========================================================

Half a turn about y leads from either to the other: :func:`convert_axes` for points, and the matrix
``HALF_TURN``, its own inverse: ``world_from_mitsuba = world_from_opengl @ HALF_TURN``.

The equations are those of *Camera Models* (``camera-models.txt``), section 5.5. Its M_cw, which
takes camera to world, is the ``basis`` here; points of all kinds are those of :mod:`.vectors`.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from ..._validation import require_choice
from .vectors import (
    absolute,
    arctan2,
    assemble,
    assemble_matrix,
    components,
    compose,
    cos,
    cross,
    degrees,
    dot,
    entries,
    finite_components,
    leaf_of,
    length,
    number,
    radians,
    require,
    scaled,
    sin,
    unit,
    where,
)

CameraAxes = Literal["opengl", "mitsuba"]
"""Where a camera's axes point: see the head of this module."""

CAMERA_AXES: tuple[CameraAxes, ...] = get_args(CameraAxes)
"""The conventions of ``CameraAxes``."""

HALF_TURN = np.diag([-1.0, 1.0, -1.0, 1.0])
"""4x4, half a turn about y: from either convention of a camera's axes to the other."""

LEAST_SINE = 1e-6
"""Sine of the angle between gaze and up below which there is no telling where right is."""


class Angles(NamedTuple):
    """Pan, tilt and swing in degrees, as :func:`orientation` takes them."""

    pan: Any
    tilt: Any
    swing: Any


def convert_axes(points: Any) -> Any:
    """Camera-space points or directions (..., 3) of either convention in the other."""
    x, y, z = components("points", points, 3)
    return assemble([-x, y, -z])


def basis_from_gaze(gaze: Any, up: Any = (0.0, 1.0, 0.0), axes: CameraAxes = "opengl") -> Any:
    r"""The matrix M_cw = [u v w], (..., 3, 3): the camera's axes, as columns, in the world.

    w = -g/\|g\|, u = t × w/\|t × w\| and v = w × u (equations 2, 3 and 7) for the direction of
    view g and the direction t that is up in the picture; neither need have length 1. With
    ``axes="mitsuba"`` the columns are -u, v and -w.

    Raises ``ValueError`` for a gaze or an up of length 0, and for an up along the gaze.
    """
    require_choice("axes", axes, CAMERA_AXES)
    leaf = leaf_of(gaze, up)
    w = scaled(unit("gaze", components("gaze", gaze, 3, leaf)), -1.0)
    t = unit("up", components("up", up, 3, leaf))
    u = cross(t, w)
    require("up", t, length(u) > LEAST_SINE, "another direction than the gaze and its opposite")
    u = unit("up", u)
    v = cross(w, u)
    return assemble_matrix(list(zip(*_in_axes(u, v, w, axes), strict=True)))


def look_at(eye: Any, target: Any, up: Any = (0.0, 1.0, 0.0), axes: CameraAxes = "opengl") -> Any:
    """The matrix ``world_from_camera``, (..., 4, 4), of a camera at ``eye`` that sees ``target``.

    The target lies on the negative z-axis of the camera with ``axes="opengl"`` (three.js'
    ``camera.lookAt``, whose ``camera.matrix`` this is), and on the positive z-axis with
    ``axes="mitsuba"`` (``Transform4f.look_at``, ``Object3D.lookAt``). Juenemann, Object3D.lookAt
    and exercise 2.

    Raises ``ValueError`` for a target at the eye, and for an up along the gaze.
    """
    leaf = leaf_of(eye, target, up)
    e, p = (finite_components(n, v, 3, leaf) for n, v in (("eye", eye), ("target", target)))
    gaze = [b - a for a, b in zip(e, p, strict=True)]
    require("target", p, length(gaze) > 0, "another point than the eye")
    return world_from_camera(basis_from_gaze(assemble(gaze), up, axes), assemble(e))


def orientation(pan: Any, tilt: Any, swing: Any, *, axes: CameraAxes = "mitsuba") -> Any:
    """The 3x3 camera-to-world rotation of the paper's angles, in degrees; (..., 3, 3) of arrays.

    With all angles 0 the camera looks along +z with +y up (and +x on the left). The order is
    pan, then tilt, then swing, each about the camera's axes as the rotation before left them:
    R = Ry(-pan) Rx(-tilt) Rz(swing). Positive ``pan`` turns the view to the right, positive
    ``tilt`` upwards, and positive ``swing`` turns the camera clockwise about its line of sight,
    as seen from behind it. The columns are the camera's axes in the world, as ``axes`` has them.
    The paper names the angles (section 2.1) and gives neither order nor sign: these are ours.
    """
    require_choice("axes", axes, CAMERA_AXES)
    leaf = leaf_of(pan, tilt, swing)
    p, t, s = (
        radians(number(name, angle, leaf))
        for name, angle in (("pan", pan), ("tilt", tilt), ("swing", swing))
    )
    (sp, cp), (st, ct), (ss, cs) = ((sin(angle), cos(angle)) for angle in (-p, -t, s))
    left = [cp * cs + sp * st * ss, ct * ss, -sp * cs + cp * st * ss]
    up = [-cp * ss + sp * st * cs, ct * cs, sp * ss + cp * st * cs]
    ahead = [sp * ct, -st, cp * ct]
    if axes == "opengl":
        left, ahead = scaled(left, -1.0), scaled(ahead, -1.0)
    return assemble_matrix(list(zip(left, up, ahead, strict=True)))


def angles_of(basis: Any, axes: CameraAxes = "mitsuba") -> Angles:
    """Pan, tilt and swing of a camera-to-world rotation: the inverse of :func:`orientation`.

    ``basis`` is (..., 3, 3), or the rotation of a (..., 4, 4). Where the camera looks straight up
    or down, pan and swing turn about the same line, and all of the turn is said to be pan.
    """
    require_choice("axes", axes, CAMERA_AXES)
    left, up, ahead = list(zip(*entries("basis", basis)[:3], strict=True))[:3]
    if axes == "opengl":
        left, _, ahead = _in_axes(left, up, ahead, "mitsuba")
    level = length([left[1], up[1]])  # the cosine of tilt
    upright = level < LEAST_SINE
    pan = where(upright, arctan2(left[2], left[0]), arctan2(-ahead[0], ahead[2]))
    swing = where(upright, 0.0 * level, arctan2(left[1], up[1]))
    return Angles(degrees(pan), degrees(arctan2(ahead[1], level)), degrees(swing))


def world_from_camera(basis: Any, eye: Any) -> Any:
    """The matrix that takes camera points to the world: basis (..., 3, 3) and ``eye`` (..., 3).

    It is the hat M_cw = [M_cw e; 0 1], (..., 4, 4), of the note after equation 7; applied by
    ``transform_points`` it is equations 4 to 6, p_w = x u + y v + z w + e.
    """
    leaf = leaf_of(basis, eye)
    rows, e = entries("basis", basis, leaf), components("eye", eye, 3, leaf)
    return _affine(rows, e)


def camera_from_world(basis: Any, eye: Any) -> Any:
    """The matrix that takes world points to the camera: [M_wc -M_wc e; 0 1] with M_wc = M_cw^T.

    ``basis`` is M_cw, (..., 3, 3), which must be orthonormal, and ``eye`` (..., 3). Last equations
    of section 5.5.
    """
    leaf = leaf_of(basis, eye)
    rows, e = entries("basis", basis, leaf), components("eye", eye, 3, leaf)
    transposed = list(zip(*rows, strict=True))
    return _affine(transposed, [-dot(row, e) for row in transposed])


def rigid_inverse(matrix: Any) -> Any:
    """The inverse of a (..., 4, 4) of a rotation and a shift: ``camera_from_world`` of
    ``world_from_camera``, and the other way about; three.js' ``matrixWorldInverse``.

    Raises ``ValueError`` for a matrix that scales or shears.
    """
    rows = entries("matrix", matrix)
    columns = list(zip(*[row[:3] for row in rows[:3]], strict=True))[:3]
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        product = dot(columns[i], columns[j])
        wrong = absolute(product - float(i == j))
        require(
            "matrix",
            columns[i],
            wrong < 1e-4,
            "a rotation and a shift: axes of length 1, perpendicular",
        )
    return camera_from_world(
        assemble_matrix([row[:3] for row in rows[:3]]), assemble([row[3] for row in rows[:3]])
    )


def dolly(world_from_camera: Any, distance: Any, axes: CameraAxes = "opengl") -> Any:
    """``world_from_camera``, (..., 4, 4), of the camera moved by ``distance`` along its view.

    Positive distances, in scene units, move it towards what it sees. The field of view stays.
    Juenemann, Dollying.
    """
    require_choice("axes", axes, CAMERA_AXES)
    forward = number("distance", distance, leaf_of(world_from_camera, distance))
    shift = -forward if axes == "opengl" else forward
    zero, one = 0.0 * shift, 1.0 + 0.0 * shift
    step = [
        [one, zero, zero, zero],
        [zero, one, zero, zero],
        [zero, zero, one, shift],
        [zero, zero, zero, one],
    ]
    return compose(world_from_camera, assemble_matrix(step))


def _in_axes(u: Any, v: Any, w: Any, axes: CameraAxes) -> tuple[Any, Any, Any]:
    """Right, up and backwards as the three axes of a convention."""
    return (u, v, w) if axes == "opengl" else (scaled(u, -1.0), v, scaled(w, -1.0))


def _affine(rows: Any, shift: Any) -> Any:
    full = [[*row, s] for row, s in zip(rows, shift, strict=True)]
    return assemble_matrix([*full, [0.0, 0.0, 0.0, 1.0]])
