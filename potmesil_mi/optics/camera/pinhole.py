"""The pinhole camera that took a picture: where it stands, where it looks, what its film covers.

Section 2.1 of Potmesil & Chakravarty (1981): the location of the lens and the viewing pyramid, as
Mitsuba's ``perspective`` states them, and the matrices that follow from them. Nothing here needs a
Mitsuba variant.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from numbers import Integral
from typing import Any, Literal, get_args

import numpy as np

from ..._html import displayed
from ..._validation import (
    require_choice,
    require_field_of_view,
    require_kind,
    require_not_before,
    require_number,
    require_positive,
    require_whole,
    shown,
)
from ..display import html_of_camera
from . import vectors
from .basis import CAMERA_AXES, HALF_TURN, CameraAxes, convert_axes, look_at
from .frustum import Frustum
from .pipeline import pixel_from_ndc
from .projection import (
    BEHIND,
    Behind,
    orthographic_clip_from_camera,
    perspective_clip_from_camera,
    perspective_divide,
)
from .vectors import (
    assemble,
    components,
    finite_components,
    leaf_of,
    multiply,
    transform_points,
)

FovAxis = Literal["x", "y", "diagonal", "smaller", "larger"]
"""Along what a field of view is given, as in Mitsuba's ``perspective``."""

FOV_AXES: tuple[FovAxis, ...] = get_args(FovAxis)
"""The axes of ``FovAxis``."""

Projection = Literal["perspective", "orthographic"]
"""How a camera sees: rays through a point, or parallel ones."""

PROJECTIONS: tuple[Projection, ...] = get_args(Projection)
"""The projections of ``Projection``."""

LARGEST_FILM = 1 << 24
"""Most pixels on a side of the film; from there on float32 does not tell neighbours apart."""


