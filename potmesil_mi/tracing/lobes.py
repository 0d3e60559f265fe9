"""Lesser lobes: smooth glass parts the light of a ray into what it reflects and what it refracts.

What comes by the lobe with more light is what the samples show, see
:mod:`potmesil_mi.tracing.virtual_depth`. Here is the rest: of the radiance L_0 along a ray the part
S = F L_1 comes by another lobe, F the share of that lobe and L_1 the radiance along its ray. It
becomes a sample of its own, of the share F of the ray and at the depth of its own image, and the
ray keeps L_0 - S. Together they are just L_0, so they add no noise to the picture through the
pinhole.
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np

from ..samples.columns import TWINS, Columns
from .buffers import SampleBuffer, Shown, Traced
from .lens_rays import LensRays
from .rays import PrimaryRays
from .seen_through import seen_through
from .virtual_depth import NO_LOBE

MOST_LOBES = 2
"""Most lesser lobes of a ray that are told apart: a pane reflects with both its faces."""

LEAST_SHARE = 1 / 64
"""Lobes of a smaller share of the light are left where they are: glass reflects at least 1/25."""

MOST_SHARE = 0.5
"""A lesser lobe has no more of the light of a ray."""

LABEL = "Reflections"
"""What is said of the progress."""


def part_lobes(
    buffer: SampleBuffer,
    which: np.ndarray,
    through: np.ndarray,
    rays: PrimaryRays,
    lens: LensRays,
    paths: int,
    layers: int,
) -> list[Columns]:
    """Part those of the samples ``which``, int (n,), whose light glass parts.

    They are of one ray each, among the first ones, whose ``through``, (N,), is given. Returns
    samples of the first lesser lobe, and of the second, if there are any. Each is shaded by
    ``paths`` paths. What is seen straight through a pane shows beside it, too: with more than one
    of the ``layers`` it gets hidden twins of the share that the pane keeps back.
    """
    primary, count = len(through), len(which)
    columns = buffer.columns()
    x, y, weight = columns.x[:primary], columns.y[:primary], columns.weight[:primary]
    number = np.repeat(np.arange(MOST_LOBES, dtype=np.uint32), count)
    at_x, at_y = (np.tile(of[which], MOST_LOBES) for of in (x, y))
    seen = seen_through(at_x, at_y, rays, lens, lesser=number)
    del at_x, at_y
    share = share_of(seen.share)
    # Only what one surface parts is parted by a second one.
    share[np.tile(seen.share[:count] == 0, MOST_LOBES)] = 0
    seen, (lobe,) = seen.chosen(share > 0), np.nonzero(share)
    if len(lobe) == 0:
        return []
    where, number, share = which[lobe % count], number[lobe], share[lobe]

    def trace(position: mi.Point2f, number: mi.UInt32) -> Traced:
        return by_lobe(rays, *rays.sampled(position), number)[0]

    shown = rays.passes.averaged(x[where], y[where], trace, LABEL, number, paths=paths)
    # What the rays keep of their light, and the part of them.
    lit, of_lit = np.unique(where, return_inverse=True)
    light, kept = columns.rgb[lit].astype(np.float64), np.ones(len(lit))
    np.subtract.at(light, of_lit, shown.rgb)
    np.subtract.at(kept, of_lit, share)
    # The pinhole does see it.
    seen.visibility[(seen.through > 0) & (seen.visibility == 0)] = 1
    parted = Columns(
        x=x[where],
        y=y[where],
        rgb=shown.rgb / share[:, None],
        alpha=columns.alpha[where],
        z=seen.depth,
        surface=shown.surface,
        weight=weight[where] * share,
        layer=np.zeros(len(where), np.uint8),
        through=seen.through,
        visibility=seen.visibility,
        albedo=shown.albedo,
        normal=shown.normal,
        aovs=shown.aovs,
    )
    rgb = (light / kept[:, None]).astype(np.float32)
    kept_light = dataclasses.replace(Shown.of(columns, lit), rgb=rgb)
    of_ray = weight[lit]
    buffer.put(lit, kept_light, of_ray * kept)
    if layers > 1:
        beside = through[lit] == 0
        twins = lit[beside]
        shares = of_ray[beside] * (1 - kept[beside])
        buffer.add(x[twins], y[twins], kept_light[beside], shares, TWINS)
    return [parted.chosen(number == lobe) for lobe in np.unique(number)]


def share_of(share: np.ndarray) -> np.ndarray:
    """The shares of lesser lobes, (N,), that become samples of their own; 0 of those that do not.

    Two of them leave something.
    """
    return np.where(share >= LEAST_SHARE, np.minimum(share, MOST_SHARE / MOST_LOBES), 0)


def by_lobe(
    rays: PrimaryRays, ray: mi.RayDifferential3f, weight: mi.Spectrum, lesser: int | mi.UInt32
) -> tuple[Traced, mi.Float]:
    """What a ray of a ``weight`` shows by a chain of surfaces alone, and the share of that.

    The chain goes by the ``lesser`` lobe of that number, if it is not ``NO_LOBE``; where there is
    none, both are 0. AOVs are those of the whole ray, as for what comes by the other lobe.
    """
    visible = rays.visible(mi.Ray3f(ray), lesser)
    there = visible.by_lesser | (lesser == NO_LOBE)
    last = mi.RayDifferential3f(visible.last)
    surface = rays.surface_of(visible.hit)
    weight = weight * mi.Spectrum(dr.select(there, visible.throughput, 0))
    traced = rays.shaded(last, weight, visible.depth, surface, None, visible.hit)
    if rays.aovs.names:
        traced = dataclasses.replace(traced, aovs=rays.aovs_along(ray))
    return traced, dr.select(there, visible.share, 0)
