"""Virtual depth: a camera sees the image in a mirror or behind glass, and the image has a depth.

A lens focuses on the image of what a mirror or a window shows, not on the mirror. Primary rays are
followed here to what they show. Their neighbours, in :mod:`potmesil_mi.tracing.differentials`,
tell where rays from all over the lens have to aim to meet there too.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from .._validation import require_whole
from .clearance import ray_from
from .differentials import Differentials, RayTransfer
from .onward import channel_mean, is_veil, may_go_on, onward_from
from .shapes import registry_index

BOUNCES = 16
"""Surfaces at which a path goes on, at most. A filled drinking glass has six, before a mirror they
are thirteen; the rest is for light that is reflected within."""

NEAREST_IMAGE = 1 / 4
"""An image before the window is no nearer than such a part of the window's depth. Glass makes
images next to the lens, too, but of no more than a few rays."""

MOST_BOUNCES = 32
"""The kinds of so many surfaces are bits of a number."""

NO_LOBE = 1 << 30
"""A number that no surface has of those that part light."""

VEILED = 1 << 31
"""More than all surfaces that part light: those behind a veil, whose light is not theirs alone."""


class Visible(NamedTuple):
    """What primary rays show, one element for each, and the chains of surfaces that show it.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``depth``                     depth in scene units along the axis, > 0
    ``hit``                       the surface that is seen, invalid where there is none
    ``is_rough``                  whether ``hit`` shows an image, whose depth is in ``depth``, but
                                  is so rough that no single ray tells where: the chain ends there
    ``first``                     what the ray meets first, a mirror or a pane perhaps
    ``goes_on``                   whether the ray goes on there
    ``through_window``            whether what is seen is an image, by reflection or refraction,
                                  and ``depth`` is that of the image: the chain has turned the ray,
                                  or ends at something rough that does
    ``last``                      the last ray of the chain, which meets ``hit``. It begins just
                                  behind the last mirror or pane; without any it is the primary
                                  ray
    ``throughput``                this times the radiance that comes along ``last`` is the light
                                  of the chain along the primary ray. It is the product of the
                                  shares of light of the lobes that were followed; in refracting
                                  surfaces these include the change of radiance by eta²
    ``share``                     part of the ray that goes along the chain, from 0 to 1: what
                                  glass parts and what veils keep back is not, but what surfaces
                                  absorb is. It is 1 unless ``lesser`` was asked for
    ``turns``                     how many surfaces of the chain turned the ray. What lets it
                                  pass straight does not count
    ``lobes``                     bit i is set where the i-th of these, from 0, has reflected
                                  the ray; else it has refracted it
    ``by_lesser``                 whether the chain goes by the lesser lobe of a surface, see
                                  :func:`trace_visible`
    ``pane``                      index in Dr.Jit's registry of the shape that it was; 0 without
    ``spread``                    how far the ray's end moves as the ray is aimed apart: scene
                                  units across the last ray for each at depth 1, without windows
                                  about the depth. Where nothing is hit it is that of the
                                  ray's direction
    ============================  ==========================================================
    """

    depth: mi.Float
    hit: mi.SurfaceInteraction3f
    is_rough: mi.Bool
    first: mi.SurfaceInteraction3f
    goes_on: mi.Bool
    through_window: mi.Bool
    last: mi.Ray3f
    throughput: mi.UnpolarizedSpectrum
    share: mi.Float
    turns: mi.UInt32
    lobes: mi.UInt32
    by_lesser: mi.Bool
    pane: mi.UInt32
    spread: mi.Float

    @classmethod
    def direct(cls, depth: mi.Float, hit: mi.SurfaceInteraction3f, ray: mi.Ray3f) -> Visible:
        """What rays show that are not followed: what they meet first."""
        return cls(
            depth=depth,
            hit=mi.SurfaceInteraction3f(hit),
            is_rough=mi.Bool(False),
            first=hit,
            goes_on=mi.Bool(False),
            through_window=mi.Bool(False),
            last=ray,
            throughput=mi.UnpolarizedSpectrum(1),
            share=mi.Float(1),
            turns=mi.UInt32(0),
            lobes=mi.UInt32(0),
            by_lesser=mi.Bool(False),
            pane=mi.UInt32(0),
            spread=dr.select(hit.is_valid(), depth, 1),
        )


@dataclasses.dataclass
class _Path:
    """The state of paths that are followed through mirrors and panes, with their neighbours.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``active``                    whether the path may go on
    ``count``                     surfaces at which it went on
    ``turns``, ``lobes``,         as in :class:`Visible`
    ``throughput``,
    ``share``, ``by_lesser``,
    ``pane``
    ``parted``                    surfaces that parted its light into lobes; ``VEILED`` behind a
                                  veil
    ``sharpness``                 weight in 1/depth of what it will show, from 1 down to 0 as rough
                                  surfaces take the image away
    ``vergence``                  share in 1/depth of rough surfaces that it has met
    ``length``                    its length from the pinhole, in scene units
    ``ray``                       its last ray
    ``hit``                       where it is
    ``neighbours``                how its point and its direction change from ray to ray
    ============================  ==========================================================
    """

    active: mi.Bool
    count: mi.UInt32
    turns: mi.UInt32
    lobes: mi.UInt32
    throughput: mi.UnpolarizedSpectrum
    share: mi.Float
    parted: mi.UInt32
    by_lesser: mi.Bool
    pane: mi.UInt32
    sharpness: mi.Float
    vergence: mi.Float
    length: mi.Float
    ray: mi.Ray3f
    hit: mi.SurfaceInteraction3f
    neighbours: Differentials

    def transfer(self) -> RayTransfer:
        """How the path's end moves as the ray leaves the lens elsewhere or is aimed apart."""
        return self.neighbours.transfer(self.ray.d, self.hit.is_valid())


