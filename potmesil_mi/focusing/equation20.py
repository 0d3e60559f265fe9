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
from collections.abc import Callable, Iterable, Iterator

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.fft
import scipy.signal

from .._progress import track
from ..optics.lens import ThinLens
from ..optics.psf import PointSpreadFunction
from ..samples.point_samples import PointSamples

SCATTER = 1 << 21
"""Most samples that are scattered at once; it bounds the memory of a step."""

SMALL_REACH = 2
"""Circles that reach no farther than so many squares are added square by square."""

SMALL_CLASSES = 64
"""Sub-pixel position classes on a side of a square for small circles, whose place matters most."""


@dataclasses.dataclass(frozen=True)
class Squares:
    """The grid of squares on which equation 20 is evaluated, and where samples lie in it.

    Positions are rounded to sub-pixel classes, ``classes`` x ``classes`` in each square, each
    with a table of its own. Samples on a lattice (the paper's, with its corners, edge middles
    and centres of pixels) are met exactly; others are taken at the middle of their class.
    """

    width: int
    height: int
    per_pixel: int
    left: int
    top: int
    lattice: int

    @classmethod
    def of(cls, samples: PointSamples, per_pixel: int) -> Squares:
        """The squares of the samples' crop window, ``per_pixel`` x ``per_pixel`` in a pixel."""
        width, height = samples.camera.crop_size
        left, top = samples.camera.crop_offset
        return cls(width * per_pixel, height * per_pixel, per_pixel, left, top, samples.lattice)

    def classes(self, reach: int) -> int:
        """Position classes on a side of a square for circles of that reach in squares."""
        classes = SMALL_CLASSES if reach <= SMALL_REACH else 2 if reach <= 8 else 1
        return min(classes, math.ceil(self.lattice / self.per_pixel)) if self.lattice else classes

    def locate(
        self, positions: np.ndarray, origin: int, classes: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Square and class, along one axis, of positions in pixels of the film."""
        fine = (positions.astype(np.float64) - origin) * (self.per_pixel * classes)
        rounded = np.rint(fine) if self.lattice else np.floor(fine)
        square, class_ = np.divmod(rounded.astype(np.int32), classes)
        return square, class_

    def offsets(self, classes: int) -> np.ndarray:
        """Where in a square, 0 to 1, the samples of each class lie: (classes * classes, 2)."""
        middle = 0.0 if self.lattice else 0.5
        y, x = np.divmod(np.arange(classes**2), classes)
        return np.stack([x + middle, y + middle], axis=-1) / classes


def equation_20(
    samples: PointSamples,
    lens: ThinLens,
    psf: PointSpreadFunction,
    *,
    alpha: bool,
    tables: int,
    inverse_square: bool,
    per_pixel: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Q for every square of the crop window, and what the square counts in its pixel.

    The C intensities c_i are R, G, B and with ``alpha`` that too. ``tables`` stand at equally
    spaced depths between the nearest and the farthest sample; samples at infinity have a table
    of their own. With ``inverse_square`` light falls off as 1/z^2; for want of a finite depth,
    samples at infinity are weighted like the farthest that hit something.

    Returns Q, float64 (H * per_pixel, W * per_pixel, C), and what each square counts in its
    pixel, without the C: on a lattice all alike, as in the paper; elsewhere, where chance puts
    more samples here than there, the light that reaches it before its fall-off. A square that no
    light reaches is 0 and counts nothing.
    """
    samples = samples.visible()
    squares = Squares.of(samples, per_pixel)
    squares_per_mm = samples.camera.focal_length_pixels * per_pixel / lens.film_distance
    # As far as a sample can be from a square of the crop window.
    farthest = (
        samples.window[2] * per_pixel + squares.width,
        samples.window[3] * per_pixel + squares.height,
    )
    stack = _TableStack.of(samples.z, tables)
    columns = [samples.rgb] + ([samples.alpha[:, None]] if alpha else [])
    # Only differences from the mean are convolved: a uniform picture stays so to the last digit.
    mean = np.concatenate([samples.weight @ column for column in columns])
    mean /= samples.weight.sum()
    # The numerators, the denominator, and where it is asked for the light before its fall-off.
    unattenuated = inverse_square and not samples.lattice
    sums = np.zeros((squares.height, squares.width, len(mean) + 1 + unattenuated))
    for depth, index, share in track(stack, "Focusing", total=tables + 1):

        def light_of(
            part: slice, index: np.ndarray = index, share: np.ndarray = share
        ) -> np.ndarray:
            i = index[part]
            weight = (samples.weight[i] * share[part])[:, None]
            falloff = np.ones_like(weight)
            if inverse_square:
                z = np.minimum(samples.z[i], stack.farthest)
                falloff[:, 0] = np.square(stack.farthest / z)
            differences = np.concatenate([column[i] for column in columns], axis=1) - mean
            values = [differences * falloff, falloff]
            if unattenuated:
                values.append(np.ones_like(falloff))
            return np.concatenate(values, axis=1) * weight

        def table(offset: np.ndarray, depth: float = depth) -> np.ndarray:
            return psf.table(lens, depth, squares_per_mm, offset, farthest)

        _spread(sums, squares, samples, index, light_of, table)

    numerators, denominator, light = sums[..., : len(mean)], sums[..., len(mean)], sums[..., -1]
    lit = denominator > 1e-12 * denominator.max()
    q = mean + numerators / np.where(lit, denominator, 1)[..., None]
    # A mean of samples lies between them; what the convolution's rounding adds does not.
    least, most = (
        np.concatenate([bound(column, axis=0) for column in columns]) for bound in (np.min, np.max)
    )
    weights = np.ones_like(light) if samples.lattice else np.maximum(light, 0)
    return np.where(lit[..., None], np.clip(q, least, most), 0), np.where(lit, weights, 0)


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

    def __iter__(self) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
        """Each table's depth, the samples that use it, and the share of each that it gets."""
        before = np.empty(0, dtype=np.uint32)
        for k, depth in enumerate(self.depths):
            # 32 bits: with all samples of a large film in a table or two, indices weigh heavily.
            beyond = np.flatnonzero(self.nearer == k).astype(np.uint32)
            if math.isinf(depth):
                yield depth, beyond, np.ones(len(beyond), dtype=np.float32)
                return
            index = np.concatenate([before, beyond])
            share = self.z[index]
            share -= np.float32(depth)
            np.abs(share, out=share)
            share /= np.float32(-self.spacing)
            share += 1
            yield depth, index, np.clip(share, 0, 1, out=share)
            before = beyond


def _spread(
    target: np.ndarray,
    squares: Squares,
    samples: PointSamples,
    index: np.ndarray,
    light_of: Callable[[slice], np.ndarray],
    table: Callable[[np.ndarray], np.ndarray],
) -> None:
    """Add to ``target``, (H, W, C), the light of the samples ``index``, spread by ``table``.

    ``light_of`` gives the values, float32 (n, C), of a part of them. The samples are gathered
    by square and class, and each class is convolved with its table, in the rectangle where
    there are samples; where the tables are small, samples are added square by square instead.
    """
    count = len(index)
    if count == 0:
        return
    middle = table(np.array([0.5, 0.5]))
    reach_y, reach_x = (size // 2 for size in middle.shape)
    reach = max(reach_x, reach_y)
    classes = squares.classes(reach)
    offsets = squares.offsets(classes)
    kernels = middle[None] if np.array_equal(offsets, [[0.5, 0.5]]) else table(offsets)
    small = reach <= SMALL_REACH
    margin_x, margin_y = (reach_x, reach_y) if small else (0, 0)
    parts = [slice(start, min(start + SCATTER, count)) for start in range(0, count, SCATTER)]

    (left, right), (top, bottom) = (
        squares.locate(_range(positions[index[part]] for part in parts), origin, classes)[
            0
        ].tolist()
        for positions, origin in ((samples.x, squares.left), (samples.y, squares.top))
    )
    left, top = left - margin_x, top - margin_y
    width, height = right + margin_x - left + 1, bottom + margin_y - top + 1

    shape = (1 if small else classes**2, height, width, target.shape[-1])
    gathered = dr.zeros(mi.Float, math.prod(shape))
    for part in parts:
        x, class_x = squares.locate(samples.x[index[part]], squares.left, classes)
        y, class_y = squares.locate(samples.y[index[part]], squares.top, classes)
        class_ = class_y * classes + class_x
        place = (y - top) * width + (x - left)
        if small:
            _scatter_add(gathered, light_of(part), place, (kernels, class_, width))
        else:
            _scatter_add(gathered, light_of(part), class_ * (height * width) + place)
    images = np.array(gathered).reshape(shape)
    del gathered
    if small:
        _add(target, images[0], top, left)
        return
    dr.flush_malloc_cache()  # the transforms need the memory that Dr.Jit would keep
    for kernel, image in zip(kernels, images, strict=True):
        if not image.any():
            continue
        for channel in range(image.shape[-1]):
            with scipy.fft.set_workers(os.cpu_count() or 1):
                spread = scipy.signal.fftconvolve(image[..., channel].astype(np.float64), kernel)
            _add(target[..., channel], spread, top - reach_y, left - reach_x)


def _scatter_add(
    target: mi.Float,
    values: np.ndarray,
    place: np.ndarray,
    around: tuple[np.ndarray, np.ndarray, int] | None = None,
) -> None:
    """Add each row of ``values``, (n, C), to the C elements of ``target`` at its place.

    With ``around`` it is spread over the K x L places around: kernels (classes, K, L), the class
    of each row, and the number of places in a row of the picture.
    """
    # Auto would choose Local for large targets, several times slower with LLVM.
    llvm = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
    mode = dr.ReduceMode.Expand if llvm else dr.ReduceMode.Auto
    channels = values.shape[1]
    lane = dr.arange(mi.UInt32, values.size)
    row = lane // channels
    index = dr.gather(mi.UInt32, mi.UInt32(place.astype(np.uint32)), row) * channels
    index += lane - row * channels
    value = mi.Float(values.ravel())
    if around is None:
        dr.scatter_add(target, value, index, mode=mode)
    else:
        kernels, class_, width = around
        rows, columns = kernels.shape[1:]
        flat = mi.Float(kernels.ravel())
        first = dr.gather(mi.UInt32, mi.UInt32(class_.astype(np.uint32)), row) * (rows * columns)
        for i, (dy, dx) in enumerate(itertools.product(range(rows), range(columns))):
            if kernels[:, dy, dx].any():
                offset = (dy - rows // 2) * width + dx - columns // 2
                share = dr.gather(mi.Float, flat, first + i)
                beside = mi.UInt32(mi.Int32(index) + offset * channels)
                dr.scatter_add(target, value * share, beside, mode=mode)
    dr.eval(target)


def _range(parts: Iterable[np.ndarray]) -> np.ndarray:
    """Least and greatest of all elements."""
    ends = [(part.min(), part.max()) for part in parts]
    return np.array([min(least for least, _ in ends), max(most for _, most in ends)])


def _add(target: np.ndarray, image: np.ndarray, top: int, left: int) -> None:
    """Add ``image`` to ``target`` with its corner at (top, left); what lies outside is lost."""
    rows, columns = (
        slice(min(max(start, 0), size), max(min(start + length, size), 0))
        for start, length, size in zip((top, left), image.shape, target.shape, strict=False)
    )
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return
    target[rows, columns] += image[
        rows.start - top : rows.stop - top, columns.start - left : columns.stop - left
    ]
