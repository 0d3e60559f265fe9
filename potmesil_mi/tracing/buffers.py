"""What rays show, on the device and on the host, and memory that passes fill with samples."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from ..samples.columns import COLUMNS, Columns, shape_of, zeros_like

SCHEMA = {field.name: field for field in COLUMNS}
"""The schema of the columns by their names."""


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
            rgb=_empty(mi.Float, 3 * count).reshape(count, 3),
            alpha=_empty(mi.Float, count),
            z=_empty(mi.Float, count),
            surface=_empty(mi.UInt32, count),
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
    where it is too little.
    """

    def __init__(self, capacity: int) -> None:
        shown = Shown.empty(capacity)
        self._count = 0
        self._memory = Columns(
            x=_empty(mi.Float, capacity),
            y=_empty(mi.Float, capacity),
            rgb=shown.rgb,
            alpha=shown.alpha,
            z=shown.z,
            surface=shown.surface,
            weight=_empty(mi.Float, capacity),
            layer=_empty(mi.UInt8, capacity),
        )

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
        start, end = self._count, self._count + len(x)
        if end > len(self._memory):
            self._grow(2 * end - start)
        part = slice(start, end)
        self._put(part, shown)
        memory = self._memory
        memory.x[part], memory.y[part] = x, y
        memory.weight[part], memory.layer[part] = weight, layer
        self._count = end

    def put(self, which: np.ndarray, shown: Shown, weight: np.ndarray) -> None:
        """Overwrite the samples ``which``, int (N,), with others of the same positions."""
        self._put(which, shown)
        self._memory.weight[which] = weight

    def columns(self) -> Columns:
        """The samples so far, in the buffer's own memory."""
        return Columns(**{name: array[: self._count] for name, array in self._arrays()})

    def _put(self, which: np.ndarray | slice, shown: Shown) -> None:
        """Overwrite what samples show. A column that is new to the memory has zeros elsewhere."""
        columns = shown.columns()
        new = [name for name in columns if getattr(self._memory, name) is None]
        if new:
            zeros = {name: zeros_like(columns[name], len(self._memory)) for name in new}
            self._memory = dataclasses.replace(self._memory, **zeros)
        for name, memory in self._arrays():
            if name in vars(shown):
                memory[which] = columns.get(name, 0)

    def _arrays(self) -> list[tuple[str, np.ndarray]]:
        """The memory of each column, by its name."""
        return [(f.name, getattr(self._memory, f.name)) for f in self._memory.present()]

    def _grow(self, capacity: int) -> None:
        """Move the samples to memory for ``capacity`` of them."""
        larger = {}
        for name, array in self._arrays():
            larger[name] = np.empty((capacity, *array.shape[1:]), dtype=array.dtype)
            larger[name][: self._count] = array[: self._count]
        self._memory = Columns(**larger)


def _empty(kind: type, count: int) -> np.ndarray:
    """Memory for numbers; on the CPU of Dr.Jit, which keeps it for the next samples.

    What NumPy gives back to the system is slow to get again.
    """
    if dr.backend_v(kind) == dr.JitBackend.LLVM:
        return np.asarray(dr.empty(kind, count))
    return np.empty(count, dtype=np.asarray(dr.empty(kind, 1)).dtype)
