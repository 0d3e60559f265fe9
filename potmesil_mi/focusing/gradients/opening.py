"""The opening of the lens with gradients: how what is made of an aperture changes with it.

What is made of it is found out in NumPy, once for its numbers, and beside it the derivative: for
parameters that are numbers central differences in double precision, for a picture, in which
kernels are linear but for what the whole lets through, the exact one and its transpose.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import drjit as dr
import numpy as np
import scipy.spatial

from ... import _backend as jit
from ...optics.aperture import FINE_RADIUS, Aperture
from ...optics.attached import DifferentiableAperture
from ...optics.disc import Disc
from ...optics.image_aperture import ImageAperture, Overlap, outside_circle
from ...optics.psf import PointSpreadFunction, aperture_behind
from ..fragments import as_column
from ..kernels import (
    FITTED_FINER,
    SUBPIXEL_VARIANCE,
    KernelFactory,
    fitted_row_slope,
    scale_without,
)
from ..small_circles import RADII_IN_CELLS, centred, of_impulses, responses_in_double

CELLS_RADIUS = 64.0
"""Radius in pixels of the kernel that tells how much light goes through around lens points."""


class Slope(Protocol):
    """The derivative of n numbers in P parameters: a linear map, and its transpose."""

    def along(self, parameters: np.ndarray) -> np.ndarray:
        """How the numbers, (n,), change as the parameters, (P,), do."""

    def back(self, numbers: np.ndarray) -> np.ndarray:
        """The transpose: of (n,) what each parameter has, (P,)."""


class AttachedKernels(NamedTuple):
    """Kernels with gradients: the numbers of all, each of a shape (rows, columns)."""

    values: jit.Float
    shapes: list[tuple[int, int]]


def parted(numbers: np.ndarray, shapes: Sequence[tuple[int, int]]) -> list[np.ndarray]:
    """The arrays (rows, columns) of some ``shapes`` that have the ``numbers``."""
    ends = np.cumsum([rows * columns for rows, columns in shapes])
    parts = np.split(numbers, ends[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


class Opening:
    """An aperture, and what is made of it, attached to its parameters; this one has no gradients.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``psf``                       that of kernels, of plain numbers
    ``seen_from``                 the aperture from whose points visibility is found
    ============================  ==========================================================

    Points of an aperture jump, or what they see does, where its parameters change. So visibility is
    found from points all over the circle if there are gradients, and what each of them counts
    changes smoothly.
    """

    def __init__(self, psf: PointSpreadFunction, seen_from: Aperture) -> None:
        self.psf, self.seen_from = psf, seen_from

    def kernels(
        self, factory: KernelFactory, radii: Sequence[float], kernels: Sequence[np.ndarray]
    ) -> AttachedKernels | None:
        """The ``kernels`` that the ``factory`` makes for circles of some radii in its pixels."""
        return None

    def responses(self, responses: np.ndarray, squeeze: float) -> jit.Float:
        """The numbers of the ``responses`` of :func:`.responses_of`."""
        return as_column(responses)

    def weights(self, count: int) -> jit.Float | None:
        """How much light goes through around each of ``count`` points, 1 on the average."""
        return None


def opening_of(psf: PointSpreadFunction) -> Opening:
    """The opening that ``psf`` is, attached to what it has gradients in."""
    if isinstance(psf, DifferentiableAperture) and psf.attached:
        return _Picture(psf) if isinstance(psf, ImageAperture) else _Numbers(psf)
    return Opening(psf, aperture_behind(psf))


@functools.lru_cache(maxsize=8)
def _nearest_points(count: int) -> np.ndarray:
    """Which of the points of a disc is nearest to each pixel of a kernel of ``CELLS_RADIUS``."""
    place = (np.arange(2 * math.ceil(CELLS_RADIUS) + 1) - math.ceil(CELLS_RADIUS)) / CELLS_RADIUS
    places = np.stack(np.meshgrid(place, place), axis=-1)
    return np.asarray(scipy.spatial.cKDTree(Disc().points(count)).query(places)[1])


class _Attach(dr.CustomOp):
    """Numbers that were found out without gradients, attached to parameters."""

    def eval(self, parameters: jit.Float, numbers: np.ndarray, slope: Slope) -> jit.Float:
        self.slope = slope
        return as_column(numbers.astype(np.float32))

    def forward(self) -> None:
        parameters = np.array(self.grad_in("parameters"), dtype=np.float64)
        self.set_grad_out(as_column(self.slope.along(parameters).astype(np.float32)))

    def backward(self) -> None:
        numbers = np.array(self.grad_out(), dtype=np.float64)
        self.set_grad_in("parameters", as_column(self.slope.back(numbers).astype(np.float32)))

    def name(self) -> str:
        return "aperture"


def _attached(parameters: jit.Float, numbers: np.ndarray, slope: Slope) -> Any:
    return dr.custom(_Attach, parameters, numbers, slope)


# ---------------------------------------------------------------- parameters that are numbers


class _Matrix(NamedTuple):
    """A slope of few parameters: float64 (n, P)."""

    columns: np.ndarray

    def along(self, parameters: np.ndarray) -> np.ndarray:
        """See :class:`Slope`."""
        return self.columns @ parameters

    def back(self, numbers: np.ndarray) -> np.ndarray:
        """See :class:`Slope`."""
        return numbers @ self.columns


class _Step(NamedTuple):
    """Apertures a step beyond and before one in one parameter, and how far they are apart."""

    beyond: Aperture
    before: Aperture
    width: float


class _Numbers(Opening):
    """The opening of an aperture whose parameters are numbers."""

    def __init__(self, psf: DifferentiableAperture) -> None:
        aperture = psf.smooth()
        super().__init__(aperture, Disc())
        self._aperture = aperture
        self._parameters = dr.concat(list(psf.attached.values()))
        self._steps = []
        for name in psf.attached:
            here, step = getattr(psf, name), psf.steps[name]
            beyond, before = (
                dataclasses.replace(aperture, **{name: here + by}) for by in (step, -step)
            )
            self._steps.append(_Step(beyond, before, 2 * step))

    def _slope(self, numbers: Callable[[Aperture], np.ndarray]) -> _Matrix:
        """The slope of some ``numbers`` of an aperture."""
        columns = [
            (numbers(beyond).ravel() - numbers(before).ravel()) / width
            for beyond, before, width in self._steps
        ]
        return _Matrix(np.stack(columns, axis=1))

    def kernels(
        self, factory: KernelFactory, radii: Sequence[float], kernels: Sequence[np.ndarray]
    ) -> AttachedKernels | None:
        """See :meth:`Opening.kernels`."""
        values, slopes, shapes = [], [], []
        for radius, here in zip(radii, kernels, strict=True):
            ends = [
                [dataclasses.replace(factory, psf=end).of_radius(radius) for end in step[:2]]
                for step in self._steps
            ]
            every = [_as_image(of).shape for of in (here, *itertools.chain(*ends))]
            shape = max(rows for rows, _ in every), max(columns for _, columns in every)
            slope = [
                _difference(here, *pair, step.width, shape).ravel()
                for pair, step in zip(ends, self._steps, strict=True)
            ]
            values.append(_padded(_as_image(here), shape).ravel())
            slopes.append(np.stack(slope, axis=1))
            shapes.append(shape)
        slope_of_all = _Matrix(np.concatenate(slopes))
        of_all = _attached(self._parameters, np.concatenate(values), slope_of_all)
        return AttachedKernels(of_all, shapes)

    def responses(self, responses: np.ndarray, squeeze: float) -> jit.Float:
        """See :meth:`Opening.responses`."""
        degree = responses.shape[2] - 1
        slope = self._slope(lambda aperture: responses_in_double(aperture, squeeze, degree))
        return _attached(self._parameters, responses.ravel(), slope)

    def weights(self, count: int) -> jit.Float | None:
        """See :meth:`Opening.weights`."""
        nearest = _nearest_points(count)

        def numbers(aperture: Aperture) -> np.ndarray:
            kernel = aperture.circle_kernel(-CELLS_RADIUS)
            return count * np.bincount(nearest.ravel(), kernel.ravel(), count)

        return _attached(self._parameters, numbers(self._aperture), self._slope(numbers))


def _difference(
    here: np.ndarray, beyond: np.ndarray, before: np.ndarray, width: float, shape: tuple[int, int]
) -> np.ndarray:
    """The derivative of a kernel, of a ``shape``, from those a step away on both sides.

    A row and a wide kernel are not compared: where it is the one here, and the other there, there
    is a difference that no derivative has.
    """
    alike = [of if of.ndim == here.ndim else here for of in (beyond, before)]
    apart = width * sum(of is not here for of in alike) / 2
    if apart == 0:
        return np.zeros(shape)
    last, first = (_padded(_as_image(of), shape) for of in alike)
    return (last - first) / apart


def _as_image(kernel: np.ndarray) -> np.ndarray:
    """A kernel (rows, columns), also of one that is a row, which spreads along both axes."""
    return np.outer(kernel, kernel) if kernel.ndim == 1 else kernel


def _padded(kernel: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A kernel with zeros around it."""
    around = [((size - own) // 2,) * 2 for size, own in zip(shape, kernel.shape, strict=True)]
    return np.pad(kernel, around)


# ---------------------------------------------------------------- a picture


class _Shares(NamedTuple):
    """Numbers that are linear in a picture, divided by what the whole of it lets through.

    ``linear`` and ``transpose`` are the linear map of pictures (H, W) and its transpose.
    """

    linear: Callable[[np.ndarray], np.ndarray]
    transpose: Callable[[np.ndarray], np.ndarray]
    total: float
    numbers: np.ndarray

    @classmethod
    def of(
        cls,
        picture: np.ndarray,
        linear: Callable[[np.ndarray], np.ndarray],
        transpose: Callable[[np.ndarray], np.ndarray],
    ) -> _Shares:
        """Those of a ``picture``."""
        total = float(picture.sum())
        return cls(linear, transpose, total, linear(picture) / total)

    def along(self, change: np.ndarray) -> np.ndarray:
        """How the numbers change as the picture does."""
        return (self.linear(change) - self.numbers * change.sum()) / self.total

    def back(self, numbers: np.ndarray) -> np.ndarray:
        """The transpose of :meth:`along`."""
        return (self.transpose(numbers) - np.vdot(self.numbers, numbers)) / self.total


class _OfKernel(Protocol):
    """The derivative of a kernel (rows, columns) in a picture (H, W), and its transpose."""

    shape: tuple[int, int]

    def along(self, change: np.ndarray) -> np.ndarray:
        """How the kernel changes as the picture does."""

    def back(self, kernel: np.ndarray) -> np.ndarray:
        """The transpose."""


class _Wide(NamedTuple):
    """The derivative of a kernel that is as wide as the picture's variance makes it.

    ``of_scale`` is that in its size, and ``scale`` that of its size in the picture.
    """

    kernel: _Shares
    of_scale: np.ndarray
    scale: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.of_scale.shape[0], self.of_scale.shape[1]

    def along(self, change: np.ndarray) -> np.ndarray:
        """See :class:`_OfKernel`."""
        return self.kernel.along(change) + self.of_scale * np.vdot(self.scale, change)

    def back(self, kernel: np.ndarray) -> np.ndarray:
        """See :class:`_OfKernel`."""
        return self.kernel.back(kernel) + self.scale * np.vdot(self.of_scale, kernel)


class _Row(NamedTuple):
    """The derivative of a kernel that is a row.

    ``fine`` is the table that it is fitted to, ``slopes`` how it changes with what that sums to,
    column by column and row by row.
    """

    row: np.ndarray
    fine: _Shares
    slopes: tuple[np.ndarray, np.ndarray]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.row), len(self.row)

    def along(self, change: np.ndarray) -> np.ndarray:
        """See :class:`_OfKernel`."""
        fine = self.fine.along(change)
        row = self.slopes[0] @ fine.sum(axis=0) + self.slopes[1] @ fine.sum(axis=1)
        return np.outer(row, self.row) + np.outer(self.row, row)

    def back(self, kernel: np.ndarray) -> np.ndarray:
        """See :class:`_OfKernel`."""
        row = kernel @ self.row + self.row @ kernel
        return self.fine.back(row @ self.slopes[0] + (row @ self.slopes[1])[:, None])


class _Fixed(NamedTuple):
    """The derivative of a kernel that does not change."""

    shape: tuple[int, int]

    def along(self, change: np.ndarray) -> np.ndarray:
        """See :class:`_OfKernel`."""
        return np.zeros(self.shape)

    def back(self, kernel: np.ndarray) -> np.ndarray:
        """See :class:`_OfKernel`."""
        return np.zeros((1, 1))


class _KernelSlopes(NamedTuple):
    """The slope of several kernels in a picture whose elements are ``inside`` the circle."""

    kernels: list[_OfKernel]
    inside: np.ndarray

    def along(self, parameters: np.ndarray) -> np.ndarray:
        """See :class:`Slope`."""
        change = parameters.reshape(self.inside.shape) * self.inside
        return np.concatenate([of.along(change).ravel() for of in self.kernels])

    def back(self, numbers: np.ndarray) -> np.ndarray:
        """See :class:`Slope`."""
        parts = parted(numbers, [of.shape for of in self.kernels])
        total = np.zeros(self.inside.shape)
        for of, part in zip(self.kernels, parts, strict=True):
            total += of.back(part)
        return (total * self.inside).ravel()


class _SharesSlope(NamedTuple):
    """The slope of numbers that are shares of a picture, elements ``inside`` the circle."""

    shares: _Shares
    inside: np.ndarray

    def along(self, parameters: np.ndarray) -> np.ndarray:
        """See :class:`Slope`."""
        return self.shares.along(parameters.reshape(self.inside.shape) * self.inside).ravel()

    def back(self, numbers: np.ndarray) -> np.ndarray:
        """See :class:`Slope`."""
        found = self.shares.back(numbers.reshape(self.shares.numbers.shape))
        return (found * self.inside).ravel()


class _Picture(Opening):
    """The opening of an aperture that is a picture."""

    def __init__(self, psf: ImageAperture) -> None:
        super().__init__(psf.without_gradients(), Disc())
        (self._parameters,) = psf.attached.values()
        shape = psf.transmission_map.shape
        self._inside = ~outside_circle(shape)
        given = np.array(dr.detach(self._parameters), dtype=np.float64)
        self._picture = given.reshape(shape) * self._inside
        self._aperture = psf

    def kernels(
        self, factory: KernelFactory, radii: Sequence[float], kernels: Sequence[np.ndarray]
    ) -> AttachedKernels | None:
        """See :meth:`Opening.kernels`."""
        slopes = [
            self._of_kernel(factory, radius, kernel)
            for radius, kernel in zip(radii, kernels, strict=True)
        ]
        values = np.concatenate([_as_image(kernel).ravel() for kernel in kernels])
        attached = _attached(self._parameters, values, _KernelSlopes(slopes, self._inside))
        return AttachedKernels(attached, [of.shape for of in slopes])

    def _of_kernel(self, factory: KernelFactory, radius: float, kernel: np.ndarray) -> _OfKernel:
        """The derivative of the kernel of a circle."""
        if kernel.size == 1:
            return _Fixed((1, 1))
        squeeze, signed = float(factory.lens.squeeze), factory.sign * radius
        if kernel.ndim == 1:
            largest = tuple(round(of * FITTED_FINER) for of in factory.largest)
            fine = self._table(*self._aperture.overlaps(signed * FITTED_FINER, squeeze, largest))
            rows, columns = fine.numbers.shape
            slopes = fitted_row_slope(kernel, columns), fitted_row_slope(kernel, rows)
            return _Row(kernel, fine, slopes)
        variance, of_variance = self._variance(squeeze)
        variance, of_variance = variance * radius**2, of_variance * radius**2
        scale = scale_without(factory.smeared, variance)
        largest = tuple(round(of * scale) for of in factory.largest)
        down, across = self._aperture.overlaps(signed * scale, squeeze, largest)
        growth = down.growth @ self._picture @ across.part.T
        growth += down.part @ self._picture @ across.growth.T
        taken = factory.smeared + SUBPIXEL_VARIANCE
        return _Wide(
            self._table(down, across),
            growth / self._picture.sum(),
            of_variance * (taken / (2 * scale**2 * variance**2)),
        )

    def _table(self, down: Overlap, across: Overlap) -> _Shares:
        """The kernel that is made of the picture."""
        return _Shares.of(
            self._picture,
            lambda picture: down.part @ picture @ across.part.T,
            lambda kernel: down.part.T @ kernel @ across.part,
        )

    def _variance(self, squeeze: float) -> tuple[float, np.ndarray]:
        """The mean variance along both axes, for a radius of 1, and its derivative, (H, W)."""
        table = self._table(*self._aperture.overlaps(-FINE_RADIUS))
        weights = table.numbers.sum(axis=0), table.numbers.sum(axis=1)
        places = [(np.arange(len(of)) - len(of) // 2) / FINE_RADIUS for of in weights]
        total, slopes = 0.0, []
        for weight, place, stretch in zip(weights, places, (squeeze, 1.0), strict=True):
            middle = weight @ place
            total += float(weight @ place**2 - middle**2) / stretch**2 / 2
            slopes.append((place**2 - 2 * middle * place) / stretch**2 / 2)
        return total, table.back(slopes[0] + slopes[1][:, None])

    def responses(self, responses: np.ndarray, squeeze: float) -> jit.Float:
        """See :meth:`Opening.responses`."""
        of_steps = of_impulses(responses.shape[2] - 1)
        pairs = [self._aperture.overlaps(radius, squeeze) for radius in RADII_IN_CELLS]
        of_columns, of_rows = (
            np.stack([centred(of_steps, len(pair[axis].part)) @ pair[axis].part for pair in pairs])
            for axis in (1, 0)
        )

        def linear(picture: np.ndarray) -> np.ndarray:
            found = of_columns @ picture.sum(axis=0), of_rows @ picture.sum(axis=1)
            return np.stack(found, axis=1)

        def transpose(numbers: np.ndarray) -> np.ndarray:
            across = np.tensordot(numbers[:, 0], of_columns, 3)
            return across + np.tensordot(numbers[:, 1], of_rows, 3)[:, None]

        shares = _Shares.of(self._picture, linear, transpose)
        return self._attached_shares(shares)

    def weights(self, count: int) -> jit.Float | None:
        """See :meth:`Opening.weights`."""
        nearest = _nearest_points(count)
        down, across = self._aperture.overlaps(-CELLS_RADIUS)

        def linear(picture: np.ndarray) -> np.ndarray:
            parts = down.part @ picture @ across.part.T
            return count * np.bincount(nearest.ravel(), parts.ravel(), count)

        def transpose(numbers: np.ndarray) -> np.ndarray:
            return down.part.T @ (count * numbers[nearest]) @ across.part

        return self._attached_shares(_Shares.of(self._picture, linear, transpose))

    def _attached_shares(self, shares: _Shares) -> Any:
        slope = _SharesSlope(shares, self._inside)
        return _attached(self._parameters, shares.numbers.ravel(), slope)
