"""Splitting: a sample before which its ray meets veils becomes several, each with its share.

Of the radiance L_0 along a ray a veil of transmittance T has its own S = L_0 - T L_1, which it
reflects, emits or scatters towards the camera; L_1 is the radiance of the ray begun behind the
veil, of which T L_1 shines through. The veil becomes a sample of the share 1 - t of the ray, t the
mean of T over the colours, and what is behind it gets the rest, which the next veil splits again.
Together they are just L_0, so they add no noise to the picture through the pinhole; an error of T
moves light from one depth to another.

From elsewhere in the lens what is behind a veil is seen past the veil's edge. So each of these
samples has a hidden twin of the share that the veils before it keep from the pinhole.
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np

from ..samples.columns import TWINS
from ..samples.grouping import grouped
from . import veils
from .buffers import SampleBuffer, Shown, Traced
from .onward import LEAST_THROUGH
from .rays import PrimaryRays
from .veils import Veils

NEAREST = 1 / 4
"""The medium around the camera is no nearer than such a part of the depth of what is nearest: its
light is all over the picture all the same, and depths are told apart in proportion to their
range."""

LEAST_SHARE = 1.0
"""Share of a ray that samples of a medium have on the average, at least. Where there would be less,
some in each pixel stand for all."""

TINY = 1e-6
"""What counts as good as nothing, and is not 0."""

LEAST_PARALLAX = 0.25
"""Pixels by which a thing moves before another, as one looks from another point of the lens, before
it hides it: visibility is found on bins of such a size."""

MOST_BEHIND = 16
"""Most of a medium that is counted behind what is before it: where less than this part of the light
comes from, as good as nothing is seen."""


def split(
    buffer: SampleBuffer, primary: int, rays: PrimaryRays, paths: int, parallax: float
) -> None:
    """Split those of the first ``primary`` samples, of one ray each, that are behind veils.

    What is behind a veil is shaded by ``paths`` paths. If the lens has a ``parallax``, in pixels
    per unit of vergence or of an orthographic camera of depth, hidden twins are added.
    """
    columns = buffer.columns()
    x, y = columns.x[:primary], columns.y[:primary]
    found = veils.met(x, y, rays, LEAST_PARALLAX / parallax if parallax > 0 else 0.0)
    if len(found) == 0:
        return
    found = _no_nearer(found, columns.z[:primary])
    behind = _behind(found, x[found.of], y[found.of], rays, paths)
    which, ray = np.unique(found.of, return_inverse=True)
    last = Shown.of(columns, which)
    weight, x, y = (column[which] for column in (columns.weight, x, y))
    parts = Part.of_rays(found, ray, last, behind, _pixels(x, y), weight)
    for place, part in enumerate(parts):
        shares = weight[part.of] * part.share
        if place == 0:
            buffer.put(which, part.shown, shares)
        else:
            seen = shares > 0
            buffer.add(x[part.of][seen], y[part.of][seen], part.shown[seen], shares[seen], 0)
    for place, part in enumerate(parts if parallax > 0 else []):
        shares = weight[part.of] * part.hidden
        there = shares > 0
        at = part.of[there]
        buffer.add(x[at], y[at], part.shown[there], shares[there], TWINS + place)


def _behind(found: Veils, x: np.ndarray, y: np.ndarray, rays: PrimaryRays, paths: int) -> Shown:
    """What is behind each of the veils ``found`` on rays through (x, y): radiance and alpha."""
    result = Shown.empty(len(found))
    result.rgb[:] = result.alpha[:] = 0
    ends = np.isfinite(found.start)
    for medium in np.unique(found.medium[ends]):
        these = np.flatnonzero(ends & (found.medium == medium))
        where = dr.reinterpret_array(mi.MediumPtr, mi.UInt32(int(medium)))[0]

        def trace(position: mi.Point2f, start: mi.Float, where: mi.Medium = where) -> Traced:
            nothing = dr.zeros(mi.UInt32, dr.width(start))
            return rays.trace_from(position, start, start, nothing, where)

        columns = x[these], y[these]
        shown = rays.passes.averaged(*columns, trace, veils.LABEL, found.start[these], paths=paths)
        result.rgb[these], result.alpha[these] = shown.rgb, shown.alpha
    return result


@dataclasses.dataclass(frozen=True)
class Part:
    """Veils of the same place on their rays, or what is behind the last ones: N samples.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``of``                        int64 (N,), which of the rays with veils
    ``shown``                     what they show
    ``share``                     float64 (N,), of the ray that the pinhole sees
    ``hidden``                    float64 (N,), of the ray that what is before it hides
    ============================  ==========================================================
    """

    of: np.ndarray
    shown: Shown
    share: np.ndarray
    hidden: np.ndarray

    @classmethod
    def of_rays(
        cls,
        found: Veils,
        ray: np.ndarray,
        last: Shown,
        behind: Shown,
        pixel: np.ndarray,
        weight: np.ndarray,
    ) -> list[Part]:
        """The parts of rays, from the nearest on.

        ``ray``, int (N,), is the number of the ray that each of the veils ``found`` belongs to.
        ``last`` are the samples of the rays: of what is behind all the veils, but with all of the
        light and alpha. ``behind`` has the radiance and the alpha behind each veil. ``pixel`` and
        ``weight`` are the rays'. All that a medium scatters in a pixel is of one colour, for a ray
        that tells where it scatters does not tell what it scatters there.
        """
        count = len(last.z)
        light = np.concatenate([last.rgb, last.alpha[:, None]], axis=1).astype(np.float64)
        through, tint, ends = np.ones(count), np.ones((count, 4)), np.ones(count, dtype=bool)
        parts = []
        for place in range(int(found.place.max()) + 1):
            here = np.flatnonzero(found.place == place)
            of, veil = ray[here], found.chosen(here)
            colours = np.concatenate([veil.through, veil.through.mean(axis=1)[:, None]], axis=1)
            mean = colours[:, -1]
            # What hardly lets any light through is all that is seen of the ray.
            ends_it = (through[of] > 0) & (through[of] * mean < LEAST_THROUGH)
            passing = np.where(ends_it[:, None], 0, colours)
            after = np.concatenate([behind.rgb[here], behind.alpha[here, None]], axis=1)
            kept = 1 - passing[:, -1]
            own = tint[of] * (light[of] - passing * after) / kept[:, None]
            inside = veil.inside
            key = np.where(inside, pixel[of] * (int(found.surface.max()) + 1) + veil.surface, -1)
            own[inside] = _means(own, weight[of] * kept * (through[of] + TINY), key)[inside]
            past = 1 / np.maximum(veil.before, 1 / MOST_BEHIND) - through[of]
            shares = [kept * through[of], kept * np.maximum(past, 0)]
            shares = [np.where(inside, _some_for_all(share, key), share) for share in shares]
            parts.append(cls(of, _shown(own, veil.z, veil.surface, last, of), *shares))
            light[of] = after
            clear = mean >= LEAST_THROUGH
            tint[of] *= np.where(clear, colours.T / np.where(clear, mean, 1), 1).T
            through[of] *= passing[:, -1]
            ends[of] = np.isfinite(veil.start)
        every = np.arange(count)
        shown = _shown(light * tint, last.z, last.surface, last, every)
        shown = dataclasses.replace(shown, albedo=last.albedo, normal=last.normal)
        parts.append(cls(every, shown, through, (1 - through) * ends))
        return parts


def _pixels(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Numbers, int64 (N,), of the pixels of positions on the film."""
    column, row = (np.floor(at).astype(np.int64) for at in (x, y))
    return (row - row.min()) * (np.ptp(column) + 1) + column - column.min()


