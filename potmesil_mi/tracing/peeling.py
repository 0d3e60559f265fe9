"""Peel, test, shade: the surfaces behind what the pinhole sees.

Primary rays are followed on through what they meet, as deep as it goes. What no point of the lens
sees is dropped before it is shaded; the rest is shaded at once.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import from_numpy
from .._progress import track
from ..optics.blur import widest_radius_per_vergence
from ..optics.camera import Camera
from ..optics.disocclusion import disoccluded, uncovered
from ..optics.lens import ThinLens
from ..samples.columns import Columns
from ..samples.raster import Window
from .buffers import SampleBuffer, Shown, Traced
from .clearance import clearance
from .lens_rays import LENS_POINTS, LensRays, Target
from .passes import wavefronts
from .rays import PrimaryRays
from .sweeping import Sweep
from .virtual_depth import Visible

LABEL = "Hidden surfaces"
"""What is said of the progress."""

FEW_POINTS = 2
"""Points of the lens from which everything is looked at; from the others only in cells of the film
where these have seen something."""

VOTERS = 64
"""Samples, at least, that nine of ten cells of the film have: what few points of the lens see is
found by few."""

ENOUGH = 32
"""If so many samples of a surface in a cell have looked for the lens in vain, all have."""

FEWEST = 0.1
"""As large a part of the pixels may have fewer samples than are counted on."""

USUALLY_MET = 12
"""There is room for so many surfaces a ray; where that is too little, rays are followed again."""

LEAST_ROOM = 1 << 21
"""There is room for so many, at least."""

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
    sweep: Sweep | None = None,
) -> np.ndarray:
    """Add what lies behind the samples that there are, up to ``layers`` surfaces in all on a ray.

    ``chosen``, int (n,), are the numbers of those behind which the ``lens`` may see something,
    also at other times of a ``sweep``.
    What is found is shaded by ``paths`` paths each. Returns where on its primary ray each added
    sample's own begins, float32 (N,): see ``start`` of :class:`Hidden`.
    """
    first = buffer.columns()
    cells = cells_of(first.x[chosen], first.y[chosen])
    parts: list[Hidden] = []
    for part in track(wavefronts(len(chosen), USUALLY_MET), LABEL):
        number = chosen[part]
        place = first.x[number], first.y[number], first.z[number]
        hides = None if sweep is None else (sweep, first.surface[number])
        parts.append(peeled(number, *place, cells[part], rays, lens, layers, hides))
    hidden = Hidden.joined(parts)
    x, y, weight = first.x[hidden.of], first.y[hidden.of], first.weight[hidden.of]
    del first  # Else there would be two of each column while memory grows.
    buffer.add(x, y, shaded(hidden, x, y, rays, paths), weight, hidden.layer)
    return hidden.start


def peeled(
    chosen: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    cells: np.ndarray,
    rays: PrimaryRays,
    lens: LensRays,
    layers: int,
    hides: tuple[Sweep, np.ndarray] | None = None,
) -> Hidden:
    """What the primary rays ``chosen`` meet behind the first surface, and the lens sees.

    ``chosen``, uint32 (N,), are their numbers, ``x``, ``y`` their positions in pixels of the film,
    ``z`` the depths of what they show first, ``cells`` the numbers of the cells in which they lie,
    uint32. Of what a mirror or glass shows it is these behind which something is hidden. ``hides``
    are the sweep of an exposure and the surfaces that the rays show first, uint32 (N,).
    """
    steps = SIDES * layers - 1
    number = from_numpy(mi.UInt32, chosen)
    position = mi.Point2f(from_numpy(mi.Float, x), from_numpy(mi.Float, y))
    met = _met_behind(position, from_numpy(mi.Float, z), number, rays, steps)
    if dr.width(met.step) == 0:
        return Hidden.joined([])
    cell = dr.gather(mi.UInt32, from_numpy(mi.UInt32, cells), met.ray)
    target = met.target(rays.begun_at(dr.gather(mi.Point2f, position, met.ray), 0), number)
    sees = _sees(lens, target, cell, met.step, met.surface)
    if hides is not None:
        sweep, first = hides
        left = dr.compress(~sees)
        hider = dr.gather(mi.UInt32, from_numpy(mi.UInt32, first), met.ray)
        unseen = (dr.gather(type(of), of, left) for of in (target, met.surface, hider))
        dr.scatter(sees, sweep.shows(lens, *unseen), left)
    kept = dr.compress(sees)
    of = target.number, met.step, met.start, met.z, met.surface
    columns = [np.array(dr.gather(type(each), each, kept)) for each in of]
    order = np.lexsort((columns[1], columns[0]))
    ray, _, start, depth, surface = (column[order] for column in columns)
    # Along each ray they are counted from 1.
    first = np.flatnonzero(np.diff(ray, prepend=-1))
    layer = np.arange(len(ray)) - np.repeat(first, np.diff(first, append=len(ray))) + 1
    few = layer < layers
    return Hidden(ray[few], layer[few].astype(np.uint32), start[few], depth[few], surface[few])


@dataclasses.dataclass
class _Met:
    """What primary rays meet behind what they show first: N surfaces, as Dr.Jit arrays.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``ray``                       which of the rays that are followed meets it
    ``step``                      how many others it has met there before, behind the first
    ``start``, ``z``, ``surface``  as in :class:`Hidden`
    ``distance``                  how far along the ray it is, or the window that shows it, in scene
                                  units from the ray's origin; ``inf`` where nothing is met
    ``normal``                    its unit normal there
    ============================  ==========================================================
    """

    ray: mi.UInt32
    step: mi.UInt32
    start: mi.Float
    z: mi.Float
    surface: mi.UInt32
    distance: mi.Float
    normal: mi.Normal3f

    def target(self, ray: mi.Ray3f, number: mi.UInt32) -> Target:
        """What is to be seen of it from the lens: ``ray`` has met it, and ``number`` has all."""
        met = dr.isfinite(self.distance)
        return Target(
            point=ray(dr.select(met, self.distance, 0)),
            normal=self.normal,
            direction=ray.d,
            met=met,
            number=dr.gather(mi.UInt32, number, self.ray),
        )


def _met_behind(
    position: mi.Point2f, z: mi.Float, number: mi.UInt32, rays: PrimaryRays, steps: int
) -> _Met:
    """What primary rays meet behind what they show first, at most ``steps`` surfaces each.

    ``position`` is theirs on the film, ``z`` the depths of what they show first, ``number`` their
    numbers. In no order.
    """
    capacity = max(USUALLY_MET * dr.width(number), LEAST_ROOM)
    while True:
        room, count = dr.empty(_Met, capacity), dr.zeros(mi.UInt32)
        _follow(position, z, number, rays, steps, count, room)
        dr.eval(room, count)
        met = int(count[0])
        if met <= capacity:
            return dr.gather(_Met, room, dr.arange(mi.UInt32, met))
        capacity = met


def _follow(
    position: mi.Point2f,
    z: mi.Float,
    number: mi.UInt32,
    rays: PrimaryRays,
    steps: int,
    count: mi.UInt32,
    room: _Met,
) -> None:
    """Write what rays meet into ``room``, as far as it goes, and how much that is to ``count``."""
    capacity = dr.opaque(mi.UInt32, dr.width(room.step))
    ray_index = dr.arange(mi.UInt32, dr.width(number))

    def step(active: mi.Bool, start: mi.Float, met: mi.UInt32) -> tuple[Any, Any, Any]:
        ray = rays.begun_at(position, start)
        visible = rays.visible(ray, coherent=False)
        goes_on, passed = _passed(ray, start, visible)
        place = dr.scatter_inc(count, mi.UInt32(0), active)
        surface, (distance, normal) = rays.surface_of(visible.hit), _shown_at(ray, visible)
        found = _Met(ray_index, met, start, visible.depth, surface, start + distance, normal)
        dr.scatter(room, found, place, active & (place < capacity))
        return active & goes_on & (met + 1 < steps), passed, met + 1

    goes_on, passed = _behind_first(position, z, rays)
    state = goes_on, passed, dr.zeros(mi.UInt32, dr.width(number))
    dr.while_loop(state, lambda active, *_: active, step, mode="symbolic")


def _behind_first(position: mi.Point2f, z: mi.Float, rays: PrimaryRays) -> tuple[mi.Bool, mi.Float]:
    """Which rays go on behind what they show first, at the depths ``z``, and from where on."""
    ray = rays.begun_at(position, 0.0)
    if rays.follows_windows:  # The depth may be that of an image.
        return _passed(ray, mi.Float(0), rays.visible(ray))
    distance = rays.distance(ray, z)
    return dr.isfinite(z), distance + clearance(ray(distance), distance)


def _passed(ray: mi.Ray3f, start: mi.Float, visible: Visible) -> tuple[mi.Bool, mi.Float]:
    """Which rays, which began at ``start``, go on behind what they show, and from where on."""
    last = dr.select(visible.through_window, visible.first, visible.hit)
    passed = start + dr.dot(last.p - ray.o, ray.d)
    return last.is_valid(), passed + clearance(last.p, passed)


def _shown_at(ray: mi.Ray3f, visible: Visible) -> tuple[mi.Float, mi.Normal3f]:
    """How far along a ray what it shows is, and its normal: of an image, the window's."""
    image, hit, first = visible.through_window, visible.hit, visible.first
    point, normal = dr.select(image, first.p, hit.p), dr.select(image, first.n, hit.n)
    met = image | hit.is_valid()
    return dr.select(met, dr.dot(point - ray.o, ray.d), dr.inf), normal


