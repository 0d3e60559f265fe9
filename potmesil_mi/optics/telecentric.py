"""The telecentric lens, which an orthographic camera has in the place of a thin lens.

Seen from its film the aperture is at infinity, so every point of the film looks along the same cone
of directions: a point blurs to the same circle wherever in the picture it is. A lens of half-angle
a that is focused at U blurs a point at depth P by a circle of radius tan(a) |P - U|. Nothing here
needs a Mitsuba variant.

That is affine in depth, as a thin lens's circle is in 1/depth. So for a depth Z beyond everything,
the change of space P' = 1 / (Z - P) makes of the one lens the other, exactly: what hides what, and
by how much everything moves as one looks from one lens point or another, stays as it is. What forms
pictures through a thin lens forms those through a telecentric one, see :func:`as_thin_lens`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._html import displayed
from .._units import length_of
from .._validation import require_kind, require_number, require_positive
from .aperture import Aperture
from .arithmetic import reciprocal, require_each
from .camera import Camera
from .disc import Disc
from .display import html_of_telecentric_lens
from .lens import AnyLensChanges, DepthOfField, ThinLens

if TYPE_CHECKING:
    from typing_extensions import Unpack

WIDEST_HALF_ANGLE = 80.0
"""Largest half-angle in degrees."""

TYPE = "telecentric"
"""What ``type`` says in :meth:`TelecentricLens.to_dict`."""

BEYOND = 1 / 16
"""How far beyond the farthest depth Z is, as a share of all depths' range."""

LEAST_BEYOND = 1e-3
"""The same as a share of the farthest depth, at least."""


