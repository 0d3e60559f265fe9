"""Which samples become which fragment: gathering as a sum over samples, which has derivatives."""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import drjit as dr
import numpy as np

from ...samples.point_samples import PointSamples
from ..density import BORROWED_DENSITY, evened
from ..fragments import SHARE, Fragments
from ..gathering import Chosen, Terms, ends_of_bins, fragments_of, sorted_sums
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

    def brightened(self, fragments: Fragments) -> Gathering:
        """The same of its ``fragments`` with their light, all of each, multiplied by something."""
        times = fragments.values[:, SHARE] / self.fragments.values[:, SHARE]
        return self._replace(fragments=fragments, scale=self.scale * times)


def gather(
    samples: PointSamples, subpixels: int, radius_per_vergence: float, alpha: bool
) -> Gathering:
    """What :func:`potmesil_mi.focusing.gathering.gather` makes of samples, and evened.

    Of each sample it tells where it went.
    """
    raster, bins = Raster.of(samples, subpixels), Bins.of(samples.z, radius_per_vergence)
    located = functools.partial(located_in, samples, subpixels, raster)
    ends = ends_of_bins(len(samples), located, bins, raster.size)
    nearest, farthest = (np.array(of) for of in ends)
    places, own_bins = (np.empty(len(samples), np.uint32) for _ in range(2))
    for part, _ in parts_of(len(samples)):
        at = located(part)
        bin_ = bins.of_vergence(at.vergence)
        dr.eval(at.subpixel, bin_)
        places[part], own_bins[part] = np.array(at.subpixel), np.array(bin_)
    # Where the pinhole sees one depth, its samples are one sum, whatever their bins.
    own_bins[(samples.layer == 0) & ((nearest - farthest)[places] <= 1)] = 0
    every = Chosen(samples, slice(None), samples.layer, samples.weight)
    place, layer, vergence, light, same = sorted_sums(
        every, subpixels, alpha, Terms.of(0), places, 0.0, 0.0, own_bins
    )
    fragments = dataclasses.replace(
        fragments_of(raster, bins, place, vergence, light),
        gap_in_front=np.where(layer > 0, bins.gap_behind(nearest[place], vergence), 0),
        detail=np.arange(len(place)),
    ).in_order()
    found = evened(fragments, subpixels)
    final = found.fragments
    assert final.detail is not None
    scale = final.values[:, SHARE] / light[final.detail, 0, SHARE]
    return Gathering(
        final,
        same.astype(np.uint32),
        final.detail.astype(np.int64),
        place.astype(np.uint32),
        layer == 0,
        scale.astype(np.float32),
        found.density,
    )