def _sees(
    lens: LensRays, target: Target, cell: mi.UInt32, step: mi.UInt32, surface: mi.UInt32
) -> mi.Bool:
    """Whether any point of the lens sees each target, bool (N,), evaluated.

    Few points are tried first. Only where one of these sees anything in the same ``cell`` of the
    film that is as many steps behind, are the others, and not where enough of them have looked in
    vain at the same side of the same ``surface``: most of what is hidden is hidden from the whole
    lens, and still more of where rays come out of things.
    """
    count = dr.width(target)
    comes_out = target.met & (dr.dot(target.normal, target.direction) > 0)
    few = dr.select(comes_out, mi.UInt32(1), mi.UInt32(FEW_POINTS))
    sees = lens.see(target, dr.zeros(mi.UInt32, count), few)
    dr.eval(target, few, comes_out, sees)
    at_step = _Votes.of(cell, step, sees)
    of_side = _Votes.of(cell, 2 * surface + dr.select(comes_out, mi.UInt32(1), 0), sees)
    again = dr.compress(
        ~sees & (at_step.seen > 0) & ((of_side.seen > 0) | (of_side.looked < ENOUGH))
    )
    if dr.width(again) > 0:
        first = dr.gather(mi.UInt32, few, again)
        more = lens.see(dr.gather(Target, target, again), first, dr.opaque(mi.UInt32, LENS_POINTS))
        dr.scatter(sees, more, again)
    return sees


