"""Which rays of a lens see what a primary ray shows through windows: mirrors and glass.

A ray of the lens is aimed at the image. It sees the thing if it is reflected and refracted by as
many surfaces, in the same order, and ends there.
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi

from .clearance import ray_from
from .onward import may_go_on, onward_from
from .shapes import registry_index
from .virtual_depth import BOUNCES, Visible


@dataclasses.dataclass
class Chain:
    """The surfaces by which primary rays are turned, and where they end, one element for each.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``turns``, ``lobes``,         as in :class:`Visible`
    ``spread``, ``is_rough``,
    ``pane``
    ``met``                       whether it ends at a surface; else in the sky
    ``point``                     where that is
    ``normal``                    the surface's unit normal
    ``shape``                     its index in Dr.Jit's registry, as :func:`registry_index` has it
    ``direction``                 unit direction of the last ray
    ============================  ==========================================================
    """

    turns: mi.UInt32
    lobes: mi.UInt32
    spread: mi.Float
    is_rough: mi.Bool
    pane: mi.UInt32
    met: mi.Bool
    point: mi.Point3f
    normal: mi.Normal3f
    shape: mi.UInt32
    direction: mi.Vector3f

    @classmethod
    def of(cls, visible: Visible) -> Chain:
        """The chains of what primary rays show."""
        hit = visible.hit
        return cls(
            turns=visible.turns,
            lobes=visible.lobes,
            spread=visible.spread,
            is_rough=visible.is_rough,
            pane=visible.pane,
            met=hit.is_valid(),
            point=hit.p,
            normal=hit.n,
            shape=registry_index(hit),
            direction=visible.last.d,
        )


@dataclasses.dataclass
class _Walk:
    """The state of rays of the lens that are followed along chains.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``active``                    whether the ray may go on
    ``count``                     surfaces at which it went on
    ``turns``                     surfaces that turned it
    ``length``                    its length from the lens, in scene units
    ``ray``                       its last ray
    ``hit``                       where it is
    ============================  ==========================================================
    """

    active: mi.Bool
    count: mi.UInt32
    turns: mi.UInt32
    length: mi.Float
    ray: mi.Ray3f
    hit: mi.SurfaceInteraction3f


def meets_end(
    scene: mi.Scene,
    ray: mi.Ray3f,
    chain: Chain,
    tolerance: mi.Float | float,
    active: mi.Bool | bool = True,
    *,
    bounces: int = BOUNCES,
) -> mi.Bool:
    """Which rays of the lens end where the chains of primary rays do, bool (N,).

    ``ray`` are N rays of unit direction from points of the lens towards images. Each is turned by
    as many surfaces as its ``chain``, and by the same lobes; what cannot reflect or refract as the
    chain does, blocks it. It passes straight what primary rays do, wherever that is. ``bounces`` is
    as in :func:`trace_visible`.

    Only in plane mirrors do the rays meet in a point. Elsewhere they miss it by the aberrations of
    the image: ``tolerance`` is how far a ray may pass the end, as a share of the chain's
    ``spread``, which without windows is the depth. A pixel is as large as 1 over the focal length
    in pixels. Nothing may be before the end, but for the surface itself: the same shape, within
    the tolerance of the plane that touches it at the end. An end in the sky is met in its
    direction, within the tolerance in radians times ``spread``. What is rough shows its image all
    over: any point of the shape is the end.
    """
    hit = scene.ray_intersect(ray, active=active)
    start = _Walk(
        active=may_go_on(hit) & active,
        count=mi.UInt32(0),
        turns=mi.UInt32(0),
        length=dr.select(hit.is_valid(), hit.t, 0),
        ray=mi.Ray3f(ray),
        hit=hit,
    )
    (end,) = dr.while_loop(
        (start,),
        lambda walk: walk.active & (walk.count < bounces),
        lambda walk: (_step(scene, walk, chain),),
    )
    return active & (end.turns == chain.turns) & _is_end(end, chain, tolerance * chain.spread)


def _step(scene: mi.Scene, walk: _Walk, chain: Chain) -> _Walk:
    """The rays at what they meet next."""
    here = walk.hit
    reflects = ((chain.lobes >> walk.turns) & 1) == 1
    mirrors = reflects & (registry_index(here) == chain.pane)
    onward = onward_from(here, walk.active, walk.turns > 0, reflects=reflects, mirrors=mirrors)
    turns = onward.turns & (walk.turns < chain.turns)
    goes = onward.straight | turns
    direction = dr.select(turns, onward.direction, walk.ray.d)
    ray = ray_from(here, direction, walk.length)
    there = scene.ray_intersect(ray, goes)
    return _Walk(
        active=goes & may_go_on(there),
        count=walk.count + dr.select(goes, mi.UInt32(1), mi.UInt32(0)),
        turns=walk.turns + dr.select(turns, mi.UInt32(1), mi.UInt32(0)),
        length=walk.length + dr.select(goes & there.is_valid(), there.t, 0),
        ray=dr.select(goes, ray, walk.ray),
        hit=dr.select(goes, there, here),
    )


def _is_end(walk: _Walk, chain: Chain, allowed: mi.Float) -> mi.Bool:
    """Whether the last rays meet the ends of chains, or miss them by no more than ``allowed``."""
    ray, hit = walk.ray, walk.hit
    in_sky = ~hit.is_valid() & (dr.norm(ray.d - chain.direction) <= allowed)
    ahead = dr.dot(chain.point - ray.o, ray.d)
    near = (dr.norm(chain.point - ray(ahead)) <= allowed) & (ahead >= -allowed)
    free = ~hit.is_valid() | (hit.t >= ahead - allowed)
    same = hit.is_valid() & (registry_index(hit) == chain.shape)
    level = same & (dr.abs(dr.dot(hit.p - chain.point, chain.normal)) <= allowed)
    return dr.select(chain.met, near & (free | level), in_sky) | (chain.is_rough & same)
