"""What is visible through the lens: each method on scenes that are hard for a post-process.

Thin rods before one another, a room whose light is dear, the image in a mirror, lamps behind bars:
each scene is sampled once, focused by each method, and compared with a converged `thinlens`.

    python benchmarks/visibility.py                             # all, some minutes
    python benchmarks/visibility.py --scenes thicket mirror --methods layered --images
    python benchmarks/visibility.py --uniform                   # does a white scene stay white?

Before that, references have to be made, once: an hour or so on two cores (`references.py`).
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import common
import mitsuba as mi
import numpy as np
from common import console, timed
from references import Encoding, Reference, make_references, thinlens

import potmesil_mi as pm
from potmesil_mi.evaluation import metrics, thinlens_sensor
from potmesil_mi.focusing.methods import MethodName

FOLDER = common.OUTPUT / "visibility_images"
SCENES = common.ROOT / "scenes"
SAMPLERS = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
UNIFORM = 1e-4
"""By how much at most a uniformly white scene may differ from white."""
WORSE = 3.0
"""By how many dB a picture is visibly worse."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene, how it is sampled and focused, and what is expected.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``settings``                  f-number and focus distance of each lens
    ``goals``                     least PSNR of a method, in dB
    ``beyond_thinlens``           for a number of samples a pixel: by how many dB ``layered``
                                  is to be above ``thinlens`` of as many
    ``without_virtual_depth``     also take depths of surfaces for those of what they show
    ``encoding``                  of the pictures that are compared; linear or sRGB
    ``light``                     largest relative error of the mean of the picture
    ``lamps``                     how the names of small lamps begin
    ``floor``                     noise floor of the references in dB
    ============================  ==========================================================
    """

    file: str
    res: int
    settings: tuple[tuple[float, float], ...]
    spp: tuple[int, ...] = (16,)
    goals: dict[str, float] = dataclasses.field(default_factory=dict)
    beyond_thinlens: dict[int, float] = dataclasses.field(default_factory=dict)
    without_virtual_depth: bool = False
    encoding: Encoding = np.asarray
    light: float = math.inf
    lamps: str | None = None
    floor: float = 57.0

    @property
    def path(self) -> Path:
        return SCENES / self.file


CASES = {
    "paper": Case(
        file="figure11.xml",
        res=512,
        settings=tuple((5.6, distance) for distance in common.FOCUS_DISTANCES),
        goals={"layered": 47, "lightfield": 51},
        floor=67,
    ),
    "thicket": Case(
        file="thicket.xml",
        res=256,
        settings=((2.8, 500), (5.6, 1200)),
        goals={"layered": 42, "lightfield": 46},
    ),
    "room": Case(
        file="room.xml",
        res=256,
        settings=((2.8, 3.2),),
        spp=(16, 64),
        beyond_thinlens={16: 4, 64: 0},
    ),
    "mirror": Case(
        file="mirror.xml",
        res=256,
        settings=((2, 2.4),),
        goals={"layered": 38},
        without_virtual_depth=True,
    ),
    "lamps": Case(
        file="lamps.xml",
        res=512,
        settings=((8, 1.1), (2, 1.1)),
        spp=(64,),
        goals={"layered": 31, "lightfield": 34},
        encoding=metrics.srgb,
        light=0.01,
        lamps="lamp_",
    ),
}


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--scenes", nargs="+", choices=CASES, default=list(CASES))
    options.add_argument(
        "--methods", nargs="+", choices=get_args(MethodName), default=list(get_args(MethodName))
    )
    options.add_argument(
        "--uniform",
        action="store_true",
        help="instead of all else: are uniformly white variants of the scenes white everywhere?",
    )
    options.add_argument(
        "--images",
        action="store_true",
        help="write pictures, references and amplified differences to output/visibility_images/",
    )
    options.add_argument("--repeats", type=int, default=2, help="refocusings, for the steady time")
    options.add_argument(
        "--floor", type=float, metavar="DB", help="noise floor of all references; None: as needed"
    )
    options.add_argument("--most-seeds", type=int, default=400, help="of a reference")
    arguments = options.parse_args()
    common.start(arguments)

    missed = []
    for name in arguments.scenes:
        run = uniformity if arguments.uniform else quality
        missed += [f"{name}, {goal}" for goal in run(name, CASES[name], arguments)]
    if not arguments.uniform:
        console.print(
            "samples: of the sampler, and in brackets all, with those that refine pixels, beyond "
            "the borders of the film and behind nearer surfaces, for a pixel of the film. light: "
            "mean of the picture relative to the reference. sampling s: the first time and again, "
            "for all settings of a scene. "
            "first s: focusing for the first time; steady s: median of "
            f"{arguments.repeats} refocusings to other distances."
        )
    console.print(f"[red]Goals missed:[/red] {'; '.join(missed)}" if missed else "All goals met")


# ---------------------------------------------------------------- how near to the reference


@dataclasses.dataclass
class Row:
    """What a table tells of a picture, and whether that is what was hoped for."""

    setting: str
    samples: str
    method: str
    decibels: float
    light: float = math.nan
    goal: str = ""
    met: bool = True
    sampling: str = ""
    first: float = math.nan
    steady: float = math.nan

    def cells(self) -> tuple[str, ...]:
        verdict = "" if not self.goal else "[green]met" if self.met else "[red]missed"
        numbers = [
            "" if math.isnan(value) else f"{value:.{digits}f}"
            for value, digits in ((self.light, 4), (self.first, 2), (self.steady, 2))
        ]
        return (
            *(self.method, self.setting, self.samples, f"{self.decibels:.2f}", numbers[0]),
            *(self.goal, verdict, self.sampling, *numbers[1:]),
        )


COLUMNS = (
    *("picture", "setting", "samples", "PSNR", "light", "goal", ""),
    *("sampling s", "first s", "steady s"),
)


def quality(name: str, case: Case, arguments: argparse.Namespace) -> list[str]:
    """Print how near each method comes to the references; what goals were missed."""
    space = "linear RGB" if case.encoding is np.asarray else "sRGB"
    table = common.table(
        f"{name}: {case.res}x{case.res}, dB of {space} against a converged thinlens", COLUMNS
    )
    missed = []
    for row in rows(name, case, arguments):
        table.add_row(*row.cells())
        if row.goal and not row.met:
            missed.append(f"{row.setting}, {row.samples} samples, {row.method}: {row.goal}")
    console.print(table)
    return missed


def rows(name: str, case: Case, arguments: argparse.Namespace) -> Iterator[Row]:
    """Everything that is measured of a scene."""
    scene = mi.load_file(str(case.path), optimize=False, res=case.res)
    lenses = lenses_of(scene, case)
    references = make_references(
        case.path,
        scene,
        lenses,
        floor=case.floor if arguments.floor is None else arguments.floor,
        encodings=(np.asarray, case.encoding),
        most_seeds=arguments.most_seeds,
        lamps=case.lamps,
    )
    for lens, reference in zip(lenses, references, strict=True):
        spp = f"{reference.count * reference.spp}"
        floor = reference.floor_as(case.encoding)
        yield Row(label(lens), spp, "noise floor of the reference", floor)
    for spp in case.spp:
        best = {}
        if spp in case.beyond_thinlens:
            for lens, reference in zip(lenses, references, strict=True):
                traced = list(traced_rows(case, scene, lens, reference, spp))
                best[label(lens)] = max(r.decibels for r in traced if r.samples == str(spp))
                yield from traced
        for row in focused_rows(name, case, scene, lenses, references, spp, arguments):
            if row.method == "layered" and row.setting in best:
                row = judged(row, case.beyond_thinlens[spp] + best[row.setting])
            yield row


def lenses_of(scene: mi.Scene, case: Case) -> list[pm.ThinLens]:
    lens = scene.sensors()[0].lens()
    return [lens.replace(f_number=n, focus_distance=u) for n, u in case.settings]


def label(lens: pm.ThinLens) -> str:
    return f"f/{lens.f_number:g}, {lens.focus_distance:g}"


def traced_rows(
    case: Case, scene: mi.Scene, lens: pm.ThinLens, reference: Reference, spp: int
) -> Iterator[Row]:
    """`thinlens` with each sampler, of which some take more samples than they are asked for."""
    for sampler in SAMPLERS:
        equivalent = thinlens_sensor(scene.sensors()[0], lens, sampler=sampler, spp=spp)
        count = equivalent.sampler().sample_count()
        render = thinlens(scene, lens, spp, 1, sampler)
        picture, first = timed(render)
        _, steady = timed(render)
        yield Row(
            setting=label(lens),
            samples=str(count),
            method=f"thinlens, {sampler}",
            decibels=compared(case, picture, reference),
            light=float(picture.mean() / reference.mean.mean()),
            first=first,
            steady=steady,
        )


def focused_rows(
    name: str,
    case: Case,
    scene: mi.Scene,
    lenses: list[pm.ThinLens],
    references: list[Reference],
    spp: int,
    arguments: argparse.Namespace,
) -> Iterator[Row]:
    """Each method, and `layered` again where mirrors are taken for what they show."""
    samples, sampling = timed_samples(scene, case, spp)
    count = f"{spp} ({len(samples) / case.res**2:.1f})"
    for lens, reference in zip(lenses, references, strict=True):
        for method in arguments.methods:
            picture, first, steady = timed_focus(samples, lens, method, arguments.repeats)
            if arguments.images:
                write_images(name, spp, method, lens, picture, reference)
            row = Row(
                setting=label(lens),
                samples=count,
                method=method,
                decibels=compared(case, picture, reference),
                light=float(picture.mean() / reference.mean.mean()),
                sampling=sampling,
                first=first,
                steady=steady,
            )
            yield judged(row, case.goals.get(method, -math.inf), case.light)
            if case.without_virtual_depth and method == "layered":
                yield flat_mirror(name, case, scene, lens, reference, row, spp, arguments)


def flat_mirror(
    name: str,
    case: Case,
    scene: mi.Scene,
    lens: pm.ThinLens,
    reference: Reference,
    better: Row,
    spp: int,
    arguments: argparse.Namespace,
) -> Row:
    """The same with the mirror's own depth, which is to be visibly worse."""
    samples, sampling = timed_samples(scene, case, spp, virtual_depth=False)
    picture, first, steady = timed_focus(samples, lens, "layered", arguments.repeats)
    method = "layered, no virtual depth"
    if arguments.images:
        write_images(name, spp, method, lens, picture, reference)
    decibels = compared(case, picture, reference)
    return Row(
        setting=label(lens),
        samples=f"{spp} ({len(samples) / case.res**2:.1f})",
        method=method,
        decibels=decibels,
        light=float(picture.mean() / reference.mean.mean()),
        goal=f"< {better.decibels - WORSE:.1f} dB",
        met=decibels < better.decibels - WORSE,
        sampling=sampling,
        first=first,
        steady=steady,
    )


