"""What the plan of a focus takes from all fragments of a view: how many there are, and where.

A picture that is formed by tiles has these of all its tiles, each of which counts the fragments of
its own part, and so has the slices, kernels and octaves of the picture that is formed whole.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..optics.blur import Blur
from ..samples.raster import Window
from .bands import Band, Raster
from .fragments import Fragments
from .lens_view import LensView
from .locating import Bins

NOWHERE = Window(0, 0, 0, 0)
"""The box of no fragments."""

LARGEST_OF_BAND = 20
"""The circles of a band on coarser pixels are smaller than so many of these times the radius that
is kept: bands are from one of the ``SLICE_RADII`` to the next, 4 times as large, are parted up to
``PARTING`` off at both ends, and their smallest circles are up to 2 times as large as is asked."""

Parts = tuple[slice, slice, slice]
"""Which of the unoccluded and occluded fragments and of the highlights are in a slice."""


class SliceFacts(NamedTuple):
    """What the plan of a slice takes from all of its fragments.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``width``, ``height``         pixels of the window, as large as the fragments' subpixels
    ``area``                      pixels of the slice in the box of its fragments
    ``bins``                      int (B,), those that have unoccluded fragments, ascending
    ``vergences``                 float64 (B,), the mean of these in each
    ``ends``                      the first and the last bin of the occluded ones, and of the
                                  highlights
    ============================  ==========================================================
    """

    width: int
    height: int
    area: int
    bins: np.ndarray
    vergences: np.ndarray
    ends: tuple[tuple[int, int], tuple[int, int]]

    @classmethod
    def of(cls, view: LensView, parts: Parts, box: Window) -> SliceFacts:
        """Those of the fragments of a view that is a whole picture's."""
        unoccluded, *others = view.kinds
        part, (bins, vergences) = parts[0], view.vergences
        these = slice(0, 0)
        if part.start < part.stop:
            ends = np.searchsorted(bins, unoccluded.bin[[part.start, part.stop - 1]])
            these = slice(ends[0], ends[1] + 1)
        occluded, highlights = (
            _ends(some.bin[part]) for some, part in zip(others, parts[1:], strict=True)
        )
        return cls(
            unoccluded.width,
            unoccluded.height,
            box.size,
            bins[these],
            vergences[these],
            (occluded, highlights),
        )


def _ends(bins: np.ndarray) -> tuple[int, int]:
    """The first and the last of some bins in their order; 0 if there are none."""
    return (int(bins[0]), int(bins[-1])) if len(bins) else (0, 0)


def parts_of_slice(view: LensView, band: Band, raster: Raster) -> Parts:
    """Which fragments of a view are in the slice of a band on one raster."""
    unoccluded, occluded, highlights = (
        some.between(*bins) for some, bins in zip(view.kinds, _bins(band, raster), strict=True)
    )
    return unoccluded, occluded, highlights


def _bins(band: Band, raster: Raster) -> list[tuple[int, int]]:
    """The first bin of a slice, and that behind the last, of each kind of fragments."""
    of_view, of_highlights = (0, 0), (0, 0)
    if raster.has_view:
        of_view = band.first // raster.coarsening, (band.end - 1) // raster.coarsening + 1
    if raster.has_highlights:
        of_highlights = band.first, band.end
    return [of_view, of_view, of_highlights]


