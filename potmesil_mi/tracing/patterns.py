"""Where the film is sampled: by the sampler, on the paper's grid, or adaptively.

:func:`papers_grid` and :func:`subdivided` are the patterns on their own: they count points in
steps of ``1 / lattice`` pixels from the window's corner, and trace no rays.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

from .._progress import track
from ..optics.blur import radius_per_vergence
from ..optics.lens import ThinLens
from ..optics.summed_area import summed_area
from ..samples.raster import Window
from .buffers import SampleBuffer, Shown, to_host
from .fireflies import Fireflies
from .passes import gathered, wavefronts
from .rays import PrimaryRays
from .refinement import further_sets, mean_sharpness, pixel_score
from .sampling import Sampling

ROOM_FOR_HIDDEN = 0.5
"""There is room for so many hidden samples for each that the pinhole sees."""

MOST_FURTHER = 1.05
"""There is room for so many samples for each that refinement is to add: it meets it nearly."""

PAPERS_LATTICE = 2
"""Points of the paper's grid on a side of a pixel: corners, middles of edges and centres."""

FINE = 16
"""Beyond the crop window a cell with samples is at most a ``FINE``-th as wide as it is far away."""


@dataclasses.dataclass(frozen=True)
class VisibleSamples:
    """What the pinhole sees: the samples of depth layer 0.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``buffer``                    the samples, to which hidden ones can be added
    ``lattice``                   positions are multiples of 1/lattice pixels; 0: anywhere
    ``goes_on``                   int64 (n,), numbers of the samples whose rays may go on at what
                                  they meet first
    ============================  ==========================================================
    """

    buffer: SampleBuffer
    lattice: int
    goes_on: np.ndarray


def sample_visible(
    rays: PrimaryRays, window: Window, sampling: Sampling, fireflies: Fireflies
) -> VisibleSamples:
    """Sample what the pinhole sees of ``window``, by the pattern of ``sampling``.

    ``fireflies`` that are clamped call for no further samples; they are not clamped yet.
    """
    if sampling.pattern == "sampler":
        return _by_sampler(rays, window, sampling, fireflies)
    uniform = sampling.pattern == "uniform"
    lattice = PAPERS_LATTICE if uniform else 1 << sampling.subdivisions

    def show(ix: np.ndarray, iy: np.ndarray) -> Shown:
        x, y = _positions(ix, iy, lattice, window)
        return rays.passes.averaged(x, y, rays.trace, "Sampling")

    if uniform:
        points = papers_grid(window, show)
    else:
        points = subdivided(window, show, sampling.threshold, sampling.subdivisions)
    buffer = SampleBuffer(len(points.ix))
    x, y = _positions(points.ix, points.iy, lattice, window)
    buffer.add(x, y, points.shown, points.weight, layer=0)
    return VisibleSamples(buffer, lattice, np.arange(len(x)))


# ---------------------------------------------------------------- by the sampler


def _by_sampler(
    rays: PrimaryRays, window: Window, sampling: Sampling, fireflies: Fireflies
) -> VisibleSamples:
    """``spp`` samples in each pixel where the sampler puts them, pixel by pixel.

    Far beyond the crop window there are as many in each of larger cells. Then come the further ones
    of pixels that are refined.
    """
    spp = rays.passes.spp
    parts = sampler_cells(rays.crop, window)
    hidden = ROOM_FOR_HIDDEN if sampling.layers > 1 else 0.0
    further = sampling.refine * MOST_FURTHER * len(parts[0])
    buffer = SampleBuffer(math.ceil((sum(map(len, parts)) + further) * spp * (1 + hidden)))
    go_on = [_sample_cells(buffer, rays, cells, cells.area / spp) for cells in parts]
    if sampling.refine > 0:
        go_on.append(_refine(buffer, rays, parts[0], sampling, fireflies))
    return VisibleSamples(buffer, 0, np.concatenate(go_on))


