"""How many samples ``thinlens`` needs for an error."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from . import metrics
from .timing import NEVER, Deadline, Measured, measuring

SMALLEST = 1e-30
"""In the place of an error of 0, which has no logarithm."""


@dataclasses.dataclass(frozen=True)
class EqualError:
    """What ``thinlens`` takes to reach an error.

    ``spp`` samples a pixel and ``seconds``, interpolated between measured counts unless the
    sampler makes just that one. ``bound`` is ``">"`` where even that many were not enough, and
    ``"<="`` where that many, the fewest of this sampler, were more than enough.
    """

    spp: float
    seconds: float
    bound: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class SearchPoint:
    """One sample count in a search, and the mean squared error that it leaves."""

    measured: Measured
    mean_square: float

    @property
    def spp(self) -> float:
        """Samples a pixel."""
        return self.measured.spp

    @property
    def seconds(self) -> float:
        """Seconds of a repeated rendering."""
        return self.measured.steady


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """What a search has found.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``start``                     the count with which the search began
    ``reached``                   the measured count whose error is the nearest; ``None``
                                  where none reached it
    ``needed``                    samples and time for exactly the error
    ``rank``                      the less, the better the sampler
    ============================  ==========================================================
    """

    start: SearchPoint
    reached: SearchPoint | None
    needed: EqualError
    rank: tuple[float, float]


class Search:
    """The samples that a sampler of ``thinlens`` needs for an error.

    ``measure`` renders a picture of so many samples a pixel, ``rounded_up`` is the nearest count
    that the sampler can take, ``reference`` is linear RGB.
    """

    def __init__(
        self,
        measure: Callable[[int], Measured],
        rounded_up: Callable[[float], int],
        reference: np.ndarray,
    ) -> None:
        self.measure, self.rounded_up, self.reference = measure, rounded_up, reference
        self.points: dict[int, SearchPoint] = {}

    def run(self, error: float, start: int, most: int, deadline: Deadline = NEVER) -> Found:
        """Double or halve the count from ``start`` until ``error`` is between two, up to ``most``.

        Then one more in between, where the error should be reached by a straight line in
        logarithms. No larger count is measured that would miss the ``deadline``.
        """
        first = low = high = self.at(start)
        while (
            high.mean_square > error
            and self.rounded_up(2 * high.spp) <= most
            and deadline.allows(measuring(2 * high.seconds))
        ):
            low, high = high, self.at(2 * high.spp)
        while low.mean_square <= error and (below := self.fewer_than(low.spp)) is not None:
            low, high = below, low
        if high.mean_square > error:
            # None reached it: the sampler whose noise falls the fastest is the best.
            rank = (1.0, high.mean_square * high.seconds)
            return Found(first, None, EqualError(high.spp, high.seconds, ">"), rank)
        if low.mean_square <= error:
            needed = EqualError(low.spp, low.seconds, "<=")
            return Found(first, low, needed, (0.0, needed.seconds))
        spp, seconds = _crossing(low, high, error)
        between = self.between(low, high, spp) if deadline.allows(measuring(seconds)) else None
        if between is not None:
            low, high = (low, between) if between.mean_square <= error else (between, high)
        needed = EqualError(*_crossing(low, high, error))
        nearest = min(low, high, key=lambda point: abs(_log(point.mean_square) - _log(error)))
        return Found(first, nearest, needed, (0.0, needed.seconds))

    def at(self, spp: float) -> SearchPoint:
        """The count that the sampler makes of ``spp``, measured once."""
        count = self.rounded_up(spp)
        if count not in self.points:
            measured = self.measure(count)
            error = metrics.mean_square(measured.picture, self.reference)
            self.points[count] = SearchPoint(measured, error)
        return self.points[count]

    def between(self, low: SearchPoint, high: SearchPoint, spp: float) -> SearchPoint | None:
        """About ``spp``, if the sampler has anything there between two others."""
        count = self.rounded_up(spp)
        if count >= high.spp:
            counts = range(math.floor(spp), int(low.spp), -1)
            count = next((n for n in counts if self.rounded_up(n) == n), count)
        return self.at(count) if low.spp < count < high.spp else None

    def fewer_than(self, spp: float) -> SearchPoint | None:
        """About half of ``spp``, or whatever the sampler has that is less."""
        half = spp / 2
        while half >= 0.5:
            if self.rounded_up(half) < spp:
                return self.at(half)
            half /= 2
        return None


def _crossing(low: SearchPoint, high: SearchPoint, error: float) -> tuple[float, float]:
    """Samples and seconds at which the line through two points, in logarithms, has the error."""
    above, below = _log(low.mean_square), _log(high.mean_square)
    share = (above - _log(error)) / (above - below)
    return (
        low.spp * (high.spp / low.spp) ** share,
        low.seconds * (high.seconds / low.seconds) ** share,
    )


def _log(error: float) -> float:
    return math.log(max(error, SMALLEST))
