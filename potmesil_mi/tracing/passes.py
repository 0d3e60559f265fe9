"""Passes: rays are traced in wavefronts of bounded size, each with a random sequence of its own."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from .._progress import track
from .buffers import Shown, Traced, to_host

WAVEFRONT = 1 << 22
"""Most rays that are traced at once, or those of one pixel if it has more: memory is bounded."""


class Passes:
    """The sampler of a run over a scene, seeded anew for each pass.

    ``sampler`` is the sensor's, of which a copy is used; ``spp`` samples a pixel, or as many as
    it says for 0. The sampler may round that up: what it takes is in the attribute ``spp``.
    """

    def __init__(self, sampler: mi.Sampler, spp: int, seed: int) -> None:
        self.sampler = sampler.clone()
        if spp > 0:
            self.sampler.set_sample_count(spp)
        self.spp = int(self.sampler.sample_count())
        self.sampler.set_samples_per_wavefront(self.spp)
        self._seed = seed
        self._begun = 0

    def begin(self, rays: int) -> None:
        """Seed the sampler for a pass of ``rays`` rays; the first gets the seed of the run."""
        seed = self._seed
        if self._begun > 0:
            seed = int(mi.sample_tea_32(mi.UInt32(self._seed), mi.UInt32(self._begun))[0][0])
        self.sampler.seed(seed, rays)
        self._begun += 1

    def averaged(
        self,
        x: np.ndarray,
        y: np.ndarray,
        trace: Callable[[mi.Point2f], Traced],
        label: str,
    ) -> Shown:
        """What ``trace`` shows at (x, y), each the mean of ``spp`` paths.

        ``x`` and ``y`` are float32 (N,) in pixels of the film; ``label`` is said of the progress.
        """
        shown = Shown.empty(len(x))
        for part in track(wavefronts(len(x), self.spp), label):
            rays = (part.stop - part.start) * self.spp
            self.begin(rays)
            point = dr.arange(mi.UInt32, rays)
            point //= dr.opaque(mi.UInt32, self.spp)
            position = mi.Point2f(
                dr.gather(mi.Float, mi.Float(x[part]), point),
                dr.gather(mi.Float, mi.Float(y[part]), point),
            )
            paths, _ = to_host(trace(position))
            shown.put(part, paths.averaged(self.spp))
        return shown


def wavefronts(count: int, rays: int) -> list[slice]:
    """Parts of ``count`` things, in their order, of at most ``WAVEFRONT`` rays together.

    Each thing has ``rays`` rays, which stay together even where they are more than that.
    """
    size = max(1, WAVEFRONT // rays)
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]
