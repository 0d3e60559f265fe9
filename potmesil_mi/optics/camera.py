"""Camera geometry: where the pinhole stands, which way it looks, what its film covers.

Section 2.1 of Potmesil & Chakravarty (1981): pan, tilt and swing angles, the location of the
lens, and the viewing pyramid. Nothing here needs a Mitsuba variant.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal, get_args

import numpy as np

from .._validation import require_choice, require_number, require_whole

FovAxis = Literal["x", "y", "diagonal", "smaller", "larger"]
"""Along what a field of view is given, as in Mitsuba's ``perspective``."""

FOV_AXES: tuple[FovAxis, ...] = get_args(FovAxis)
"""The axes of ``FovAxis``."""

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
                                  < 180
    ``to_world``                  4x4 camera-to-world matrix
    ``near_clip``, ``far_clip``   clipping planes, scene units along z, 0 < near < far
    ``principal_point_offset``    offset (x, y) as a share of the film size, as in
                                  Mitsuba's ``perspective``
    ``shutter_open``,             the interval of time in which rays are sampled
    ``shutter_close``
    ============================  ==========================================================

    Raises ``TypeError`` or ``ValueError`` that names the field, its value and what is allowed.
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
        require_number("x_fov", self.x_fov)
        if not 0 < self.x_fov < 180:
            raise ValueError(f"x_fov={self.x_fov}: must be > 0 and < 180 degrees")
        for i, row in enumerate(_several("to_world", self.to_world, 4)):
            for j, number in enumerate(_several(f"to_world[{i}]", row, 4)):
                require_number(f"to_world[{i}][{j}]", number)
        require_number("near_clip", self.near_clip)
        if not (isinstance(self.far_clip, float) and self.far_clip == math.inf):
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
        require_number("shutter_close", self.shutter_close, float(self.shutter_open))

    @property
    def focal_length_pixels(self) -> float:
        """Distance of the film from the pinhole in pixels: what a slope of 1 is worth."""
        return self.film_size[0] / (2 * math.tan(math.radians(self.x_fov) / 2))

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON-ready values."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Camera:
        """The inverse of :meth:`to_dict`; lists become tuples.

        Raises ``TypeError`` for unknown and missing names, and what the constructor raises.
        """
        fields = dataclasses.fields(cls)
        unknown = sorted(set(values) - {field.name for field in fields})
        if unknown:
            raise TypeError(
                f"{unknown[0]}: not a field of Camera, which has "
                f"{', '.join(field.name for field in fields)}"
            )
        for field in fields:
            if field.default is dataclasses.MISSING and field.name not in values:
                raise TypeError(f"{field.name}: must be given for a Camera")
        return cls(**{name: _tuples(value) for name, value in values.items()})


def orientation(pan: float, tilt: float, swing: float) -> np.ndarray:
    """The 3x3 camera-to-world rotation of the paper's angles, in degrees.

    With all angles 0 the camera looks along +z with +y up (and +x on the left). The order is
    pan, then tilt, then swing, each about the camera's axes as the rotation before left them:
    R = Ry(-pan) Rx(-tilt) Rz(swing). Positive ``pan`` turns the view to the right, positive
    ``tilt`` upwards, and positive ``swing`` turns the camera clockwise about its line of sight,
    as seen from behind it.
    """
    (sp, cp), (st, ct), (ss, cs) = (
        (math.sin(angle), math.cos(angle)) for angle in np.radians([-pan, -tilt, swing])
    )
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_x = np.array([[1, 0, 0], [0, ct, -st], [0, st, ct]])
    about_z = np.array([[cs, -ss, 0], [ss, cs, 0], [0, 0, 1]])
    return about_y @ about_x @ about_z


def horizontal_fov(fov: float, axis: FovAxis, aspect: float) -> float:
    """The field of view along x in degrees of one given along ``axis``.

    ``axis`` is ``x``, ``y``, ``diagonal``, ``smaller`` or ``larger``, as in ``perspective``;
    ``aspect`` is the film's width over its height. Raises ``ValueError`` for a field of view
    that is not in (0, 180) degrees or an unknown axis.
    """
    if not 0 < fov < 180:
        raise ValueError(f"fov={fov}: must be > 0 and < 180 degrees")
    require_choice("fov_axis", axis, FOV_AXES)
    if axis in ("smaller", "larger"):
        axis = "x" if (axis == "larger") == (aspect > 1) else "y"
    scale = {"x": 1.0, "y": aspect, "diagonal": aspect / math.hypot(1, aspect)}[axis]
    return math.degrees(2 * math.atan(math.tan(math.radians(fov) / 2) * scale))


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _several(name: str, values: Any, count: int) -> tuple[Any, ...]:
    """The ``count`` values; raises ``TypeError`` for what is no tuple of so many."""
    if not isinstance(values, tuple) or len(values) != count:
        raise TypeError(f"{name}={values!r}: must be a tuple of {count}")
    return values