def judged(row: Row, least: float, light: float = math.inf) -> Row:
    """The row with its goal: a PSNR of ``least`` dB, and the mean light within ``light``."""
    goals, met = [], True
    if least > -math.inf:
        goals.append(f">= {least:.4g} dB")
        met = row.decibels >= least
        if light < math.inf:
            goals.append(f"light {light:.0%}")
            met = met and abs(row.light - 1) <= light
    return dataclasses.replace(row, goal=", ".join(goals), met=met)


def compared(case: Case, picture: np.ndarray, reference: Reference) -> float:
    return metrics.psnr(case.encoding(picture), case.encoding(reference.mean))


def timed_samples(
    scene: mi.Scene, case: Case, spp: int, virtual_depth: bool = True
) -> tuple[pm.PointSamples, str]:
    """Point samples for all settings of a case, and the seconds of the first time and again."""
    sampling = pm.Sampling(
        min_f_number=min(f_number for f_number, _ in case.settings),
        virtual_depth=virtual_depth,
    )
    made: list[pm.PointSamples] = []

    def take() -> int:
        made[:] = [pm.render_samples(scene, spp=spp, seed=0, sampling=sampling)]
        return 0

    seconds = [timed(take)[1] for _ in range(2)]
    return made[0], "  ".join(f"{s:.2f}" for s in seconds)


