"""A converged picture, and how much noise is left in it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from .._progress import ProgressCallback
from . import metrics
from .thinlens import SAMPLERS, rounded_down
from .timing import Deadline

FLOOR_MARGIN = 10.0
"""By how many dB the reference's noise is to be below the focused picture's error."""

REFERENCE_SPP = 4096
"""Samples a pixel of a reference at most."""

REFERENCE_PASS = 64
"""Samples a pixel of each of the renderings that a reference is the mean of."""


class Reference:
    """The mean of renderings with seeds of their own, and how much noise is left in it.

    ``render`` gives a picture of so many samples a pixel, and of a number that is new each time.
    """

    def __init__(self, render: Callable[[int, int], np.ndarray]) -> None:
        self.render = render
        self.count = self.spp = 0
        self.halves: list[Any] = [0.0, 0.0]

    @property
    def mean(self) -> np.ndarray:
        """The picture, linear RGB."""
        return (self.halves[0] + self.halves[1]) / self.count

    @property
    def independent(self) -> tuple[np.ndarray, np.ndarray]:
        """The means of two halves of the renderings, whose noise is independent."""
        half = self.count / 2
        return self.halves[0] / half, self.halves[1] / half

    @property
    def floor(self) -> float:
        """PSNR in dB of the noise of the mean.

        The halves are independent, so their difference has the variance of each twice, and
        their mean half that of each: a quarter of the mean squared difference.
        """
        return metrics.decibels(metrics.mean_square(*self.independent) / 4)

    def add(self, spp: int) -> None:
        """Add a rendering of ``spp`` samples a pixel to each of the halves."""
        for half in (0, 1):
            self.halves[half] = self.halves[half] + self.render(spp, self.count).astype(float)
            self.count += 1
            self.spp += spp

    def converge(
        self,
        picture: np.ndarray,
        most: int,
        floor: float | None,
        deadline: Deadline,
        report: ProgressCallback,
    ) -> None:
        """Add renderings until the noise is at ``floor`` dB, or ``most`` samples are taken.

        Without ``floor`` it is to be well below the error of ``picture``. No more are begun that
        would miss the ``deadline``.
        """
        spp = rounded_down(SAMPLERS[0], min(REFERENCE_PASS, most // 2))
        report("reference", 0.0)
        while True:
            began = time.perf_counter()
            self.add(spp)
            target = metrics.psnr(picture, self.mean) + FLOOR_MARGIN if floor is None else floor
            if self.floor >= target or self.spp + 2 * spp > most:
                return
            if not deadline.allows(time.perf_counter() - began):
                return
            needed = min(self.spp * 10 ** ((target - self.floor) / 10), most)
            report(
                f"reference: {self.spp} samples a pixel, noise at {self.floor:.1f} dB of "
                f"{target:.1f}",
                self.spp / needed,
            )
