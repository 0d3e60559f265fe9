"""How long renderings and the two stages take."""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np

from ..optics.lens import ThinLens
from ..samples.point_samples import PointSamples

T = TypeVar("T")

REPEATS = 3
"""Times are medians of so many repetitions."""

LONG = 5.0
"""A rendering that takes so many seconds is repeated once only."""


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """A picture, its samples a pixel, and the seconds that it took.

    ``first`` are those of the first time, in which kernels may have been compiled, ``steady`` the
    median of repetitions.
    """

    picture: np.ndarray
    spp: float
    first: float
    steady: float


@dataclasses.dataclass(frozen=True, eq=False)
class Stages:
    """A focused picture, and what its two stages took.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``picture``                   the focused picture, linear RGB, (height, width, 3)
    ``point_samples``             number of point samples
    ``sampling``                  seconds of taking them, first and again
    ``focus_first``               seconds of the first focus of the first samples
    ``focus_steady``              seconds of refocusing
    ``first_picture``             seconds of taking samples anew and focusing them for the
                                  first time, all kernels being compiled
    ============================  ==========================================================
    """

    picture: np.ndarray
    point_samples: int
    sampling: tuple[float, float]
    focus_first: float
    focus_steady: float
    first_picture: float


def timed(action: Callable[[], T]) -> tuple[T, float]:
    """What ``action`` returns, and the seconds that it took."""
    began = time.perf_counter()
    result = action()
    return result, time.perf_counter() - began


def measured(render: Callable[[int], np.ndarray], spp: float) -> Measured:
    """A picture of ``spp`` samples a pixel, rendered several times.

    ``render`` is given a number that is 0 for the picture and another for each repetition.
    """
    picture, first = timed(lambda: render(0))
    times: list[float] = []
    while not times or (len(times) < REPEATS and times[0] < LONG):
        times.append(timed(lambda: render(1 + len(times)))[1])
    return Measured(picture, spp, first, statistics.median(times))


def timed_stages(
    take_samples: Callable[[], PointSamples],
    form: Callable[[PointSamples, ThinLens], np.ndarray],
    lens: ThinLens,
) -> Stages:
    """Take samples and form the picture of ``lens`` with them, several times."""

    def new_samples() -> tuple[float, float]:
        """Seconds of taking samples that are not kept, and of their first picture."""
        samples, seconds = timed(take_samples)
        return seconds, timed(partial(form, samples, lens))[1]

    samples, sampling_first = timed(take_samples)
    picture, focus_first = timed(lambda: form(samples, lens))
    again = [new_samples()]
    while len(again) < REPEATS and again[0][0] < LONG:
        again.append(new_samples())
    # Slightly refocused, so that no result of the lens itself can be used again.
    others = [
        lens.replace(focus_distance=lens.focus_distance * (1 + number / 100))
        for number in range(1, REPEATS + 1)
    ]
    return Stages(
        picture=picture,
        point_samples=len(samples),
        sampling=(sampling_first, statistics.median(taking for taking, _ in again)),
        focus_first=focus_first,
        focus_steady=statistics.median(timed(partial(form, samples, other))[1] for other in others),
        first_picture=statistics.median(map(sum, again)),
    )