def trace_visible(
    scene: mi.Scene,
    origin: mi.Point3f,
    ray: mi.Ray3f,
    hit: mi.SurfaceInteraction3f,
    axis: mi.Vector3f,
    *,
    alphas: mi.Float | None = None,
    bounces: int = BOUNCES,
    lesser: int | mi.UInt32 | None = None,
) -> Visible:
    """Depth of what primary rays show, behind at most ``bounces`` mirrors and panes.

    ``origin`` is the pinhole and ``axis`` the unit vector along which it looks, in the world;
    ``ray`` are rays of unit direction from it, or from points of a lens across the axis there, and
    ``hit`` is what each meets first. ``alphas`` are those of the scene, see
    :func:`potmesil_mi.tracing.onward.alphas_of`; without them what is rough ends the path.

    At a surface the path goes on

    - straight, where any of the light passes so (``mask``, ``null``), behind a mirror and through
      glass (``thindielectric``) where at least half does, and at a ``dielectric`` that does not
      refract;
    - reflected or refracted, where the BSDF does nothing but that, as a smooth ``conductor``, a
      ``dielectric``, and a ``thindielectric`` at a grazing angle. Of two such lobes it follows
      the one with more light; where refraction is impossible, the total reflection.

    Smooth glass that does both parts the light. At the surface of the number ``lesser`` of these,
    from 0, the path goes by the lobe with less light; ``NO_LOBE`` is none of them. It may be one
    number for each path.

    Anything else ends the path, and so does the front of a lamp. What is diffuse, or glossy with
    something diffuse below, has the depth of its surface. From rough microfacets
    (``roughconductor``, ``roughdielectric``) the path is followed on as if they were smooth, only
    for the depth.

    The depth is the one, along the axis, to which a thin lens at the pinhole has to be focused
    for the path's end to be sharp:

    - where nothing turned the path, the depth of the last hit, and ``inf`` where nothing was hit;
    - in plane mirrors, the depth of the unfolded path;
    - in curved mirrors and behind glass, the depth of the point from which the light seems to
      come. An astigmatic image has the mean of 1/depth over all directions, since the circle of
      confusion is affine in it. A convex mirror or a ball of glass shows what is infinitely far
      at a finite depth, with an invalid hit;
    - of an image before the window, no less than ``NEAREST_IMAGE`` times the window's;
    - ``inf`` for every image that is no nearer than infinity: its light reaches the lens
      converging, to a point behind it;
    - at rough surfaces, a mean in 1/depth of that of the image and theirs. Light that they have
      spread is still as far away as the image, but the farther it is spread the less that shows.

    Curvature is that of the shading normals a pixel or so around; bumps turn the path but do
    not count as curvature. Raises ``ValueError`` or ``TypeError`` for bad ``bounces`` or a bad
    number ``lesser``.
    """
    require_whole("bounces", bounces, 0, MOST_BOUNCES)
    if lesser is not None and not isinstance(lesser, mi.UInt32):
        require_whole("lesser", lesser, 0, NO_LOBE)
        lesser = dr.opaque(mi.UInt32, lesser)
    origin, axis = mi.Point3f(origin), mi.Vector3f(axis)

    def followed(path: _Path, alphas: mi.Float | None, lesser: mi.UInt32 | None) -> _Path:
        (end,) = dr.while_loop(
            (path,),
            lambda path: path.active & (path.count < bounces),
            lambda path: (_step(scene, path, alphas, depth_of(path), lesser),),
        )
        return end

    def depth_of(path: _Path) -> mi.Float:
        image = path.transfer().image_depth()
        return dr.select(path.turns > 0, image, _depth(origin, axis, path.hit))

    start = _start(ray, hit, axis, _depth(origin, axis, hit) / dr.dot(ray.d, axis))
    end = followed(start, None, lesser)
    depth, is_rough, goes_on = depth_of(end), mi.Bool(False), end.count > 0
    if alphas is not None:
        beyond = dataclasses.replace(end, active=may_go_on(end.hit, alphas))
        beyond = followed(beyond, alphas, None)
        is_rough, goes_on = beyond.turns > end.turns, beyond.count > 0
        image = dr.rcp(beyond.vergence + beyond.sharpness / depth_of(beyond))
        depth = dr.select(is_rough, image, depth)
    through_window = (end.turns > 0) | is_rough
    nearest = NEAREST_IMAGE * _depth(origin, axis, hit)
    return Visible(
        depth=dr.select(through_window, dr.maximum(depth, nearest), depth),
        hit=end.hit,
        is_rough=is_rough,
        first=hit,
        goes_on=goes_on,
        through_window=through_window,
        last=end.ray,
        throughput=end.throughput,
        share=end.share,
        turns=end.turns,
        lobes=end.lobes,
        by_lesser=end.by_lesser & ((end.pane > 0) | (end.turns == 0)),
        pane=end.pane,
        spread=end.transfer().spread(),
    )


