"""First pictures beside `thinlens` of equal error: who tries this out once sees that one.

    python benchmarks/first_picture.py                       # the room
    python benchmarks/first_picture.py --folders ~/scenes     # and scenes of others
    python benchmarks/first_picture.py --denoise              # both sides denoised

**A first picture** is samples, with all that is hidden and beyond the film, and the first focus of
them by `layered`; with `--denoise` their features and `denoised()`, too. Kernels are compiled and
the scene is loaded. `--refine` gives it once more with other shares of further samples.

**thinlens** takes 1, 4, 16, ... samples of the same sampler until its error is smaller; what it
needs for an equal one is told by the straight line through two of these, in logarithms. With
`--denoise` each is denoised by the same denoiser, with albedo and normal of Mitsuba's own `aov`
integrator, which cost it time, too.

Errors are of sRGB, clipped to [0, 1], judged by two halves of a reference without their noise, as
in `scenes_of_others.py`, from which lenses and references are.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import statistics
from collections.abc import Callable, Iterator

import common
import mitsuba as mi
import numpy as np
from common import console, timed
from denoising import Subject, add_subjects, denoised_after, subjects
from scenes_of_others import Halves

import potmesil_mi as pm
from potmesil_mi.evaluation import metrics, thinlens_sensor
from potmesil_mi.tracing.sampling import REFINE

MOST_SPP = 4096
"""Samples a pixel of a `thinlens` at most."""
LONGEST = 40.0
"""Seconds of a rendering at most."""
SLOWER = 1.0
"""Ratio from which on a first picture is no slower."""


@dataclasses.dataclass
class Taken:
    """A picture's error, of sRGB, and the seconds that it takes."""

    error: float
    seconds: float


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    add_subjects(options)
    options.add_argument("--refine", type=float, nargs="+", default=[REFINE], help="shares")
    options.add_argument("--repeats", type=int, default=3, help="first pictures, for medians")
    options.add_argument("--denoise", action="store_true", help="denoise both sides")
    arguments = options.parse_args()
    # A denoiser wants the noise of pixels apart.
    arguments.rfilter = "box" if arguments.denoise else None
    common.start(arguments)
    mi.set_log_level(mi.LogLevel.Error)
    ratios: dict[tuple[int, float], list[float]] = {}
    for subject in subjects(arguments):
        for key, ratio in compared(subject, arguments):
            ratios.setdefault(key, []).append(ratio)
    table = common.table(
        "How many times as long thinlens takes for the same error",
        ("samples, refine", "scenes", "median", "least", "not slower"),
    )
    for (spp, refine), found in sorted(ratios.items()):
        numbers = f"{statistics.median(found):.2f}", f"{min(found):.2f}"
        quick = sum(ratio >= SLOWER for ratio in found)
        table.add_row(f"{spp}, {refine:g}", f"{len(found)}", *numbers, f"{quick}")
    console.print(table)


def compared(
    subject: Subject, arguments: argparse.Namespace
) -> Iterator[tuple[tuple[int, float], float]]:
    """Print what each first picture takes, and give the ratio of times of each."""
    halves = Halves.of(subject.reference)
    table = common.table(
        f"{subject.name}: first pictures; reference of {subject.reference.count} seeds of "
        f"{subject.reference.spp} samples",
        ("samples, refine", "sRGB dB", "seconds", "thinlens samples", "thinlens s", "ratio"),
    )
    rendered: dict[int, Taken] = {}

    def thinlens(spp: int) -> Taken:
        if spp not in rendered:
            rendered[spp] = taken(through_thinlens(subject, spp, arguments), halves, 1)
        return rendered[spp]

    for spp in arguments.spp:
        for refine in arguments.refine:
            first = taken(first_picture(subject, spp, refine, arguments), halves, arguments.repeats)
            needed, seconds, bound = equal_error(thinlens, first.error)
            ratio = seconds / first.seconds
            table.add_row(
                f"{spp}, {refine:g}",
                f"{metrics.decibels(max(first.error, 1e-12)):.2f}",
                f"{first.seconds:.2f}",
                f"{bound}{needed:.3g}",
                f"{bound}{seconds:.2f}",
                f"{bound}{ratio:.2f}",
            )
            yield (spp, refine), ratio
    console.print(table)


def taken(render: Callable[[int], np.ndarray], halves: Halves, repeats: int) -> Taken:
    """A picture of seed 0, and the median time of others."""
    picture = render(0)
    seconds = [timed(lambda n=n: render(1 + n))[1] for n in range(repeats)]
    return Taken(float(halves.errors(picture[..., :3]).mean()), statistics.median(seconds))


def first_picture(
    subject: Subject, spp: int, refine: float, arguments: argparse.Namespace
) -> Callable[[int], np.ndarray]:
    """A function that takes samples and focuses them, with a seed."""
    sampling = pm.Sampling(features=arguments.denoise, refine=refine)
    film, sensor = subject.sensor.film(), with_sampler(subject.sensor, arguments.sampler)

    def render(seed: int) -> np.ndarray:
        samples = pm.render_samples(
            subject.scene, sensor, subject.integrator, spp=spp, seed=seed, sampling=sampling
        )
        if arguments.denoise:
            samples = samples.denoised()
        return np.array(pm.focus(samples, rfilter=film.rfilter()))

    return render


def with_sampler(sensor: mi.Sensor, sampler: str) -> mi.Sensor:
    return pm.potmesil_sensor(thinlens_sensor(sensor, sampler=sampler))


def through_thinlens(
    subject: Subject, spp: int, arguments: argparse.Namespace
) -> Callable[[int], np.ndarray]:
    """A function that renders with `thinlens`, with a seed."""
    sensor = thinlens_sensor(subject.sensor, sampler=arguments.sampler, spp=spp)
    after = dataclasses.replace(subject, sampler=arguments.sampler)

    def render(seed: int) -> np.ndarray:
        if arguments.denoise:
            return denoised_after(after, spp, seed)[1]
        picture = mi.render(
            subject.scene, sensor=sensor, integrator=subject.integrator, spp=spp, seed=seed
        )
        return np.array(picture)

    return render


def equal_error(thinlens: Callable[[int], Taken], error: float) -> tuple[float, float, str]:
    """The samples a pixel and the seconds that `thinlens` needs for an ``error``, and a bound."""
    low_spp, low = 1, thinlens(1)
    if low.error <= error:
        return 1, low.seconds, "<="
    while True:
        spp = 4 * low_spp
        if spp > MOST_SPP or 4 * low.seconds > LONGEST:
            return low_spp, low.seconds, ">"
        high = thinlens(spp)
        if high.error <= error:
            apart = math.log(low.error / max(high.error, 1e-12))
            share = math.log(low.error / max(error, 1e-12)) / apart
            return low_spp * 4**share, low.seconds * (high.seconds / low.seconds) ** share, ""
        low_spp, low = spp, high


if __name__ == "__main__":
    main()
