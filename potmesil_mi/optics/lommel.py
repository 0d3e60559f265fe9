"""A round aperture with diffraction: Airy's pattern in focus, Lommel's out of it."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from .._validation import require_choice, require_flag, require_number, shown
from .aperture import Aperture
from .arithmetic import on_host
from .attached import has_gradient
from .diffraction import ARGUMENTS, Argument, optical_coordinates
from .diffraction_kernel import diffraction_kernel
from .disc import disc_corner_area, disc_kernel, lens_points
from .lens_protocol import LensProtocol
from .spectrum import BANDS, SPECTRUM, sensitivity

UNIFORM_RADIUS = 0.25
"""Radius in pixels of a circle within which a truncated pattern is taken as uniform."""


class _Diffracting(Aperture):
    """What all round apertures with diffraction have in common."""

    finest: ClassVar[float] = math.inf
    diffracts: ClassVar[bool] = True
    is_round: ClassVar[bool] = True

    def corner_area(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :meth:`Aperture.corner_area`."""
        return disc_corner_area(x, y)

    def points(self, count: int) -> np.ndarray:
        """See :meth:`Aperture.points`."""
        return lens_points(count)


@dataclasses.dataclass(frozen=True)
class LommelChannel(_Diffracting):
    """The pattern of one channel of :class:`Lommel`.

    ``lines`` are its wavelengths in nm, and what share of the light each has; the others are the
    parameters of :class:`Lommel`. It has no text.
    """

    lines: tuple[tuple[float, float], ...]
    truncated: bool
    argument: Argument

    @property
    def ends_sharply(self) -> bool:
        """See :attr:`Aperture.ends_sharply`."""
        return self.truncated

    def table(
        self,
        lens: LensProtocol,
        depth: float,
        pixels_per_mm: float,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """See :meth:`potmesil_mi.PointSpreadFunction.table`: the mean over the wavelengths."""
        radius = abs(float(lens.circle_of_confusion(depth))) * pixels_per_mm / 2
        end = radius if self.truncated else math.inf
        if end < UNIFORM_RADIUS:
            return disc_kernel(end, offset, largest)
        kernels = []
        for wavelength, share in self.lines:
            u, per_mm = (
                abs(float(np.asarray(value)))
                for value in optical_coordinates(lens, depth, 1.0, wavelength, self.argument)
            )
            pattern = (_significant(u), _significant(per_mm / pixels_per_mm), _significant(end))
            kernels.append((diffraction_kernel(*pattern, offset, largest), share))
        return _mean_kernel(kernels)


@dataclasses.dataclass(frozen=True)
class Lommel(_Diffracting):
    """A round aperture as diffraction has it: equations 12 to 19.

    In focus it is Airy's pattern, out of focus Lommel's; see :mod:`potmesil_mi.optics.diffraction`.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``wavelengths``               in nm, 100 to 100000: three for red, green and blue (default
                                  610, 550, 465), or one for all, or ``spectrum``: each channel
                                  is the mean over nine wavelengths of its part of the visible
                                  spectrum, by what an sRGB film takes of each
    ``truncated``                 the pattern ends at the circle of confusion, as in the paper
                                  (section 3.2); by default it is kept whole, but for
                                  1/400 of the light
    ``argument``                  ``consistent`` (default): the edge of the geometric shadow is
                                  the circle of equation 8. ``paper``: equations 15 and 16 as
                                  printed, with F in the place of V
    ============================  ==========================================================
    """

    wavelengths: tuple[float, ...] | Literal["spectrum"] = (610.0, 550.0, 465.0)
    truncated: bool = False
    argument: Argument = "consistent"

    name: ClassVar[str] = "lommel"

    def __post_init__(self) -> None:
        if has_gradient(self.wavelengths):
            raise NotImplementedError(
                f"wavelengths={shown(on_host(self.wavelengths))}: has gradients enabled, but "
                "diffraction has no derivatives; detach it, as by dr.detach"
            )
        if isinstance(self.wavelengths, str):
            if self.wavelengths != SPECTRUM:
                raise ValueError(
                    f"wavelengths={shown(self.wavelengths)}: must be one or three numbers in nm, "
                    f"or {SPECTRUM!r}"
                )
        else:
            given = np.atleast_1d(np.asarray(self.wavelengths, dtype=object)).tolist()
            if len(given) not in (1, 3):
                raise ValueError(f"wavelengths={shown(self.wavelengths)}: must be one or three")
            for value in given:
                require_number("wavelengths", value, 100, 100_000)
            object.__setattr__(self, "wavelengths", tuple(float(value) for value in given))
        require_flag("truncated", self.truncated)
        require_choice("argument", self.argument, ARGUMENTS)

    @property
    def ends_sharply(self) -> bool:
        """See :attr:`Aperture.ends_sharply`."""
        return self.truncated

    @property
    def channels(self) -> tuple[LommelChannel, ...]:
        """See :attr:`Aperture.channels`."""
        if isinstance(self.wavelengths, str):
            lines = [sensitivity(channel) for channel in BANDS]
        else:
            lines = [((wavelength, 1.0),) for wavelength in self.wavelengths]
        return tuple(LommelChannel(line, self.truncated, self.argument) for line in lines)

    def table(
        self,
        lens: LensProtocol,
        depth: float,
        pixels_per_mm: float,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """See :meth:`potmesil_mi.PointSpreadFunction.table`: the mean of the channels."""
        lines = tuple(line for channel in self.channels for line in channel.lines)
        white = LommelChannel(lines, self.truncated, self.argument)
        return white.table(lens, depth, pixels_per_mm, offset, largest)


def _significant(value: float) -> float:
    """``value`` to nine digits: what rounding makes of one lens is one pattern."""
    return float(f"{value:.9g}")


def _mean_kernel(kernels: list[tuple[np.ndarray, float]]) -> np.ndarray:
    """The weighted mean of kernels of unequal size."""
    rows, columns = (max(kernel.shape[axis] for kernel, _ in kernels) for axis in (-2, -1))
    total = np.zeros((*kernels[0][0].shape[:-2], rows, columns))
    for kernel, weight in kernels:
        row, column = (rows - kernel.shape[-2]) // 2, (columns - kernel.shape[-1]) // 2
        total[..., row : rows - row, column : columns - column] += weight * kernel
    return total / sum(weight for _, weight in kernels)