def _sample_cells(
    buffer: SampleBuffer, rays: PrimaryRays, cells: Cells, weight: np.ndarray
) -> np.ndarray:
    """Add ``spp`` samples in each cell, whose ``weight``, (N,), is that of each of them.

    Returns the numbers, int64 (n,), of those whose rays go on at what they meet first.
    """
    spp = rays.passes.spp
    go_on = [np.empty(0, np.int64)]
    for part in track(wavefronts(len(cells), spp), "Sampling"):
        here = cells[part]
        rays.passes.begin(len(here) * spp)
        position, end = here.positions(rays.passes.sampler.next_2d(), spp)
        traced, goes_on = rays.traced(position)
        places = _before(position.x, end.x), _before(position.y, end.y)
        shown, (x, y, onward) = to_host(traced, *places, dr.select(goes_on, mi.UInt8(1), 0))
        go_on.append(len(buffer) + np.flatnonzero(onward))
        buffer.add(x, y, shown, np.repeat(weight[part], spp), layer=0)
    return np.concatenate(go_on)


def _refine(
    buffer: SampleBuffer,
    rays: PrimaryRays,
    pixels: Cells,
    sampling: Sampling,
    fireflies: Fireflies,
) -> np.ndarray:
    """Add further sets of samples to the ``pixels`` of the crop window, which come first.

    All samples of a pixel then count the same. Returns what :func:`_sample_cells` does.
    """
    spp, columns, lens = rays.passes.spp, buffer.columns(), rays.sensor.lens()
    scale = 0.0
    if isinstance(lens, ThinLens):
        scale = radius_per_vergence(lens, rays.sensor.camera())
    score = np.empty(len(pixels))
    for part in wavefronts(len(pixels), spp):
        here = slice(part.start * spp, part.stop * spp)
        rgb, z = columns.rgb[here], columns.z[here]
        rgb = fireflies.clamped(rgb, columns.surface[here], z).reshape(-1, spp, 3)
        z = z.reshape(-1, spp)
        score[part] = pixel_score(rgb, mean_sharpness(z, scale, sampling.foci))
    size = rays.crop.height, rays.crop.width
    sets = further_sets(score.reshape(size), sampling.refine).ravel()
    weight = 1 / (spp * (1 + sets))
    columns.weight[: len(pixels) * spp] = np.repeat(weight, spp)
    return _sample_cells(buffer, rays, pixels.repeated(sets), np.repeat(weight, sets))


@dataclasses.dataclass(frozen=True)
class Cells:
    """Rectangles of pixels, each of which gets as many samples as a pixel of the crop window.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``left``, ``top``             int32 (N,), first column and first row of pixels of the film
    ``width``, ``height``         int32 (N,), columns and rows
    ============================  ==========================================================
    """

    left: np.ndarray
    top: np.ndarray
    width: np.ndarray
    height: np.ndarray

    @classmethod
    def of(cls, window: Window, size: int) -> Cells:
        """Squares of ``size`` pixels a side, row by row; less at the right and below."""
        columns = np.arange(window.left, window.right, size, dtype=np.int32)
        rows = np.arange(window.top, window.bottom, size, dtype=np.int32)
        left, top = np.tile(columns, len(rows)), np.repeat(rows, len(columns))
        width = np.minimum(window.right - left, size)
        return cls(left, top, width, np.minimum(window.bottom - top, size))

    @classmethod
    def joined(cls, parts: list[Cells]) -> Cells:
        """Those of several, one after the other."""
        return cls(
            *(np.concatenate(of) for of in zip(*(each._columns() for each in parts), strict=True))
        )

    def __len__(self) -> int:
        return len(self.left)

    def __getitem__(self, part: slice) -> Cells:
        """Some of them."""
        return Cells(*(column[part] for column in self._columns()))

    def chosen(self, which: np.ndarray) -> Cells:
        """Those of which ``which``, bool (N,), is true."""
        return Cells(*(column[which] for column in self._columns()))

    def touch(self, pixels: np.ndarray, window: Window) -> np.ndarray:
        """Which cells, bool (N,), have any of the ``pixels`` of ``window``, bool (H, W)."""
        left, top = self.left - window.left, self.top - window.top
        sums = summed_area(pixels.astype(np.float64))
        right, bottom = left + self.width, top + self.height
        inside = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
        return inside > 0.5

    def repeated(self, times: np.ndarray) -> Cells:
        """Each of them so many ``times``, int (N,)."""
        return Cells(*(np.repeat(column, times) for column in self._columns()))

    @property
    def area(self) -> np.ndarray:
        """Pixels of each, int32 (N,)."""
        return self.width * self.height

    def positions(self, within: mi.Point2f, each: int) -> tuple[mi.Point2f, mi.Point2f]:
        """Film positions of ``each`` points of every cell, which ``within`` has from 0 to 1.

        Also returns the right and lower ends of their cells.
        """
        cell = dr.arange(mi.UInt32, len(self) * each) // dr.opaque(mi.UInt32, each)
        left, top, width, height = (gathered(column, cell) for column in self._columns())
        first, size = mi.Point2f(left, top), mi.Point2f(width, height)
        return dr.fma(within, size, first), first + size

    def _columns(self) -> tuple[np.ndarray, ...]:
        return self.left, self.top, self.width, self.height


