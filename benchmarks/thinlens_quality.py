"""How near the focused pictures come to a ray-traced thin lens, and how long both take.

The paper's scene at f/5.6 is rendered with Mitsuba's own `thinlens` until the noise of that
reference is known to be small; then the same lens focuses point samples, and both are compared.

    python benchmarks/thinlens_quality.py                # 512x512, a few minutes
    python benchmarks/thinlens_quality.py --res 128      # a quick try

References are kept in `output/thinlens_quality/` and used again; delete them to start anew.
"""

from __future__ import annotations

import argparse
import math

import common
import mitsuba as mi
import numpy as np
from common import console, first_and_steady, timed
from references import make_references, thinlens

import potmesil_mi as pm
from potmesil_mi.evaluation.metrics import psnr

LEAST_FLOOR = 50.0
GOALS = {"paper": 30.0, "paper, no 1/z²": 35.0}


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--res", type=int, default=512, help="pixels each way")
    options.add_argument("--f-number", type=float, default=5.6)
    options.add_argument(
        "--focus-distances", type=float, nargs="+", default=common.FOCUS_DISTANCES, metavar="MM"
    )
    options.add_argument("--spp", type=int, default=16, help="point samples a pixel (multijitter)")
    options.add_argument("--tables", type=int, default=73)
    options.add_argument(
        "--uniform", action="store_true", help="also the paper's uniform grid of samples"
    )
    options.add_argument(
        "--thinlens-spp",
        type=int,
        nargs="*",
        default=[25, 121],
        metavar="SPP",
        help="samples a pixel of the `thinlens` pictures to compare with (orthogonal sampler)",
    )
    options.add_argument(
        "--floor",
        type=float,
        default=60.0,
        metavar="DB",
        help=f"add seeds until the reference's own noise is at this PSNR, >= {LEAST_FLOOR:g}",
    )
    options.add_argument("--most-seeds", type=int, default=64, help="of a reference")
    options.add_argument("--reference-spp", type=int, default=289, help="samples a pixel and seed")
    options.add_argument(
        "--images", action="store_true", help="write pictures and differences to output/"
    )
    arguments = options.parse_args()
    if arguments.floor < LEAST_FLOOR:
        options.error(f"--floor={arguments.floor}: must be >= {LEAST_FLOOR:g} dB")
    common.start(arguments)

    scene = common.load_paper_scene(arguments.res, arguments.spp)
    sensor = scene.sensors()[0]
    nested = scene.integrator().nested
    lenses = [
        sensor.lens().replace(f_number=arguments.f_number, focus_distance=distance)
        for distance in arguments.focus_distances
    ]
    references = make_references(
        common.SCENE,
        scene,
        lenses,
        floor=arguments.floor,
        most_seeds=arguments.most_seeds,
        spp=arguments.reference_spp,
    )

    sets, sampling_times = {}, {}
    for name, sampling in sample_sets(arguments):
        samples, first = timed_samples(scene, sampling)
        sets[name], second = timed_samples(scene, sampling)
        sampling_times[name] = (len(samples), first, second)
    pinhole, _ = timed(lambda: mi.render(scene, integrator=nested, spp=arguments.spp, seed=0))

    stages = common.table("Point samples", ["samples", "count", "first s", "again s"])
    for name, (count, first, second) in sampling_times.items():
        stages.add_row(
            name.lstrip(", ") or f"{arguments.spp} spp multijitter",
            f"{count:,}",
            f"{first:.2f}",
            f"{second:.2f}",
        )

    quality = common.table(
        f"PSNR against thinlens, dB; {arguments.res}x{arguments.res}, f/{arguments.f_number:g}, "
        f"{arguments.tables} tables",
        ["picture", *(f"{lens.focus_distance:g} mm" for lens in lenses), "first s", "steady s"],
    )
    floors = [reference.floor for reference in references]
    quality.add_row("noise floor of reference", *(f"{floor:.1f}" for floor in floors), "", "")
    quality.add_row(
        "pinhole", *(f"{psnr(pinhole, reference.mean):.1f}" for reference in references), "", ""
    )
    quality.add_section()
    missed = []
    for name, method in methods(sets, arguments.tables).items():
        cells, firsts, steadies = [], [], []
        for lens, reference in zip(lenses, references, strict=True):
            picture, first, steady = first_and_steady(lambda lens=lens, m=method: m(lens))
            quality_db = psnr(picture, reference.mean)
            cells.append(f"{quality_db:.1f}")
            firsts.append(first)
            steadies.append(steady)
            if quality_db < GOALS.get(name, -math.inf):
                missed.append(f"{name} at {lens.focus_distance:g} mm: {quality_db:.1f} dB")
            if arguments.images:
                write_images(name, lens, picture, reference.mean, arguments.res)
        quality.add_row(name, *cells, several(firsts), several(steadies))
    quality.add_section()
    for spp in arguments.thinlens_spp:
        cells, firsts, steadies = [], [], []
        for lens, reference in zip(lenses, references, strict=True):
            picture, first, steady = first_and_steady(thinlens(scene, lens, spp, seed=1))
            cells.append(f"{psnr(picture, reference.mean):.1f}")
            firsts.append(first)
            steadies.append(steady)
        quality.add_row(f"thinlens, {spp} spp", *cells, several(firsts), several(steadies))

    console.print(stages)
    console.print(quality)
    console.print(
        "first s: the first call of each focus distance, with kernels to compile where the cache "
        "has none; steady s: median of 3 more. Ranges are over the focus distances."
    )
    for reference, lens in zip(references, lenses, strict=True):
        console.print(
            f"reference at {lens.focus_distance:g} mm: {reference.count} seeds of "
            f"{reference.spp} samples a pixel, noise floor {reference.floor:.1f} dB"
        )
        if reference.floor < arguments.floor:
            console.print(f"[red]below the {arguments.floor:g} dB asked for: more --most-seeds")
    goals = ", ".join(f"{name} >= {goal:g} dB" for name, goal in GOALS.items())
    console.print(
        f"[red]Goals ({goals}) missed: {'; '.join(missed)}" if missed else f"Goals met: {goals}"
    )


