"""Equation 20 as printed: the focus processor of the paper, by tables.

Section 3.2 of Potmesil & Chakravarty (1981). The intensity of a square of the film is

    Q = sum_i c_i f_i / sum_i f_i,    f_i = (integral over the square of I(z_i, x - x_i)) / z_i^2

over all samples i. The integrals come from tables at equally spaced depths, interpolated linearly
between the two nearest. That is linear in the tables, so the sums over samples are sums over
tables of the samples' shares of that table, convolved with it: the cost does not grow with the
area of the circles.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.fft
import scipy.signal

from .lens import ThinLens
from .progress import track
from .psf import SHARP, PointSpreadFunction
from .samples import PointSamples

SCATTER = 1 << 23
"""Most samples that are scattered at once; it bounds the memory of a step."""


@dataclasses.dataclass(frozen=True)
class Squares:
    """The grid of squares on which equation 20 is evaluated, and where samples lie in it.

    Positions are rounded to sub-pixel classes, ``classes`` x ``classes`` in each square, each
    with a set of tables of its own. Samples on a lattice (the paper's, with its corners, edge
    middles and centres of pixels) are met exactly where ``classes`` allows it; others are
    taken at the middle of their class.
    """

    width: int
    height: int
    per_pixel: int
    left: int
    top: int
    classes: int
    on_lattice: bool

    @classmethod
    def of(cls, samples: PointSamples, per_pixel: int, classes: int) -> Squares:
        """The squares of the samples' crop window, ``per_pixel`` x ``per_pixel`` in a pixel."""
        width, height = samples.camera.crop_size
        left, top = samples.camera.crop_offset
        if samples.lattice > 0:
            classes = min(classes, math.ceil(samples.lattice / per_pixel))
        return cls(
            width * per_pixel,
            height * per_pixel,
            per_pixel,
            left,
            top,
            classes,
            samples.lattice > 0,
        )

    def locate(self, positions: np.ndarray, origin: int) -> tuple[np.ndarray, np.ndarray]:
        """Square and class, along one axis, of positions in pixels of the film."""
        fine = (positions.astype(np.float64) - origin) * (self.per_pixel * self.classes)
        rounded = np.rint(fine) if self.on_lattice else np.floor(fine)
        square, class_ = np.divmod(rounded.astype(np.int32), self.classes)
        return square, class_

    def offset(self, class_: int) -> float:
        """Where in a square the samples of a class lie, 0 to 1."""
        return (class_ + (0.0 if self.on_lattice else 0.5)) / self.classes


