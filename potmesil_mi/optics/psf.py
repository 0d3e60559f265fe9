"""Point-spread functions: how a lens spreads the light of one point over the film.

Section 3.2 of Potmesil & Chakravarty (1981), figure 9: the focus processor asks a point-spread
function for its table, the integrals of the intensity over the squares of a grid. Here it is the
aperture of the lens that has one: :class:`Disc`, :class:`Polygon`, :class:`ImageAperture`, by
geometric optics, and :class:`Lommel` by diffraction.

Apertures are described as a photographer sees them from behind the camera, the right way up. So
highlights beyond the focused plane show them; nearer ones show them upside down.
"""

from __future__ import annotations

import base64
import dataclasses
import functools
import math
import os
import zlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from .._spec import describe, described
from .._validation import require_number, require_whole
from .diffraction import encircled_energy, optical_coordinates

if TYPE_CHECKING:
    from .lens import ThinLens

SHARP = 1e-6
"""Least radius of a circle, in grid squares: a sharp point is a circle of this size."""

HARDLY = 0.25
"""Radius in grid squares of a circle within which a truncated pattern is taken as uniform."""

TAIL = 1 / 400
"""Share of the light, at most, that a diffraction pattern has beyond its table. What the table
has is divided by its sum, so that none is lost."""

MOST_PARTS, MOST_A_SIDE = 1 << 20, 16
"""Parts, at most, into which the squares of a diffraction pattern's table are divided, in all, and
on a side of a square."""

CORE, FINE = 8, 0.25
"""In so many squares around the middle of a diffraction pattern parts are of so much of v."""

FINE_SIZE = 128
"""Radius, in squares, of the table in which the variances of an aperture are measured."""

ARC = 0.05
"""Angle in radians, at most, of the straight pieces of which a curved blade is made."""

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


