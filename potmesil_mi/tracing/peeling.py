"""Peel, test, shade: the surfaces behind what the pinhole sees.

Primary rays are followed on through what they meet, as deep as it goes. What no point of the lens
sees is dropped before it is shaded; the rest is shaded at once.
"""

from __future__ import annotations

import dataclasses
import math

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
from .lens_rays import LENS_POINTS, LensRays, Target
from .passes import wavefronts
from .rays import PrimaryRays
from .virtual_depth import Visible

LABEL = "Hidden surfaces"
"""What is said of the progress."""

FEW_POINTS = 3
"""Points of the lens from which everything is looked at; from the others only in cells of the film
where these have seen something."""

VOTERS = 16
"""Samples, at least, that a cell of the film has."""

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
    cells = _cells(first.x[chosen], first.y[chosen])
    parts: list[Hidden] = []
    for part in track(wavefronts(len(chosen), 1), LABEL):
        number = chosen[part]
        place = first.x[number], first.y[number], cells[part]
        parts += peeled(number, *place, rays, lens, layers)
    hidden = Hidden.joined(parts)
    x, y, weight = first.x[hidden.of], first.y[hidden.of], first.weight[hidden.of]
    buffer.add(x, y, shaded(hidden, x, y, rays, paths), weight, hidden.layer)


def peeled(
    chosen: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    cells: np.ndarray,
    rays: PrimaryRays,
    lens: LensRays,
    layers: int,
) -> list[Hidden]:
    """What the primary rays ``chosen`` meet behind the first surface, and the lens sees: in parts.

    ``chosen``, uint32 (N,), are their numbers, ``x``, ``y`` their positions in pixels of the film,
    ``cells`` the numbers of the cells in which they lie, uint32. What a mirror shows hides nothing.
    """
    index, cell = (from_numpy(mi.UInt32, column) for column in (chosen, cells))
    position = mi.Point2f(from_numpy(mi.Float, x), from_numpy(mi.Float, y))
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
        passed += clearance(hit.p, passed)
        if met > 0:
            columns = [index, layer, start, visible.depth, rays.surface_of(hit)]
            target = _target(ray, visible, index)
            dr.eval(goes_on, passed, columns, target)
            sees = _sees(lens, target, cell)
            layer = columns[1] = layer + dr.select(sees, mi.UInt32(1), mi.UInt32(0))
            goes_on &= layer < dr.opaque(mi.UInt32, layers - 1)
            kept = dr.compress(sees)
            columns = [dr.gather(type(c), c, kept) for c in columns]
            dr.eval(columns, layer, goes_on)
            found.append(Hidden(*(np.array(column) for column in columns)))
        else:
            dr.eval(goes_on, passed)
        further = dr.compress(goes_on)
        if dr.width(further) == 0:
            break
        index, layer, cell = (dr.gather(mi.UInt32, c, further) for c in (index, layer, cell))
        start = dr.gather(mi.Float, passed, further)
        position = dr.gather(mi.Point2f, position, further)
        dr.eval(index, layer, cell, start, position)
    return found


def _target(ray: mi.Ray3f, visible: Visible, number: mi.UInt32) -> Target:
    """What is to be seen of what a primary ray meets: of an image, the mirror that shows it."""
    mirrored, hit, first = visible.mirrored, visible.hit, visible.first
    met = mirrored | hit.is_valid()
    point = dr.select(mirrored, first.p, hit.p)
    return Target(
        point=dr.select(met, point, ray.o),
        normal=dr.select(mirrored, first.n, hit.n),
        direction=mi.Vector3f(ray.d),
        met=met,
        number=mi.UInt32(number),
    )


def _sees(lens: LensRays, target: Target, cell: mi.UInt32) -> mi.Bool:
    """Whether any point of the lens sees each target, bool (N,), evaluated.

    Few points are tried first. Only where one of these sees anything in the same ``cell`` of the
    film are the others: most of what is hidden is hidden from the whole lens, and still more of
    where rays come out of things.
    """
    comes_out = target.met & (dr.dot(target.normal, target.direction) > 0)
    few = dr.select(comes_out, mi.UInt32(1), mi.UInt32(FEW_POINTS))
    sees = lens.see(target, dr.zeros(mi.UInt32, dr.width(target)), few)
    seen = dr.zeros(mi.UInt32, int(dr.max(cell)[0]) + 1)
    dr.scatter(seen, mi.UInt32(1), cell, sees)
    dr.eval(sees, seen, few)
    again = dr.compress(~sees & (dr.gather(mi.UInt32, seen, cell) > 0))
    if dr.width(again) > 0:
        first = dr.gather(mi.UInt32, few, again)
        more = lens.see(dr.gather(Target, target, again), first, dr.opaque(mi.UInt32, LENS_POINTS))
        dr.scatter(sees, more, again)
        dr.eval(sees)
    return sees


def _cells(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Numbers, uint32 (N,), of square cells of the film in which positions lie.

    They are of whole pixels, which have ``VOTERS`` of the positions or more on the average.
    """
    column, row = (np.floor(at - at.min()).astype(np.uint32) for at in (x, y))
    pixels = np.count_nonzero(np.bincount(row * (column.max() + 1) + column))
    side = math.ceil(math.sqrt(VOTERS * pixels / len(x)))
    column, row = column // side, row // side
    return row * (column.max() + 1) + column


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
