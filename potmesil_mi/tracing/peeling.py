"""Peeling: primary rays are followed on through what they meet, to the surfaces behind.

Depth layer by depth layer, and only where the lens may see past the edge of something nearer.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .._progress import track
from ..optics.blur import widest_radius_per_vergence
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..samples.columns import Columns
from ..samples.raster import Window
from .buffers import Shown, Traced, to_host
from .disocclusion import disoccluded
from .passes import wavefronts
from .patterns import VisibleSamples
from .rays import PrimaryRays
from .shapes import registry_index
from .virtual_depth import passes_straight

LABEL = "Hidden surfaces"
"""What is said of the progress."""


@dataclasses.dataclass(frozen=True)
class Peeling:
    """Primary rays, and what they need to go on behind what they meet first.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``rays``                      the primary rays
    ``closed``                    which shapes enclose a volume, and on which side; see
                                  :func:`potmesil_mi.tracing.shapes.closed_shapes`
    ============================  ==========================================================
    """

    rays: PrimaryRays
    closed: mi.Float

    def add_hidden(self, visible: VisibleSamples, chosen: np.ndarray, layers: int) -> None:
        """Add the surfaces behind ``visible``, layer by layer, up to ``layers`` in all.

        ``chosen``, bool (N,), are the samples behind which something may be seen. Where a ray
        finds a surface, all rays of its group are followed further.
        """
        first, group = visible.buffer.columns(), visible.group
        for layer in range(1, layers):
            chosen = np.flatnonzero(chosen)
            if len(chosen) == 0:
                break
            x, y, weight = first.x[chosen], first.y[chosen], first.weight[chosen]
            behind = self.behind(x, y, layer, group)
            found = behind.z > 0
            visible.buffer.add(x[found], y[found], behind[found], weight[found], layer)
            goes_on = np.zeros(len(first), dtype=bool)
            goes_on[chosen] = found & np.isfinite(behind.z)
            chosen = np.repeat(goes_on.reshape(-1, group).any(axis=1), group)

    def behind(self, x: np.ndarray, y: np.ndarray, layer: int, group: int) -> Shown:
        """The surfaces behind ``layer`` others at (x, y), float32 (N,); z is 0 where none is."""

        def trace(position: mi.Point2f) -> Traced:
            return self.trace(position, mi.UInt32(layer))

        passes = self.rays.passes
        if group == 1:
            return passes.averaged(x, y, trace, LABEL)
        shown = Shown.empty(len(x))
        for pixels in track(wavefronts(len(x) // group, group), LABEL):
            part = slice(pixels.start * group, pixels.stop * group)
            passes.begin(len(x[part]))
            shown.put(part, to_host(trace(mi.Point2f(x[part], y[part])))[0])
        return shown

    def trace(self, position: mi.Point2f, layer: mi.UInt32) -> Traced:
        """What the rays through ``position`` meet behind ``layer`` surfaces; z = 0 for nothing.

        No lens sees the far sides of closed shapes, nor what is inside them: they are passed.
        What a mirror shows hides nothing.
        """
        rays = self.rays
        ray, ray_weight = rays.sampled(position)
        _, hit, mirrored = rays.visible(mi.Ray3f(ray))
        end = ray(ray.maxt)

        def step(
            active: mi.Bool,
            hit: mi.SurfaceInteraction3f,
            origin: mi.Point3f,
            inside: mi.Float,
            passed: mi.UInt32,
        ) -> tuple[Any, ...]:
            further = hit.spawn_ray(ray.d)
            further.maxt = dr.dot(end - further.o, ray.d)
            hit = rays.scene.ray_intersect(further, active)
            origin = mi.Point3f(further.o)
            counts = active & (inside == 0) & ~rays.is_left_out(hit)
            if rays.follows_mirrors:
                counts &= ~passes_straight(hit, counts)
            # Never inside fewer than no shapes: the camera may have been in one from the start.
            inside = dr.maximum(inside + self._goes_in(ray, hit), 0)
            passed = passed + dr.select(counts, mi.UInt32(1), mi.UInt32(0))
            return active & hit.is_valid() & (passed < layer), hit, origin, inside, passed

        active = hit.is_valid() & ~mirrored
        inside = dr.maximum(self._goes_in(ray, hit), 0)
        state = (active, hit, mi.Point3f(ray.o), inside, mi.UInt32(0))
        _, behind, origin, _, passed = dr.while_loop(state, lambda active, *_: active, step)
        found = active & (passed == layer)
        ray.o = dr.select(found, origin, ray.o)
        ray.maxt = dr.dot(end - ray.o, ray.d)
        depth, shown, _ = rays.visible_at(mi.Ray3f(ray), behind)
        return rays.shaded(ray, ray_weight, dr.select(found, depth, 0), shown, found)

    def _goes_in(self, ray: mi.Ray3f, hit: mi.SurfaceInteraction3f) -> mi.Float:
        """1 where the ray goes into a closed shape, -1 where it comes out, 0 for others."""
        side = dr.gather(mi.Float, self.closed, registry_index(hit), hit.is_valid())
        return -side * dr.sign(dr.dot(hit.n, ray.d))


def may_hide(
    visible: Columns, group: int, window: Window, lens: ThinLens, camera: Camera
) -> np.ndarray:
    """Which samples, bool (N,), may have something behind them that the lens sees.

    ``visible`` are the samples of layer 0, of which ``group`` after each other lie in one pixel
    of ``window``. A pixel is chosen whole; any focus from its nearest depth on is counted.
    """
    nearest_of, farthest_of = (
        np.asarray(dr.block_reduce(op, mi.Float(visible.z), group))
        for op in (dr.ReduceOp.Min, dr.ReduceOp.Max)
    )
    scale = widest_radius_per_vergence(lens, camera, float(nearest_of.min()))
    if scale == 0:
        return np.zeros(len(visible), dtype=bool)
    pixel = window.pixel_of(visible.x[::group], visible.y[::group])
    nearest = np.full(window.size, np.inf, dtype=np.float32)
    farthest = np.zeros(window.size, dtype=np.float32)
    np.minimum.at(nearest, pixel, nearest_of)
    np.maximum.at(farthest, pixel, farthest_of)
    farthest[farthest == 0] = np.inf
    chosen = disoccluded(nearest.reshape(window.shape), farthest.reshape(window.shape), scale)
    return np.repeat(chosen.ravel()[pixel], group)
