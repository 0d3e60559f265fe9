"""The finite aperture: lens law, depth of field and circle of confusion.

Section 2.2 and 2.3 of Potmesil & Chakravarty, "A Lens and Aperture Camera Model for Synthetic
Image Generation", SIGGRAPH 1981; equation numbers in brackets are the paper's. Nothing here needs
a Mitsuba variant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypedDict, get_args

import numpy as np

from .._html import displayed
from .._validation import require_choice, require_field_of_view, require_kind, require_number, shown
from .aperture import Aperture
from .arithmetic import clamp_at_zero, on_host, positive_finite, reciprocal, require_each, single
from .disc import Disc
from .display import html_of_thin_lens
from .lens_checks import (
    distance_in_mm,
    in_numbers,
    require_focus,
    require_length,
    require_one_opening,
    require_unit,
)

if TYPE_CHECKING:
    from typing_extensions import Unpack

ACUITY = 1e-3
"""Angular resolving power of the eye in radians: "1 mil", a patch of U/1000 (section 2.2)."""

FULL_FRAME_WIDTH = 36.0
"""Width of a 35 mm still frame in millimetres, assumed where no frame width is given."""

Film = Literal["focal", "focused"]
"""Where the picture forms: on a film fixed at F, or at the image of the focused plane."""

PLAIN = ("film", "aperture", "squeeze", "vignetting")
"""Parameters of a lens that are no arrays."""

FILMS: tuple[Film, ...] = get_args(Film)
"""The two places of the film."""


class LensOptions(TypedDict, total=False):
    """Parameters of :class:`ThinLens` but for the two that a field of view stands for."""

    f_number: Any
    focus_distance: Any
    aperture_radius: Any
    millimeters_per_unit: Any
    film: Film
    aperture: Aperture | str
    squeeze: float
    vignetting: float


class LensChanges(LensOptions, total=False):
    """What :meth:`ThinLens.replace` can change: the parameters of :class:`ThinLens`."""

    focal_length: Any
    frame_width: Any


class AnyLensChanges(LensChanges, total=False):
    """Parameters of the lens of any camera, whichever it turns out to be.

    What it does not have, :meth:`ThinLens.replace` or :meth:`TelecentricLens.replace` refuses.
    """

    half_angle: Any


class DepthOfField(NamedTuple):
    """Limits of what appears in focus, as distances from the lens in scene units."""

    near: Any
    far: Any

    @property
    def depth(self) -> Any:
        """``far - near`` in scene units."""
        return self.far - self.near


class ThinLens:
    """A thin lens with an aperture, focused on a plane: equations 1-8.

    Every parameter may be a number, a NumPy array or a Dr.Jit array (then every result is
    differentiable in it). Distances are along the optical axis, positive before the lens. A length
    may be text with its unit, ``1.2m``, ``29cm``, ``290mm`` or ``10in``, and an f-number ``f/2.8``.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``focal_length``              F in millimetres, > 0
    ``f_number``                  n, the aperture number, > 0; ``inf`` is a pinhole.
                                  Exactly one of ``f_number`` and ``aperture_radius``
    ``focus_distance``            U in scene units, beyond the focal length; ``inf``
                                  (default) is allowed
    ``aperture_radius``           R in scene units, >= 0: the ``aperture_radius`` of the
                                  equivalent ``thinlens``. F/(2n) with the film at the
                                  focused image, V_u/(2n) with the film at F
    ``frame_width``               width of the film in millimetres, > 0 (default 36)
    ``millimeters_per_unit``      size of a scene unit, > 0 (default 1: distances in
                                  millimetres; 1000 for a scene in metres)
    ``film``                      where the film is: ``focal``, fixed at F (the paper,
                                  default), or ``focused``, at the image of the focused
                                  plane (a real camera; its field of view changes as it
                                  is focused)
    ``aperture``                  its shape: :class:`potmesil_mi.Disc` (default), ``Polygon``,
                                  ``Lommel`` or ``ImageAperture``, or text such as
                                  ``polygon:blades=6``, see :func:`potmesil_mi.aperture_of`
    ``squeeze``                   of an anamorphic lens: highlights are so many times as tall
                                  as wide; 1 (default) to 4. The height is that of the
                                  aperture
    ``vignetting``                mechanical vignetting, 0 (default) to 0.9: seen from a corner
                                  of the frame the rim of the lens is shifted against the
                                  aperture by so much of its diameter, elsewhere by less in
                                  proportion; so highlights there look like a cat's eye
    ============================  ==========================================================

    Raises ``ValueError`` or ``TypeError`` that names the parameter, its value and what is allowed.
    """

    def __init__(
        self,
        focal_length: Any,
        f_number: Any = None,
        focus_distance: Any = math.inf,
        *,
        aperture_radius: Any = None,
        frame_width: Any = FULL_FRAME_WIDTH,
        millimeters_per_unit: Any = 1.0,
        film: Film = "focal",
        aperture: Aperture | str = Disc(),  # noqa: B008
        squeeze: float = 1.0,
        vignetting: float = 0.0,
    ) -> None:
        require_one_opening(f_number, aperture_radius)
        require_choice("film", film, FILMS)
        require_unit(millimeters_per_unit)
        texts = {"focal_length": focal_length, "frame_width": frame_width, "f_number": f_number}
        texts |= {"aperture_radius": aperture_radius, "focus_distance": focus_distance}
        focal_length, frame_width, f_number, aperture_radius, focus_distance = in_numbers(
            texts, millimeters_per_unit
        ).values()
        require_length("focal_length", focal_length)
        require_length("frame_width", frame_width)
        if f_number is not None:
            require_each("f_number", f_number, "> 0", lambda x: x > 0)
        if aperture_radius is not None:
            require_each(
                "aperture_radius",
                aperture_radius,
                ">= 0 scene units and finite",
                lambda x: (x >= 0) & np.isfinite(x),
            )
        require_focus(focus_distance, focal_length, millimeters_per_unit)
        require_number("squeeze", squeeze, 1, 4)
        require_number("vignetting", vignetting, 0, 0.9)
        aperture = Aperture.parse(aperture)
        if aperture.diffracts and (squeeze != 1 or vignetting != 0):
            raise ValueError(
                f"squeeze={squeeze}, vignetting={vignetting}: must be 1 and 0 with the aperture "
                f"{aperture.name}, whose pattern is that of a whole circle"
            )
        self.focal_length = focal_length
        self.focus_distance = focus_distance
        self.frame_width = frame_width
        self.millimeters_per_unit = millimeters_per_unit
        self.film: Film = film
        self.aperture = aperture
        self.squeeze = squeeze
        self.vignetting = vignetting
        self._f_number = f_number
        self._aperture_radius = aperture_radius

    @classmethod
    def of_field_of_view(
        cls,
        fov: float,
        *,
        focal_length: float | None = None,
        frame_width: float | None = None,
        **parameters: Unpack[LensOptions],
    ) -> ThinLens:
        """The lens whose frame covers ``fov`` degrees across.

        With ``focal_length`` (mm) the frame's width follows from it; without, the focal length
        follows from ``frame_width`` (mm, default 36). Other parameters as for ``ThinLens``.
        """
        require_field_of_view("fov", fov)
        _require_known(parameters)
        given: Any = {**parameters, "focal_length": focal_length, "frame_width": frame_width}
        given = in_numbers(given, parameters.get("millimeters_per_unit", 1.0))
        focal_length, frame_width = given.pop("focal_length"), given.pop("frame_width")
        parameters = given
        if focal_length is not None and frame_width is not None:
            raise ValueError(
                f"focal_length={shown(focal_length)}, frame_width={shown(frame_width)}: must not "
                "both be given with fov"
            )
        slope = 2 * math.tan(math.radians(fov) / 2)
        if focal_length is not None:
            lens = cls(focal_length, **parameters)
            return lens.replace(frame_width=slope * lens.film_distance)
        if frame_width is None:
            frame_width = FULL_FRAME_WIDTH
        require_length("frame_width", frame_width)
        focal_length = frame_width / slope
        film = parameters.get("film", "focal")
        require_choice("film", film, FILMS)
        focused = film == "focused"
        if focused:
            in_mm = distance_in_mm(
                parameters.get("focus_distance", math.inf),
                parameters.get("millimeters_per_unit", 1.0),
            )
            focal_length = 1 / (1 / focal_length + reciprocal(in_mm))
        try:
            return cls(focal_length, frame_width=frame_width, **parameters)
        except ValueError as error:
            if "focal_length" not in str(error):
                raise
            made_by = {"fov": fov, "frame_width": frame_width, **(parameters if focused else {})}
            of = ", ".join(f"{name}={shown(value)}" for name, value in made_by.items())
            raise ValueError(f"{error}; the focal length follows from {of}") from error

    def parameters(self) -> dict[str, Any]:
        """The constructor's arguments: ``ThinLens(**lens.parameters())`` equals ``lens``."""
        parameters = {
            "focal_length": self.focal_length,
            "focus_distance": self.focus_distance,
            "frame_width": self.frame_width,
            "millimeters_per_unit": self.millimeters_per_unit,
            "film": self.film,
            "aperture": self.aperture,
            "squeeze": self.squeeze,
            "vignetting": self.vignetting,
        }
        if self._f_number is not None:
            parameters["f_number"] = self._f_number
        else:
            parameters["aperture_radius"] = self._aperture_radius
        return parameters

    def plain(self) -> ThinLens:
        """The same lens of plain numbers; a parameter of several elements is an error."""
        parameters = self.parameters()
        if all(type(value) is float or name in PLAIN for name, value in parameters.items()):
            return self
        plain: dict[str, Any] = {
            name: value if isinstance(value, (str, Aperture)) else single(name, value)
            for name, value in parameters.items()
        }
        return ThinLens(**plain)

    def to_dict(self) -> dict[str, Any]:
        """:meth:`parameters` as numbers and text, as they are in JSON.

        A parameter of several elements is an error.
        """
        return {**self.plain().parameters(), "aperture": self.aperture.describe()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ThinLens:
        """The inverse of :meth:`to_dict`, for values that come from a file.

        The text of its aperture names no file. Files written before the parameter ``film`` had its
        name call it ``image_distance``. Raises ``TypeError`` or ``ValueError`` that names what is
        unknown, missing, no number or out of range.
        """
        require_kind("values", values, Mapping, "a mapping, as to_dict gives")
        given = dict(values)
        if "image_distance" in given:
            given["film"] = given.pop("image_distance")
        _require_known(given)
        if "focal_length" not in given:
            raise TypeError("focal_length: must be given for a ThinLens")
        for name, value in given.items():
            numeric = isinstance(value, (int, float)) and not isinstance(value, bool)
            if name not in ("film", "aperture") and not numeric:
                raise TypeError(f"{name}={shown(value)}: must be a number")
        require_choice("film", given.setdefault("film", "focal"), FILMS)
        aperture = Aperture.parse(given.get("aperture", Disc.name), from_file=True)
        return cls(**{**given, "aperture": aperture})

    def replace(self, **changes: Unpack[AnyLensChanges]) -> ThinLens:
        """A lens with some constructor arguments changed.

        ``f_number`` takes the place of an ``aperture_radius`` and the other way round; whichever
        of the two was given stays as the lens is focused. Raises ``TypeError`` for an unknown
        name.
        """
        parameters = self.parameters()
        _require_known(changes)
        if not changes.keys().isdisjoint({"f_number", "aperture_radius"}):
            parameters.pop("f_number", None)
            parameters.pop("aperture_radius", None)
        return ThinLens(**{**parameters, **changes})

    def in_units(self, millimeters_per_unit: Any) -> ThinLens:
        """The same lens, with its distances in scene units of another size."""
        require_unit(millimeters_per_unit)
        ratio = self.millimeters_per_unit / millimeters_per_unit
        changes = {"focus_distance": self.focus_distance * ratio}
        if self._aperture_radius is not None:
            changes["aperture_radius"] = self._aperture_radius * ratio
        return self.replace(millimeters_per_unit=millimeters_per_unit, **changes)

    @property
    def f_number(self) -> Any:
        """N = F/D, the aperture number."""
        if self._f_number is not None:
            return self._f_number
        opening = 2 * self._aperture_radius * self.millimeters_per_unit
        return self._aperture_reference * reciprocal(opening)

    @property
    def aperture_radius(self) -> Any:
        """R in scene units, the ``aperture_radius`` of the equivalent ``thinlens``."""
        if self._aperture_radius is not None:
            return self._aperture_radius
        diameter = self._aperture_reference * reciprocal(self._f_number)
        return diameter / (2 * self.millimeters_per_unit)

    @property
    def _aperture_reference(self) -> Any:
        """2nR in millimetres: F with the film at the focused image, V_u with the film at F."""
        return self.focal_length if self.film == "focused" else self.image_distance()

    @property
    def film_distance(self) -> Any:
        """Distance from the lens to the film in millimetres: F, or V_u where it is focused."""
        return self.image_distance() if self.film == "focused" else self.focal_length

    @property
    def lens_diameter(self) -> Any:
        """D = F/n in millimetres."""
        return self.focal_length * reciprocal(self.f_number)

    @property
    def fov(self) -> float:
        """Field of view across the frame, a plain number in degrees."""
        slope = single("fov", self.frame_width / (2 * self.film_distance))
        return math.degrees(2 * math.atan(slope))

    def image_distance(self, depth: Any = None) -> Any:
        """V in millimetres of the image of a point at ``depth`` (scene units): [1], [7].

        1/V = 1/F - 1/P; by default of the focused plane. Negative for a point inside the focal
        length, whose image is virtual, and infinite for one at the focal length.
        """
        if depth is None:
            depth = self.focus_distance
        else:
            require_each("depth", depth, "scene units", lambda x: ~np.isnan(x))
        return reciprocal(
            reciprocal(self.focal_length) - reciprocal(depth * self.millimeters_per_unit)
        )

    def circle_of_confusion(self, depth: Any) -> Any:
        """Signed diameter C on the film in millimetres of a point at ``depth`` (scene units).

        C = D V_u (1/P - 1/U): equation 8 in the form that is affine in 1/P, so it is valid at
        P <= F, at P = inf and at U = inf. Positive nearer than the focused plane, negative
        beyond it; its limit for P = inf is -F^2 / (n (U - F)). Raises ``ValueError`` for a
        negative depth.
        """
        require_each("depth", depth, ">= 0 scene units", lambda x: x >= 0)
        vergence = reciprocal(depth) - reciprocal(self.focus_distance)
        return self.lens_diameter * self.image_distance() * vergence / self.millimeters_per_unit

    def hyperfocal_distance(self, acuity: float = ACUITY) -> Any:
        """H = D / acuity in scene units, 1000 F/n by default (section 2.2)."""
        require_each("acuity", acuity, "> 0 radians", positive_finite)
        return self.lens_diameter / (acuity * self.millimeters_per_unit)

    def depth_of_field(self, acuity: float = ACUITY) -> DepthOfField:
        """Nearest and farthest distance that appear in focus, in scene units: [2]-[6].

        1/U± = 1/U ∓ 1/H; beyond the hyperfocal distance the far limit is infinite.
        """
        vergence = reciprocal(self.focus_distance)
        tolerance = reciprocal(self.hyperfocal_distance(acuity))
        return DepthOfField(
            near=reciprocal(vergence + tolerance),
            far=reciprocal(clamp_at_zero(vergence - tolerance)),
        )

    def to_thinlens(self) -> dict[str, Any]:
        """The exactly equivalent built-in sensor, as a dictionary for ``mi.load_dict``.

        Its aperture is a disc, whatever this one's.

        ``fov`` is along x. A pinhole (f-number ``inf``) gives ``perspective``. ``thinlens``
        cannot focus at infinity: there the distance is 1e9 aperture radii, which no pixel can
        tell from infinity.
        """
        radius = single("aperture_radius", self.aperture_radius)
        sensor: dict[str, Any] = {"type": "perspective", "fov": self.fov, "fov_axis": "x"}
        if radius > 0:
            focus_distance = single("focus_distance", self.focus_distance)
            sensor["type"] = "thinlens"
            sensor["aperture_radius"] = radius
            sensor["focus_distance"] = min(focus_distance, 1e9 * radius)
        return sensor

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ThinLens):
            return NotImplemented
        mine, theirs = self.parameters(), other.parameters()
        return (
            self.aperture == other.aperture
            and mine.keys() == theirs.keys()
            and all(
                np.array_equal(on_host(mine[key]), on_host(theirs[key]))
                for key in mine
                if key != "aperture"
            )
        )

    __hash__ = None  # type: ignore[assignment]

    def _repr_html_(self) -> str | None:
        return displayed(lambda: html_of_thin_lens(self))

    def __repr__(self) -> str:
        return f"ThinLens({', '.join(f'{k}={v!r}' for k, v in self.parameters().items())})"


def _require_known(names: Mapping[str, Any]) -> None:
    """Raise ``TypeError`` for one of the ``names`` that is no parameter of a lens."""
    known = sorted(LensChanges.__annotations__)
    unknown = sorted(str(name) for name in names if name not in known)
    if unknown:
        raise TypeError(f"{unknown[0]}: not a parameter of ThinLens, which has {', '.join(known)}")
