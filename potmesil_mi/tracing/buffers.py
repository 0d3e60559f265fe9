"""What rays show, on the device and on the host, and memory that passes fill with samples."""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np

from ..samples.columns import Columns


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
    ============================  ==========================================================
    """

    rgb: mi.Color3f
    alpha: mi.Float
    z: mi.Float
    surface: mi.UInt32


@dataclasses.dataclass(frozen=True)
class Shown:
    """What rays show, on the host: the fields of :class:`Traced`.

    ``rgb`` is float32 (N, 3), ``alpha`` and ``z`` float32 (N,), ``surface`` uint32 (N,).
    """

    rgb: np.ndarray
    alpha: np.ndarray
    z: np.ndarray
    surface: np.ndarray

    @classmethod
    def empty(cls, count: int) -> Shown:
        """Memory for ``count`` rays."""
        return cls(
            rgb=_empty(mi.Float, 3 * count).reshape(count, 3),
            alpha=_empty(mi.Float, count),
            z=_empty(mi.Float, count),
            surface=_empty(mi.UInt32, count),
        )

    def __getitem__(self, rays: np.ndarray | slice) -> Shown:
        """Some of the rays, by their numbers, a mask or a slice."""
        return Shown(self.rgb[rays], self.alpha[rays], self.z[rays], self.surface[rays])

    def followed_by(self, other: Shown) -> Shown:
        """These rays and then those of ``other``."""
        return Shown(
            np.concatenate([self.rgb, other.rgb]),
            np.concatenate([self.alpha, other.alpha]),
            np.concatenate([self.z, other.z]),
            np.concatenate([self.surface, other.surface]),
        )

    def put(self, part: slice, other: Shown) -> None:
        """Overwrite the rays of ``part`` with ``other``."""
        self.rgb[part], self.alpha[part] = other.rgb, other.alpha
        self.z[part], self.surface[part] = other.z, other.surface

    def averaged(self, paths: int) -> Shown:
        """One ray in the place of each ``paths`` rays after each other.

        It has the mean of their radiance and alpha, and the depth and surface of the first.
        """
        return Shown(
            rgb=self.rgb.reshape(-1, paths, 3).mean(axis=1),
            alpha=self.alpha.reshape(-1, paths).mean(axis=1),
            z=self.z.reshape(-1, paths)[:, 0],
            surface=self.surface.reshape(-1, paths)[:, 0],
        )


def to_host(traced: Traced, *more: mi.Float) -> tuple[Shown, list[np.ndarray]]:
    """What rays show, and ``more`` arrays, as NumPy arrays, by one kernel.

    Each array asked for alone would trace the rays again. On the CPU the results are Dr.Jit's own
    memory, not copies of it.
    """
    arrays = [traced.rgb, traced.alpha, traced.z, traced.surface, *more]
    flat = [dr.ravel(array) for array in arrays]
    dr.eval(flat)
    rgb, alpha, z, surface, *others = (np.asarray(values) for values in flat)
    return Shown(rgb.reshape(len(z), -1), alpha, z, surface), others


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
        memory, part = self._memory, slice(start, end)
        memory.x[part], memory.y[part] = x, y
        memory.rgb[part], memory.alpha[part] = shown.rgb, shown.alpha
        memory.z[part], memory.surface[part] = shown.z, shown.surface
        memory.weight[part], memory.layer[part] = weight, layer
        self._count = end

    def put(self, which: np.ndarray, shown: Shown, weight: np.ndarray) -> None:
        """Overwrite the samples ``which``, int (N,), with others of the same positions."""
        memory = self._memory
        memory.rgb[which], memory.alpha[which] = shown.rgb, shown.alpha
        memory.z[which], memory.surface[which] = shown.z, shown.surface
        memory.weight[which] = weight

    def columns(self) -> Columns:
        """The samples so far, in the buffer's own memory."""
        return Columns(**{name: array[: self._count] for name, array in self._arrays()})

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
