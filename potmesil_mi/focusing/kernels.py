"""Kernels by which subpixels of light are spread: float64 (H, W), their middle the subpixel's own.

Where a short row of weights will do, along both axes one after the other, the kernel is that row,
float64 (n,).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from typing import TypeGuard

import numpy as np
import scipy.ndimage

from ..optics.aperture import Aperture
from ..optics.convolution import convolve_fully
from ..optics.disc import disc_kernel
from ..optics.lens import ThinLens
from ..optics.psf import PointSpreadFunction, aperture_behind

SUBPIXEL_VARIANCE = 1 / 12
"""Variance along an axis of a subpixel, in subpixels squared."""

LINEAR_VARIANCE = 1 / 6
"""Variance along an axis of what the subpixels around it share linearly, in subpixels squared."""

MIDDLE = (0.5, 0.5)
"""The middle of a subpixel."""

CELL_ROW_VARIANCE = 4 / 3
"""Variance, in subpixels squared, up to which a cell is spread by a row."""

FITTED_ROW_VARIANCE = 0.5
"""Variance, in subpixels squared, below which a row stands for the kernel of a circle."""

FITTED_FINER = 8
"""A row is fitted to a kernel on subpixels so many times as fine."""

FITTED_REACH = 2
"""Subpixels on each side that a fitted row has."""

SMALL_KERNEL = 11
"""Elements on a side of a kernel up to which its variance is measured on a finer raster."""

VARIANCE_FINER = 16
"""That raster is so many times as fine."""


@dataclasses.dataclass(frozen=True)
class KernelFactory:
    """Makes the kernels of one lens on the raster of one depth slice.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``lens``, ``psf``             what spreads the light
    ``pixels_per_mm``             pixels of the slice's raster in a millimetre of film
    ``radius_per_vergence``       radius of the circle in those pixels per unit of vergence
    ``focused_vergence``          1/U per scene unit
    ``sign``                      of the circles' radii: 1 nearer than the focused plane, or -1
    ``smeared``                   variance along an axis, in those pixels squared, with which
                                  the images of the slice are spread already
    ``largest``                   (columns, rows) farther than which nothing can be seen
    ============================  ==========================================================
    """

    lens: ThinLens
    psf: PointSpreadFunction
    pixels_per_mm: float
    radius_per_vergence: float
    focused_vergence: float
    sign: float
    smeared: float
    largest: tuple[int, int]

    @property
    def diffracts(self) -> bool:
        """Whether the patterns of light change with the circle, and reach beyond it."""
        return aperture_behind(self.psf).diffracts

    def of_radius(self, radius: float) -> np.ndarray:
        """The kernel for circles of a ``radius``, >= 0, in pixels of the slice."""
        if self.diffracts:
            return self._exact(radius, 1.0)
        if radius == 0 or self.radius_per_vergence == 0:
            return np.ones(1)
        if is_plain(self.psf):
            squeeze, signed = float(self.lens.squeeze), self.sign * radius
            return circle_kernel(self.psf, signed, squeeze, self.smeared, self.largest)
        return without_variance(self.smeared, functools.partial(self._exact, radius))

    def in_focus(self) -> np.ndarray:
        """What diffraction makes of a point in focus, which spreads the light of lens points."""
        return self._exact(0.0, 1.0)

    def of_cell(self, radius: float) -> np.ndarray:
        """The kernel that spreads a lens point's share over its cell of a ``radius``."""
        kernel = cell_kernel(radius)
        if not self.diffracts:
            return kernel
        if kernel.ndim == 1:
            kernel = np.outer(kernel, kernel)
        return convolve_fully(kernel, self.in_focus())

    def _exact(self, radius: float, finer: float) -> np.ndarray:
        """The PSF's table for circles of a ``radius``, on a raster so many times as fine."""
        vergence = self.focused_vergence
        if self.radius_per_vergence > 0:
            vergence += self.sign * radius / self.radius_per_vergence
        if vergence < 0:  # No point has it: one as far in front of the focused plane stands in.
            vergence = self.focused_vergence + radius / self.radius_per_vergence
        depth = 1 / vergence if vergence > 0 else math.inf
        largest = (round(self.largest[0] * finer), round(self.largest[1] * finer))
        return self.psf.table(self.lens, depth, self.pixels_per_mm * finer, MIDDLE, largest)


def is_plain(psf: PointSpreadFunction) -> TypeGuard[Aperture]:
    """Whether the light of a point is the shape of an aperture, of the size of its circle."""
    return isinstance(psf, Aperture) and type(psf).table is Aperture.table


@functools.lru_cache(maxsize=256)
def cell_kernel(radius: float) -> np.ndarray:
    """The kernel that spreads a lens point's share over its cell, a disc of ``radius`` pixels.

    It has the disc's variance but is smoother: a disc spread by an equal one, whose spectrum has
    no ripples that would make rings of the lens points.
    """
    variance = radius**2 / 4
    if variance < CELL_ROW_VARIANCE:
        return _row(variance)
    half = disc_kernel(2 * math.sqrt(variance / 2 - SUBPIXEL_VARIANCE))
    reach = len(half) // 2
    kernel = scipy.ndimage.convolve(np.pad(half, reach), half, mode="constant")
    kernel.setflags(write=False)
    return kernel


@functools.lru_cache(maxsize=256)
def circle_kernel(
    aperture: Aperture,
    radius: float,
    squeeze: float,
    smeared: float,
    largest: tuple[int, int] | None,
) -> np.ndarray:
    """The kernel of an aperture's circles of a signed radius, see :func:`without_variance`."""

    def scaled(finer: float) -> np.ndarray:
        most = None if largest is None else (round(largest[0] * finer), round(largest[1] * finer))
        return aperture.circle_kernel(radius * finer, squeeze, MIDDLE, most)

    across, down = aperture.variances
    kernel = without_variance(smeared, scaled, radius**2 * (across / squeeze**2 + down) / 2)
    kernel.setflags(write=False)
    return kernel