def _start(
    ray: mi.Ray3f,
    hit: mi.SurfaceInteraction3f,
    axis: mi.Vector3f,
    distance: mi.Float,
) -> _Path:
    """The paths at what the primary rays meet first, at a ``distance`` from the pinhole."""
    length = dr.select(hit.is_valid(), distance, 0)
    return _Path(
        active=may_go_on(hit),
        count=mi.UInt32(0),
        turns=mi.UInt32(0),
        lobes=mi.UInt32(0),
        throughput=mi.UnpolarizedSpectrum(1),
        share=mi.Float(1),
        parted=mi.UInt32(0),
        by_lesser=mi.Bool(False),
        pane=mi.UInt32(0),
        sharpness=mi.Float(1),
        vergence=mi.Float(0),
        length=length,
        ray=mi.Ray3f(ray),
        hit=mi.SurfaceInteraction3f(hit),
        neighbours=Differentials.of_lens(axis, ray.d).moved(length),
    )


def _step(
    scene: mi.Scene,
    path: _Path,
    alphas: mi.Float | None,
    depth: mi.Float,
    lesser: mi.UInt32 | None,
) -> _Path:
    """The paths at what they meet next; ``depth`` is that of what they show where they are."""
    here = path.hit
    by_lesser = None if lesser is None else path.parted == lesser
    onward = onward_from(here, path.active, path.turns > 0, alphas, lesser=by_lesser)
    sharpness, vergence = path.sharpness, path.vergence
    if alphas is not None:
        kept = dr.select(onward.turns, onward.sharpness, 1)
        vergence = vergence + sharpness * (1 - kept) / depth
        sharpness = sharpness * kept
    goes = onward.straight | onward.turns
    neighbours = path.neighbours.turned(
        scene, here, path.ray.d, path.length, onward.direction, onward.eta, onward.turns
    )
    direction = dr.select(onward.turns, onward.direction, path.ray.d)
    ray = ray_from(here, direction, path.length)
    there = scene.ray_intersect(ray, goes)
    step = dr.select(goes & there.is_valid(), dr.norm(there.p - here.p), 0)
    bit = dr.select(onward.turns & onward.reflects, mi.UInt32(1) << path.turns, 0)
    end = _Path(
        active=goes & may_go_on(there, alphas),
        count=path.count + dr.select(goes, mi.UInt32(1), mi.UInt32(0)),
        turns=path.turns + dr.select(onward.turns, mi.UInt32(1), mi.UInt32(0)),
        lobes=path.lobes | bit,
        throughput=path.throughput * dr.select(goes, onward.weight, 1),
        share=path.share,
        parted=path.parted,
        by_lesser=path.by_lesser,
        pane=path.pane,
        sharpness=sharpness,
        vergence=vergence,
        length=path.length + step,
        ray=dr.select(goes, ray, path.ray),
        hit=dr.select(goes, there, here),
        neighbours=neighbours.moved(step),
    )
    if by_lesser is not None:
        passed = channel_mean(onward.weight)
        now, veiled = goes & (onward.lesser_share > 0), goes & is_veil(here, passed)
        share = dr.select(by_lesser, onward.lesser_share, 1 - onward.lesser_share)
        share = dr.select(veiled, passed, share)
        end.share = path.share * dr.select(now | veiled, share, 1)
        parted = path.parted + dr.select(now, mi.UInt32(1), mi.UInt32(0))
        end.parted = dr.select(veiled, mi.UInt32(VEILED), parted)
        end.by_lesser = path.by_lesser | (now & by_lesser)
        end.pane = dr.select(now & by_lesser & onward.turns, registry_index(here), path.pane)
    return end


def _depth(origin: mi.Point3f, axis: mi.Vector3f, hit: mi.SurfaceInteraction3f) -> mi.Float:
    """Depth of a hit along ``axis``; ``inf`` where nothing was hit."""
    return dr.select(hit.is_valid(), dr.dot(hit.p - origin, axis), dr.inf)
