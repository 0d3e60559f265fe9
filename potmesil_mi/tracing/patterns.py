"""Where the film is sampled: by the sampler, on the paper's grid, or adaptively.

:func:`papers_grid` and :func:`subdivided` are the patterns on their own: they count points in
steps of ``1 / lattice`` pixels from the window's corner, and trace no rays.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from .._progress import track
from ..samples.raster import Window
from .buffers import SampleBuffer, Shown, to_host
from .passes import wavefronts
from .rays import PrimaryRays
from .sampling import Sampling

PAPERS_LATTICE = 2
"""Points of the paper's grid on a side of a pixel: corners, middles of edges and centres."""


@dataclasses.dataclass(frozen=True)
class VisibleSamples:
    """What the pinhole sees: the samples of depth layer 0.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``buffer``                    the samples, to which hidden ones can be added
    ``group``                     so many after each other lie in one pixel and belong together
    ``lattice``                   positions are multiples of 1/lattice pixels; 0: anywhere
    ============================  ==========================================================
    """

    buffer: SampleBuffer
    group: int
    lattice: int


def sample_visible(rays: PrimaryRays, window: Window, sampling: Sampling) -> VisibleSamples:
    """Sample what the pinhole sees of ``window``, by the pattern of ``sampling``."""
    if sampling.pattern == "sampler":
        return _by_sampler(rays, window, sampling.layers)
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
    return VisibleSamples(buffer, 1, lattice)


# ---------------------------------------------------------------- by the sampler


def _by_sampler(rays: PrimaryRays, window: Window, layers: int) -> VisibleSamples:
    """``spp`` samples in each pixel where the sampler puts them, pixel by pixel."""
    spp = rays.passes.spp
    parts = sampler_pixels(rays.crop, window)
    # There is room for as many hidden samples, too.
    buffer = SampleBuffer(sum(len(column) for column, _ in parts) * spp * min(layers, 2))
    passes = [
        (column[part], row[part]) for column, row in parts for part in wavefronts(len(column), spp)
    ]
    for column, row in track(passes, "Sampling"):
        count = len(column) * spp
        rays.passes.begin(count)
        pixel = dr.arange(mi.UInt32, count) // dr.opaque(mi.UInt32, spp)
        corner = mi.Point2f(
            dr.gather(mi.Float, mi.Float(column.astype(np.float32)), pixel),
            dr.gather(mi.Float, mi.Float(row.astype(np.float32)), pixel),
        )
        position = corner + rays.passes.sampler.next_2d()
        traced = rays.trace(position)
        inside = _within(position.x, corner.x), _within(position.y, corner.y)
        shown, (x, y) = to_host(traced, *inside)
        buffer.add(x, y, shown, weight=1 / spp, layer=0)
    return VisibleSamples(buffer, spp, 0)


def sampler_pixels(crop: Window, window: Window) -> list[tuple[np.ndarray, np.ndarray]]:
    """Columns and rows of the pixels of ``window``: those of ``crop`` in it, then the others.

    The crop window is a part of its own and comes first, so that its rays are those of
    ``mi.render``. The second part is missing where there are no other pixels.
    """
    parts = [crop.pixels()]
    column, row = window.pixels()
    beyond = ~crop.contains(column, row)
    if beyond.any():
        parts.append((column[beyond], row[beyond]))
    return parts


def _within(position: mi.Float, corner: mi.Float) -> mi.Float:
    """``position``, moved left of ``corner + 1`` where single precision has rounded it up."""
    end = corner + 1
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
