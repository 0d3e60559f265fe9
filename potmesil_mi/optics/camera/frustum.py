"""The view frustum: its parameters in each other's terms, what lies in it, zoom and dolly zoom.

Juenemann, *Perspective cameras and the view frustum*: the near plane n, the far plane f, the fields
of view θ_x and θ_y, the aspect ratio a, widths and heights w_n, h_n, w_f and h_f. Four of them are
independent, and as in three.js these are θ_y, a, n and f. The relation is
w_n/(2 n) = tan(θ_x/2), h_n/(2 n) = tan(θ_y/2), and the same for the far plane.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

from ..._validation import require_choice
from .basis import CAMERA_AXES, CameraAxes, convert_axes, dolly
from .projection import perspective_clip_from_camera
from .vectors import (
    absolute,
    arctan2,
    assemble,
    components,
    degrees,
    dot,
    leaf_of,
    maximum,
    minimum,
    number,
    radians,
    require,
    sqrt,
    tan,
    where,
)

FRUSTUM_PLANES = ("left", "right", "bottom", "top", "near", "far")
"""The planes of a frustum, in the order of :class:`PlaneValues`."""


class PlaneValues(NamedTuple):
    """One value for each plane of the frustum, in the order of ``FRUSTUM_PLANES``."""

    left: Any
    right: Any
    bottom: Any
    top: Any
    near: Any
    far: Any


class BallInFrustum(NamedTuple):
    """Where a ball lies: see :meth:`Frustum.ball`.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``inside``                    the whole ball is in the frustum
    ``outside``                   the ball is beyond one of the planes, so not in the frustum
    ``cuts``                      which planes the ball meets: :class:`PlaneValues`
    ``distances``                 signed distances of its centre from the planes, positive on
                                  the frustum's side: :class:`PlaneValues`
    ============================  ==========================================================
    """

    inside: Any
    outside: Any
    cuts: PlaneValues
    distances: PlaneValues


@dataclasses.dataclass(frozen=True)
class Frustum:
    """The view frustum of a camera that looks through the middle of its picture.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``y_fov``                     θ_y, the vertical field of view in degrees, > 0 and < 180
    ``aspect``                    a, width over height, > 0
    ``near``, ``far``             n and f, distances of the planes, 0 < near < far; ``far``
                                  may be infinite
    ============================  ==========================================================

    ``Frustum(90, 2, 2, 10)`` is three.js' ``PerspectiveCamera(90, 2, 2, 10)``. Each parameter may
    be a number, a NumPy array (shapes broadcast) or a Dr.Jit ``Float``. Camera points are those of
    ``axes``: ``opengl`` (default) or ``mitsuba``, see :mod:`.basis`; depth is the distance from the
    camera along its view, positive in front of it.

    Raises ``ValueError`` that names the parameter, its value and what is allowed.
    """

    y_fov: Any
    aspect: Any
    near: Any
    far: Any

    def __post_init__(self) -> None:
        fov, aspect, near, far = self._numbers(self._leaf)
        require("y_fov", fov, (fov > 0) & (fov < 180), "> 0 and < 180 degrees")
        require("aspect", aspect, (aspect > 0) & (aspect < math.inf), "> 0 and finite")
        require("near", near, (near > 0) & (near < far), f"> 0 and less than far={self.far}")

    # ------------------------------------------------------------ from other parameters

    @classmethod
    def from_x_fov(cls, x_fov: Any, aspect: Any, near: Any, far: Any) -> Frustum:
        """The frustum with a horizontal field of view θ_x in degrees: tan(θ_x/2) = a tan(θ_y/2)."""
        leaf = leaf_of(x_fov, aspect)
        fov, ratio = number("x_fov", x_fov, leaf), number("aspect", aspect, leaf)
        require("x_fov", fov, (fov > 0) & (fov < 180), "> 0 and < 180 degrees")
        require("aspect", ratio, (ratio > 0) & (ratio < math.inf), "> 0 and finite")
        return cls(_fov(tan(radians(fov / 2)) / ratio), aspect, near, far)

    @classmethod
    def from_near_plane(cls, width: Any, height: Any, near: Any, far: Any) -> Frustum:
        """The frustum whose near plane has this width w_n and height h_n, in scene units."""
        return cls(*_from_window(width, height, near, "near"), near, far)

    @classmethod
    def from_far_plane(cls, width: Any, height: Any, near: Any, far: Any) -> Frustum:
        """The frustum whose far plane, which is finite, has this width w_f and height h_f."""
        return cls(*_from_window(width, height, far, "far"), near, far)

    @classmethod
    def from_lens(
        cls, focal_length: Any, frame_width: Any, frame_height: Any, near: Any, far: Any
    ) -> Frustum:
        """The paper's viewing pyramid (section 2.1): focal length and size of the image frame.

        All three are in one unit, say millimetres; the film stands at the focal length.
        """
        window = _from_window(frame_width, frame_height, focal_length, "focal_length")
        return cls(*window, near, far)

    # ------------------------------------------------------------ in other parameters

    @property
    def slopes(self) -> tuple[Any, Any]:
        """tan(θ_x/2) and tan(θ_y/2): half the width and half the height at distance 1."""
        return self._slopes(self._leaf)

    @property
    def x_fov(self) -> Any:
        """θ_x, the horizontal field of view in degrees."""
        return _fov(self.slopes[0])

    @property
    def near_width(self) -> Any:
        """w_n = 2 n tan(θ_x/2), the width of the near plane."""
        return self.size_at(self.near)[0]

    @property
    def near_height(self) -> Any:
        """h_n = 2 n tan(θ_y/2), the height of the near plane."""
        return self.size_at(self.near)[1]

    @property
    def far_width(self) -> Any:
        """w_f = 2 f tan(θ_x/2), the width of the far plane."""
        return self.size_at(self.far)[0]

    @property
    def far_height(self) -> Any:
        """h_f = 2 f tan(θ_y/2), the height of the far plane."""
        return self.size_at(self.far)[1]

    def size_at(self, depth: Any) -> tuple[Any, Any]:
        """Width w_c and height h_c of the frustum at a depth (Juenemann, exercise 1)."""
        leaf = leaf_of(depth, *self._fields)
        z = number("depth", depth, leaf)
        x, y = self._slopes(leaf)
        return 2 * z * x, 2 * z * y

    def focal_length(self, frame_width: Any) -> Any:
        """The focal length whose film of this width sees the frustum, in the width's unit."""
        leaf = leaf_of(frame_width, *self._fields)
        width = number("frame_width", frame_width, leaf)
        require("frame_width", width, (width > 0) & (width < math.inf), "> 0 and finite")
        return width / (2 * self._slopes(leaf)[0])

    def corners(self, axes: CameraAxes = "opengl") -> tuple[Any, ...]:
        """The eight corners as camera points (..., 3).

        First the four of the near plane, counterclockwise as the camera sees them from the bottom
        left, then those of the far plane.
        """
        require_choice("axes", axes, CAMERA_AXES)
        x, y = self.slopes
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        depths = self._numbers(self._leaf)[2:]
        points = [assemble([i * x * z, j * y * z, -z]) for z in depths for i, j in signs]
        return tuple(points if axes == "opengl" else map(convert_axes, points))

    def clip_from_camera(self, axes: CameraAxes = "opengl") -> Any:
        """Q_ndc, (..., 4, 4): camera points to homogeneous clip space."""
        width, height = (side / 2 for side in self.size_at(self.near))
        return perspective_clip_from_camera(
            -width, width, -height, height, self.near, self.far, axes
        )

    # ------------------------------------------------------------ what lies in it

    def planes(self, axes: CameraAxes = "opengl") -> PlaneValues:
        """The six planes (n, d), (..., 4), in camera space.

        n has length 1 and points inwards, so n·p + d is the distance of a point p from the plane,
        positive on the frustum's side. The sides are left and right as the camera sees them.
        """
        require_choice("axes", axes, CAMERA_AXES)
        x, y = self.slopes
        over_x, over_y = 1 / sqrt(1 + x * x), 1 / sqrt(1 + y * y)
        near, far = self._numbers(self._leaf)[2:]
        normals: tuple[list[Any], ...] = (
            [over_x, 0.0, -x * over_x, 0.0],
            [-over_x, 0.0, -x * over_x, 0.0],
            [0.0, over_y, -y * over_y, 0.0],
            [0.0, -over_y, -y * over_y, 0.0],
            [0.0, 0.0, -1.0, -near],
            [0.0, 0.0, 1.0, far],
        )
        if axes == "mitsuba":
            normals = tuple([-a, b, -c, d] for a, b, c, d in normals)
        return PlaneValues(*map(assemble, normals))

    def distances(self, points: Any, axes: CameraAxes = "opengl") -> PlaneValues:
        """Signed distances of camera points (..., 3) from the planes, positive inside."""
        planes = self.planes(axes)
        leaf = leaf_of(points, *planes)
        point = [*components("points", points, 3, leaf), 1.0]
        return PlaneValues(*(dot(components("plane", p, 4, leaf), point) for p in planes))

    def contains(self, points: Any, axes: CameraAxes = "opengl") -> Any:
        """Whether camera points (..., 3) are in the frustum; its surface belongs to it."""
        return _all(distance >= 0 for distance in self.distances(points, axes))

    def ball(self, center: Any, radius: Any, axes: CameraAxes = "opengl") -> BallInFrustum:
        """Where a ball in camera space lies, and which planes it meets.

        It cuts a plane that is nearer to its centre than the radius. ``outside`` is the usual test
        for culling: a ball that it says is outside is, but one near an edge of the frustum may miss
        the frustum without being beyond any single plane.

        Raises ``ValueError`` for a radius that is not >= 0.
        """
        leaf = leaf_of(center, radius, *self._fields)
        r = number("radius", radius, leaf)
        require("radius", r, (r >= 0) & (r < math.inf), ">= 0 and finite")
        distances = PlaneValues(
            *(number("center", distance, leaf) for distance in self.distances(center, axes))
        )
        return BallInFrustum(
            _all(distance >= r for distance in distances),
            ~_all(distance >= -r for distance in distances),
            PlaneValues(*(absolute(distance) < r for distance in distances)),
            distances,
        )

    def bounce(
        self, center: Any, velocity: Any, radius: Any, axes: CameraAxes = "opengl"
    ) -> tuple[Any, Any]:
        """The ball's ``center`` and ``velocity`` after it is reflected by the planes it has met.

        Juenemann, exercise 1. At each plane nearer than the radius the centre goes back to where
        the ball touches it and the part of the velocity that leads outwards is turned round, so the
        speed stays. (The exercise compares x_c with w_c/2 - radius, along x; here the distance is
        that from the slanted plane, so it is the ball that touches and not its x-axis.) In a corner
        the planes follow each other in the order of ``FRUSTUM_PLANES``, and what one has pushed
        beyond another is brought back along z, then x and y. The frustum must have room for the
        ball.
        """
        planes = self.planes(axes)
        leaf = leaf_of(center, velocity, radius, *planes)
        c, v = components("center", center, 3, leaf), components("velocity", velocity, 3, leaf)
        r = number("radius", radius, leaf)
        for plane in planes:
            *normal, offset = components("plane", plane, 4, leaf)
            depth = minimum(dot(normal, c) + offset - r, 0.0)  # < 0: beyond where it touches
            outwards = where(depth < 0, minimum(dot(normal, v), 0.0), 0.0)
            c = [x - depth * n for x, n in zip(c, normal, strict=True)]
            v = [x - 2 * outwards * n for x, n in zip(v, normal, strict=True)]
        return assemble(self._with_room(c, r, axes, leaf)), assemble(v)

    def _with_room(self, center: list[Any], radius: Any, axes: CameraAxes, leaf: Any) -> list[Any]:
        """The centre of a ball moved along z, then x and y, to where the ball is in the frustum."""
        ahead = -1.0 if axes == "opengl" else 1.0
        near, far = self._numbers(leaf)[2:]
        depth = maximum(minimum(ahead * center[2], far - radius), near + radius)
        inside = []
        for x, slope in zip(center[:2], self._slopes(leaf), strict=True):
            room = maximum(slope * depth - radius * sqrt(1 + slope * slope), 0.0)
            inside.append(maximum(minimum(x, room), -room))
        return [*inside, ahead * depth]

    # ------------------------------------------------------------ zoom

    def zoom(self, magnification: Any) -> Frustum:
        """The frustum whose picture shows things so many times as large, from the same place.

        tan(θ_y/2) is divided by ``magnification``, > 0, as by three.js' ``camera.zoom``.
        """
        leaf = leaf_of(magnification, *self._fields)
        factor = number("magnification", magnification, leaf)
        require("magnification", factor, (factor > 0) & (factor < math.inf), "> 0 and finite")
        return dataclasses.replace(self, y_fov=_fov(self._slopes(leaf)[1] / factor))

    # ------------------------------------------------------------ numbers of one kind

    @property
    def _fields(self) -> tuple[Any, Any, Any, Any]:
        return self.y_fov, self.aspect, self.near, self.far

    @property
    def _leaf(self) -> Any:
        return leaf_of(*self._fields)

    def _numbers(self, leaf: Any) -> list[Any]:
        names = ("y_fov", "aspect", "near", "far")
        return [number(n, value, leaf) for n, value in zip(names, self._fields, strict=True)]

    def _slopes(self, leaf: Any) -> tuple[Any, Any]:
        fov, aspect = self._numbers(leaf)[:2]
        slope = tan(radians(fov / 2))
        return slope * aspect, slope


