"""The opening of an aperture that is a picture: shares of it, with exact transposes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import drjit as dr
import numpy as np

from ... import _backend as jit
from ...optics.aperture import FINE_RADIUS
from ...optics.disc import Disc
from ...optics.image_aperture import ImageAperture, Overlap, outside_circle
from ..kernels import (
    FITTED_FINER,
    SUBPIXEL_VARIANCE,
    KernelFactory,
    fitted_row_slope,
    scale_without,
)
from ..small_circles import RADII_IN_CELLS, centred, of_impulses
from .opening import (
    AttachedKernels,
    Opening,
    as_image,
    attached,
    nearest_points,
    parted,
    radius_of_cells,
)


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

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

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
        """See :class:`.Slope`."""
        change = parameters.reshape(self.inside.shape) * self.inside
        return np.concatenate([of.along(change).ravel() for of in self.kernels])

    def back(self, numbers: np.ndarray) -> np.ndarray:
        """See :class:`.Slope`."""
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
        """See :class:`.Slope`."""
        return self.shares.along(parameters.reshape(self.inside.shape) * self.inside).ravel()

    def back(self, numbers: np.ndarray) -> np.ndarray:
        """See :class:`.Slope`."""
        found = self.shares.back(numbers.reshape(self.shares.numbers.shape))
        return (found * self.inside).ravel()


class OpeningOfPicture(Opening):
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
        self, factory: KernelFactory, radii: np.ndarray, kernels: Sequence[np.ndarray]
    ) -> AttachedKernels | None:
        """See :meth:`.Opening.kernels`."""
        slopes = [
            self._of_kernel(factory, radius, kernel)
            for radius, kernel in zip(radii, kernels, strict=True)
        ]
        values = np.concatenate([as_image(kernel).ravel() for kernel in kernels])
        of_all = attached(self._parameters, values, _KernelSlopes(slopes, self._inside))
        return AttachedKernels(of_all, [of.shape for of in slopes])

    def _of_kernel(self, factory: KernelFactory, radius: float, kernel: np.ndarray) -> _OfKernel:
        """The derivative of the kernel of a circle."""
        if kernel.size == 1:
            return _Fixed((1, 1))
        squeeze, signed = float(factory.lens.squeeze), factory.sign * radius
        if kernel.ndim == 1:
            largest = factory.largest[0] * FITTED_FINER, factory.largest[1] * FITTED_FINER
            fine = self._table(*self._aperture.overlaps(signed * FITTED_FINER, squeeze, largest))
            rows, columns = fine.numbers.shape
            slopes = fitted_row_slope(kernel, columns), fitted_row_slope(kernel, rows)
            return _Row(kernel, fine, slopes)
        variance, of_variance = self._variance(squeeze)
        variance, of_variance = variance * radius**2, of_variance * radius**2
        scale = scale_without(factory.smeared, variance)
        largest = round(factory.largest[0] * scale), round(factory.largest[1] * scale)
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
        """See :meth:`.Opening.responses`."""
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
        """See :meth:`.Opening.weights`."""
        nearest = nearest_points(count)
        down, across = self._aperture.overlaps(-radius_of_cells(count))

        def linear(picture: np.ndarray) -> np.ndarray:
            parts = down.part @ picture @ across.part.T
            return count * np.bincount(nearest.ravel(), parts.ravel(), count)

        def transpose(numbers: np.ndarray) -> np.ndarray:
            return down.part.T @ (count * numbers[nearest]) @ across.part

        return self._attached_shares(_Shares.of(self._picture, linear, transpose))

    def _attached_shares(self, shares: _Shares) -> Any:
        slope = _SharesSlope(shares, self._inside)
        return attached(self._parameters, shares.numbers.ravel(), slope)