def _means(light: np.ndarray, weight: np.ndarray, key: np.ndarray) -> np.ndarray:
    """The weighted mean of the ``light``, (N, 4), of all that has the same key, for each."""
    same, _ = grouped(key)
    total = np.bincount(same, weight)
    means = [np.bincount(same, weight * column) / total for column in light.T]
    return np.stack(means, axis=1)[same]


def _no_nearer(found: Veils, z: np.ndarray) -> Veils:
    """The veils ``found``, where the medium around the camera is no nearer than ``NEAREST``.

    ``z``, (N,), are the depths of what is behind veils.
    """
    around = found.surface == 0
    nearest = min(z.min(), found.z[~around].min(initial=np.inf))
    if not np.isfinite(nearest):
        return found
    least = np.where(around, NEAREST * nearest, 0).astype(np.float32)
    return dataclasses.replace(found, z=np.maximum(found.z, least))


def _some_for_all(shares: np.ndarray, key: np.ndarray) -> np.ndarray:
    """Shares, (N,), with the same sum over all that have the same key; where they are small some
    of them are 0, chosen in proportion to their shares.
    """
    order = np.argsort(key, kind="stable")
    own, begins = shares[order], np.diff(key[order], prepend=-2) != 0
    group = np.cumsum(begins) - 1
    total, count = np.bincount(group, own), np.bincount(group)
    number = np.clip(np.rint(total / LEAST_SHARE), 1, count)
    after = np.cumsum(own)
    after -= (after - own)[begins][group]
    each = (number / np.maximum(total, TINY))[group]
    times = np.floor(after * each + 0.5) - np.floor((after - own) * each + 0.5)
    result = np.empty_like(shares)
    result[order] = np.where(number[group] < count[group], times / each, own)
    return result


def _shown(
    light: np.ndarray, z: np.ndarray, surface: np.ndarray, rays: Shown, of: np.ndarray
) -> Shown:
    """What is shown, of RGB and alpha, (N, 4). AOVs are those of the rays that it is ``of``."""
    rgb, alpha = light[:, :3].astype(np.float32), light[:, 3].astype(np.float32)
    return Shown(rgb, alpha, z, surface, aovs=None if rays.aovs is None else rays.aovs[of])
