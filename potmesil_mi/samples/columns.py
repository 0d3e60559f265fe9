"""The columns of point samples: one array for each thing that is known of a sample."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from numbers import Real
from typing import Any, TypeVar

import numpy as np

from .._threads import for_each
from .._validation import require_kind, require_numbers, require_whole, shown
from ..optics.disc import lens_points

OF_DEFAULT: Any = None
"""What stands in a field that was not given, until ``__post_init__`` puts its default there."""

C = TypeVar("C", bound="Columns")


_FLOAT: dict[str, Any] = {"dtype": np.float32, "channels": 0}
_RGB: dict[str, Any] = {"dtype": np.float32, "channels": 3}
_ID: dict[str, Any] = {"dtype": np.uint32, "channels": 0}
_LAYER: dict[str, Any] = {"dtype": np.uint8, "channels": 0}
_OPTIONAL_FLOAT: dict[str, Any] = {"dtype": np.float32, "channels": 0, "optional": True}
_VISIBILITY: dict[str, Any] = {"dtype": np.uint64, "channels": 0, "optional": True}
_OPTIONAL_VECTOR: dict[str, Any] = {"dtype": np.float32, "channels": 3, "optional": True}
_AOVS: dict[str, Any] = {"dtype": np.float32, "channels": None, "optional": True}

ELSEWHERE = 255
"""``layer`` of what is on none of the rays of the pinhole."""

TWINS = 240
"""``layer`` of hidden twins, from this on to before ``ELSEWHERE``: of what a ray shows first, of
what is behind one veil, and so on."""

LONGEST_NORMAL = 1.001
"""Unit vectors are rounded."""

MOST_IDS = (1 << 32) - 1
"""The largest id of a surface."""

VISIBILITY_POINTS = 64
"""Points of the lens, one for each bit of ``visibility``."""

AT_ONCE = 1 << 22
"""Samples that are looked at together where what is found out of them takes memory of its own."""


@dataclasses.dataclass(frozen=True, eq=False)
class Columns:
    """N point samples, column by column.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``x``, ``y``                  float32 (N,), position in pixels of the whole film, from its
                                  top left corner; pixel i covers [i, i + 1]
    ``rgb``                       float32 (N, 3), radiance in linear sRGB, unfiltered
    ``alpha``                     float32 (N,), 1 where the nested integrator saw something
    ``z``                         float32 (N,), depth in scene units along the camera's axis,
                                  > 0; ``inf`` for a ray that hit nothing
    ``surface``                   uint32 (N,), id of the visible surface; 0 for none
    ``weight``                    float32 (N,), share of a pixel's area the sample stands for
    ``layer``                     uint8 (N,), how many surfaces the pinhole sees in front of it:
                                  0 for what it sees (default), 1 and more for what is hidden;
                                  240 to 254 for the part that panes and veils keep back of what
                                  it sees, and that is seen past their edges;
                                  255 for what is on none of its rays: its place is that where
                                  it would be seen
    ``through``                   float32 (N,), depth of the mirror or pane that it is seen
                                  through, its ``z`` being that of the image; 0 for what is seen
                                  directly; ``None`` where nothing is seen through anything
    ``visibility``                uint64 (N,), which of 64 points of the lens see it: bit i is
                                  set for point i; 0 where that is to be found out from the
                                  other samples; ``None`` for all of these
    ``albedo``                    float32 (N, 3), diffuse reflectance of what is seen, in linear
                                  sRGB, 0 to 1; 1 of what does not reflect diffusely; 0 of lamps,
                                  of the sky, of media and veils; ``None`` where it
                                  was not kept
    ``normal``                    float32 (N, 3), its shading normal in the world; 0 where
                                  ``albedo`` is for lamps and the like; ``None`` where
                                  it was not kept
    ``time``                      float32 (N,), part of the exposure, 0 to 1, that is over when the
                                  sample is where it is; ``None`` where all are of one time
    ``motion``                    float32 (N, 3), by how much x and y, in pixels, and z, in scene
                                  units, change during the part of the exposure that the sample
                                  stands for, half of it before its ``time`` and half after;
                                  ``None`` where all stands still
    ``aovs``                      float32 (N, K), further values that the nested integrator has of
                                  the sample's ray; ``None`` where it has none
    ============================  ==========================================================

    What is given becomes arrays of these types, without a copy where it is one. Raises
    ``ValueError`` for columns of unequal length or wrong shape, and for whole numbers that their
    type does not have, ``TypeError`` for what is no numbers.
    """

    x: np.ndarray = dataclasses.field(metadata=_FLOAT)
    y: np.ndarray = dataclasses.field(metadata=_FLOAT)
    rgb: np.ndarray = dataclasses.field(metadata=_RGB)
    alpha: np.ndarray = dataclasses.field(metadata=_FLOAT)
    z: np.ndarray = dataclasses.field(metadata=_FLOAT)
    surface: np.ndarray = dataclasses.field(metadata=_ID)
    weight: np.ndarray = dataclasses.field(metadata=_FLOAT)
    layer: np.ndarray = dataclasses.field(default=OF_DEFAULT, metadata=_LAYER)
    through: np.ndarray | None = dataclasses.field(default=None, metadata=_OPTIONAL_FLOAT)
    visibility: np.ndarray | None = dataclasses.field(default=None, metadata=_VISIBILITY)
    albedo: np.ndarray | None = dataclasses.field(default=None, metadata=_OPTIONAL_VECTOR)
    normal: np.ndarray | None = dataclasses.field(default=None, metadata=_OPTIONAL_VECTOR)
    time: np.ndarray | None = dataclasses.field(default=None, metadata=_OPTIONAL_FLOAT)
    motion: np.ndarray | None = dataclasses.field(default=None, metadata=_OPTIONAL_VECTOR)
    aovs: np.ndarray | None = dataclasses.field(default=None, metadata=_AOVS)

    def __post_init__(self) -> None:
        count = require_numbers("x", self.x).size
        if self.layer is OF_DEFAULT:
            object.__setattr__(self, "layer", np.zeros(count, dtype=np.uint8))
        for field in self.present():
            values = require_numbers(field.name, getattr(self, field.name))
            expected = shape_of(field, count, values.shape[1] if values.ndim == 2 else 1)
            if values.shape != expected:
                raise ValueError(
                    f"{field.name}={shown(values)}: has shape {values.shape}, must have "
                    f"{expected}, as many as x"
                )
            column = _in_type(field.name, values, field.metadata["dtype"])
            object.__setattr__(self, field.name, column)

    def __len__(self) -> int:
        return len(self.x)

    @property
    def nbytes(self) -> int:
        """Bytes that the columns take in memory."""
        return sum(getattr(self, field.name).nbytes for field in self.present())

    def present(self) -> list[dataclasses.Field[Any]]:
        """The schema of the columns that there are: see :data:`COLUMNS`."""
        return [f for f in COLUMNS if not is_optional(f) or getattr(self, f.name) is not None]

    def chosen(self: C, which: np.ndarray | slice) -> C:
        """The samples that ``which`` has: bool (N,), indices in their order, or a slice of them.

        Raises ``TypeError`` or ``ValueError`` for anything else.
        """
        if not isinstance(which, slice):
            which = _indices(which, len(self))
        columns: dict[str, Any] = {f.name: getattr(self, f.name)[which] for f in self.present()}
        return dataclasses.replace(self, **columns)

    def view(self, part: slice) -> Columns:
        """The samples of a slice, in the memory of these."""
        return Columns(**{field.name: getattr(self, field.name)[part] for field in self.present()})

    def _conditions(self) -> Iterator[np.ndarray]:
        """What has to be true of samples of which a picture is formed, bool (N,) or (N, 3)."""
        for values in (self.rgb, self.alpha, self.x, self.y, self.weight):
            yield np.isfinite(values)
        for values in (self.z, self.weight):
            yield values > 0
        if self.through is not None:
            yield np.isfinite(self.through) & (self.through >= 0)
        if self.albedo is not None:
            yield (self.albedo >= 0) & (self.albedo <= 1)
        if self.normal is not None:
            yield np.abs(self.normal) <= LONGEST_NORMAL
        if self.time is not None:
            yield (self.time >= 0) & (self.time <= 1)
        if self.motion is not None:
            yield np.isfinite(self.motion)
            yield np.abs(self.motion[:, 2]) < 2 * self.z

    @property
    def all_valid(self) -> bool:
        """Whether a picture can be formed of every sample: see :meth:`is_valid`."""
        return all(
            bool(condition.all())
            for part in parts_of(len(self))
            for condition in self.view(part)._conditions()
        )

    def is_valid(self) -> np.ndarray:
        """Of which samples a picture can be formed, bool (N,).

        Radiance, alpha, position and weight must be finite, depth and weight > 0, and what it is
        seen through must be at a finite depth >= 0. Albedo and time must be 0 to 1, normals no
        longer than unit vectors, and motion finite and not through the camera.
        """
        return np.logical_and.reduce(
            [condition.reshape(len(self), -1).all(axis=1) for condition in self._conditions()]
        )

    @staticmethod
    def joined(parts: Sequence[Columns]) -> Columns:
        """The samples of all ``parts``, one part after the other; of a single one itself."""
        if len(parts) == 1:
            return parts[0]
        names = [{f.name for f in part.present()} for part in parts]
        columns: dict[str, Any] = {}

        def join(field: dataclasses.Field[Any]) -> None:
            own = [getattr(part, field.name) for part in parts]
            like = next(values for values in own if values is not None)
            columns[field.name] = np.concatenate(
                [
                    zeros_like(like, len(part)) if values is None else values
                    for part, values in zip(parts, own, strict=True)
                ]
            )

        # New memory of this size takes longer to get than to fill.
        for_each(join, [field for field in COLUMNS if any(field.name in own for own in names)])
        return Columns(**columns)


def parts_of(count: int) -> list[slice]:
    """Parts of ``count`` samples, in their order, of ``AT_ONCE`` of them."""
    return [slice(start, min(start + AT_ONCE, count)) for start in range(0, count, AT_ONCE)]


def require_beside_columns(surfaces: Any, radius: Any, known: bool) -> None:
    """Raise unless ``surfaces`` are names of ids; and see :func:`require_visibility_radius`."""
    require_kind("surfaces", surfaces, Mapping, "a mapping, of ids to names")
    for surface, name in surfaces.items():
        require_whole("surfaces: id", surface, 0, MOST_IDS)
        require_kind(f"surfaces[{surface}]", name, str, "a name")
    require_visibility_radius(radius, known)


def require_visibility_radius(radius: Any, known: bool) -> None:
    """Raise unless ``radius`` are two half-widths > 0, or ``None`` where no visibility is known."""
    if (radius is None) == known:
        raise ValueError(
            f"visibility_radius={shown(radius)}: must be the half-widths of the lens (across, "
            "down) where samples have visibility, and None where not"
        )
    if radius is None:
        return
    values = tuple(radius) if isinstance(radius, Iterable) else ()
    if len(values) != 2 or not all(isinstance(v, Real) and 0 < float(v) < np.inf for v in values):
        raise ValueError(
            f"visibility_radius={shown(radius)}: must be two numbers > 0, in scene units"
        )


def visibility_points(radius: Sequence[float]) -> np.ndarray:
    """The points of the lens for the bits of ``visibility``, (64, 2), in the units of ``radius``.

    That is half the width of the lens across and down. They go to the left and upwards from the
    middle, as the camera looks: they are those of a round aperture, which is described from behind.
    """
    return -lens_points(VISIBILITY_POINTS) * radius


def points_that_see(visibility: np.ndarray) -> np.ndarray:
    """How many bits of each of uint64 (N,) are set, int64 (N,)."""
    count = np.full(len(visibility), VISIBILITY_POINTS, np.int64)
    partly = visibility != np.iinfo(np.uint64).max
    by_byte = np.unpackbits(visibility[partly].view(np.uint8).reshape(-1, 8), axis=1)
    count[partly] = by_byte.sum(axis=1, dtype=np.int64)
    return count


def is_optional(field: dataclasses.Field[Any]) -> bool:
    """Whether samples may do without the column; then it is ``None`` and stands for zeros."""
    return bool(field.metadata.get("optional", False))


def shape_of(field: dataclasses.Field[Any], count: int, aovs: int = 0) -> tuple[int, ...]:
    """The shape of a column of ``count`` samples, which have so many ``aovs``."""
    channels = field.metadata["channels"]
    if channels is None:
        channels = max(aovs, 1)
    return (count, channels) if channels else (count,)


def zeros_like(column: np.ndarray, count: int) -> np.ndarray:
    """A column of ``count`` zeros, whose memory costs nothing until it is written to."""
    return np.zeros((count, *column.shape[1:]), column.dtype)


def _in_type(name: str, values: np.ndarray, dtype: Any) -> np.ndarray:
    """The column in its type. Raises ``ValueError`` for what a type of whole numbers has not."""
    kind = np.dtype(dtype)
    if kind.kind == "u" and values.dtype != kind and values.size > 0:
        most = int(np.iinfo(kind).max)
        whole = values.dtype.kind != "f" or bool((np.floor(values) == values).all())
        if not (whole and values.min() >= 0 and values.max() <= most):
            raise ValueError(
                f"{name}: {values.min()} to {values.max()}, must be whole numbers from 0 to {most}"
            )
    with np.errstate(over="ignore"):  # What is infinite then is no valid sample.
        return np.ascontiguousarray(values, kind)


def _indices(which: Any, count: int) -> np.ndarray:
    """Which of so many samples: bool (count,), or whole numbers (M,) of -count to count - 1."""
    chosen = require_numbers("which", which)
    if chosen.ndim != 1 or chosen.dtype.kind == "f":
        raise TypeError(
            f"which={shown(which)}: must be a slice, bool ({count},) or whole numbers (M,)"
        )
    fits = len(chosen) == count
    if chosen.dtype.kind != "b":
        fits = len(chosen) == 0 or (-count <= chosen.min() and chosen.max() < count)
    if not fits:
        raise ValueError(f"which={shown(which)}: must be of {count} samples")
    return chosen


COLUMNS: tuple[dataclasses.Field[Any], ...] = dataclasses.fields(Columns)
"""The schema: name of each column, and in its ``metadata`` the ``dtype`` and ``channels``, ``None``
for any number of them, and whether it is ``optional``."""