def box_of(view: LensView, parts: Parts, raster: Raster) -> Window:
    """The box, in pixels of the slice, of the fragments of a slice; empty if there are none."""
    return _around(
        [
            (some.x[part] // pixel, some.y[part] // pixel)
            for some, part, pixel in zip(view.kinds, parts, _pixels(raster), strict=True)
            if part.start < part.stop
        ]
    )


def _pixels(raster: Raster) -> tuple[int, int, int]:
    """How many of the subpixels of each kind of fragments make a pixel of the slice."""
    return 1, 1, raster.resolution


def _around(places: Sequence[tuple[np.ndarray, np.ndarray]]) -> Window:
    """The box around columns and rows."""
    if not places:
        return NOWHERE
    left, top = (min(int(of[i].min()) for of in places) for i in (0, 1))
    right, bottom = (max(int(of[i].max()) for of in places) for i in (0, 1))
    return Window(left, top, right + 1 - left, bottom + 1 - top)


class _Sums(NamedTuple):
    """How many fragments there are in each bin, int64 (B,), and the sums of their vergences."""

    counts: np.ndarray
    sums: np.ndarray

    @classmethod
    def of(cls, fragments: Fragments) -> _Sums:
        return cls(np.bincount(fragments.bin), np.bincount(fragments.bin, fragments.vergence))

    @classmethod
    def added(cls, every: Sequence[_Sums]) -> _Sums:
        return cls(*(_added(of) for of in zip(*every, strict=True)))


def _added(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """The sum of arrays (..., B), of which shorter ones have zeros at their ends."""
    longest = max(of.shape[-1] for of in arrays)
    return np.sum([_longer(of, longest, 0) for of in arrays], axis=0)


def _longer(array: np.ndarray, length: int, value: int) -> np.ndarray:
    """An array (..., B) made longer by a value."""
    ends = [(0, 0)] * (array.ndim - 1) + [(0, length - array.shape[-1])]
    return np.pad(array, ends, constant_values=value)


@dataclasses.dataclass(frozen=True)
class ViewCounts:
    """How many fragments a view of a whole picture has, and where, before the lens is focused.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``width``, ``height``         subpixels of the window
    ``total``                     int64 (B,), how many fragments each bin has
    ``firsts``                    int64 (3, 2, B), the first column and row of those of each
                                  kind, see :attr:`.LensView.kinds`; beyond the window if there
                                  are none
    ``lasts``                     int64 (3, 2, B), the last ones; -1 if there are none
    ``unoccluded``                by coarsening, what there is of the unoccluded ones on pixels,
                                  and in bins, so many times as large
    ============================  ==========================================================
    """

    width: int
    height: int
    total: np.ndarray
    firsts: np.ndarray
    lasts: np.ndarray
    unoccluded: dict[int, _Sums]

    @classmethod
    def of(
        cls, view: LensView, own: Window, whole: tuple[int, int], coarse: Sequence[CoarseBins]
    ) -> ViewCounts:
        """Those of the fragments of a tile's view that are in its ``own`` subpixels.

        ``whole`` are the width and height of the picture in subpixels. ``coarse`` are the coarser
        views that its plan may ask for.
        """
        beyond = max(whole)
        unoccluded = view.unoccluded
        kinds = [some.chosen(own.contains(some.x, some.y)) for some in view.kinds]
        count = max((int(some.bin[-1]) + 1 for some in kinds if len(some)), default=0)
        firsts = np.full((3, 2, count), beyond, np.int64)
        lasts = np.full((3, 2, count), -1, np.int64)
        for i, some in enumerate(kinds):
            for j, places in enumerate((some.x + some.left, some.y + some.top)):
                np.minimum.at(firsts[i, j], some.bin, places)
                np.maximum.at(lasts[i, j], some.bin, places)
        counts = [np.bincount(some.bin, minlength=count) for some in kinds]
        sums = {1: _Sums.of(kinds[0])}
        for factor, bins in coarse:
            part = unoccluded.between(bins.start, bins.stop)
            # A fragment is shared by four pixels, the farthest of which is less than two away.
            near = own.grown(2 * factor).contains(unoccluded.x[part], unoccluded.y[part])
            coarser = unoccluded.chosen(part).chosen(near).coarser_linearly(factor)
            # A pixel on the edge of several tiles is that of the one that has its first subpixel.
            coarser = coarser.chosen(own.contains(coarser.x * factor, coarser.y * factor))
            found = _Sums.of(coarser)
            sums[factor] = _Sums.added([sums[factor], found]) if factor in sums else found
        return cls(*whole, np.sum(counts, axis=0), firsts, lasts, sums)

    @classmethod
    def added(cls, tiles: Sequence[ViewCounts]) -> ViewCounts:
        """Those of the whole picture, of those of all its tiles."""
        first = tiles[0]
        longest = max(len(of.total) for of in tiles)
        beyond = max(first.width, first.height)
        return cls(
            first.width,
            first.height,
            _added([of.total for of in tiles]),
            np.min([_longer(of.firsts, longest, beyond) for of in tiles], axis=0),
            np.max([_longer(of.lasts, longest, -1) for of in tiles], axis=0),
            {
                factor: _Sums.added([of.unoccluded[factor] for of in tiles])
                for factor in first.unoccluded
            },
        )

    def facts(self, band: Band, raster: Raster) -> SliceFacts:
        """What the plan of the slice of a band on one raster takes from the whole picture."""
        factor = raster.coarsening
        first, end = _bins(band, raster)[0]
        counts, sums = (of[first:end] for of in self.unoccluded.get(factor, self.unoccluded[1]))
        filled = np.flatnonzero(counts)
        places, ends = [], []
        for kind, (start, stop) in enumerate(_bins(band, raster)):
            its_factor = 1 if kind == 2 else factor
            fine = slice(start * its_factor, stop * its_factor)
            lasts = self.lasts[kind, :, fine]
            there = np.flatnonzero(lasts[0] >= 0)
            ends.append(_ends((there + fine.start) // its_factor))
            if len(there):
                firsts = self.firsts[kind, :, fine][:, there].min(axis=1)
                lasts = lasts.max(axis=1)
                places.append(self._pixels(kind, firsts, lasts, raster))
        return SliceFacts(
            -(-self.width // factor),
            -(-self.height // factor),
            _around(places).size,
            filled + first,
            sums[filled] / counts[filled],
            (ends[1], ends[2]),
        )

    def _pixels(
        self, kind: int, firsts: np.ndarray, lasts: np.ndarray, raster: Raster
    ) -> tuple[np.ndarray, np.ndarray]:
        """Columns and rows, in pixels of a slice, of the first and the last fragment of a kind."""
        places = np.stack([firsts, lasts], axis=1)
        if kind == 0 and raster.coarsening > 1:  # It is shared by the pixels around it.
            middles = (places + 0.5) / raster.coarsening - 0.5
            places = np.floor(middles).astype(np.int64) + np.array([0, 1])
            ends = [-(-size // raster.coarsening) - 1 for size in (self.width, self.height)]
            places = np.clip(places, 0, np.array(ends)[:, None])
        else:
            places = places // raster.resolution
        return places[0], places[1]


class CoarseBins(NamedTuple):
    """Bins that a plan may ask for on pixels, and in bins, ``factor`` times as large."""

    factor: int
    bins: range


def coarse_bins(bins: Bins, count: int, blur: Blur, kept_radius: float) -> Iterator[CoarseBins]:
    """The bins, of ``count``, that the plan of a focus may ask for on coarser pixels.

    A band has pixels of ``factor`` subpixels where its smallest circles are ``factor`` times as
    large as the radius that is kept, and less than twice that.
    """
    if blur.radius_per_vergence == 0:
        return
    focused = (blur.focused_vergence - bins.vergence_min) / bins.width
    bins_of_radius = 1 / (blur.radius_per_vergence * bins.width)
    farthest = max(abs(focused), abs(count - focused)) / bins_of_radius
    factor = 2
    while factor * kept_radius <= farthest:
        ends = [factor * kept_radius * bins_of_radius * by for by in (1, LARGEST_OF_BAND)]
        for first, end in (
            (focused + ends[0], focused + ends[1]),
            (focused - ends[1], focused - ends[0]),
        ):
            start = max(int(first // factor), 0) * factor
            stop = min(int(end // factor) + 1, -(-count // factor)) * factor
            if start < stop:
                yield CoarseBins(factor, range(start, stop))
        factor *= 2
