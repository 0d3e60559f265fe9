"""What the lens sees in windows and the pinhole does not: other points of the lens find it."""

from __future__ import annotations

import dataclasses
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.ndimage

from .._backend import from_numpy
from .._progress import track
from ..samples.columns import (
    ELSEWHERE,
    VISIBILITY_POINTS,
    Columns,
    points_that_see,
    visibility_points,
)
from ..samples.raster import Window
from .buffers import Shown, to_host
from .images import ALL, VirtualImage, seen_by, visibility_of
from .lens_rays import TURN, LensRays
from .lobes import LEAST_SHARE, by_lobe, share_of
from .passes import gathered, wavefronts
from .patterns import sampler_cells
from .peeling import cells_of
from .rays import PrimaryRays
from .seen_through import CELL_SAMPLES, LABEL
from .virtual_depth import NO_LOBE

MOST_SHIFTED = 0.95
"""How far images are shifted that are sought: as far as this part of those that are known."""

TRIED_ELSEWHERE = 1024
"""So many points of the lens are tried by as many samples in a pixel as the pinhole's: how many see
what is found tells what it counts."""

FINDERS = 2
"""Rays by which what the pinhole does not see is looked for, for each of its samples. Most find
nothing new, and are not shaded."""


def seen_elsewhere(
    rays: PrimaryRays, lens: LensRays, window: Window, columns: Columns, lobes: int
) -> list[Columns]:
    """What the lens sees in windows and the pinhole does not: samples of layer ``ELSEWHERE``.

    Rays of the points of the lens show it. Its place is where the pinhole would see the image.
    What several of the points see is found from each of them, so that a sample there stands for
    less. ``columns`` are the samples that there are, among them those of so many lesser ``lobes``
    of a ray.
    """
    assert columns.through is not None
    images = columns.through > 0
    vergence = float(np.median(1 / columns.z[images]))
    finder = _Finder(rays, lens, window, vergence)
    around = _around(window, lens, columns)
    parts = [
        cells.chosen(cells.touch(around, window)) for cells in sampler_cells(rays.crop, window)
    ]
    spp = rays.passes.spp
    # Lesser lobes have little light: half as many rays do. All go by one kernel.
    groups = np.array([*[NO_LOBE] * FINDERS, *range(lobes)], np.uint32)
    each = len(groups) * spp
    passes = [cells[part] for cells in parts for part in wavefronts(len(cells), each)]
    found = []
    for cells in track(passes, LABEL):
        rays.passes.begin(len(cells) * each)
        position, _ = cells.positions(rays.passes.sampler.next_2d(), each)
        lobe = np.tile(np.repeat(groups, spp), len(cells))
        area = np.repeat(cells.area / spp, each)
        area[lobe == NO_LOBE] /= FINDERS
        found.append(finder.found(position, area, lobe if lobes > 0 else None))
    return [part for part in found if part is not None]


def _around(window: Window, lens: LensRays, columns: Columns) -> np.ndarray:
    """The pixels of ``window``, bool (H, W), in which there may be images the pinhole does not see.

    There is one as far from an image that some points of the lens do not see as these are shifted.
    """
    assert columns.through is not None
    assert columns.visibility is not None
    partly = (columns.through > 0) & (columns.layer == 0) & (columns.visibility != ALL)
    found = np.zeros(window.size, dtype=bool)
    found[window.pixel_of(columns.x[partly], columns.y[partly])] = True
    if not found.any():
        return found.reshape(window.shape)
    apart = np.quantile(np.abs(1 / columns.through[partly] - 1 / columns.z[partly]), MOST_SHIFTED)
    reach = math.ceil(min(apart * lens.parallax, max(window.shape))) + 1
    return scipy.ndimage.maximum_filter(found.reshape(window.shape), 2 * reach + 1)