@dataclasses.dataclass(frozen=True)
class Camera:
    """The pinhole camera that took a set of point samples.

    Camera space is Mitsuba's: z along the view, y up, x to the left; depth is camera-space z.
    Pixel coordinates have their origin at the top left corner of the whole film, with pixel
    (i, j) covering [i, i + 1] x [j, j + 1], also where only a crop window is rendered.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``film_size``                 width and height of the whole film in pixels
    ``crop_offset``               first pixel (x, y) of the crop window, which lies in the film
    ``crop_size``                 width and height of the crop window in pixels
    ``x_fov``                     horizontal field of view of the whole film in degrees, > 0 and
                                  < 180; 0 for ``orthographic``
    ``to_world``                  4x4 camera-to-world matrix
    ``near_clip``, ``far_clip``   clipping planes, scene units along z, 0 < near < far
    ``principal_point_offset``    offset (x, y) as a share of the film size, as in
                                  Mitsuba's ``perspective``
    ``shutter_open``,             the interval of time in which rays are sampled
    ``shutter_close``
    ``projection``                ``perspective`` (default), or ``orthographic``: parallel rays,
                                  as of Mitsuba's sensor of that name
    ``film_width``                ``orthographic``: width of the whole film in scene units, > 0;
                                  ``None`` for ``perspective``
    ============================  ==========================================================

    The methods that give matrices and points take ``axes``: ``mitsuba``, as above, or ``opengl``
    (x to the right, -z along the view), see :mod:`potmesil_mi.optics.camera.basis`.

    Numbers of NumPy become those of Python. Raises ``TypeError`` or ``ValueError`` that names the
    field, its value and what is allowed.
    """

    film_size: tuple[int, int]
    crop_offset: tuple[int, int]
    crop_size: tuple[int, int]
    x_fov: float
    to_world: tuple[tuple[float, ...], ...]
    near_clip: float = 1e-2
    far_clip: float = 1e4
    principal_point_offset: tuple[float, float] = (0.0, 0.0)
    shutter_open: float = 0.0
    shutter_close: float = 0.0
    projection: Projection = "perspective"
    film_width: float | None = None

    def __post_init__(self) -> None:
        for name, least in (("film_size", 1), ("crop_offset", 0), ("crop_size", 1)):
            for i, number in enumerate(_several(name, getattr(self, name), 2)):
                require_whole(f"{name}[{i}]", number, least, LARGEST_FILM)
        for i, film in enumerate(self.film_size):
            if self.crop_offset[i] + self.crop_size[i] > film:
                raise ValueError(
                    f"crop_offset[{i}]={self.crop_offset[i]}, crop_size[{i}]={self.crop_size[i]}: "
                    f"the crop window must lie in the film of {film} pixels"
                )
        self._check_projection()
        for i, row in enumerate(_several("to_world", self.to_world, 4)):
            for j, number in enumerate(_several(f"to_world[{i}]", row, 4)):
                require_number(f"to_world[{i}][{j}]", number)
        require_number("near_clip", self.near_clip)
        if not (isinstance(self.far_clip, (float, np.floating)) and self.far_clip == math.inf):
            require_number("far_clip", self.far_clip)
        if not 0 < self.near_clip < self.far_clip:
            raise ValueError(
                f"near_clip={self.near_clip}, far_clip={self.far_clip}: must be > 0, and the "
                "second larger"
            )
        offset = _several("principal_point_offset", self.principal_point_offset, 2)
        for i, number in enumerate(offset):
            require_number(f"principal_point_offset[{i}]", number)
        require_number("shutter_open", self.shutter_open)
        require_not_before(
            "shutter_close", self.shutter_close, "shutter_open", float(self.shutter_open)
        )
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, _plain(getattr(self, field.name)))

    def _check_projection(self) -> None:
        require_choice("projection", self.projection, PROJECTIONS)
        if self.projection == "orthographic":
            require_number("x_fov", self.x_fov)
            if self.x_fov != 0:
                raise ValueError(f"x_fov={shown(self.x_fov)}: must be 0 for an orthographic camera")
            if self.film_width is None:
                raise TypeError("film_width: must be given for an orthographic camera")
            require_positive("film_width", self.film_width, "scene units")
            return
        require_field_of_view("x_fov", self.x_fov)
        if self.film_width is not None:
            raise ValueError(
                f"film_width={shown(self.film_width)}: must be None for a perspective camera, "
                "whose film x_fov describes"
            )

    def _require_projection(self, projection: Projection, what: str) -> None:
        if self.projection != projection:
            raise ValueError(
                f"projection={self.projection!r}: must be {projection!r} for {what} of a Camera"
            )

    @property
    def pixels_per_unit(self) -> float:
        """Pixels in a scene unit, at any depth, of an orthographic camera.

        Raises ``ValueError`` for a perspective one.
        """
        self._require_projection("orthographic", "pixels_per_unit")
        return self.film_size[0] / float(self.film_width or math.nan)

    @property
    def focal_length_pixels(self) -> float:
        """Distance of the film from the pinhole in pixels: what a slope of 1 is worth.

        Raises ``ValueError`` for an orthographic camera, which has no pinhole.
        """
        self._require_projection("perspective", "focal_length_pixels")
        return self.film_size[0] / (2 * math.tan(math.radians(self.x_fov) / 2))

    @property
    def principal_point(self) -> tuple[float, float]:
        """The pixel (x, y) that the camera looks along, the foot of the pinhole on the film.

        It is (0.5 - ``principal_point_offset``) times the film's size: Mitsuba adds the offset to
        the place of a sample on the film, so a positive one moves what is seen left and up.
        """
        (width, height), (x, y) = self.film_size, self.principal_point_offset
        return (0.5 - x) * width, (0.5 - y) * height

    @property
    def frustum(self) -> Frustum:
        """The view frustum of the whole film.

        Raises ``ValueError`` where the principal point is not in the middle: then the frustum is
        askew, and :meth:`clip_from_camera` has it; and for an orthographic camera.
        """
        self._require_projection("perspective", "frustum")
        if any(self.principal_point_offset):
            raise ValueError(
                f"principal_point_offset={self.principal_point_offset}: must be (0, 0) for a "
                "Frustum, which is symmetric; see clip_from_camera"
            )
        aspect = self.film_size[0] / self.film_size[1]
        return Frustum.from_x_fov(self.x_fov, aspect, self.near_clip, self.far_clip)

    @classmethod
    def looking_at(
        cls,
        eye: Any,
        target: Any,
        up: Any = (0.0, 1.0, 0.0),
        *,
        film_size: tuple[int, int],
        x_fov: float,
        **fields: Any,
    ) -> Camera:
        """The camera at ``eye`` that sees ``target`` in the middle, ``up`` upwards in its picture.

        ``fields`` are other fields; without a crop window the picture is the whole film. Raises
        what :func:`look_at` and the constructor raise.
        """
        matrix = look_at(eye, target, up, axes="mitsuba")
        fields = {"crop_offset": (0, 0), "crop_size": film_size, **fields}
        rows = tuple(tuple(row) for row in matrix.tolist())
        return cls(film_size=film_size, x_fov=x_fov, to_world=rows, **fields)

    # ------------------------------------------------------------ the view pipeline

    def world_from_camera(self, axes: CameraAxes = "mitsuba") -> np.ndarray:
        """``to_world`` as an array (4, 4), from camera space with these ``axes``."""
        require_choice("axes", axes, CAMERA_AXES)
        matrix = np.array(self.to_world, dtype=np.float64)
        return matrix if axes == "mitsuba" else matrix @ HALF_TURN

    def camera_from_world(self, axes: CameraAxes = "mitsuba") -> np.ndarray:
        """The inverse of :meth:`world_from_camera`.

        Raises ``ValueError`` for a ``to_world`` that has none.
        """
        try:
            return np.linalg.inv(self.world_from_camera(axes))
        except np.linalg.LinAlgError:
            raise ValueError(f"to_world={self.to_world}: must be invertible") from None

    def clip_from_camera(self, axes: CameraAxes = "mitsuba") -> np.ndarray:
        """Camera points to homogeneous clip space, (4, 4), of the whole film.

        Its x is to the right, y up, z -1 on ``near_clip`` and 1 on ``far_clip``; the axis of view
        meets the film at the :attr:`principal_point`.
        """
        orthographic = self.projection == "orthographic"
        slope = self.near_clip * math.tan(math.radians(self.x_fov) / 2)
        if orthographic:
            slope = float(self.film_width or math.nan) / 2
        height = slope * self.film_size[1] / self.film_size[0]
        x, y = (2 * offset for offset in self.principal_point_offset)
        clip_of = orthographic_clip_from_camera if orthographic else perspective_clip_from_camera
        return clip_of(
            -(1 - x) * slope,
            (1 + x) * slope,
            -(1 + y) * height,
            (1 - y) * height,
            self.near_clip,
            self.far_clip,
            axes,
        )

    def clip_from_world(self) -> np.ndarray:
        """World points to homogeneous clip space, (4, 4), of the whole film."""
        return self.clip_from_camera() @ self.camera_from_world()

    def pixel_from_camera(
        self, points: Any, axes: CameraAxes = "mitsuba", behind: Behind = "refuse"
    ) -> Any:
        """Pixels (..., 2) of the whole film where camera points (..., 3) are seen.

        Points may be arrays of NumPy or of Dr.Jit. Those beyond the film and the clipping planes
        have pixels, too. Raises ``ValueError`` for a point at or behind the camera, whose pixels
        are NaN with ``behind="nan"``.
        """
        require_choice("behind", behind, BEHIND)
        seen = components if behind == "nan" else finite_components
        clip = multiply(self.clip_from_camera(axes), assemble([*seen("points", points, 3), 1.0]))
        return pixel_from_ndc(perspective_divide(clip, behind), *self.film_size)

    def pixel_from_world(self, points: Any, behind: Behind = "refuse") -> Any:
        """Pixels (..., 2) of the whole film where world points (..., 3) are seen."""
        points = assemble(components("points", points, 3))
        camera = transform_points(self.camera_from_world(), points)
        return self.pixel_from_camera(camera, behind=behind)

    def depth_from_world(self, points: Any) -> Any:
        """Depth (...) of world points (..., 3): camera-space z, > 0 in front of the camera."""
        points = assemble(finite_components("points", points, 3))
        return components("points", transform_points(self.camera_from_world(), points), 3)[2]

    def camera_from_pixel(self, pixels: Any, depth: Any, axes: CameraAxes = "mitsuba") -> Any:
        """Camera points (..., 3) that are seen at ``pixels`` (..., 2) and have this depth (...)."""
        require_choice("axes", axes, CAMERA_AXES)
        leaf = leaf_of(pixels, depth)
        x, y = finite_components("pixels", pixels, 2, leaf)
        z = vectors.number("depth", depth, leaf)
        vectors.require("depth", z, vectors.absolute(z) < math.inf, "finite")
        if self.projection == "orthographic":
            scale = 1.0 / self.pixels_per_unit
        else:
            scale = z / self.focal_length_pixels
        left, up = (middle - at for middle, at in zip(self.principal_point, (x, y), strict=True))
        points = assemble([left * scale, up * scale, z])
        return points if axes == "mitsuba" else convert_axes(points)

    def world_from_pixel(self, pixels: Any, depth: Any) -> Any:
        """World points (..., 3) that are seen at ``pixels`` (..., 2) and have this depth (...)."""
        return transform_points(self.world_from_camera(), self.camera_from_pixel(pixels, depth))

    # ------------------------------------------------------------ as values

    def _repr_html_(self) -> str | None:
        return displayed(lambda: html_of_camera(self))

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON-ready values; those of ``orthographic`` only where it is one."""
        values = dataclasses.asdict(self)
        if self.projection == "perspective":
            del values["projection"], values["film_width"]
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Camera:
        """The inverse of :meth:`to_dict`; lists become tuples.

        Raises ``TypeError`` for unknown and missing names, and what the constructor raises.
        """
        require_kind("values", values, Mapping, "a mapping, as to_dict gives")
        fields = dataclasses.fields(cls)
        unknown = sorted(str(name) for name in set(values) - {field.name for field in fields})
        if unknown:
            raise TypeError(
                f"{unknown[0]}: not a field of Camera, which has "
                f"{', '.join(field.name for field in fields)}"
            )
        for field in fields:
            if field.default is dataclasses.MISSING and field.name not in values:
                raise TypeError(f"{field.name}: must be given for a Camera")
        return cls(**{name: _tuples(value) for name, value in values.items()})


def horizontal_fov(fov: float, axis: FovAxis, aspect: float) -> float:
    """The field of view along x in degrees of one given along ``axis``.

    ``axis`` is ``x``, ``y``, ``diagonal``, ``smaller`` or ``larger``, as in ``perspective``;
    ``aspect`` is the film's width over its height. Raises ``ValueError`` for a field of view
    that is not in (0, 180) degrees or an unknown axis.
    """
    require_field_of_view("fov", fov)
    require_choice("fov_axis", axis, FOV_AXES)
    if axis in ("smaller", "larger"):
        axis = "x" if (axis == "larger") == (aspect > 1) else "y"
    scale = {"x": 1.0, "y": aspect, "diagonal": aspect / math.hypot(1, aspect)}[axis]
    return math.degrees(2 * math.atan(math.tan(math.radians(fov) / 2) * scale))


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _plain(value: Any) -> Any:
    """A number, or the numbers in a tuple, as Python's own, which JSON has; else the value."""
    if isinstance(value, tuple):
        return tuple(_plain(item) for item in value)
    if value is None or isinstance(value, str):
        return value
    return int(value) if isinstance(value, Integral) else float(value)


def _several(name: str, values: Any, count: int) -> tuple[Any, ...]:
    """The ``count`` values; raises ``TypeError`` for what is no tuple of so many."""
    if not isinstance(values, tuple) or len(values) != count:
        raise TypeError(f"{name}={shown(values)}: must be a tuple of {count}")
    return values
