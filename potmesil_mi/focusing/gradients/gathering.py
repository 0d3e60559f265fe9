"""Which samples become which fragment: gathering as a sum over samples, which has derivatives."""

from __future__ import annotations

import functools
from typing import NamedTuple

import drjit as dr
import numpy as np

from ...samples.point_samples import PointSamples
from ..density import BORROWED_DENSITY, evened
from ..fragments import MAX_BINS, SHARE, Fragments
from ..gathering import ends_of_bins
from ..locating import Bins, Raster, located_in, parts_of


class Gathering(NamedTuple):
    """Fragments, evened, and of which samples they are.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``fragments``                 F fragments, in order, whose ``detail`` is the sum of each
    ``sum_of_sample``             uint32 (N,), the sum, of S, that each sample is part of
    ``sum_of_fragment``           int64 (F,), the sum that each fragment is a copy of
    ``subpixel_of_sum``           uint32 (S,), the subpixel of each
    ``is_first``                  bool (S,), whether the pinhole sees it
    ``scale``                     float32 (F,), by which it was evened
    ``density``                   that of :class:`potmesil_mi.focusing.density.Evened`; ``None``
                                  where nothing was evened
    ============================  ==========================================================
    """

    fragments: Fragments
    sum_of_sample: np.ndarray
    sum_of_fragment: np.ndarray
    subpixel_of_sum: np.ndarray
    is_first: np.ndarray
    scale: np.ndarray
    density: np.ndarray | None

    @property
    def scale_of_subpixel(self) -> np.ndarray | None:
        """By what the fragments of each subpixel were evened, (height * width,); 0 of copies."""
        if self.density is None:
            return None
        own = self.density.ravel() > BORROWED_DENSITY
        return np.divide(1, self.density.ravel(), out=np.zeros(own.size), where=own)

    @property
    def nbytes(self) -> int:
        """Memory in bytes."""
        columns = (self.sum_of_sample, self.sum_of_fragment, self.subpixel_of_sum, self.scale)
        return self.fragments.nbytes + sum(of.nbytes for of in columns)

    def scaled(self, scale: np.ndarray) -> Gathering:
        """The same with the light of each fragment multiplied by a ``scale``, float32 (F,)."""
        return self._replace(fragments=self.fragments.scaled(scale), scale=self.scale * scale)


def gather(
    samples: PointSamples, subpixels: int, radius_per_vergence: float, alpha: bool
) -> Gathering:
    """What :func:`potmesil_mi.focusing.gathering.gather` makes of samples, and evened.

    Of each sample it tells where it went.
    """
    raster = Raster.of(samples, subpixels)
    width, height = raster.window.width, raster.window.height
    bins = Bins.of(samples.z, radius_per_vergence)
    located = functools.partial(located_in, samples, subpixels, raster)
    nearest, farthest = (
        np.array(of) for of in ends_of_bins(len(samples), located, bins, raster.size)
    )
    keys = np.empty(len(samples), np.int64)
    for part, _ in parts_of(len(samples)):
        at = located(part)
        bin_ = bins.of_vergence(at.vergence)
        dr.eval(at.subpixel, bin_)
        place = np.array(at.subpixel).astype(np.int64)
        # Where the pinhole sees one depth, its samples are one sum, whatever their bins.
        alone = (samples.layer[part] == 0) & ((nearest - farthest)[place] <= 1)
        own = np.where(alone, 0, np.array(bin_))
        keys[part] = (place * 256 + samples.layer[part]) * (MAX_BINS + 1) + own
    keys, index = np.unique(keys, return_inverse=True)
    index = index.astype(np.uint32)
    place, layer = keys // ((MAX_BINS + 1) * 256), keys // (MAX_BINS + 1) % 256
    weight = samples.weight.astype(np.float64) * subpixels**2

    def sums(of: np.ndarray) -> np.ndarray:
        return np.bincount(index, weight * of, len(keys))

    share = sums(np.ones(len(samples)))
    columns = [*(sums(of) for of in samples.rgb.T), share]
    if alpha:
        columns.append(sums(samples.alpha))
    vergence = sums(1 / samples.z) / share
    first = bins.vergence_min + (nearest[place] + 0.5) * bins.width
    gap = np.where(layer > 0, np.maximum(first - vergence, bins.width * 1e-3), 0)
    fragments = Fragments(
        width,
        height,
        place % width,
        place // width,
        vergence,
        np.stack(columns, axis=1),
        gap,
        np.clip((vergence - bins.vergence_min) / bins.width, 0, MAX_BINS).astype(np.int64),
        bins.vergence_min,
        bins.width,
        detail=np.arange(len(keys)),
    ).in_order()
    found = evened(fragments, subpixels)
    final = found.fragments
    assert final.detail is not None
    scale = final.values[:, SHARE] / share[final.detail]
    return Gathering(
        final,
        index,
        final.detail.astype(np.int64),
        place.astype(np.uint32),
        layer == 0,
        scale.astype(np.float32),
        found.density,
    )