class PointSpreadFunction(Protocol):
    """What the focus stage asks of a distribution of intensity."""

    def table(
        self,
        lens: ThinLens,
        depth: float,
        squares_per_mm: float,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """Integrals of the intensity of a point at ``depth`` over the squares of a grid.

        ``depth`` is in scene units (``inf`` is allowed), ``squares_per_mm`` the number of grid
        squares in a millimetre of film, ``offset`` the position (x, y) of the point in its
        square, from 0 (the left or upper edge) to 1; an array (..., 2) asks for many tables.
        Returns float64 of shape (..., 2K+1, 2L+1), rows and columns, whose middle element is the
        point's own square; each table sums to 1. ``largest`` bounds (L, K): what lies farther
        out is left out, for a grid of so many columns and rows cannot see it.
        """
        ...


class Aperture:
    """An aperture of the lens, and the point-spread function that goes with it.

    What has the ``table`` of :class:`PointSpreadFunction` and no more can be given to
    :func:`potmesil_mi.focus` as ``psf``, too.
    """

    name: ClassVar[str]

    finest: ClassVar[float] = 6
    """Radius of a circle, in grid squares, at which its table shows all there is to be seen."""

    diffracts: ClassVar[bool] = False
    """Whether the light goes beyond the circle of confusion, in patterns that change with it."""

    is_round: ClassVar[bool] = False
    """Whether it looks the same however it is turned."""

    @property
    def channels(self) -> tuple[PointSpreadFunction, ...]:
        """Those of red, green and blue, or one for all of them."""
        return (self,)

    def table(
        self,
        lens: ThinLens,
        depth: float,
        squares_per_mm: float,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """See :meth:`PointSpreadFunction.table`."""
        radius = float(lens.circle_of_confusion(depth)) * squares_per_mm / 2
        return self.circle_table(radius, float(lens.squeeze), offset, largest)

    def circle_table(
        self,
        radius: float,
        squeeze: float = 1.0,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """The table of a circle of a radius in squares, positive nearer than what is focused."""
        offset = np.asarray(offset, dtype=np.float64)
        size = max(abs(radius), SHARP)
        if radius > 0:  # Upside down.
            return self._grid(size, squeeze, 1 - offset, largest)[..., ::-1, ::-1]
        return self._grid(size, squeeze, offset, largest)

    def _grid(
        self,
        radius: float,
        squeeze: float,
        offset: np.ndarray,
        largest: tuple[int, int] | None,
    ) -> np.ndarray:
        """The table of the aperture itself, ``radius`` squares in size."""
        x, y = np.moveaxis(offset, -1, 0)
        reach_x, reach_y = math.ceil(radius / squeeze), math.ceil(radius)
        if largest is not None:
            reach_x, reach_y = min(reach_x, largest[0]), min(reach_y, largest[1])
        area = self.corner_area(
            (np.arange(-reach_x, reach_x + 2) - x[..., None])[..., None, :] * (squeeze / radius),
            (np.arange(-reach_y, reach_y + 2) - y[..., None])[..., :, None] / radius,
        )
        return np.maximum(np.diff(np.diff(area, axis=-2), axis=-1), 0.0) / self._area

    @functools.cached_property
    def _area(self) -> float:
        beyond = np.array(2.0)
        return float(self.corner_area(beyond, beyond))

    @functools.cached_property
    def variances(self) -> tuple[float, float]:
        """Variances of what the aperture lets through, across and down, in radii squared."""
        table = self._grid(float(FINE_SIZE), 1.0, np.array([0.5, 0.5]), None)
        places = (np.arange(len(table)) - len(table) // 2) / FINE_SIZE
        weights = table.sum(axis=0), table.sum(axis=1)
        across, down = (float(w @ places**2 - (w @ places) ** 2) for w in weights)
        return across, down

    def corner_area(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """What the aperture lets through left of ``x`` and above ``y``, as an area.

        Coordinates are in radii of the aperture, x to the right and y downwards from its middle;
        arrays broadcast. What any rectangle lets through is the second difference of this.
        """
        raise NotImplementedError

    def transmission(self, size: int) -> np.ndarray:
        """What the aperture lets through, float64 (size, size), 0 to 1.

        Over the square around it, rows from the top, columns from the left, seen from behind the
        camera: integrated over the elements.
        """
        edges = np.linspace(-1, 1, size + 1)
        area = self.corner_area(edges[None, :], edges[:, None])
        return np.clip(np.diff(np.diff(area, axis=0), axis=1) * (size / 2) ** 2, 0, 1)

    def points(self, count: int) -> np.ndarray:
        """Points spread evenly over the aperture, (count, 2), in radii, x right and y downwards."""
        return lens_points(count)

    def describe(self) -> str:
        """One word of text, of which :func:`aperture_of` makes an equal aperture."""
        names = [field.name for field in dataclasses.fields(self)]  # type: ignore[arg-type]
        return describe(self.name, {name: getattr(self, name) for name in names})


@dataclasses.dataclass(frozen=True)
class Disc(Aperture):
    """A round aperture: uniform intensity over the circle of confusion, equation 8."""

    name: ClassVar[str] = "disc"
    is_round: ClassVar[bool] = True

    def corner_area(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :meth:`Aperture.corner_area`."""
        return disc_corner_area(x, y)


@dataclasses.dataclass(frozen=True)
class Polygon(Aperture):
    """An aperture of blades: its corners lie on the circle of the aperture's radius.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``blades``                    number of blades, 3 to 64 (default 6)
    ``rotation``                  degrees by which it is turned, anticlockwise as seen from
                                  behind the camera; at 0 (default) a corner is at the top
    ``curvature``                 of the blades, from 0 (default), straight, to 1, the circle
    ============================  ==========================================================
    """

    blades: int = 6
    rotation: float = 0.0
    curvature: float = 0.0

    name: ClassVar[str] = "polygon"

    def __post_init__(self) -> None:
        require_whole("blades", self.blades, 3, 64)
        require_number("rotation", self.rotation)
        require_number("curvature", self.curvature, 0, 1)

    @functools.cached_property
    def corners(self) -> np.ndarray:
        """Corners (N, 2), x right and y downwards; a curved blade is of several straight pieces."""
        step = 2 * math.pi / self.blades
        # The blade is an arc through both corners, of a circle whose curvature is the parameter's.
        half, middle = math.sin(step / 2), math.cos(step / 2)
        angle = self.curvature * step / 2
        pieces = max(1, math.ceil(2 * angle / ARC))
        share = np.linspace(-1, 1, pieces, endpoint=False)
        if angle > 0:
            size = half / math.sin(angle)
            x = size * np.sin(share * angle)
            y = middle + size * (np.cos(share * angle) - math.cos(angle))
        else:
            x, y = half * share, np.full(pieces, middle)
        turns = (np.arange(self.blades) + 0.5) * step - math.radians(self.rotation)
        cosine, sine = np.cos(turns)[:, None], np.sin(turns)[:, None]
        # Clockwise from the top, where y is up; then y downwards.
        right, up = x * cosine + y * sine, y * cosine - x * sine
        return np.stack([right.ravel(), -up.ravel()], axis=-1)

    def corner_area(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :meth:`Aperture.corner_area`; in closed form, by Green's theorem along the edges."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        area = np.zeros(x.shape)
        ends = np.roll(self.corners, -1, axis=0)
        for (x0, y0), (x1, y1) in zip(self.corners.tolist(), ends.tolist(), strict=True):
            if y0 == y1:
                continue
            # Along the edge above y: the integral over y of the smaller of the edge's x and x.
            t = np.clip((y - y0) / (y1 - y0), 0, 1)
            first, last = (0.0, t) if y1 > y0 else (t, 1.0)
            area += (y1 - y0) * (
                _integral_of_lesser(x0, x1, x, last) - _integral_of_lesser(x0, x1, x, first)
            )
        return area

    def points(self, count: int) -> np.ndarray:
        """See :meth:`Aperture.points`: those of the disc, each sector drawn to the same share."""
        corners = np.concatenate([self.corners, self.corners[:1]])
        x, y = corners.T
        sectors = (x[:-1] * y[1:] - x[1:] * y[:-1]) / 2
        shares = np.concatenate([[0], np.cumsum(sectors)]) / sectors.sum()
        k = np.arange(count)
        turn = (k * GOLDEN_ANGLE / (2 * math.pi)) % 1
        sector = np.minimum(np.searchsorted(shares, turn, side="right") - 1, len(sectors) - 1)
        along = ((turn - shares[sector]) / np.diff(shares)[sector])[:, None]
        edge = corners[sector] * (1 - along) + corners[sector + 1] * along
        return edge * np.sqrt((k + 0.5) / count)[:, None]


@dataclasses.dataclass(frozen=True, eq=False)
class ImageAperture(Aperture):
    """Any picture as the aperture.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``transmission_map``          what it lets through, (H, W), >= 0, brightest 1 (values are
                                  divided by the largest): rows from the top, as seen from
                                  behind the camera. Its larger side is the diameter of the
                                  aperture; what is outside the circle lets nothing through
    ============================  ==========================================================

    Raises ``ValueError`` for a picture that is empty, not finite, negative or black, or of more
    than 4096 elements on a side.
    """

    transmission_map: np.ndarray

    name: ClassVar[str] = "image"
    finest: ClassVar[float] = 32

    def __post_init__(self) -> None:
        values = np.array(self.transmission_map, dtype=np.float64)
        if values.ndim != 2 or values.size == 0 or max(values.shape) > 4096:
            raise ValueError(
                f"transmission_map: has shape {values.shape}, must be (H, W) of at most 4096"
            )
        down, across = np.indices(values.shape) + 0.5
        height, width = values.shape
        outside = np.hypot(across - width / 2, down - height / 2) > max(height, width) / 2
        if not (np.isfinite(values).all() and (values >= 0).all() and values[~outside].any()):
            raise ValueError(
                "transmission_map: must be finite, >= 0, and in the circle somewhere more than 0"
            )
        values[outside] = 0
        values /= values.max()
        values.setflags(write=False)
        object.__setattr__(self, "transmission_map", values)

    @classmethod
    def load(cls, filename: str | os.PathLike[str]) -> ImageAperture:
        """The luminance of a picture in a file that Mitsuba can read: PNG, JPEG, EXR, ..."""
        import mitsuba as mi

        if not os.path.exists(filename):
            raise FileNotFoundError(f"filename={os.fspath(filename)!r}: there is no such file")
        bitmap = mi.Bitmap(os.fspath(filename)).convert(
            mi.Bitmap.PixelFormat.Y, mi.Struct.Type.Float32, srgb_gamma=False
        )
        return cls(np.array(bitmap, dtype=np.float64).reshape(bitmap.size()[::-1]))

    @functools.cached_property
    def _integral(self) -> np.ndarray:
        height, width = self.transmission_map.shape
        integral = np.zeros((height + 1, width + 1))
        integral[1:, 1:] = self.transmission_map.cumsum(axis=0).cumsum(axis=1)
        return integral * (2 / max(height, width)) ** 2

    def corner_area(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :meth:`Aperture.corner_area`; elements are uniform squares."""
        height, width = self.transmission_map.shape
        scale = max(height, width) / 2
        return _bilinear(self._integral, x * scale + width / 2, y * scale + height / 2)

    def points(self, count: int) -> np.ndarray:
        """See :meth:`Aperture.points`: as dense as what it lets through."""
        height, width = self.transmission_map.shape
        # Of a sequence that fills the square evenly, by the golden section: by the inverse of the
        # distribution of rows, and in a row of columns.
        k = np.arange(count)
        first = (k + 0.5) / count
        second = (0.5 + k * (math.sqrt(5) - 1) / 2) % 1
        rows = np.concatenate([[0], self._integral[1:, -1]])
        y = np.interp(first * rows[-1], rows, np.arange(height + 1))
        row = np.minimum(y.astype(int), height - 1)
        columns = np.cumsum(self.transmission_map[row], axis=1)
        columns = np.concatenate([np.zeros((count, 1)), columns], axis=1)
        x = np.array(
            [
                np.interp(share * column[-1], column, np.arange(width + 1))
                for share, column in zip(second, columns, strict=True)
            ]
        )
        return (np.stack([x, y], axis=-1) - [width / 2, height / 2]) * (2 / max(height, width))

    def describe(self) -> str:
        """See :meth:`Aperture.describe`; 16 bits an element, compressed."""
        levels = np.rint(self.transmission_map * 65535).astype("<u2")
        data = base64.urlsafe_b64encode(zlib.compress(levels.tobytes())).decode().rstrip("=")
        height, width = levels.shape
        return describe(self.name, {"width": width, "height": height, "data": data})

    @classmethod
    def _described(cls, width: int, height: int, data: str) -> ImageAperture:
        filled = str(data) + "=" * (-len(str(data)) % 4)
        levels = np.frombuffer(zlib.decompress(base64.urlsafe_b64decode(filled)), "<u2")
        return cls(levels.reshape(height, width) / 65535)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ImageAperture):
            return NotImplemented
        return self.describe() == other.describe()

    @functools.cached_property
    def _hash(self) -> int:
        return hash(self.transmission_map.tobytes())

    def __hash__(self) -> int:
        return self._hash

    def __repr__(self) -> str:
        return f"ImageAperture({'x'.join(map(str, self.transmission_map.shape[::-1]))})"


SPECTRUM = "spectrum"

BANDS: Mapping[int, tuple[float, float, int]] = {
    0: (560, 680, 9),
    1: (490, 610, 9),
    2: (410, 510, 9),
}
"""Least and greatest wavelength in nm of red, green and blue, and how many between."""


@dataclasses.dataclass(frozen=True)
class Lommel(Aperture):
    """A round aperture as diffraction has it: equations 12 to 19.

    In focus it is Airy's pattern, out of focus Lommel's; see :mod:`potmesil_mi.diffraction`.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``wavelengths``               in nm, 100 to 100000: three for red, green and blue (default
                                  610, 550, 465), or one for all, or ``spectrum``: each channel
                                  is the mean over nine wavelengths of its part of the visible
                                  spectrum, by what an sRGB film takes of each
    ``truncated``                 the pattern ends at the circle of confusion, as in the paper
                                  (section 3.2); by default it is kept whole, but for
                                  1/400 of the light
    ``argument``                  ``consistent`` (default): the edge of the geometric shadow is
                                  the circle of equation 8. ``paper``: equations 15 and 16 as
                                  printed, with F in the place of V
    ============================  ==========================================================
    """

    wavelengths: tuple[float, ...] | str = (610.0, 550.0, 465.0)
    truncated: bool = False
    argument: str = "consistent"

    name: ClassVar[str] = "lommel"
    finest: ClassVar[float] = math.inf
    diffracts: ClassVar[bool] = True
    is_round: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if isinstance(self.wavelengths, str):
            if self.wavelengths != SPECTRUM:
                raise ValueError(
                    f"wavelengths={self.wavelengths!r}: must be one or three numbers in nm, or "
                    f"{SPECTRUM!r}"
                )
        else:
            given = np.atleast_1d(np.asarray(self.wavelengths, dtype=object)).tolist()
            if len(given) not in (1, 3):
                raise ValueError(f"wavelengths={self.wavelengths}: must be one or three")
            for value in given:
                require_number("wavelengths", value, 100, 100_000)
            object.__setattr__(self, "wavelengths", tuple(float(value) for value in given))
        if not isinstance(self.truncated, (bool, np.bool_)):
            raise TypeError(f"truncated={self.truncated!r}: must be True or False")
        if self.argument not in ("consistent", "paper"):
            raise ValueError(f"argument={self.argument!r}: must be one of consistent, paper")

    @property
    def channels(self) -> tuple[PointSpreadFunction, ...]:
        """See :attr:`Aperture.channels`."""
        if isinstance(self.wavelengths, str):
            lines = [_sensitivity(channel) for channel in BANDS]
        else:
            lines = [((wavelength, 1.0),) for wavelength in self.wavelengths]
        return tuple(_Channel(line, self.truncated, self.argument) for line in lines)

    def table(
        self,
        lens: ThinLens,
        depth: float,
        squares_per_mm: float,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """See :meth:`PointSpreadFunction.table`: the mean of the channels."""
        radius = abs(float(lens.circle_of_confusion(depth))) * squares_per_mm / 2
        end = radius if self.truncated else math.inf
        if end < HARDLY:
            return disc_table(end, offset, largest)
        tables = []
        for wavelength, share in self._lines():
            u, per_mm = (
                abs(float(np.asarray(value)))
                for value in optical_coordinates(lens, depth, 1.0, wavelength, self.argument)
            )
            pattern = (_significant(u), _significant(per_mm / squares_per_mm), _significant(end))
            tables.append((_diffraction_table(*pattern, offset, largest), share))
        return _mean_table(tables)

    def _lines(self) -> list[tuple[float, float]]:
        """Wavelengths in nm and their shares, in all 1 for each channel."""
        return [line for channel in self.channels for line in channel._lines()]  # type: ignore[attr-defined]

    def corner_area(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :meth:`Aperture.corner_area`."""
        return disc_corner_area(x, y)


@dataclasses.dataclass(frozen=True)
class _Channel(Lommel):
    """The pattern of one channel; ``wavelengths`` are (nm, share)."""

    wavelengths: tuple[tuple[float, float], ...] = ()  # type: ignore[assignment]

    def __post_init__(self) -> None:
        pass

    @property
    def channels(self) -> tuple[PointSpreadFunction, ...]:
        """See :attr:`Aperture.channels`."""
        return (self,)

    def _lines(self) -> list[tuple[float, float]]:
        return list(self.wavelengths)


def aperture_of(description: Aperture | str) -> Aperture:
    """An aperture from text, or itself.

    The text is that of :meth:`Aperture.describe`: ``disc``, ``polygon:blades=6,rotation=15``,
    ``lommel:wavelengths=610/550/465``; or ``image:filename=heart.png``. Raises ``TypeError`` for
    what is neither, ``ValueError`` for an unknown name or parameter.
    """
    if isinstance(description, Aperture):
        return description
    if not isinstance(description, str):
        raise TypeError(
            f"aperture={description!r}: must be one of Disc(), Polygon(), Lommel(), "
            "ImageAperture(), or text such as polygon:blades=6"
        )
    return aperture_with(*described(description, "aperture"))


def aperture_with(name: str, parameters: Mapping[str, Any]) -> Aperture:
    """The aperture of that name with these parameters; errors are those of :func:`aperture_of`."""
    if name not in APERTURES:
        raise ValueError(f"aperture={name!r}: must be one of {', '.join(APERTURES)}")
    kind: Any = APERTURES[name]
    known = [field.name for field in dataclasses.fields(kind)]
    if name == ImageAperture.name:
        if parameters.keys() == {"width", "height", "data"}:
            return ImageAperture._described(**parameters)
        kind, known = ImageAperture.load, ["filename"]
    unknown = sorted(set(parameters) - set(known))
    if unknown:
        raise ValueError(
            f"{unknown[0]}: not a parameter of the aperture {name}, which has "
            f"{', '.join(known) or 'none'}"
        )
    if name == ImageAperture.name and not parameters:
        raise ValueError("filename: must be given for the aperture image")
    return kind(**parameters)


def aperture_behind(psf: PointSpreadFunction) -> Aperture:
    """The aperture that ``psf`` is; what is no more than its tables stands for a round one."""
    return psf if isinstance(psf, Aperture) else Disc()


APERTURES: Mapping[str, type[Aperture]] = {
    kind.name: kind for kind in (Disc, Polygon, Lommel, ImageAperture)
}


def lens_points(count: int) -> np.ndarray:
    """Points spread evenly over the unit disc, (count, 2): H. Vogel's sunflower (1979)."""
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), k * GOLDEN_ANGLE
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def disc_table(
    radius: float,
    offset: ArrayLike = (0.5, 0.5),
    largest: tuple[int, int] | None = None,
) -> np.ndarray:
    """The table, as of :class:`PointSpreadFunction`, of a disc of ``radius`` squares."""
    offset = np.asarray(offset, dtype=np.float64)
    return Disc()._grid(max(radius, SHARP), 1.0, offset, largest)


def disc_corner_area(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Area of the unit disc that lies left of ``x`` and above ``y``, in closed form.

    The part of any axis-aligned rectangle inside a disc is the second difference of this.
    """
    x, y = np.broadcast_arrays(np.clip(x, -1.0, 1.0), np.clip(y, -1.0, 1.0))
    inside = x * x + y * y < 1
    # Twice the area left of x, under the chord's arc: the disc's own half-plane areas.
    half_x = x * np.sqrt(1 - x * x) + np.arcsin(x) + math.pi / 2
    half_y = y * np.sqrt(1 - y * y) + np.arcsin(y) + math.pi / 2
    corner_inside = (half_x + half_y) / 2 + x * y - math.pi / 4
    # A corner outside the circle cuts off nothing more than its two half-planes do.
    both = np.where((x > 0) & (y > 0), half_x + half_y - math.pi, 0.0)
    one_x = np.where((x <= 0) & (y > 0), half_x, 0.0)
    one_y = np.where((x > 0) & (y <= 0), half_y, 0.0)
    return np.where(inside, corner_inside, both + one_x + one_y)


def _integral_of_lesser(x0: float, x1: float, most: np.ndarray, t: Any) -> np.ndarray:
    """Integral from 0 to ``t`` of the lesser of x0 + (x1 - x0) s and ``most``."""
    slope = x1 - x0
    if slope == 0:
        return np.minimum(x0, most) * t
    crossing = np.clip((most - x0) / slope, 0, t)

    def under(end: Any) -> Any:
        return x0 * end + slope / 2 * end * end

    if slope > 0:
        return under(crossing) + most * (t - crossing)
    return most * crossing + under(t) - under(crossing)


def _bilinear(values: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """``values`` (H, W) at columns x and rows y, beyond the border those of the border."""
    height, width = values.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    column = np.minimum(np.floor(x).astype(int), width - 2)
    row = np.minimum(np.floor(y).astype(int), height - 2)
    fx, fy = x - column, y - row
    upper = values[row, column] * (1 - fx) + values[row, column + 1] * fx
    lower = values[row + 1, column] * (1 - fx) + values[row + 1, column + 1] * fx
    return upper * (1 - fy) + lower * fy


# ---------------------------------------------------------------- diffraction


def _significant(value: float) -> float:
    """``value`` to nine digits: what rounding makes of one lens is one pattern."""
    return float(f"{value:.9g}")


def _diffraction_table(
    u: float,
    v_per_square: float,
    end: float,
    offset: ArrayLike,
    largest: tuple[int, int] | None,
) -> np.ndarray:
    """The table of I(u, v); ``v_per_square`` is v a square from the middle, ``end`` in squares."""
    places = np.asarray(offset, dtype=np.float64)
    if places.shape == (2,):
        return _one_diffraction_table(u, v_per_square, end, tuple(places.tolist()), largest)
    return _diffraction_tables(u, v_per_square, end, places, largest)


@functools.lru_cache(maxsize=256)
def _one_diffraction_table(
    u: float,
    v_per_square: float,
    end: float,
    offset: tuple[float, float],
    largest: tuple[int, int] | None,
) -> np.ndarray:
    table = _diffraction_tables(u, v_per_square, end, np.array(offset), largest)
    table.setflags(write=False)
    return table


def _diffraction_tables(
    u: float,
    v_per_square: float,
    end: float,
    offset: np.ndarray,
    largest: tuple[int, int] | None,
) -> np.ndarray:
    reach, integral, parts, whole = _diffraction_integral(u, v_per_square, end, largest)
    reach_x, reach_y = (reach, reach) if largest is None else (min(reach, n) for n in largest)
    x, y = np.moveaxis(offset, -1, 0)
    middle = (reach + 1) * parts
    columns = (np.arange(-reach_x, reach_x + 2) - x[..., None])[..., None, :] * parts + middle
    rows = (np.arange(-reach_y, reach_y + 2) - y[..., None])[..., :, None] * parts + middle
    table = np.diff(np.diff(_bilinear(integral, columns, rows), axis=-2), axis=-1)
    return np.maximum(table, 0) / whole


@functools.lru_cache(maxsize=4)
def _diffraction_integral(
    u: float, v_per_square: float, end: float, largest: tuple[int, int] | None
) -> tuple[int, np.ndarray, int, float]:
    """How far the pattern reaches, what is left of and above a corner, parts a square, the whole.

    The light of a ring is known in closed form, so each part of a square, whatever the fringes
    in it, gets the mean of the ring that goes through it.
    """
    farthest = math.inf if largest is None else math.hypot(*largest) + 1
    limit = min(_reach(u, v_per_square), end)
    radius = min(limit, farthest)
    reach = max(math.ceil(radius), 1)
    if largest is not None:
        reach = min(reach, max(largest))
    parts = min(
        int(math.sqrt(MOST_PARTS) / (2 * reach + 2)), MOST_A_SIDE, math.ceil(v_per_square / FINE)
    )
    parts = max(parts // 2 * 2, 2)
    farthest = (reach + 1) * math.sqrt(2)
    # Finer parts and rings in the middle, where the pattern is steepest.
    core = min(CORE, reach + 1)
    finer = math.ceil(
        min(v_per_square / (parts * FINE), math.sqrt(MOST_PARTS) / (2 * core * parts))
    )
    finest = 0.5 / (parts * finer)
    radii = np.arange(0, math.ceil((core + 1) * math.sqrt(2) / finest)) * finest
    beyond = np.arange(radii[-1] + 0.5 / parts, farthest + 2 / parts, 0.5 / parts)
    radii = np.concatenate([radii, beyond])
    energy = encircled_energy(u, np.minimum(radii, end) * v_per_square)

    def quarter(squares: int, parts: int) -> np.ndarray:
        """The light of the parts of so many squares left of and above the middle."""
        axis = (np.arange(squares * parts) + 0.5) / parts - squares
        distance, half = np.hypot(axis[:, None], axis[None, :]), 0.5 / parts
        inner, outer = np.maximum(distance - half, 0), distance + half
        light = np.interp(outer, radii, energy) - np.interp(inner, radii, energy)
        light *= 1 / (math.pi * (outer**2 - inner**2) * parts**2)
        light[distance > limit + 2 * half] = 0
        return light

    light = quarter(reach + 1, parts)
    middle = quarter(core, parts * finer).reshape(core * parts, finer, core * parts, finer)
    light[-core * parts :, -core * parts :] = middle.sum(axis=(1, 3))
    light = np.concatenate([light, light[:, ::-1]], axis=1)
    light = np.concatenate([light, light[::-1]], axis=0)
    integral = np.zeros((len(light) + 1, len(light) + 1))
    integral[1:, 1:] = light.cumsum(axis=0).cumsum(axis=1)
    whole = float(encircled_energy(u, limit * v_per_square))
    if limit <= reach:  # What the rings' approximation makes of it.
        whole = float(integral[-1, -1])
    return reach, integral, parts, whole


def _reach(u: float, v_per_square: float) -> float:
    """Squares beyond which the pattern has no more than ``TAIL`` of its light."""
    v = u + 2 ** np.arange(1, 24, 0.25)
    beyond = 1 - encircled_energy(u, v)
    within = np.flatnonzero(beyond <= TAIL)
    return float(v[within[0] if len(within) else -1]) / v_per_square


def _mean_table(tables: list[tuple[np.ndarray, float]]) -> np.ndarray:
    """The weighted mean of tables of unequal size."""
    rows, columns = (max(table.shape[axis] for table, _ in tables) for axis in (-2, -1))
    total = np.zeros((*tables[0][0].shape[:-2], rows, columns))
    for table, weight in tables:
        row, column = (rows - table.shape[-2]) // 2, (columns - table.shape[-1]) // 2
        total[..., row : rows - row, column : columns - column] += weight * table
    return total / sum(weight for _, weight in tables)


def _sensitivity(channel: int) -> tuple[tuple[float, float], ...]:
    """Wavelengths in nm, and which share of a channel of an sRGB film each has.

    The colour matching functions are the analytic fits of Wyman, Sloan and Shirley (2013).
    """
    least, most, count = BANDS[channel]
    wavelength = np.linspace(least, most, count)

    def lobe(height: float, middle: float, left: float, right: float) -> np.ndarray:
        slope = np.where(wavelength < middle, left, right)
        return height * np.exp(-0.5 * np.square((wavelength - middle) * slope))

    x = lobe(0.362, 442.0, 0.0624, 0.0374) + lobe(1.056, 599.8, 0.0264, 0.0323)
    x += lobe(-0.065, 501.1, 0.0490, 0.0382)
    y = lobe(0.821, 568.8, 0.0213, 0.0247) + lobe(0.286, 530.9, 0.0613, 0.0322)
    z = lobe(1.217, 437.0, 0.0845, 0.0278) + lobe(0.681, 459.0, 0.0385, 0.0725)
    to_rgb = ((3.2406, -1.5372, -0.4986), (-0.9689, 1.8758, 0.0415), (0.0557, -0.2040, 1.0570))
    taken = sum(c * f for c, f in zip(to_rgb[channel], (x, y, z), strict=True))
    share = np.maximum(taken, 0) / np.maximum(taken, 0).sum()
    return tuple(zip(wavelength.tolist(), share.tolist(), strict=True))