def sampler_cells(crop: Window, window: Window) -> list[Cells]:
    """Cells that cover ``window``: pixels of ``crop``, pixels around it, larger cells beyond.

    The crop window, which ``window`` covers, is a part of its own and comes first, so that its
    rays are those of ``mi.render``. What lies farther away matters in the picture only where its
    circles of confusion reach that far, or its parallax does, so it needs no finer cells: those
    ``FINE`` times ``size`` pixels away and more may be twice that size.
    """
    return [
        Cells.joined([Cells.of(strip, size) for strip in strips])
        for size, strips in _rings(crop, window)
    ]


def visible_count(crop: Window, window: Window, spp: int, sampling: Sampling) -> int:
    """How many samples :func:`sample_visible` takes; of ``adaptive`` ones at least so many."""
    if sampling.pattern != "sampler":
        steps = PAPERS_LATTICE if sampling.pattern == "uniform" else 1
        return (steps * window.width + 1) * (steps * window.height + 1)
    cells = sum(
        -(-strip.width // size) * -(-strip.height // size)
        for size, strips in _rings(crop, window)
        for strip in strips
    )
    return math.ceil(spp * (cells + sampling.refine * crop.size))


def _rings(crop: Window, window: Window) -> Iterator[tuple[int, list[Window]]]:
    """The parts of ``window``, from ``crop`` outwards: the size of their cells, and strips."""
    inner, size = crop, 1
    yield size, [crop]
    while inner != window:
        outer = crop.grown(2 * size * FINE).intersection(window)
        beside = inner.height
        strips = [
            Window(outer.left, outer.top, outer.width, inner.top - outer.top),
            Window(outer.left, inner.top, inner.left - outer.left, beside),
            Window(inner.right, inner.top, outer.right - inner.right, beside),
            Window(outer.left, inner.bottom, outer.width, outer.bottom - inner.bottom),
        ]
        around = [strip for strip in strips if not strip.is_empty]
        if around:
            yield size, around
        inner, size = outer, 2 * size


def _before(position: mi.Float, end: mi.Float) -> mi.Float:
    """``position``, moved left of ``end`` where single precision has rounded it up."""
    below = end - dr.maximum(dr.abs(end), 1) * dr.epsilon(mi.Float)
    return dr.minimum(position, below)


# ---------------------------------------------------------------- on a lattice


def _positions(
    ix: np.ndarray, iy: np.ndarray, lattice: int, window: Window
) -> tuple[np.ndarray, np.ndarray]:
    """Positions in pixels of the film, float32, of points of the window's lattice."""
    x = (ix / lattice + window.left).astype(np.float32)
    y = (iy / lattice + window.top).astype(np.float32)
    return x, y


Show = Callable[[np.ndarray, np.ndarray], Shown]
"""What the rays through points (ix, iy) of a lattice show."""


@dataclasses.dataclass(frozen=True)
class LatticePoints:
    """N points of a lattice, in the order of their rows and columns.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``ix``, ``iy``                int64 (N,), in steps of 1/lattice pixels from the window's
                                  corner
    ``shown``                     what the rays through them show
    ``weight``                    float64 (N,), share of a pixel's area each stands for
    ============================  ==========================================================
    """

    ix: np.ndarray
    iy: np.ndarray
    shown: Shown
    weight: np.ndarray


def papers_grid(window: Window, show: Show) -> LatticePoints:
    """The (2W+1) x (2H+1) points of the paper's grid, of a quarter of a pixel each."""
    columns = PAPERS_LATTICE * window.width + 1
    rows = PAPERS_LATTICE * window.height + 1
    iy, ix = np.divmod(np.arange(columns * rows), columns)
    return LatticePoints(ix, iy, show(ix, iy), np.full(len(ix), 1 / PAPERS_LATTICE**2))


def subdivided(window: Window, show: Show, threshold: float, subdivisions: int) -> LatticePoints:
    """Pixel corners, subdivided where they differ: the paper's antialiasing (figure 8).

    ``show`` is asked once for each point. A square is divided into 2x2 where :func:`_differ` says
    so of its corners, a pixel at most ``subdivisions`` times. A point's weight is a quarter of the
    area of the squares, not divided further, of which it is a corner; on the border of the window
    the squares beyond it are taken for the mirror image of those inside.
    """
    lattice = side = 1 << subdivisions
    stride = window.width * lattice + 1
    corner_y, corner_x = np.divmod(np.arange(window.size), window.width)
    squares = np.stack([corner_x, corner_y]) * lattice
    known = np.empty(0, dtype=np.int64)
    shown = Shown.empty(0)
    weight = np.empty(0)
    for level in range(subdivisions + 1):
        corners = _corners(squares, side, stride)
        new = np.setdiff1d(corners, known)
        added = show(new % stride, new // stride)
        order = np.argsort(np.concatenate([known, new]))
        known = np.concatenate([known, new])[order]
        weight = np.concatenate([weight, np.zeros(len(new))])[order]
        shown = shown.followed_by(added)[order]
        index = np.searchsorted(known, corners)
        divided = _differ(shown.rgb[index], threshold)
        if level == subdivisions:
            divided[:] = False
        quarter = (side / lattice) ** 2 / 4
        weight += quarter * np.bincount(index[~divided].ravel(), minlength=len(known))
        side //= 2
        squares = _quarters(squares[:, divided], side)
    iy, ix = np.divmod(known, stride)
    for points, last in ((ix, window.width * lattice), (iy, window.height * lattice)):
        weight[(points == 0) | (points == last)] *= 2
    return LatticePoints(ix, iy, shown, weight)


def _corners(squares: np.ndarray, side: int, stride: int) -> np.ndarray:
    """Numbers of the four corners of each square, (N, 4): rows of ``stride`` points each.

    ``squares`` (2, N) holds the left and the upper ends of squares of ``side`` steps.
    """
    x, y = squares
    return np.stack([(y + dy) * stride + x + dx for dy in (0, side) for dx in (0, side)], axis=1)


def _differ(rgb: np.ndarray, threshold: float) -> np.ndarray:
    """Whether one of four intensities, (N, 4, 3), is more than ``threshold`` from their mean."""
    rgb = np.clip(np.nan_to_num(rgb), 0, 1)
    return (np.abs(rgb - rgb.mean(axis=1, keepdims=True)) > threshold).any(axis=(1, 2))


def _quarters(squares: np.ndarray, side: int) -> np.ndarray:
    """The four squares of ``side`` steps that each of the squares, (2, N), is divided into."""
    x, y = squares
    return np.stack(
        [
            np.concatenate([x + dx for _ in (0, side) for dx in (0, side)]),
            np.concatenate([y + dy for dy in (0, side) for _ in (0, side)]),
        ]
    )
