"""Camera geometry: where the pinhole stands, which way it looks, what its film covers.

Section 2.1 of Potmesil & Chakravarty (1981): pan, tilt and swing angles, the location of the
lens, and the viewing pyramid. Nothing here needs a Mitsuba variant.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")


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
    ``crop_offset``               first pixel (x, y) of the crop window
    ``crop_size``                 width and height of the crop window in pixels
    ``x_fov``                     horizontal field of view of the whole film in degrees
    ``to_world``                  4x4 camera-to-world matrix
    ``near_clip``, ``far_clip``   clipping planes, scene units along z
    ``principal_point_offset``    offset (x, y) as a share of the film size, as in
                                  Mitsuba's ``perspective``
    ``shutter_open``,             the interval of time in which rays are sampled
    ``shutter_close``
    ============================  ==========================================================
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

    @property
    def focal_length_pixels(self) -> float:
        """Distance of the film from the pinhole in pixels: what a slope of 1 is worth."""
        return self.film_size[0] / (2 * math.tan(math.radians(self.x_fov) / 2))

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON-ready values."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Camera:
        """The inverse of :meth:`to_dict`; lists become tuples. Unknown names are a TypeError."""
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


def horizontal_fov(fov: float, axis: str, aspect: float) -> float:
    """The field of view along x in degrees of one given along ``axis``.

    ``axis`` is ``x``, ``y``, ``diagonal``, ``smaller`` or ``larger``, as in ``perspective``;
    ``aspect`` is the film's width over its height. Raises ``ValueError`` for a field of view
    that is not in (0, 180) degrees or an unknown axis.
    """
    if not 0 < fov < 180:
        raise ValueError(f"fov={fov}: must be > 0 and < 180 degrees")
    if axis not in FOV_AXES:
        raise ValueError(f"fov_axis={axis!r}: must be one of {', '.join(FOV_AXES)}")
    if axis in ("smaller", "larger"):
        axis = "x" if (axis == "larger") == (aspect > 1) else "y"
    scale = {"x": 1.0, "y": aspect, "diagonal": aspect / math.hypot(1, aspect)}[axis]
    return math.degrees(2 * math.atan(math.tan(math.radians(fov) / 2) * scale))


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value