class _Finder:
    """Finds in windows what points of the lens see and the pinhole does not.

    Their rays go to where those of the pinhole are at a ``vergence``, so that most of what they
    find is seen near there.
    """

    def __init__(self, rays: PrimaryRays, lens: LensRays, window: Window, vergence: float) -> None:
        self.rays, self.lens, self.window = rays, lens, window
        self.vergence = dr.opaque(mi.Float, vergence)
        self.u, self.v = (
            from_numpy(mi.Float, column) for column in visibility_points(lens.radius).T
        )

    def found(
        self, position: mi.Point2f, area: np.ndarray, lobe: np.ndarray | None
    ) -> Columns | None:
        """What is found by rays by way of each ``position`` on the film; ``None`` for nothing.

        ``area``, (N,), is what of the film each of them stands for, in pixels, and ``lobe``,
        uint32 (N,), by which lesser lobe it goes, if there are any.
        """
        # Each has its turn, in an order without a pattern.
        turn = dr.arange(mi.UInt32, dr.width(position)) * mi.UInt32(TURN)
        point = turn >> mi.UInt32(32 - int(math.log2(VISIBILITY_POINTS)))
        ray, _ = self._ray(position, point)
        lesser = None if lobe is None else from_numpy(mi.UInt32, lobe)
        visible = self.rays.visible(mi.Ray3f(ray), lesser, coherent=False)
        image = VirtualImage.of(ray, visible, self.rays)
        new = visible.through_window
        if lesser is not None:
            new &= visible.by_lesser | (lesser == NO_LOBE)
        new &= ~image.seen_from(mi.Float(0), mi.Float(0), self.lens, new)
        x, y = self._place(image)
        new &= (x >= self.window.left) & (x < self.window.right)
        new &= (y >= self.window.top) & (y < self.window.bottom)
        depth, surface = self.rays.depth(visible.first), self.rays.surface_of(visible.hit)
        known = x, y, visible.depth, depth, surface
        dr.eval(new, image, position, known)
        index = dr.compress(new)
        if dr.width(index) == 0:
            return None
        x, y, z, through, surface = (np.array(dr.gather(type(of), of, index)) for of in known)
        chosen = dr.gather(mi.Point2f, position, index), dr.gather(mi.UInt32, point, index)
        image = dr.gather(VirtualImage, image, index)
        # The points that others try do not depend on which point has found them.
        own = seen_by(image, np.uint64(1) << np.array(chosen[1]).astype(np.uint64), self.lens)
        cell = cells_of(x, y, CELL_SAMPLES)
        visibility = own | visibility_of(image, x, y, cell, self.lens, TRIED_ELSEWHERE)
        share = VISIBILITY_POINTS / np.maximum(points_that_see(visibility), 1)
        shown, part = self._shown(*chosen, None if lobe is None else lobe[np.array(index)])
        found = Columns(
            x=x,
            y=y,
            rgb=shown.rgb,
            alpha=shown.alpha,
            z=z,
            surface=surface,
            weight=area[np.array(index)] * share * part,
            layer=np.full(len(x), ELSEWHERE, np.uint8),
            through=through,
            visibility=visibility,
            albedo=shown.albedo,
            normal=shown.normal,
            aovs=shown.aovs,
        )
        return found.chosen((own > 0) & found.is_valid() & (part > 0))

    def _ray(
        self, position: mi.Point2f, point: mi.UInt32
    ) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """The ray of each ``point`` by way of each ``position``, and its weight."""
        ray, weight = self.rays.sampled(position)
        axis, origin = self.lens.axis, self.lens.origin
        per_depth = ray.d / dr.dot(ray.d, axis)
        u, v = dr.gather(mi.Float, self.u, point), dr.gather(mi.Float, self.v, point)
        step = u * self.lens.across[0] + v * self.lens.across[1]
        near = dr.dot(ray.o - origin, axis)
        ray.o += step * (1 - near * self.vergence)
        ray.d = dr.normalize(per_depth - step * self.vergence)
        ray.has_differentials = False
        return ray, weight

    def _place(self, image: VirtualImage) -> tuple[mi.Float, mi.Float]:
        """Where on the film the pinhole would see images, in pixels."""
        camera = self.rays.sensor.camera()
        apart = dr.select(image.is_near, image.point - self.lens.origin, image.direction)
        scale = camera.focal_length_pixels / dr.dot(apart, self.lens.axis)
        x, y = (
            dr.opaque(mi.Float, middle) - scale * dr.dot(apart, across)
            for middle, across in zip(camera.principal_point, self.lens.across, strict=True)
        )
        return x, y

    def _shown(
        self, position: mi.Point2f, point: mi.UInt32, lobe: np.ndarray | None
    ) -> tuple[Shown, np.ndarray]:
        """What the rays by way of each ``position`` show by a lobe, and its share, float32 (N,).

        Depth and surface are not told.
        """
        count = dr.width(position)
        index = self.rays.passes.begin_for(count)
        ray, weight = self._ray(
            dr.gather(mi.Point2f, position, index), dr.gather(mi.UInt32, point, index)
        )
        if lobe is None:
            lanes = dr.width(index)
            nothing = dr.zeros(mi.Float, lanes), dr.zeros(mi.UInt32, lanes)
            hit = self.rays.visible(mi.Ray3f(ray)).hit if self.rays.features else None
            traced = self.rays.shaded(ray, weight, *nothing, self.rays.sensor.get_medium(), hit)
            return to_host(traced)[0][:count], np.ones(count, np.float32)
        # Of glass each lobe has what it shows alone.
        traced, share = by_lobe(self.rays, ray, weight, gathered(lobe, index))
        every, (share,) = to_host(traced, share)
        share = np.where(lobe == NO_LOBE, share[:count], share_of(share[:count]))
        rgb = every.rgb[:count] / np.maximum(share, LEAST_SHARE)[:, None]
        return dataclasses.replace(every[:count], rgb=rgb, alpha=np.ones(count, np.float32)), share
