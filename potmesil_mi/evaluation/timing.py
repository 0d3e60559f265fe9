"""How long renderings and the two stages take."""

from __future__ import annotations

import dataclasses
import math
import statistics
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ..optics.lens import ThinLens
from ..samples.point_samples import PointSamples

T = TypeVar("T")

Take = Callable[[int], PointSamples]
"""What takes point samples with the seed of a number."""

REPEATS = 3
"""Times are medians of so many repetitions."""

LONG = 5.0
"""A rendering that takes so many seconds is repeated once only."""


@dataclasses.dataclass(frozen=True)
class Deadline:
    """A time by which something should be done, of ``time.perf_counter``."""

    end: float

    @classmethod
    def after(cls, seconds: float) -> Deadline:
        """So many seconds from now."""
        return cls(time.perf_counter() + seconds)

    def part(self, share: float) -> Deadline:
        """When a ``share`` of the time that is left is over."""
        now = time.perf_counter()
        return Deadline(now + share * max(self.end - now, 0))

    def allows(self, seconds: float) -> bool:
        """Whether something that takes so many ``seconds`` is done in time."""
        return time.perf_counter() + seconds <= self.end


NEVER = Deadline(math.inf)
"""Of what may take as long as it does."""


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
    ``other``                     the same of another seed
    ``point_samples``             number of point samples
    ``said``                      what is said of the picture
    ``sampling``                  seconds of taking them, first and again
    ``denoising``                 seconds of denoising them; 0 where they are not
    ``focus_first``               seconds of the first focus of the first samples
    ``focus_steady``              seconds of refocusing
    ``first_picture``             seconds of taking samples anew, denoising and focusing them for
                                  the first time, all kernels being compiled
    ============================  ==========================================================
    """

    picture: np.ndarray
    other: np.ndarray
    point_samples: int
    said: Mapping[str, Any]
    sampling: tuple[float, float]
    denoising: float
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


def measuring(seconds: float) -> float:
    """How many seconds :func:`measured` takes for a rendering of so many ``seconds``."""
    return seconds * (1 + (REPEATS if seconds < LONG else 1))


def timed_stages(
    take_samples: Take,
    denoise: Callable[[PointSamples], PointSamples] | None,
    form: Callable[[PointSamples, ThinLens], np.ndarray],
    lens: ThinLens,
    say: Callable[[PointSamples], Mapping[str, Any]],
) -> Stages:
    """Take samples, ``denoise`` them if that is given, and form the picture of ``lens`` with them.

    All of it several times. ``say`` tells what is said of the picture of some samples.
    """

    def all_of_it(number: int) -> tuple[PointSamples, np.ndarray, tuple[float, float, float]]:
        """The samples of a seed, their picture, and the seconds of the three stages."""
        samples, sampling = timed(lambda: take_samples(number))
        denoising = 0.0
        if denoise is not None:
            samples, denoising = timed(partial(denoise, samples))
        picture, focusing = timed(partial(form, samples, lens))
        return samples, picture, (sampling, denoising, focusing)

    samples, picture, first = all_of_it(0)
    other, seconds = all_of_it(1)[1:]
    again = [seconds]
    while len(again) < REPEATS and again[0][0] < LONG:
        again.append(all_of_it(1 + len(again))[2])
    # Slightly refocused, so that no result of the lens itself can be used again.
    others = [
        lens.replace(focus_distance=lens.focus_distance * (1 + number / 100))
        for number in range(1, REPEATS + 1)
    ]
    return Stages(
        picture=picture,
        other=other,
        point_samples=len(samples),
        said=say(samples),
        sampling=(first[0], statistics.median(taking for taking, _, _ in again)),
        denoising=statistics.median(denoising for _, denoising, _ in again),
        focus_first=first[2],
        focus_steady=statistics.median(timed(partial(form, samples, other))[1] for other in others),
        first_picture=statistics.median(map(sum, again)),
    )
