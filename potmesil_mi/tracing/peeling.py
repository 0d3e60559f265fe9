"""Peel, test, shade: the surfaces behind what the pinhole sees.

Primary rays are followed on through what they meet, as deep as it goes. What no point of the lens
sees is dropped before it is shaded; the rest is shaded at once.
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import from_numpy
from .._progress import track
from ..optics.blur import widest_radius_per_vergence
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..samples.columns import Columns
from ..samples.raster import Window
from .buffers import SampleBuffer, Shown, Traced
from .clearance import clearance
from .disocclusion import disoccluded
from .lens_rays import LensRays
from .passes import wavefronts
from .rays import PrimaryRays

LABEL = "Hidden surfaces"
"""What is said of the progress."""

SIDES = 2
"""A ray is followed through so many surfaces for each that may be kept: into things and out."""


@dataclasses.dataclass(frozen=True)
class Hidden:
    """N surfaces behind what the pinhole sees, before they are shaded.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``of``                        uint32 (N,), number of the primary ray
    ``layer``                     uint32 (N,), its place, from 1, among what is kept of the ray
    ``start``                     float32 (N,), where on the ray the surface before it has been
                                  left, in scene units from the ray's origin
    ``z``                         float32 (N,), depth; ``inf`` where nothing more was met
    ``surface``                   uint32 (N,), id of the surface, 0 for none
    ============================  ==========================================================
    """

    of: np.ndarray
    layer: np.ndarray
    start: np.ndarray
    z: np.ndarray
    surface: np.ndarray

    @classmethod
    def joined(cls, parts: list[Hidden]) -> Hidden:
        """All of several, in the order of their layers and rays."""
        empty = cls(*(np.empty(0, kind) for kind in ("u4", "u4", "f4", "f4", "u4")))
        columns = {
            field.name: np.concatenate([getattr(part, field.name) for part in [empty, *parts]])
            for field in dataclasses.fields(cls)
        }
        order = np.lexsort((columns["of"], columns["layer"]))
        return cls(**{name: column[order] for name, column in columns.items()})


def add_hidden(
    buffer: SampleBuffer,
    chosen: np.ndarray,
    rays: PrimaryRays,
    lens: LensRays,
    layers: int,
    paths: int,
) -> None:
    """Add what lies behind the samples that there are, up to ``layers`` surfaces in all on a ray.

    ``chosen``, int (n,), are the numbers of those behind which the ``lens`` may see something.
    What is found is shaded by ``paths`` paths each.
    """
    first = buffer.columns()
    parts = [
        peeled(chosen[part], first.x, first.y, rays, lens, layers)
        for part in track(wavefronts(len(chosen), 1), LABEL)
    ]
    hidden = Hidden.joined(parts)
    x, y, weight = first.x[hidden.of], first.y[hidden.of], first.weight[hidden.of]
    buffer.add(x, y, shaded(hidden, x, y, rays, paths), weight, hidden.layer)


def peeled(
    chosen: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    rays: PrimaryRays,
    lens: LensRays,
    layers: int,
) -> Hidden:
    """What the primary rays ``chosen`` meet behind the first surface, and the lens sees.

    ``x``, ``y`` (N,) are the positions of all rays in pixels of the film. What a mirror shows
    hides nothing.
    """
    index = from_numpy(mi.UInt32, chosen)
    position = mi.Point2f(from_numpy(mi.Float, x[chosen]), from_numpy(mi.Float, y[chosen]))
    start = dr.zeros(mi.Float, len(chosen))
    layer = dr.zeros(mi.UInt32, len(chosen))
    dr.make_opaque(start, layer)
    found: list[Hidden] = []
    for met in range(SIDES * layers):
        ray, _ = rays.through(position, mi.Float(0.5), rays.sensor.shutter_open())
        ray = mi.Ray3f(ray)
        ray.o, ray.maxt = ray.o + start * ray.d, ray.maxt - start
        visible = rays.visible(ray)
        hit = visible.hit
        goes_on = hit.is_valid() & ~visible.mirrored
        passed = start + dr.dot(hit.p - ray.o, ray.d)
        passed += clearance(hit, passed)
        if met > 0:
            sees = lens.see(ray, dr.select(visible.mirrored, visible.first, hit), index)
            layer += dr.select(sees, mi.UInt32(1), mi.UInt32(0))
            goes_on &= layer < dr.opaque(mi.UInt32, layers - 1)
            columns = [index, layer, start, visible.depth, rays.surface_of(hit)]
            dr.eval(sees, goes_on, passed, columns)
            kept = dr.compress(sees)
            columns = [dr.gather(type(c), c, kept) for c in columns]
            dr.eval(columns)
            found.append(Hidden(*(np.array(column) for column in columns)))
        else:
            dr.eval(goes_on, passed)
        further = dr.compress(goes_on)
        if dr.width(further) == 0:
            break
        index, layer = (dr.gather(mi.UInt32, column, further) for column in (index, layer))
        start = dr.gather(mi.Float, passed, further)
        position = dr.gather(mi.Point2f, position, further)
        dr.eval(index, layer, start, position)
    return Hidden.joined(found)


def shaded(hidden: Hidden, x: np.ndarray, y: np.ndarray, rays: PrimaryRays, paths: int) -> Shown:
    """``hidden`` with the radiance that the pinhole would see if nothing were before it.

    It is the mean of ``paths`` paths each.
    """

    def trace(position: mi.Point2f, start: mi.Float, z: mi.Float, surface: mi.UInt32) -> Traced:
        ray, weight = rays.sampled(position)
        ray.o, ray.maxt = ray.o + start * ray.d, ray.maxt - start
        return rays.shaded(ray, weight, z, surface)

    columns = hidden.start, hidden.z, hidden.surface
    return rays.passes.averaged(x, y, trace, LABEL, *columns, paths=paths)


def may_hide(visible: Columns, window: Window, lens: ThinLens, camera: Camera) -> np.ndarray:
    """Which samples, int (n,), may have something behind them that the lens sees.

    ``visible`` are the samples of layer 0, in ``window``. A pixel is chosen whole; any focus
    from its nearest depth on is counted.
    """
    scale = widest_radius_per_vergence(lens, camera, float(visible.z.min()))
    if scale == 0:
        return np.empty(0, dtype=np.int64)
    pixel = window.pixel_of(visible.x, visible.y)
    index, depth = from_numpy(mi.UInt32, pixel), from_numpy(mi.Float, visible.z)
    nearest = dr.full(mi.Float, dr.inf, window.size)
    farthest = dr.zeros(mi.Float, window.size)
    dr.scatter_reduce(dr.ReduceOp.Min, nearest, depth, index)
    dr.scatter_reduce(dr.ReduceOp.Max, farthest, depth, index)
    dr.eval(nearest, farthest)
    near, far = (np.array(ends).reshape(window.shape) for ends in (nearest, farthest))
    return np.flatnonzero(disoccluded(near, far, scale).ravel()[pixel])