def equation_20(
    samples: PointSamples,
    lens: ThinLens,
    psf: PointSpreadFunction,
    channels: np.ndarray,
    *,
    tables: int,
    inverse_square: bool,
    per_pixel: int,
    classes: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Q for every square of the crop window, and the weight of the samples in it.

    ``channels`` are the intensities c_i, float32 (N, C). ``tables`` stand at equally spaced
    depths between the nearest and the farthest sample; samples at infinity have a table of
    their own. With ``inverse_square`` light falls off as 1/z^2; for want of a finite depth,
    samples at infinity are weighted like the farthest that hit something.

    Returns Q, float64 (H * per_pixel, W * per_pixel, C), and the weights, without the C.
    A square that no light reaches is 0.
    """
    squares = Squares.of(samples, per_pixel, classes)
    squares_per_mm = samples.camera.focal_length_pixels * per_pixel / lens.film_distance
    largest = max(squares.width, squares.height)
    stack = _TableStack.of(samples.z, tables)

    # Only differences from the mean are convolved: a uniform picture stays so to the last digit.
    mean = np.average(channels, axis=0, weights=samples.weight).astype(np.float32)
    sums = np.zeros((squares.height, squares.width, channels.shape[1] + 1))
    for k in track(range(len(stack.depths)), "Focusing"):
        index, share = stack.shares(k)

        def light(part: slice, index: np.ndarray = index, share: np.ndarray = share) -> np.ndarray:
            i = index[part]
            weight = samples.weight[i] * share[part]
            if inverse_square:
                weight *= np.square(stack.farthest / np.minimum(samples.z[i], stack.farthest))
            values = np.concatenate([channels[i] - mean, np.ones((len(i), 1), np.float32)], axis=1)
            return values * weight[:, None]

        def table(offset: tuple[float, float], depth: float = stack.depths[k]) -> np.ndarray:
            return psf.table(lens, depth, squares_per_mm, offset, largest)

        _spread(sums, squares, samples, index, light, table)

    weights = np.zeros((squares.height, squares.width, 1))
    _spread(
        weights,
        squares,
        samples,
        np.arange(len(samples)),
        lambda part: samples.weight[part, None],
        sharp_table,
    )
    lit = sums[..., -1] > 1e-12 * sums[..., -1].max()
    q = mean + sums[..., :-1] / np.where(lit, sums[..., -1], 1)[..., None]
    # A mean of samples lies between them; what the convolution's rounding adds does not.
    q = np.clip(q, channels.min(axis=0), channels.max(axis=0))
    return np.where(lit[..., None], q, 0), weights[..., 0]


@dataclasses.dataclass(frozen=True)
class _TableStack:
    """Depths of the tables, and between which two of them each sample lies."""

    z: np.ndarray
    depths: list[float]
    spacing: float
    farthest: float
    nearer: np.ndarray

    @classmethod
    def of(cls, z: np.ndarray, tables: int) -> _TableStack:
        finite = np.isfinite(z)
        nearest, farthest = 1.0, 1.0
        if finite.any():
            nearest, farthest = float(z.min()), float(z[finite].max())
        spacing = max(farthest - nearest, np.finfo(np.float32).tiny) / (tables - 1)
        nearer = np.full(len(z), tables, dtype=np.int16)
        nearer[finite] = np.minimum((z[finite] - nearest) / spacing, tables - 2)
        depths = [*np.linspace(nearest, farthest, tables).tolist(), math.inf]
        return cls(z, depths, spacing, farthest, nearer)

    def shares(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Indices of the samples that use table ``k``, and the share of each that it gets."""
        beyond = np.flatnonzero(self.nearer == k)
        if math.isinf(self.depths[k]):
            return beyond, np.ones(len(beyond), dtype=np.float32)
        before = np.flatnonzero(self.nearer == k - 1)
        index = np.concatenate([before, beyond])
        distance = np.abs(self.z[index] - self.depths[k]) / self.spacing
        return index, np.clip(1 - distance, 0, 1).astype(np.float32)


def sharp_table(offset: tuple[float, float]) -> np.ndarray:
    """The table, 3x3, of a point in focus: on an edge or a corner the squares there share it."""
    before, after = (
        np.array([max(SHARP - position, 0) / (2 * SHARP) for position in offset]),
        np.array([max(SHARP - (1 - position), 0) / (2 * SHARP) for position in offset]),
    )
    along_x, along_y = np.stack([before, 1 - before - after, after], axis=1)
    return np.outer(along_y, along_x)


def _spread(
    target: np.ndarray,
    squares: Squares,
    samples: PointSamples,
    index: np.ndarray,
    light: Callable[[slice], np.ndarray],
    table: Callable[[tuple[float, float]], np.ndarray],
) -> None:
    """Add to ``target``, (H, W, C), the light of the samples ``index``, spread by its table.

    ``light`` gives the values, float32 (n, C), of a part of them. Only the rectangle in which
    the samples lie is convolved, class by class.
    """
    if len(index) == 0:
        return
    parts = [slice(start, start + SCATTER) for start in range(0, len(index), SCATTER)]
    (left, right), (top, bottom) = (
        [int(squares.locate(edge, origin)[0]) for edge in _range(positions, index, parts)]
        for positions, origin in ((samples.x, squares.left), (samples.y, squares.top))
    )
    width, height = right - left + 1, bottom - top + 1
    channels = target.shape[-1]
    shape = (squares.classes, squares.classes, height, width, channels)
    gathered = dr.zeros(mi.Float, math.prod(shape))
    for part in parts:
        x, class_x = squares.locate(samples.x[index[part]], squares.left)
        y, class_y = squares.locate(samples.y[index[part]], squares.top)
        place = ((class_y * squares.classes + class_x) * height + (y - top)) * width + (x - left)
        _scatter_add(gathered, light(part), place)
    at_sample = np.array(gathered).reshape(shape)

    for class_y, class_x in itertools.product(range(squares.classes), repeat=2):
        kernel = table((squares.offset(class_x), squares.offset(class_y)))
        with scipy.fft.set_workers(os.cpu_count() or 1):
            spread = scipy.signal.fftconvolve(
                at_sample[class_y, class_x].astype(np.float64), kernel[..., None], axes=(0, 1)
            )
        reach = len(kernel) // 2
        inside_y, from_y = _overlap(top - reach, spread.shape[0], squares.height)
        inside_x, from_x = _overlap(left - reach, spread.shape[1], squares.width)
        target[inside_y, inside_x] += spread[from_y, from_x]


def _scatter_add(target: mi.Float, values: np.ndarray, place: np.ndarray) -> None:
    """Add each row of ``values``, (n, C), to the C elements of ``target`` at its place."""
    channels = values.shape[1]
    lane = dr.arange(mi.UInt32, values.size)
    row = lane // channels
    first = dr.gather(mi.UInt32, mi.UInt32(place.astype(np.uint32)), row) * channels
    # Auto would choose Local for large targets, several times slower with LLVM.
    llvm = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
    mode = dr.ReduceMode.Expand if llvm else dr.ReduceMode.Auto
    dr.scatter_add(target, mi.Float(values.ravel()), first + lane - row * channels, mode=mode)
    dr.eval(target)


def _range(
    positions: np.ndarray, index: np.ndarray, parts: list[slice]
) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest of ``positions[index]``."""
    chosen = [positions[index[part]] for part in parts]
    return np.min([c.min() for c in chosen]), np.max([c.max() for c in chosen])


def _overlap(start: int, length: int, size: int) -> tuple[slice, slice]:
    """The part of [0, size) that [start, start + length) covers, and that part seen from it."""
    first, last = max(start, 0), max(min(start + length, size), 0)
    return slice(first, last), slice(first - start, last - start)
