"""The columns of point samples: one array for each thing that is known of a sample."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import numpy as np

OF_DEFAULT: Any = None
"""What stands in a field that was not given, until ``__post_init__`` puts its default there."""

C = TypeVar("C", bound="Columns")


_FLOAT: dict[str, Any] = {"dtype": np.float32, "channels": 0}
_RGB: dict[str, Any] = {"dtype": np.float32, "channels": 3}
_ID: dict[str, Any] = {"dtype": np.uint32, "channels": 0}
_LAYER: dict[str, Any] = {"dtype": np.uint8, "channels": 0}


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
                                  0 for what it sees (default), 1 and more for what is hidden
    ============================  ==========================================================

    What is given becomes arrays of these types, without a copy where it is one. Raises
    ``ValueError`` for columns of unequal length or wrong shape.
    """

    x: np.ndarray = dataclasses.field(metadata=_FLOAT)
    y: np.ndarray = dataclasses.field(metadata=_FLOAT)
    rgb: np.ndarray = dataclasses.field(metadata=_RGB)
    alpha: np.ndarray = dataclasses.field(metadata=_FLOAT)
    z: np.ndarray = dataclasses.field(metadata=_FLOAT)
    surface: np.ndarray = dataclasses.field(metadata=_ID)
    weight: np.ndarray = dataclasses.field(metadata=_FLOAT)
    layer: np.ndarray = dataclasses.field(default=OF_DEFAULT, metadata=_LAYER)

    def __post_init__(self) -> None:
        count = len(self.x)
        if self.layer is OF_DEFAULT:
            object.__setattr__(self, "layer", np.zeros(count, dtype=np.uint8))
        for field in COLUMNS:
            column = np.ascontiguousarray(getattr(self, field.name), field.metadata["dtype"])
            channels = field.metadata["channels"]
            expected = (count, channels) if channels else (count,)
            if column.shape != expected:
                raise ValueError(f"{field.name}: has shape {column.shape}, must have {expected}")
            object.__setattr__(self, field.name, column)

    def __len__(self) -> int:
        return len(self.x)

    @property
    def nbytes(self) -> int:
        """Bytes that the columns take in memory."""
        return sum(getattr(self, field.name).nbytes for field in COLUMNS)

    def chosen(self: C, which: np.ndarray) -> C:
        """The samples that ``which`` has, bool (N,) or indices in their order."""
        columns: dict[str, Any] = {f.name: getattr(self, f.name)[which] for f in COLUMNS}
        return dataclasses.replace(self, **columns)

    def _conditions(self) -> Iterator[np.ndarray]:
        """What has to be true of samples of which a picture is formed, bool (N,) or (N, 3)."""
        for values in (self.rgb, self.alpha, self.x, self.y, self.weight):
            yield np.isfinite(values)
        for values in (self.z, self.weight):
            yield values > 0

    @property
    def all_valid(self) -> bool:
        """Whether a picture can be formed of every sample: see :meth:`is_valid`."""
        return all(bool(condition.all()) for condition in self._conditions())

    def is_valid(self) -> np.ndarray:
        """Of which samples a picture can be formed, bool (N,).

        Radiance, alpha, position and weight must be finite, depth and weight > 0.
        """
        return np.logical_and.reduce(
            [condition.reshape(len(self), -1).all(axis=1) for condition in self._conditions()]
        )

    @staticmethod
    def joined(parts: Sequence[Columns]) -> Columns:
        """The samples of all ``parts``, one part after the other."""
        columns: dict[str, Any] = {
            f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in COLUMNS
        }
        return Columns(**columns)


COLUMNS: tuple[dataclasses.Field[Any], ...] = dataclasses.fields(Columns)
"""The schema: name of each column, and in its ``metadata`` the ``dtype`` and ``channels``."""