def timed_focus(
    samples: pm.PointSamples, lens: pm.ThinLens, method: str, repeats: int
) -> tuple[np.ndarray, float, float]:
    """The picture, seconds of the first focusing, and of refocusing to a distance nearby."""
    fresh = samples.replace()  # of which nothing is known yet
    picture, first = timed(lambda: pm.focus(fresh, lens, method=method))
    others = (
        lens.replace(focus_distance=lens.focus_distance * (1 + number / 200))
        for number in range(1, repeats + 1)
    )
    again = [timed(lambda lens=lens: pm.focus(fresh, lens, method=method))[1] for lens in others]
    return picture, first, statistics.median(again) if again else math.nan


def write_images(
    name: str,
    spp: int,
    method: str,
    lens: pm.ThinLens,
    picture: np.ndarray,
    reference: Reference,
) -> None:
    stem = f"{name}_f{lens.f_number:g}_{lens.focus_distance:g}"
    slug = f"{spp}spp_{method}".replace(", ", "_").replace(" ", "_")
    common.write_comparison(FOLDER, stem, slug, picture, reference.mean)


# ---------------------------------------------------------------- white stays white


def uniformity(name: str, case: Case, arguments: argparse.Namespace) -> list[str]:
    """Print how uniform each method's picture of a white scene is; what was not."""
    scene = mi.load_file(str(case.path), optimize=False, res=case.res)
    spp = case.spp[0]
    samples, _ = timed_samples(scene, case, spp)
    white = samples.replace(rgb=np.ones_like(samples.rgb))
    table = common.table(
        f"{name}: {case.res}x{case.res}, {spp} samples a pixel, all white",
        ("picture", "setting", "least", "greatest", f"1 ± {UNIFORM:g}"),
    )
    missed = []
    for lens in lenses_of(scene, case):
        for method in arguments.methods:
            picture = np.array(pm.focus(white, lens, method=method), dtype=np.float64)
            met = bool(np.abs(picture - 1).max() <= UNIFORM)
            table.add_row(
                method,
                label(lens),
                f"{picture.min():.6f}",
                f"{picture.max():.6f}",
                "[green]met" if met else "[red]missed",
            )
            if not met:
                missed.append(f"{label(lens)}, {method}: uniform within {UNIFORM:g}")
    console.print(table)
    return missed


if __name__ == "__main__":
    main()