@dataclasses.dataclass(frozen=True)
class _Votes:
    """How many targets there are of a kind in a cell of the film, and how many have been seen.

    uint32, one element for each target. Kinds share a count now and then, by chance.
    """

    looked: mi.UInt32
    seen: mi.UInt32

    @classmethod
    def of(cls, cell: mi.UInt32, kind: mi.UInt32, sees: mi.Bool) -> _Votes:
        bins = 2 << dr.width(sees).bit_length()
        place = mi.sample_tea_32(cell, kind)[0] & dr.opaque(mi.UInt32, bins - 1)
        looked, seen = dr.zeros(mi.UInt32, bins), dr.zeros(mi.UInt32, bins)
        dr.scatter_add(looked, mi.UInt32(1), place)
        dr.scatter_add(seen, mi.UInt32(1), place, sees)
        return cls(dr.gather(mi.UInt32, looked, place), dr.gather(mi.UInt32, seen, place))


def cells_of(x: np.ndarray, y: np.ndarray, samples: int = VOTERS) -> np.ndarray:
    """Numbers, uint32 (N,), of square cells of the film in which positions lie.

    They are of whole pixels, and most have so many ``samples`` or more.
    """
    column, row = (np.floor(at - at.min()).astype(np.uint32) for at in (x, y))
    counts = np.bincount(row * (column.max() + 1) + column)
    side = math.ceil(math.sqrt(samples / np.quantile(counts[counts > 0], FEWEST)))
    column, row = column // side, row // side
    return row * (column.max() + 1) + column


