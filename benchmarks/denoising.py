"""Denoising before the lens beside denoising after it, and beside neither.

    python benchmarks/denoising.py                                   # the room
    python benchmarks/denoising.py --folders ~/scenes --only 'bath*'  # scenes of others
    python benchmarks/denoising.py --images                          # and pictures of all

**Before**: point samples, `denoised()`, then focused by `layered`. **After**: a `thinlens` of the
same sampler and samples, with albedo and shading normal of Mitsuba's own `aov` integrator, blurred
as the picture is, denoised by the same denoiser.

PSNR is of linear RGB and of sRGB, clipped to [0, 1]. Two independent halves of the reference judge
without their noise, see `scenes_of_others.py`; a lens for scenes of others is chosen as there.
References are kept in `output/` and used again. `--images` writes to output/denoising/ each picture
and, 4 times enlarged, a crop of where the denoised one is worst: samples | denoised | `thinlens`
denoised | reference.
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import common
import mitsuba as mi
import numpy as np
from common import console, timed
from foreign_scenes import Case, scenes_in
from references import Reference, make_references
from scenes_of_others import CROP, Halves, clipped
from scipy import ndimage
from visibility import CASES

import potmesil_mi as pm
from potmesil_mi.evaluation import thinlens_sensor
from potmesil_mi.evaluation.thinlens import FEATURES, denoised_picture

FOLDER = common.OUTPUT / "denoising"
ENLARGED = 4
BETTER = 3.0
"""dB that denoising before is to be above denoising after, of the room at ``FEW`` samples."""
FEW = (4, 16)
REFERENCE_SPP = 289
NEITHER, BEFORE = "layered", "layered, denoised before"
AFTER = "thinlens, denoised after"


@dataclasses.dataclass
class Subject:
    """A scene to look at with a sensor that has a lens, and what its pictures should be."""

    name: str
    scene: mi.Scene
    sensor: mi.Sensor
    integrator: mi.Integrator
    sampler: str
    reference: Reference


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    add_subjects(options)
    options.add_argument("--repeats", type=int, default=3, help="denoisings, for the median time")
    options.add_argument("--images", action="store_true", help="write pictures and crops")
    options.set_defaults(rfilter="box")
    arguments = options.parse_args()
    common.start(arguments)
    mi.set_log_level(mi.LogLevel.Error)
    missed = []
    for subject in subjects(arguments):
        missed += compared(subject, arguments)
    console.print(f"[red]Goals missed:[/red] {'; '.join(missed)}" if missed else "All goals met")


def add_subjects(options: argparse.ArgumentParser) -> None:
    """Add what `subjects` asks for, but for `rfilter`, and how many samples they get."""
    options.add_argument("--folders", nargs="*", type=Path, default=[], help="scenes of others")
    options.add_argument("--only", nargs="+", metavar="NAME", help="of these names, or patterns")
    options.add_argument("--size", type=int, default=192, help="longest side of those, pixels")
    options.add_argument("--sampler", default="multijitter", help="of those")
    options.add_argument("--limit", type=float, default=120.0, help="seconds for a reference")
    options.add_argument("--spp", type=int, nargs="+", default=[4, 16, 64], help="samples a pixel")
    options.set_defaults(aperture=1.0, unmerged=False)


def subjects(arguments: argparse.Namespace) -> Iterator[Subject]:
    """The room, or each scene in folders."""
    if not arguments.folders:
        yield room()
    for name, path in scenes_in(arguments.folders, arguments.only):
        case = Case.load(name, path, arguments)
        reference = Reference.open(case.place, case.size, REFERENCE_SPP)
        began = time.perf_counter()
        while reference.count == 0 or time.perf_counter() - began < arguments.limit:
            reference.add_pair(lambda seed, c=case: c.thinlens(REFERENCE_SPP, seed, "orthogonal")())
        integrator = case.scene.integrator()
        yield Subject(name, case.scene, case.sensor, integrator, arguments.sampler, reference)


def room() -> Subject:
    case = CASES["room"]
    scene = mi.load_file(str(case.path), optimize=False, res=case.res)
    sensor = scene.sensors()[0]
    (reference,) = make_references(
        case.path, scene, [sensor.lens()], floor=case.floor, most_seeds=400
    )
    nested = scene.integrator().nested
    return Subject("room", scene, sensor, nested, "multijitter", reference)


# ---------------------------------------------------------------- pictures


def compared(subject: Subject, arguments: argparse.Namespace) -> list[str]:
    """Print how good each picture is; what was not as good as it is to be."""
    halves, reference = Halves.of(subject.reference), subject.reference
    table = common.table(
        f"{subject.name}: PSNR in dB of linear RGB and sRGB; reference of {reference.count} seeds "
        f"of {reference.spp} samples, noise floor {reference.floor:.1f} dB",
        ("picture", "samples", "linear", "sRGB", "denoised() s"),
    )
    missed = []
    for spp in arguments.spp:
        pictures, seconds = taken(subject, spp, arguments.repeats)
        decibels = {name: halves.psnr(image, clipped) for name, image in pictures.items()}
        for name, image in pictures.items():
            cells = f"{spp}", f"{decibels[name]:.2f}", f"{halves.psnr(image):.2f}"
            table.add_row(name, *cells, f"{seconds:.2f}" if name == BEFORE else "")
            if arguments.images:
                slug = f"{subject.name}_{spp}_{name}".replace(", ", "_").replace(" ", "_")
                common.write_png(FOLDER / f"{slug}.png", image)
        table.add_section()
        if arguments.images:
            write_crop(subject, spp, pictures, halves)
        if decibels[BEFORE] < decibels[NEITHER]:
            missed.append(f"{subject.name}, {spp} samples: not worse than not denoised")
        if subject.name == "room" and spp in FEW and decibels[BEFORE] < decibels[AFTER] + BETTER:
            missed.append(f"{subject.name}, {spp} samples: {BETTER:g} dB above denoised after")
    console.print(table)
    return missed


def taken(subject: Subject, spp: int, repeats: int) -> tuple[dict[str, np.ndarray], float]:
    """The pictures of so many samples by their names, and the seconds of ``denoised()``."""
    samples = pm.render_samples(
        subject.scene,
        subject.sensor,
        subject.integrator,
        spp=spp,
        seed=0,
        sampling=pm.Sampling(features=True, refine=0),
    )
    made: list[pm.PointSamples] = []

    def denoise() -> int:
        made[:] = [samples.denoised()]
        return 0

    denoise()
    seconds = statistics.median(timed(denoise)[1] for _ in range(repeats))
    pictures = {
        NEITHER: np.array(pm.focus(samples)),
        BEFORE: np.array(pm.focus(made[0])),
    }
    pictures["thinlens"], pictures[AFTER] = denoised_after(subject, spp, seed=1)
    return pictures, seconds


def denoised_after(subject: Subject, spp: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """What `thinlens` shows, and that denoised."""
    sensor = thinlens_sensor(subject.sensor, sampler=subject.sampler, spp=spp)
    with_features = mi.load_dict({**FEATURES, "picture": subject.integrator})
    channels = np.array(
        mi.render(subject.scene, sensor=sensor, integrator=with_features, spp=spp, seed=seed)
    )
    return channels[..., :3], denoised_picture(channels)


def write_crop(subject: Subject, spp: int, pictures: dict[str, np.ndarray], halves: Halves) -> None:
    """Where the denoised samples are worst, enlarged, beside the other pictures."""
    mean = subject.reference.mean
    error = ndimage.uniform_filter(halves.errors(pictures[BEFORE]), CROP, mode="constant")
    middle = np.unravel_index(np.argmax(error), error.shape)
    top, left = (
        int(np.clip(at - CROP // 2, 0, max(side - CROP, 0)))
        for at, side in zip(middle, error.shape, strict=True)
    )
    window = np.s_[top : top + CROP, left : left + CROP]
    shown = pictures[NEITHER], pictures[BEFORE], pictures[AFTER], mean
    block = np.ones((ENLARGED, ENLARGED, 1))
    strip = np.concatenate([np.kron(image[window], block) for image in shown], axis=1)
    common.write_png(FOLDER / f"{subject.name}_{spp}_worst_{left}_{top}.png", strip)


if __name__ == "__main__":
    main()
