"""Scenes of others: how good each method's picture is beside `thinlens`, and what it costs.

Every Mitsuba scene in a folder is sampled once, with its own sampler, integrator and
reconstruction filter, and focused. A converged `thinlens` is the reference. `--rfilter box` and
`--aperture 0.01` tell what the film's filter and the lens have to do with a difference.

    python benchmarks/scenes_of_others.py ~/mitsuba-data/docs/scenes ~/mitsuba-tutorials/scenes
    python benchmarks/scenes_of_others.py FOLDER --only lego 'veach*' --methods layered --spp 64

**Lens.** A scene's own, or one chosen by the rule in `foreign_scenes.py`; the same for all methods.

**Judgement.** PSNR of sRGB clipped to [0, 1]. Two independent halves of the reference, A and B,
judge without their noise: the squared error of a picture x is the mean of (x - A)(x - B).

**Crops.** output/scenes_of_others/ gets the place where a method is worst beside `thinlens` of the
same samples: picture | `thinlens` | reference | difference to the reference, grey for none.

References are kept there too, and extended by later runs until their noise is far enough below
what is judged; `--limit` bounds the time for each.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import math
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import common
import mitsuba as mi
import numpy as np
from common import console, first_and_steady, timed
from foreign_scenes import FOLDER, Case, pinhole, scalar, scenes_in
from references import Reference
from scipy import ndimage

import potmesil_mi as pm
from potmesil_mi.evaluation import metrics
from potmesil_mi.focusing.methods import MethodName

BEST_OF = ("stratified", "multijitter", "ldsampler")
"""Samplers of which the best one for `thinlens` is looked for: they take 16 and 64 samples."""
REFERENCE_SPP = 289
"""Samples a pixel of each seed of a reference: 17², which `orthogonal` can take."""
CROP, ENLARGED = 32, 8
"""Pixels on a side of a crop, and how many times it is enlarged."""


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("folders", nargs="+", type=Path, help="where scenes are, at any depth")
    options.add_argument("--size", type=int, default=192, help="longest side of a picture, pixels")
    options.add_argument("--spp", type=int, nargs="+", default=[16, 64], help="samples a pixel")
    options.add_argument(
        "--only", nargs="+", metavar="NAME", help="scenes of these names, or patterns of names"
    )
    options.add_argument(
        "--methods", nargs="+", choices=get_args(MethodName), default=["layered", "lightfield"]
    )
    options.add_argument("--above", type=float, default=10.0, help="dB of a reference's floor over")
    options.add_argument("--limit", type=float, default=120.0, help="seconds for a reference")
    options.add_argument("--repeats", type=int, default=1, help="runs after the first, for medians")
    options.add_argument("--rfilter", help="reconstruction filter in the place of a scene's own")
    options.add_argument("--sampler", help="sampler in the place of a scene's own")
    options.add_argument("--squares", type=int, help="subpixels on a side; a method's own if none")
    options.add_argument(
        "--aperture", type=float, default=1.0, help="the lens's radius is times this"
    )
    options.add_argument(
        "--unmerged", action="store_true", help="load shapes as they are: optimize=False"
    )
    options.add_argument("--pictures", action="store_true", help="write whole pictures, too")
    arguments = options.parse_args()
    common.start(arguments)
    mi.set_log_level(mi.LogLevel.Error)

    rows = []
    for name, path in scenes_in(arguments.folders, arguments.only):
        try:
            case = Case.load(name, path, arguments)
        except (RuntimeError, TypeError, ValueError) as error:
            console.print(f"{name}: left out: {' '.join(str(error).split())[:200]}", markup=False)
            continue
        rows += run(case, arguments)
    console.print(summary(rows))


# ---------------------------------------------------------------- measures


@dataclasses.dataclass
class Row:
    """What the table tells of a picture; times in seconds."""

    scene: str
    picture: str
    spp: int
    image: np.ndarray
    first: float = math.nan
    again: float = math.nan
    decibels: float = math.nan
    linear: float = math.nan


@dataclasses.dataclass
class Halves:
    """Two independent halves of a reference, which judge a picture without their noise."""

    a: np.ndarray
    b: np.ndarray

    @classmethod
    def of(cls, reference: Reference) -> Halves:
        return cls(*(sums / (reference.count / 2) for sums in (reference.even, reference.odd)))

    def errors(self, picture: np.ndarray, encoding: Callable = metrics.srgb) -> np.ndarray:
        """Squared error at each pixel, (height, width), right on average and at times negative."""
        x, a, b = (encoding(image) for image in (picture, self.a, self.b))
        return np.mean((x - a) * (x - b), axis=2)

    def psnr(self, picture: np.ndarray, encoding: Callable = metrics.srgb) -> float:
        error = float(self.errors(picture, encoding).mean())
        return math.inf if error <= 0 else metrics.decibels(error)


def clipped(linear: np.ndarray) -> np.ndarray:
    return np.clip(linear, 0, 1)


def run(case: Case, arguments: argparse.Namespace) -> list[Row]:
    """Measure a scene, and print and draw what was found."""
    rows = [row for spp in arguments.spp for row in measured(case, spp, arguments)]
    reference = Reference.open(case.place, case.size, REFERENCE_SPP)
    extend(case, reference, rows, arguments)
    halves = Halves.of(reference)
    for row in rows:
        row.decibels, row.linear = halves.psnr(row.image), halves.psnr(row.image, clipped)
    console.print(table(case, rows, reference))
    for row in rows:
        beside = same(rows, row, "thinlens")
        if row.picture in arguments.methods and beside is not None:
            write_crop(case, row, beside, halves, reference.mean)
        if arguments.pictures:
            common.write_png(FOLDER / f"{stem(row)}.png", row.image)
    if arguments.pictures:
        common.write_png(FOLDER / f"{case.name}_reference.png", reference.mean)
    return rows


def measured(case: Case, spp: int, arguments: argparse.Namespace) -> Iterator[Row]:
    """All pictures of so many samples a pixel, and their times, first and again."""

    def row(picture: str, image: np.ndarray, first: float, again: float) -> Row:
        return Row(case.name, picture, spp, image[..., :3], first, again)

    closed = mi.load_dict(pinhole(case.sensor))
    repeats = arguments.repeats
    for picture, action in (
        ("mi.render, pinhole", lambda: case.render(closed, spp, 0)),
        ("thinlens", case.thinlens(spp, 0)),
    ):
        yield row(picture, *first_and_steady(action, repeats))
    for sampler in BEST_OF:
        yield row(f"thinlens, {sampler}", *timed(case.thinlens(spp, 0, sampler)), math.nan)

    made: list[pm.PointSamples] = []

    def take() -> int:
        # As many as of `thinlens`, none to refine pixels.
        even = pm.Sampling(refine=0)
        made[:] = [pm.render_samples(case.scene, case.sensor, spp=spp, seed=0, sampling=even)]
        return 0

    _, first, again = first_and_steady(take, repeats)
    yield row("samples", np.full((1, 1, 3), np.nan), first, again)
    lens = pm.potmesil_sensor(case.sensor).lens()
    settings = {"rfilter": case.sensor.film().rfilter(), "squares": arguments.squares}
    for method in arguments.methods:
        fresh = made[0].replace()  # of which nothing is known yet
        focus = functools.partial(pm.focus, fresh, method=method, **settings)
        image, first = timed(functools.partial(focus, lens))
        near = (
            lens.replace(focus_distance=lens.focus_distance * (1 + number / 400))
            for number in range(1, repeats + 1)
        )
        again = statistics.median(timed(functools.partial(focus, each))[1] for each in near)
        yield row(method, image, first, again)


def extend(
    case: Case, reference: Reference, rows: list[Row], arguments: argparse.Namespace
) -> None:
    """Add seeds until the floor is far enough above the best picture, or time is up."""
    began = time.perf_counter()
    judged = [row for row in rows if row.picture == "thinlens" or row.picture in arguments.methods]

    def enough() -> bool:
        if reference.count == 0:
            return False
        best = max(Halves.of(reference).psnr(row.image) for row in judged)
        return reference.floor_as(metrics.srgb) >= best + arguments.above

    while not enough() and (reference.count == 0 or time.perf_counter() - began < arguments.limit):
        reference.add_pair(lambda seed: case.thinlens(REFERENCE_SPP, seed, "orthogonal")())


# ---------------------------------------------------------------- what is told


def same(rows: list[Row], row: Row, picture: str) -> Row | None:
    """The row of another picture of the same scene and samples."""
    for other in rows:
        if (other.scene, other.spp, other.picture) == (row.scene, row.spp, picture):
            return other
    return None


def table(case: Case, rows: list[Row], reference: Reference) -> Any:
    lens = case.sensor
    radius, focus = (scalar(mi.traverse(lens)[n]) for n in ("aperture_radius", "focus_distance"))
    kind = "its own" if case.own_lens else "chosen"
    result = common.table(
        f"{case.name}: {case.size[0]}x{case.size[1]}, {kind} lens of radius {radius:.4g} focused "
        f"at {focus:.4g}; reference of {reference.count * reference.spp} samples, noise floor "
        f"{reference.floor_as(metrics.srgb):.1f} dB",
        ("picture", "samples", "sRGB dB", "- thinlens", "linear dB", "first s", "again s", "times"),
    )
    for row in rows:
        beside, closed = (same(rows, row, name) for name in ("thinlens", "mi.render, pinhole"))
        assert beside is not None
        assert closed is not None
        result.add_row(
            row.picture,
            f"{row.spp}",
            *("" if math.isnan(n) else f"{n:.2f}" for n in (row.decibels,)),
            *("" if math.isnan(n) else f"{n:+.2f}" for n in (row.decibels - beside.decibels,)),
            *("" if math.isnan(n) else f"{n:.2f}" for n in (row.linear,)),
            f"{row.first:.2f}",
            *("" if math.isnan(n) else f"{n:.2f}" for n in (row.again, row.again / closed.again)),
        )
    return result


def summary(rows: list[Row]) -> Any:
    """By how many dB each method is above ``thinlens`` of the same sampler, and what it costs."""
    methods = [m for m in get_args(MethodName) if any(row.picture == m for row in rows)]
    counts = sorted({row.spp for row in rows})
    columns = [
        *("scene", "samples", "thinlens dB", "best sampler"),
        *methods,
        *("samples / mi.render", *(f"first {method} / samples" for method in methods)),
    ]
    result = common.table("dB above thinlens with the same sampler; times", columns)
    for scene in dict.fromkeys(row.scene for row in rows):
        for spp in counts:
            found = {row.picture: row for row in rows if (row.scene, row.spp) == (scene, spp)}
            plain = found["thinlens"].decibels
            best = max(found[f"thinlens, {name}"].decibels for name in BEST_OF)
            samples = found["samples"].again
            result.add_row(
                *(scene, f"{spp}", f"{plain:.2f}", f"{best - plain:+.2f}"),
                *(f"{found[method].decibels - plain:+.2f}" for method in methods),
                f"{samples / found['mi.render, pinhole'].again:.2f}",
                *(f"{found[method].first / samples:.2f}" for method in methods),
            )
    return result


def stem(row: Row) -> str:
    return f"{row.scene}_{row.spp}_{row.picture.replace(', ', '_')}"


def write_crop(case: Case, row: Row, beside: Row, halves: Halves, mean: np.ndarray) -> None:
    """The place where the picture is worst beside another one, enlarged."""
    excess = halves.errors(row.image) - halves.errors(beside.image)
    sides = [min(CROP, side) for side in case.size]
    there = ndimage.uniform_filter(excess, size=sides[::-1], mode="constant")
    half = [side // 2 for side in sides]
    allowed = there[half[1] : case.size[1] - half[1] + 1, half[0] : case.size[0] - half[0] + 1]
    top, left = np.unravel_index(np.argmax(allowed), allowed.shape)
    window = np.s_[top : top + sides[1], left : left + sides[0]]
    difference = metrics.srgb(row.image) - metrics.srgb(mean)
    panels = [
        *(metrics.srgb(image[window]) for image in (row.image, beside.image, mean)),
        np.clip(0.5 + 2 * difference[window], 0, 1),
    ]
    strip = np.concatenate([np.kron(p, np.ones((ENLARGED, ENLARGED, 1))) for p in panels], axis=1)
    path = FOLDER / f"{stem(row)}_worst_{left}_{top}.png"
    for old in FOLDER.glob(f"{stem(row)}_worst_*.png"):
        old.unlink()
    FOLDER.mkdir(parents=True, exist_ok=True)
    mi.Bitmap(np.round(255 * strip).astype(np.uint8)).write(str(path))


if __name__ == "__main__":
    main()
