"""Passes: rays are traced in wavefronts of bounded size, each with a random sequence of its own."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import from_numpy
from .._progress import track
from .buffers import Shown, Traced, to_host

WAVEFRONT = 1 << 22
"""Most rays that are traced at once, or those of one pixel if it has more: memory is bounded."""


class Passes:
    """The sampler of a run over a scene, seeded anew for each pass.

    ``sampler`` is the sensor's, of which a copy is used; ``spp`` samples a pixel, or as many as
    it says for 0. The sampler may round that up: what it takes is in the attribute ``spp``, and the
    ``seed`` of the run beside it.
    """

    def __init__(self, sampler: mi.Sampler, spp: int, seed: int) -> None:
        self.sampler = sampler.clone()
        if spp > 0:
            self.sampler.set_sample_count(spp)
        self.spp = int(self.sampler.sample_count())
        self.sampler.set_samples_per_wavefront(self.spp)
        self.seed = seed
        self._begun = 0

    def begin(self, rays: int) -> None:
        """Seed the sampler for a pass of ``rays`` rays; the first gets the seed of the run."""
        self.sampler.seed(self.seed_of(self._begun), rays)
        self._begun += 1

    def seed_of(self, number: int) -> int:
        """The seed of a pass, which are counted from 0."""
        if number == 0:
            return self.seed
        return int(mi.sample_tea_32(mi.UInt32(self.seed), mi.UInt32(number))[0][0])

    def begin_for(self, count: int) -> mi.UInt32:
        """Seed the sampler for a pass of ``count`` rays, or a few more: it wants whole pixels.

        Returns the number of the ray of each lane; those too many have the last one's.
        """
        lanes = -(-count // self.spp) * self.spp
        self.begin(lanes)
        return dr.minimum(dr.arange(mi.UInt32, lanes), dr.opaque(mi.UInt32, count - 1))

    def averaged(
        self,
        x: np.ndarray,
        y: np.ndarray,
        trace: Callable[..., Traced],
        label: str,
        *columns: np.ndarray,
        paths: int | None = None,
    ) -> Shown:
        """What ``trace`` shows at (x, y), each the mean of ``paths``, by default ``spp``.

        ``x``, ``y`` are float32 (N,) in pixels of the film. ``columns`` are more of each sample,
        (N,): ``trace`` is called with the positions of the paths and then these, for each path.
        ``label`` is said of the progress.
        """
        paths = self.spp if paths is None else paths
        shown: Shown | None = None
        for part in track(wavefronts(len(x), paths), label):
            count = part.stop - part.start
            sample = self.begin_for(count * paths) // dr.opaque(mi.UInt32, paths)
            of_x, of_y, *more = (gathered(column[part], sample) for column in (x, y, *columns))
            every, _ = to_host(trace(mi.Point2f(of_x, of_y), *more))
            means = every[: count * paths].averaged(paths)
            shown = means.room_for(len(x)) if shown is None else shown
            shown.put(part, means)
        return Shown.empty(0) if shown is None else shown


def gathered(column: np.ndarray, index: mi.UInt32) -> mi.Float | mi.UInt32:
    """Elements of a column on the device: whole numbers where it is uint32, else ``Float``."""
    kind = mi.UInt32 if column.dtype == np.uint32 else mi.Float
    return dr.gather(kind, from_numpy(kind, column), index)


def wavefronts(count: int, rays: int) -> list[slice]:
    """Parts of ``count`` things, in their order, of at most ``WAVEFRONT`` rays together.

    Each thing has ``rays`` rays, which stay together even where they are more than that.
    """
    size = max(1, WAVEFRONT // rays)
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def sample_count(sampler: mi.Sampler, spp: int = 0) -> int:
    """How many samples a pixel ``sampler`` takes where ``spp`` are asked for, 0 for its own."""
    if spp > 0:
        sampler = sampler.clone()
        with without_warnings():
            sampler.set_sample_count(spp)
    return int(sampler.sample_count())


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Samplers say each time that they round a count up."""
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        mi.set_log_level(level)