def sample_sets(arguments: argparse.Namespace) -> list[tuple[str, pm.Sampling]]:
    """Name and sampling of each set of point samples."""
    sets = [("", pm.Sampling())]
    if arguments.uniform:
        sets.append((", uniform grid", pm.Sampling(pattern="uniform")))
    return sets


def timed_samples(scene: mi.Scene, sampling: pm.Sampling) -> tuple[pm.PointSamples, float]:
    """Point samples; on the uniform grid a single one at each point, as in the paper."""
    spp = 1 if sampling.pattern == "uniform" else 0
    made: list[pm.PointSamples] = []
    _, seconds = timed(
        lambda: made.append(pm.render_samples(scene, spp=spp, seed=0, sampling=sampling))
    )
    return made[0], seconds


def methods(sets: dict[str, pm.PointSamples], tables: int) -> dict:
    """Name of each way to focus, and a function of the lens."""
    result = {}
    for name, samples in sets.items():
        for suffix, inverse_square in (("", True), (", no 1/z²", False)):
            result[f"paper{name}{suffix}"] = lambda lens, s=samples, i=inverse_square: pm.focus(
                s, lens, method="paper", tables=tables, inverse_square=i
            )
    return result


def write_images(
    name: str, lens: pm.ThinLens, picture: np.ndarray, reference: np.ndarray, res: int
) -> None:
    """The picture, the reference and the difference, grey for none and 4 times enlarged."""
    folder = common.OUTPUT / "thinlens_quality_images"
    slug = name.replace(", ", "_").replace(" ", "_").replace("/", "").replace("²", "2")
    stem = f"{res}_{lens.focus_distance:g}mm"
    common.write_comparison(folder, stem, slug, picture, reference)


def several(seconds: list[float]) -> str:
    """Least and greatest of some times."""
    least, greatest = f"{min(seconds):.2f}", f"{max(seconds):.2f}"
    return least if least == greatest else f"{least}–{greatest}"


if __name__ == "__main__":
    main()
