"""The opening of an aperture whose parameters are numbers: central differences.

Kernels are exact in double precision, and a step of :attr:`.DifferentiableAperture.steps` moves the
edge of the widest by a hundredth of a pixel: less than float32 can tell from a straight line.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import drjit as dr
import numpy as np

from ... import _backend as jit
from ...optics.aperture import Aperture
from ...optics.attached import DifferentiableAperture
from ...optics.disc import Disc
from ..kernels import KernelFactory
from ..small_circles import responses_in_double
from .opening import AttachedKernels, Opening, as_image, attached, nearest_points, radius_of_cells


class _Matrix(NamedTuple):
    """A slope of few parameters: float64 (n, P)."""

    columns: np.ndarray

    def along(self, parameters: np.ndarray) -> np.ndarray:
        """See :class:`.Slope`."""
        return self.columns @ parameters

    def back(self, numbers: np.ndarray) -> np.ndarray:
        """See :class:`.Slope`."""
        return numbers @ self.columns


class _Step(NamedTuple):
    """Apertures a step beyond and before one in one parameter, and how far they are apart."""

    beyond: Aperture
    before: Aperture
    width: float


class OpeningOfNumbers(Opening):
    """The opening of an aperture whose parameters are numbers."""

    def __init__(self, psf: DifferentiableAperture) -> None:
        self._aperture = psf.smooth()
        super().__init__(self._aperture, Disc())
        self._parameters = dr.concat(list(psf.attached.values()))
        self._steps = []
        for name in psf.attached:
            here, step = getattr(psf, name), psf.steps[name]
            beyond, before = (
                dataclasses.replace(self._aperture, **{name: here + by}) for by in (step, -step)
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
        self, factory: KernelFactory, radii: np.ndarray, kernels: Sequence[np.ndarray]
    ) -> AttachedKernels | None:
        """See :meth:`.Opening.kernels`."""
        values, slopes, shapes = [], [], []
        for radius, here in zip(radii, kernels, strict=True):
            ends = [
                [dataclasses.replace(factory, psf=end).of_radius(radius) for end in step[:2]]
                for step in self._steps
            ]
            every = [as_image(of).shape for of in (here, *itertools.chain(*ends))]
            shape = max(rows for rows, _ in every), max(columns for _, columns in every)
            slope = [
                _difference(here, beyond, before, step.width, shape).ravel()
                for (beyond, before), step in zip(ends, self._steps, strict=True)
            ]
            values.append(_padded(as_image(here), shape).ravel())
            slopes.append(np.stack(slope, axis=1))
            shapes.append(shape)
        slope_of_all = _Matrix(np.concatenate(slopes))
        of_all = attached(self._parameters, np.concatenate(values), slope_of_all)
        return AttachedKernels(of_all, shapes)

    def responses(self, responses: np.ndarray, squeeze: float) -> jit.Float:
        """See :meth:`.Opening.responses`."""
        degree = responses.shape[2] - 1
        slope = self._slope(lambda aperture: responses_in_double(aperture, squeeze, degree))
        return attached(self._parameters, responses.ravel(), slope)

    def weights(self, count: int) -> jit.Float | None:
        """See :meth:`.Opening.weights`."""
        nearest = nearest_points(count)

        def numbers(aperture: Aperture) -> np.ndarray:
            kernel = aperture.circle_kernel(-radius_of_cells(count))
            return count * np.bincount(nearest.ravel(), kernel.ravel(), count)

        return attached(self._parameters, numbers(self._aperture), self._slope(numbers))


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
    last, first = (_padded(as_image(of), shape) for of in alike)
    return (last - first) / apart


def _padded(kernel: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A kernel with zeros around it."""
    around = [((size - own) // 2,) * 2 for size, own in zip(shape, kernel.shape, strict=True)]
    return np.pad(kernel, around)
