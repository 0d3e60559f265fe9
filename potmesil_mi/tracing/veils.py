"""Veils: what lets a part of the light through along a primary ray.

A surface that is half transparent (``mask``, a ``blendbsdf`` with a ``null`` lobe) and a stretch
of a participating medium are veils. Here are the veils that rays meet; what samples they become is
in :mod:`potmesil_mi.tracing.splitting`.
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np

from .._progress import track
from .clearance import clearance
from .onward import LEAST_THROUGH, channel_mean, is_veil
from .passes import gathered, wavefronts
from .rays import PrimaryRays
from .transmission import Stretch

MOST_VEILS = 4
"""Most veils of a ray that are told apart: what is behind them is one sample."""

LABEL = "Veils"
"""What is said of the progress."""

TURN = (5**0.5 - 1) / 2
"""What is added to a ray's random numbers, modulo 1, for its next veil: the golden section."""


@dataclasses.dataclass(frozen=True)
class Veils:
    """N veils of primary rays, in the order of the rays and in which each ray meets them.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``of``                        uint32 (N,), number of the ray
    ``place``                     uint32 (N,), from 0, among the veils of the ray
    ``through``                   float32 (N, 3), transmittance for R, G and B, with that of
                                  panes of glass and the like since the veil before
    ``z``                         float32 (N,), depth; in a medium, of one scattering in it
    ``before``                    float32 (N,), transmittance of what of a medium may hide what
                                  is at ``z``; 1 of a surface
    ``surface``                   uint32 (N,), id of the surface, or of the one at which the
                                  medium begins; 0 for none
    ``start``                     float32 (N,), where on the ray the veil has been left, in scene
                                  units from the ray's origin; ``inf`` where it does not end
    ``medium``                    uint32 (N,), index in Dr.Jit's registry of the medium behind it
    ``inside``                    bool (N,), whether it is a medium
    ============================  ==========================================================
    """

    of: np.ndarray
    place: np.ndarray
    through: np.ndarray
    z: np.ndarray
    before: np.ndarray
    surface: np.ndarray
    start: np.ndarray
    medium: np.ndarray
    inside: np.ndarray

    def __len__(self) -> int:
        return len(self.of)

    def chosen(self, which: np.ndarray) -> Veils:
        """Those of which ``which``, bool (N,), is true."""
        return Veils(*(column[which] for column in vars(self).values()))

    @classmethod
    def joined(cls, parts: list[Veils]) -> Veils:
        """All of several, one after the other."""
        names = (field.name for field in dataclasses.fields(cls))
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def met(x: np.ndarray, y: np.ndarray, rays: PrimaryRays, apart: float) -> Veils:
    """The veils of the primary rays through (x, y), at most ``MOST_VEILS`` of each.

    ``x``, ``y`` are float32 (N,) in pixels of the film. ``apart`` is by how much the vergence of
    two things differs, of an orthographic camera their depth, so that one may hide the other.
    """
    parts = []
    for part in track(wavefronts(len(x), MOST_VEILS), LABEL):
        count = part.stop - part.start
        ray = rays.passes.begin_for(count)
        position = mi.Point2f(*(gathered(column[part], ray) for column in (x, y)))
        sampler = rays.passes.sampler
        random = sampler.next_1d(), sampler.next_1d()
        room = dr.zeros(_Met, dr.width(ray) * MOST_VEILS)
        _follow(rays, position, random, dr.opaque(mi.Float, apart), room)
        dr.eval(room)
        index = dr.compress(room.there)
        number, place = np.divmod(np.array(index), MOST_VEILS)
        columns = vars(dr.gather(_Met, room, index)).values()
        _, through, *others = (np.array(column) for column in columns)
        veils = Veils((number + part.start).astype(np.uint32), place, through.T, *others)
        parts.append(veils.chosen(number < count))
    return Veils.joined(parts)


@dataclasses.dataclass
class _Met:
    """The columns of :class:`Veils` as Dr.Jit arrays, and whether there is a veil."""

    there: mi.Bool
    through: mi.Color3f
    z: mi.Float
    before: mi.Float
    surface: mi.UInt32
    start: mi.Float
    medium: mi.UInt32
    inside: mi.Bool


@dataclasses.dataclass
class _Way:
    """How far rays have been followed.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``active``                    whether the ray goes on
    ``at``                        distance from the ray's origin
    ``medium``, ``bound``         the medium there, and the id of the surface at which it began
    ``through``                   transmittance since the last veil
    ``met``                       how many veils the ray has met
    ============================  ==========================================================
    """

    active: mi.Bool
    at: mi.Float
    medium: mi.MediumPtr
    bound: mi.UInt32
    through: mi.Color3f
    met: mi.UInt32