@dataclasses.dataclass(frozen=True)
class TelecentricLens:
    """A telecentric lens, focused on a plane: for an orthographic camera.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``half_angle``                of the cone of light that a point of the film takes in, in
                                  degrees, 0 (a pinhole at infinity) to 80
    ``focus_distance``            U in scene units along the axis, finite; may be <= 0
    ``aperture``                  its shape: :class:`potmesil_mi.Disc` (default), ``Polygon`` or
                                  ``ImageAperture``, or text such as ``polygon:blades=6``. No
                                  aperture that diffracts
    ``squeeze``                   of an anamorphic lens: highlights are so many times as tall as
                                  wide; 1 (default) to 4
    ============================  ==========================================================

    It has no vignetting, and no fall-off of light with depth: each point of the film sees its cone
    filled, whatever the distance. Raises ``ValueError`` or ``TypeError`` that names the parameter,
    its value and what is allowed.
    """

    half_angle: float
    focus_distance: float
    aperture: Aperture | str = Disc()  # noqa: RUF009
    squeeze: float = 1.0

    def __post_init__(self) -> None:
        require_number("half_angle", self.half_angle, 0, WIDEST_HALF_ANGLE)
        focus_distance = length_of("focus_distance", self.focus_distance, None)
        require_number("focus_distance", focus_distance)
        object.__setattr__(self, "focus_distance", focus_distance)
        require_number("squeeze", self.squeeze, 1, 4)
        aperture = Aperture.parse(self.aperture)
        if aperture.diffracts:
            raise ValueError(
                f"aperture={aperture.name}: must not diffract for a TelecentricLens, which has no "
                "focal length to diffract with"
            )
        object.__setattr__(self, "aperture", aperture)

    @property
    def shape(self) -> Aperture:
        """The aperture as an object, whatever it was given as."""
        return Aperture.parse(self.aperture)

    @property
    def slope(self) -> float:
        """tan(a): radius of the circle of confusion per scene unit of depth."""
        return math.tan(math.radians(self.half_angle))

    def circle_of_confusion(self, depth: Any) -> Any:
        """Signed diameter in scene units of a point at ``depth``: 2 tan(a) (U - P).

        ``depth`` is a number or an array of NumPy or Dr.Jit, in scene units; ``inf`` is allowed.
        Positive nearer than the focused plane, negative beyond it.
        """
        require_each("depth", depth, "scene units", lambda x: ~np.isnan(x))
        if self.slope == 0:
            return 0.0 * reciprocal(1 + depth * depth)
        return 2 * self.slope * (self.focus_distance - depth)

    def depth_of_field(self, circle: float) -> DepthOfField:
        """Nearest and farthest depth with circles of at most ``circle``, a diameter in scene units.

        U ± circle / (2 tan(a)). Raises ``ValueError`` unless ``circle`` is > 0.
        """
        require_positive("circle", circle, "scene units")
        reach = circle / (2 * self.slope) if self.slope > 0 else math.inf
        return DepthOfField(self.focus_distance - reach, self.focus_distance + reach)

    def _repr_html_(self) -> str | None:
        return displayed(lambda: html_of_telecentric_lens(self))

    def parameters(self) -> dict[str, Any]:
        """The constructor's arguments."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    def plain(self) -> TelecentricLens:
        """The lens itself, which is one of plain numbers."""
        return self

    def replace(self, **changes: Unpack[AnyLensChanges]) -> TelecentricLens:
        """A lens with some parameters changed. Raises ``TypeError`` for an unknown name."""
        _require_known(changes)
        parameters: dict[str, Any] = {**self.parameters(), **changes}
        return TelecentricLens(**parameters)

    def to_dict(self) -> dict[str, Any]:
        """The parameters as numbers and text, as they are in JSON, and a ``type``."""
        return {"type": TYPE, **self.parameters(), "aperture": self.shape.describe()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TelecentricLens:
        """The inverse of :meth:`to_dict`, for values that come from a file.

        The text of its aperture names no file. Raises ``TypeError`` or ``ValueError`` that names
        what is unknown, missing, no number or out of range.
        """
        require_kind("values", values, Mapping, "a mapping, as to_dict gives")
        given = {name: value for name, value in values.items() if name != "type"}
        _require_known(given)
        for name in ("half_angle", "focus_distance"):
            if name not in given:
                raise TypeError(f"{name}: must be given for a TelecentricLens")
        aperture = Aperture.parse(given.get("aperture", Disc.name), from_file=True)
        return cls(**{**given, "aperture": aperture})


class ThinLensPicture(NamedTuple):
    """A thin lens that forms the picture of a telecentric one, of points whose depth is changed.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``lens``, ``camera``          the lens, and the perspective camera with the same film
    ``reference``                 Z, beyond all finite depths and the focused plane
    ============================  ==========================================================
    """

    lens: ThinLens
    camera: Camera
    reference: float

    def depth(self, depth: np.ndarray) -> np.ndarray:
        """1 / (Z - P), float32; a ray that hit nothing, at ``inf``, counts as one at Z."""
        finite = np.isfinite(depth)
        vergence = self.reference - np.where(finite, depth, 0).astype(np.float64)
        return np.where(finite, 1 / vergence, np.inf).astype(np.float32)


def as_thin_lens(depth: np.ndarray, lens: TelecentricLens, camera: Camera) -> ThinLensPicture:
    """What forms the picture of ``lens`` before points at ``depth``, (N,), of ``camera``.

    Z is the same for every focus that is not beyond the farthest of the points.
    """
    finite = depth[np.isfinite(depth)].astype(np.float64)
    nearest, farthest = (finite.min(), finite.max()) if finite.size else (1.0, 1.0)
    beyond = max(BEYOND * float(farthest - nearest), LEAST_BEYOND * abs(float(farthest)))
    reference = float(farthest) + beyond
    if lens.focus_distance > reference - beyond / 2:
        reference = lens.focus_distance + max(beyond, LEAST_BEYOND * abs(lens.focus_distance))
    perspective = dataclasses.replace(camera, projection="perspective", x_fov=90.0, film_width=None)
    focused = 1 / (reference - lens.focus_distance)
    thin_lens = ThinLens(
        1.0,
        focus_distance=focused,
        aperture_radius=lens.slope * camera.pixels_per_unit / perspective.focal_length_pixels,
        millimeters_per_unit=1e6 / focused,  # so the focal length is short beside the distance
        film="focused",
        aperture=lens.shape,
        squeeze=lens.squeeze,
    )
    return ThinLensPicture(thin_lens, perspective, reference)


def require_fitting(camera: Camera, lens: ThinLens | TelecentricLens) -> None:
    """Raise ``ValueError`` for a lens of the other kind than the camera's projection needs.

    Raises ``TypeError`` for what is no camera or no lens.
    """
    require_kind("camera", camera, Camera, "a Camera")
    require_lens(lens)
    telecentric = isinstance(lens, TelecentricLens)
    if telecentric != (camera.projection == "orthographic"):
        needed = "ThinLens" if telecentric else "TelecentricLens"
        raise ValueError(
            f"lens={type(lens).__name__}: must be a {needed} for a camera of "
            f"projection={camera.projection!r}"
        )


def is_open(lens: ThinLens | TelecentricLens) -> bool:
    """Whether a lens of either kind has an aperture, and is no pinhole."""
    plain = lens.plain()
    opening = plain.aperture_radius if isinstance(plain, ThinLens) else plain.slope
    return bool(opening > 0)


def require_lens(lens: Any) -> None:
    """Raise ``TypeError`` for what is no lens."""
    kinds = (ThinLens, TelecentricLens)
    require_kind("lens", lens, kinds, "a ThinLens, such as samples.lens, or a TelecentricLens")


def _require_known(given: Mapping[str, Any]) -> None:
    names = {field.name for field in dataclasses.fields(TelecentricLens)}
    unknown = sorted(str(name) for name in given if name not in names)
    if unknown:
        known = ", ".join(sorted(names))
        raise TypeError(f"{unknown[0]}: not a parameter of TelecentricLens, which has {known}")
