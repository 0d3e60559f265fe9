"""What rays show, on the device and on the host, and memory that passes fill with samples."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from ..samples.columns import COLUMNS, Columns, is_optional, parts_of, shape_of, zeros_like

SCHEMA = {field.name: field for field in COLUMNS}
"""The schema of the columns by their names."""

KINDS = {np.float32: "Float32", np.uint32: "UInt32", np.uint8: "UInt8"}
"""Mitsuba's names of the types of columns that all samples have."""

MOST_KEPT = 1 << 25
"""Samples up to which their memory is kept for the next ones."""


@dataclasses.dataclass(frozen=True)
class Traced:
    """What rays show, as Dr.Jit arrays that need not have been evaluated: N elements each.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``rgb``                       radiance in linear sRGB
    ``alpha``                     1 where the integrator saw something, else 0
    ``z``                         depth in scene units; ``inf`` where a ray meets nothing, 0
                                  where it has nothing to tell
    ``surface``                   id of the surface, 0 for none
    ``albedo``, ``normal``        its :class:`potmesil_mi.tracing.features.Features`, if wanted
    ``aovs``                      K values of the integrator, if it has any: see
                                  :class:`potmesil_mi.tracing.aovs.Aovs`
    ============================  ==========================================================
    """

    rgb: mi.Color3f
    alpha: mi.Float
    z: mi.Float
    surface: mi.UInt32
    albedo: mi.Color3f | None = None
    normal: mi.Normal3f | None = None
    aovs: mi.ArrayXf | None = None