def shaded(hidden: Hidden, x: np.ndarray, y: np.ndarray, rays: PrimaryRays, paths: int) -> Shown:
    """``hidden`` with the radiance that the pinhole would see if nothing were before it.

    It is the mean of ``paths`` paths each.
    """

    def trace(position: mi.Point2f, start: mi.Float, z: mi.Float, surface: mi.UInt32) -> Traced:
        return rays.trace_from(position, start, z, surface, rays.sensor.get_medium())

    columns = hidden.start, hidden.z, hidden.surface
    return rays.passes.averaged(x, y, trace, LABEL, *columns, paths=paths)


def _pixel_of(window: Window, x: mi.Float, y: mi.Float) -> mi.UInt32:
    """Index of the pixel of each position, as :meth:`Window.pixel_of` has it."""
    left, top, width, height = (dr.opaque(mi.Int32, edge) for edge in window)
    column = dr.clip(mi.Int32(dr.floor(x)) - left, 0, width - 1)
    row = dr.clip(mi.Int32(dr.floor(y)) - top, 0, height - 1)
    return mi.UInt32(row * width + column)


def may_hide(
    visible: Columns, window: Window, lens: ThinLens, camera: Camera, reach: float = 0.0
) -> np.ndarray:
    """Which samples, int (n,), may have something behind them that the lens sees.

    ``visible`` are the samples of layer 0, in ``window``. A pixel is chosen whole; any focus
    from its nearest depth on is counted. Things move up to ``reach`` pixels meanwhile.
    """
    scale = widest_radius_per_vergence(lens, camera, float(visible.z.min()))
    if scale == 0 and reach == 0:
        return np.empty(0, dtype=np.int64)
    parts = wavefronts(len(visible), 1)

    def pixels_of(part: slice) -> mi.UInt32:
        x, y = (from_numpy(mi.Float, column[part]) for column in (visible.x, visible.y))
        return _pixel_of(window, x, y)

    nearest = dr.full(mi.Float, dr.inf, window.size)
    farthest = dr.zeros(mi.Float, window.size)
    for part in parts:
        index, depth = pixels_of(part), from_numpy(mi.Float, visible.z[part])
        dr.scatter_reduce(dr.ReduceOp.Min, nearest, depth, index)
        dr.scatter_reduce(dr.ReduceOp.Max, farthest, depth, index)
        dr.eval(nearest, farthest)
    near, far = (np.array(ends).reshape(window.shape) for ends in (nearest, farthest))
    pixels = disoccluded(near, far, scale)
    if reach > 0:
        pixels |= uncovered(near, far, reach)
    chosen = from_numpy(mi.Bool, pixels.ravel())
    found = [np.empty(0, np.int64)]
    for part in parts:
        index = dr.compress(dr.gather(mi.Bool, chosen, pixels_of(part)))
        found.append(np.array(index).astype(np.int64) + part.start)
    return np.concatenate(found)