def without_variance(
    smeared: float, table: Callable[[float], np.ndarray], variance: float | None = None
) -> np.ndarray:
    """A kernel that spreads pixels as the point-spread function spreads points.

    ``table(s)`` gives the integrals over pixels of a distribution ``s`` times as large. They smear
    it by a pixel, which gathering samples by pixel has done already. For that, and for whatever
    else has ``smeared`` it (a variance along an axis), the distribution is made smaller. Its own
    ``variance`` is measured if it is not given. The variance says too little of what is hardly
    larger than a pixel: there a row is fitted.
    """
    if variance is None:
        kernel = table(1.0)
        # A kernel of a few pixels does not tell it; one on a finer raster does.
        small = max(kernel.shape) <= SMALL_KERNEL
        variance = (
            _variance(table(float(VARIANCE_FINER))) / VARIANCE_FINER**2
            if small
            else _variance(kernel) - SUBPIXEL_VARIANCE
        )
    if variance - smeared < FITTED_ROW_VARIANCE:
        return _fitted_row(table(FITTED_FINER))
    return table(scale_without(smeared, variance))


def scale_without(smeared: float, variance: float) -> float:
    """How much smaller a distribution is that is to be ``smeared``, and by a pixel, to have one."""
    return math.sqrt((variance - smeared - SUBPIXEL_VARIANCE) / variance)


def _row(variance: float) -> np.ndarray:
    """A row of a variance, nearly a normal distribution."""
    row = np.ones(1)
    times = math.ceil(3 * variance)
    for _ in range(times):
        share = variance / times / 2
        row = np.convolve(row, [share, 1 - 2 * share, share])
    return row


def _fitted_row(fine: np.ndarray) -> np.ndarray:
    """The row, nowhere negative, that spreads pictures most like a distribution.

    ``fine`` is the table of the distribution on a raster ``FITTED_FINER`` times as fine. The row
    has the least mean square error for pictures whose power falls off as 1/f^2, as that of edges
    does, gathered by pixel.
    """
    response, amplitude = _responses_of_rows()
    transform = np.zeros(len(response))
    for share in (fine.sum(axis=0), fine.sum(axis=1)):
        transform += _waves(len(share)) @ share
    transform /= _sinc_of_fine()
    fitted = _non_negative_least_squares(response * amplitude, (transform - 1) * amplitude[:, 0])
    fitted = np.trim_zeros(fitted, "b")
    return np.concatenate([fitted[::-1], [1 - 2 * fitted.sum()], fitted])


def fitted_row_slope(row: np.ndarray, length: int) -> np.ndarray:
    """How a fitted ``row``, (n,), changes with what it is fitted to, float64 (n, ``length``).

    That is with the sums of the fine table, of so many elements on a side, along one of its axes.
    What is 0 in the row, as it must not be negative, stays so.
    """
    response, amplitude = _responses_of_rows()
    middle = len(row) // 2
    free = np.flatnonzero(row[middle + 1 :] > 0)
    slope = np.zeros((middle, length))
    if len(free) > 0:
        target = _waves(length) / _sinc_of_fine()[:, None] * amplitude
        slope[free] = np.linalg.lstsq((response * amplitude)[:, free], target, rcond=None)[0]
    return np.concatenate([slope[::-1], -2 * slope.sum(axis=0, keepdims=True), slope])


@functools.cache
def _responses_of_rows() -> tuple[np.ndarray, np.ndarray]:
    """Frequency by frequency, (400, ...): what each step of a row adds, and how much it counts."""
    frequency = _frequencies()
    steps = 1 + np.arange(FITTED_REACH)
    response = 2 * np.cos(2 * np.pi * frequency * steps) - 2
    return response, np.sinc(frequency) / frequency


@functools.lru_cache(maxsize=64)
def _waves(length: int) -> np.ndarray:
    """Half the cosines, (400, ``length``), of the places along an axis of a fine table."""
    place = (np.arange(length) - length // 2) / FITTED_FINER
    return np.cos(2 * np.pi * _frequencies() * place) / 2


def _sinc_of_fine() -> np.ndarray:
    """What is left of waves, (400,), in the pixels of the fine table."""
    return np.sinc(_frequencies()[:, 0] / FITTED_FINER)


def _frequencies() -> np.ndarray:
    """Those at which rows are fitted, (400, 1), in periods a pixel."""
    return np.linspace(0.005, 2, 400)[:, None]


def _non_negative_least_squares(matrix: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The coefficients >= 0, (n,), that bring ``matrix`` (m, n) closest to ``target`` (m,).

    For a few columns: those of the best are free of bounds, so all choices of them are tried.
    ``scipy.optimize.nnls`` is for more of them, and its import takes a tenth of a second.
    """
    best, least = np.zeros(matrix.shape[1]), float(target @ target)
    for choice in itertools.product((False, True), repeat=matrix.shape[1]):
        columns = np.flatnonzero(choice)
        solution = np.linalg.lstsq(matrix[:, columns], target, rcond=None)[0]
        error = float(((matrix[:, columns] @ solution - target) ** 2).sum())
        if error < least and (solution >= 0).all():
            best, least = np.zeros(matrix.shape[1]), error
            best[columns] = solution
    return best


def _variance(table: np.ndarray) -> float:
    """Mean variance along rows and columns."""
    rows, columns = (np.arange(n) - n // 2 for n in table.shape)
    return float((table.sum(axis=1) @ rows**2 + table.sum(axis=0) @ columns**2) / 2)