@dataclasses.dataclass(frozen=True)
class Shown:
    """What rays show, on the host: the fields of :class:`Traced`.

    ``rgb`` is float32 (N, 3), ``alpha`` and ``z`` float32 (N,), ``surface`` uint32 (N,);
    ``albedo`` and ``normal`` are float32 (N, 3), ``aovs`` (N, K), or ``None``, which stands for
    zeros.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    z: np.ndarray
    surface: np.ndarray
    albedo: np.ndarray | None = None
    normal: np.ndarray | None = None
    aovs: np.ndarray | None = None

    @classmethod
    def empty(cls, count: int) -> Shown:
        """Memory for ``count`` rays."""
        return cls(
            rgb=_empty("rgb", count),
            alpha=_empty("alpha", count),
            z=_empty("z", count),
            surface=_empty("surface", count),
        )

    @classmethod
    def of(cls, columns: Columns, which: np.ndarray) -> Shown:
        """What the samples ``which`` show, by their numbers."""
        names = {field.name for field in columns.present()} & {
            f.name for f in dataclasses.fields(cls)
        }
        return cls(**{name: getattr(columns, name)[which] for name in names})

    def room_for(self, count: int) -> Shown:
        """Memory for ``count`` rays, with the columns of these."""
        room = Shown.empty(count)
        own = self.columns()
        more = own.keys() - room.columns().keys()
        return dataclasses.replace(room, **{name: zeros_like(own[name], count) for name in more})

    def columns(self) -> dict[str, np.ndarray]:
        """The columns that there are, by their names."""
        return {name: column for name, column in vars(self).items() if column is not None}

    def __getitem__(self, rays: np.ndarray | slice) -> Shown:
        """Some of the rays, by their numbers, a mask or a slice."""
        return Shown(**{name: column[rays] for name, column in self.columns().items()})

    def followed_by(self, other: Shown) -> Shown:
        """These rays and then those of ``other``."""
        there = self.columns() | other.columns()
        both = self._with(there), other._with(there)
        return Shown(
            **{name: np.concatenate([vars(part)[name] for part in both]) for name in there}
        )

    def put(self, part: slice, other: Shown) -> None:
        """Overwrite the rays of ``part`` with ``other``, which has the same columns."""
        for name, column in self.columns().items():
            column[part] = vars(other)[name]

    def _with(self, columns: Mapping[str, np.ndarray]) -> Shown:
        """These rays, with zeros for what they do not have, as others do, of these ``columns``."""
        absent = columns.keys() - self.columns().keys()
        zeros = {name: zeros_like(columns[name], len(self.z)) for name in absent}
        return dataclasses.replace(self, **zeros)

    def averaged(self, paths: int) -> Shown:
        """One ray in the place of each ``paths`` rays after each other.

        It has the mean of their radiance, alpha and AOVs, and the rest of the first.
        """
        first = self[::paths]
        if self.aovs is not None:
            # In double precision the mean of equal numbers is that number, also of ids.
            every = self.aovs.reshape(len(first.z), paths, -1)
            means = every.mean(axis=1, dtype=np.float64).astype(np.float32)
            first = dataclasses.replace(first, aovs=means)
        return dataclasses.replace(
            first,
            rgb=self.rgb.reshape(-1, paths, 3).mean(axis=1),
            alpha=self.alpha.reshape(-1, paths).mean(axis=1),
        )


def to_host(traced: Traced, *more: mi.Float | mi.UInt8) -> tuple[Shown, list[np.ndarray]]:
    """What rays show, and ``more`` arrays, as NumPy arrays, by one kernel.

    Each array asked for alone would trace the rays again. On the CPU the results are Dr.Jit's own
    memory, not copies of it.
    """
    arrays = {name: array for name, array in vars(traced).items() if array is not None}
    flat = [dr.ravel(array) for array in (*arrays.values(), *more)]
    dr.eval(flat)
    host = [np.asarray(values) for values in flat]
    aovs = 0 if traced.aovs is None else len(traced.aovs)
    columns = {
        name: values.reshape(shape_of(SCHEMA[name], -1, aovs))
        for name, values in zip(arrays, host, strict=False)
    }
    if aovs:  # They may all be constants, which Dr.Jit has once.
        columns["aovs"] = np.broadcast_to(columns["aovs"], (len(columns["z"]), aovs))
    return Shown(**columns), host[len(arrays) :]


class SampleBuffer:
    """Samples as they come in: memory for ``capacity`` of them is taken at once, then filled.

    Memory that is not written to costs nothing, so ``capacity`` may be generous. More is taken
    where it is too little. Nothing is copied but what has to be, and that column by column.
    """

    def __init__(self, capacity: int) -> None:
        self._count = 0
        self._memory = {
            field.name: _empty(field.name, capacity) for field in COLUMNS if not is_optional(field)
        }

    def __len__(self) -> int:
        return self._count

    def add(
        self,
        x: np.ndarray,
        y: np.ndarray,
        shown: Shown,
        weight: np.ndarray | float,
        layer: np.ndarray | int,
    ) -> None:
        """Put samples of one depth layer behind those that there are.

        ``x``, ``y`` (N,) are positions in pixels of the film; ``weight`` is that of each sample,
        or of all of them.
        """
        self._append({"x": x, "y": y, "weight": weight, "layer": layer, **shown.columns()}, len(x))

    def extend(self, columns: Columns) -> None:
        """Put samples of any columns behind those that there are."""
        values = {field.name: getattr(columns, field.name) for field in columns.present()}
        self._append(values, len(columns))

    def put(self, which: np.ndarray, shown: Shown, weight: np.ndarray) -> None:
        """Overwrite the samples ``which``, int (N,), with others of the same positions."""
        of_shown = {field.name for field in dataclasses.fields(Shown)} & self._memory.keys()
        nothing = dict.fromkeys(of_shown, 0)
        self._put(which, {**nothing, **shown.columns(), "weight": weight})

    def set(self, name: str, column: np.ndarray) -> None:
        """Give all samples an optional column, whose memory becomes that of the buffer."""
        self._memory[name] = column

    def keep(self, which: np.ndarray) -> None:
        """Keep only the samples of which ``which``, bool (N,), is true.

        The columns of before show others then: they are moved together in their own memory.
        """
        if which.all():
            return
        for memory in self._memory.values():
            end = 0
            for part in parts_of(self._count):
                kept = memory[part][which[part]]
                memory[end : end + len(kept)] = kept
                end += len(kept)
        self._count = int(np.count_nonzero(which))

    def columns(self) -> Columns:
        """The samples so far, in the buffer's own memory."""
        return Columns(**{name: memory[: self._count] for name, memory in self._memory.items()})

    def _append(self, values: Mapping[str, np.ndarray | float], count: int) -> None:
        """Put ``count`` samples behind those that there are; columns that they lack are 0."""
        part = slice(self._count, self._count + count)
        for name, memory in self._memory.items():
            if part.stop > len(memory):
                self._memory[name] = self._moved(memory, part.stop + count)
        self._count = part.stop
        self._put(part, {**dict.fromkeys(self._memory, 0), **values})

    def _put(self, which: np.ndarray | slice, values: Mapping[str, np.ndarray | float]) -> None:
        """Overwrite columns of some samples. One that is new to the memory is 0 elsewhere."""
        for name, column in values.items():
            if name not in self._memory:
                self._memory[name] = zeros_like(np.asarray(column), len(self._memory["x"]))
            self._memory[name][which] = column

    def _moved(self, memory: np.ndarray, capacity: int) -> np.ndarray:
        """The samples of a column in memory for ``capacity`` of them."""
        larger = np.empty((capacity, *memory.shape[1:]), dtype=memory.dtype)
        larger[: self._count] = memory[: self._count]
        return larger


def _empty(name: str, count: int) -> np.ndarray:
    """Memory for a column; on the CPU of Dr.Jit, which keeps it for the next samples.

    What NumPy gives back to the system is slow to get again. Of many samples that is little of the
    time that they take, and Dr.Jit would take up to twice what they need.
    """
    shape, dtype = shape_of(SCHEMA[name], count), SCHEMA[name].metadata["dtype"]
    kind = getattr(mi, KINDS[dtype])
    if count > MOST_KEPT or dr.backend_v(kind) != dr.JitBackend.LLVM:
        return np.empty(shape, dtype)
    return np.asarray(dr.empty(kind, math.prod(shape))).reshape(shape)