def dolly_zoom(
    frustum: Frustum,
    world_from_camera: Any,
    depth: Any,
    distance: Any,
    axes: CameraAxes = "opengl",
) -> tuple[Frustum, Any]:
    """Zoom and dolly at once, so that what is at ``depth`` keeps its size in the picture.

    The camera moves by ``distance`` along its view, towards what it sees if that is positive, and
    the field of view becomes such that width and height of the frustum there stay:
    tan(θ'/2) = tan(θ/2) depth/(depth - distance). Gives the frustum and ``world_from_camera``.

    Raises ``ValueError`` for a depth that is not > 0, and for a camera that would reach it.
    """
    leaf = leaf_of(depth, distance)
    before, way = number("depth", depth, leaf), number("distance", distance, leaf)
    require("depth", before, (before > 0) & (before < math.inf), "> 0 and finite")
    require("distance", way, way < before, f"less than depth={depth}")
    zoomed = frustum.zoom((before - way) / before)
    return zoomed, dolly(world_from_camera, distance, axes)


def _fov(slope: Any) -> Any:
    """The field of view in degrees of the tangent of its half."""
    return 2 * degrees(arctan2(slope, 1.0 + 0.0 * slope))


def _from_window(width: Any, height: Any, distance: Any, name: str) -> tuple[Any, Any]:
    """θ_y and the aspect ratio of a window at a distance."""
    leaf = leaf_of(width, height, distance)
    w, h = number("width", width, leaf), number("height", height, leaf)
    d = number(name, distance, leaf)
    for what, value in (("width", w), ("height", h), (name, d)):
        require(what, value, (value > 0) & (value < math.inf), "> 0 and finite")
    return _fov(h / (2 * d)), w / h


def _all(conditions: Any) -> Any:
    result: Any = True
    for condition in conditions:
        result = result & condition
    return result