def _follow(
    rays: PrimaryRays,
    position: mi.Point2f,
    random: tuple[mi.Float, mi.Float],
    apart: mi.Float,
    room: _Met,
) -> None:
    """Write the veils of each ray, one after the other, into ``room``."""
    ray = rays.begun_at(position, 0.0)
    count = dr.width(position)
    first = dr.arange(mi.UInt32, count) * MOST_VEILS

    def put(way: _Way, here: mi.Bool, veil: _Met) -> None:
        here = here & (way.met < MOST_VEILS)
        dr.scatter(room, veil, first + way.met, here)
        way.through = dr.select(here, 1, way.through)
        way.met += dr.select(here, mi.UInt32(1), mi.UInt32(0))

    def step(way: _Way) -> tuple[_Way]:
        way = dataclasses.replace(way)
        rest = mi.Ray3f(ray)
        rest.o, rest.maxt = ray(way.at), ray.maxt - way.at
        surface = _Surface.of(rays, rest, way)
        if rays.veils.media:
            turned = [of + mi.Float(way.met) * TURN for of in random]
            turned = [of - dr.floor(of) for of in turned]
            put(way, *_medium_veil(rays, rest, way, surface, turned, apart))
        way.through = dr.select(surface.passes, way.through * surface.through, way.through)
        put(way, surface.veils, surface.veil(rays, way))
        way.active &= surface.passes & (way.met < MOST_VEILS)
        way.bound = dr.select(surface.changes, rays.surface_of(surface.hit), way.bound)
        way.at, way.medium = surface.behind, surface.medium
        return (way,)

    around = mi.MediumPtr(rays.sensor.get_medium())
    way = _Way(
        active=dr.full(mi.Bool, True, count),
        at=dr.zeros(mi.Float, count),
        medium=dr.gather(mi.MediumPtr, around, dr.zeros(mi.UInt32, count)),
        bound=dr.zeros(mi.UInt32, count),
        through=dr.full(mi.Color3f, 1, count),
        met=dr.zeros(mi.UInt32, count),
    )
    dr.while_loop((way,), lambda way: way.active, step)


@dataclasses.dataclass
class _Surface:
    """The surface that a ray meets next.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``hit``                       the surface, invalid where there is none
    ``passes``                    whether the ray goes on behind it
    ``veils``                     whether it is a veil
    ``through``                   its transmittance
    ``ahead``, ``behind``         distances from the primary ray's origin just before it and
                                  just behind it
    ``changes``, ``medium``       whether another medium begins there; the medium behind it
    ============================  ==========================================================
    """

    hit: mi.SurfaceInteraction3f
    passes: mi.Bool
    veils: mi.Bool
    through: mi.Color3f
    ahead: mi.Float
    behind: mi.Float
    changes: mi.Bool
    medium: mi.MediumPtr

    @classmethod
    def of(cls, rays: PrimaryRays, rest: mi.Ray3f, way: _Way) -> _Surface:
        """What the ``rest`` of a ray meets that has gone some ``way``."""
        hit = rays.scene.ray_intersect(rest, mi.RayFlags.All, coherent=True, active=way.active)
        meets = way.active & hit.is_valid()
        passes = rays.lets_through(hit, meets)
        through = _rgb(hit.bsdf().eval_null_transmission(hit, passes))
        # Lamps that are not shown and glass that does not refract let all through.
        through = dr.select(dr.max(through) > 0, through, 1)
        distance = way.at + hit.t
        apart = clearance(hit.p, distance)
        changes = meets & hit.is_medium_transition()
        return cls(
            hit=hit,
            passes=passes,
            veils=passes & is_veil(hit, channel_mean(through)),
            through=through,
            ahead=dr.select(meets, distance - apart, dr.inf),
            behind=dr.select(meets, distance + apart, dr.inf),
            changes=changes,
            medium=dr.select(changes, hit.target_medium(rest.d), way.medium),
        )

    def veil(self, rays: PrimaryRays, way: _Way) -> _Met:
        """The surface as a veil."""
        return _Met(
            there=mi.Bool(True),
            through=way.through,
            z=rays.depth(self.hit),
            before=mi.Float(1),
            surface=rays.surface_of(self.hit),
            start=self.behind,
            medium=dr.reinterpret_array(mi.UInt32, self.medium),
            inside=mi.Bool(False),
        )


def _medium_veil(
    rays: PrimaryRays,
    rest: mi.Ray3f,
    way: _Way,
    surface: _Surface,
    random: list[mi.Float],
    apart: mi.Float,
) -> tuple[mi.Bool, _Met]:
    """Where the medium between here and the next ``surface`` is a veil, and that veil.

    It ends behind a surface that lets all through, and before any other. Elsewhere what the medium
    lets through becomes a part of what the ``way`` does.
    """
    inside = way.active & (way.medium != mi.MediumPtr(None))
    stretch = Stretch.of(way.medium, rest, surface.hit.t, random, inside)
    through = dr.select(inside, way.through * _rgb(stretch.through), way.through)
    veils = inside & (channel_mean(_rgb(stretch.through)) < 1 - LEAST_THROUGH)
    clear = surface.passes & ~surface.veils
    medium = dr.select(clear, surface.medium, way.medium)
    z = rays.depth_of(rest(stretch.scattered))
    # What is nearly as far hides nothing of it, from whatever point of the lens.
    nearly = stretch.extinction * (apart if rays.parallel else apart * dr.square(z))
    veil = _Met(
        there=mi.Bool(True),
        through=dr.select(clear, through * surface.through, through),
        z=z,
        before=dr.minimum(stretch.before * dr.exp(nearly), 1),
        surface=way.bound,
        start=dr.select(clear, surface.behind, surface.ahead),
        medium=dr.reinterpret_array(mi.UInt32, medium),
        inside=mi.Bool(True),
    )
    way.through = through
    surface.through = dr.select(veils & clear, 1, surface.through)
    return veils, veil


def _rgb(transmittance: mi.Spectrum) -> mi.Color3f:
    """A transmittance for R, G and B; the mean in variants that count in other colours."""
    transmittance = mi.unpolarized_spectrum(transmittance)
    return mi.Color3f(transmittance if mi.is_rgb else channel_mean(transmittance))
