"""Motion blur: how good it is, and what it costs.

Pictures of scenes/moving.xml are compared with the mean of pictures that a `thinlens` renders at
many instants of the exposure.

    python benchmarks/motion.py                           # about 20 minutes
    python benchmarks/motion.py --motions ball --spp 16
    python benchmarks/motion.py --costs                   # what a refocus costs at 512x512
"""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Iterator

import common
import mitsuba as mi
import numpy as np
from common import console, first_and_steady, timed

import potmesil_mi as pm
from potmesil_mi.evaluation.metrics import psnr
from potmesil_mi.evaluation.thinlens import thinlens_sensor
from potmesil_mi.tracing.posing import PosedShapes
from potmesil_mi.tracing.sensor import placed

SCENE = common.ROOT / "scenes" / "moving.xml"
MOTIONS = ("ball", "pan", "dolly", "cube", "together")
F_NUMBERS = (0.2, math.inf)
METHODS = ("layered", "lightfield")
LENGTHS = (1, 16, 160)


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--motions", nargs="*", default=MOTIONS, help="files in scenes/motions")
    options.add_argument("--f-numbers", nargs="*", type=float, default=F_NUMBERS)
    options.add_argument("--res", type=int, default=256, help="pixels each way")
    options.add_argument("--spp", type=int, default=64, help="samples a pixel")
    options.add_argument("--instants", type=int, default=64, help="of the reference")
    options.add_argument("--reference-spp", type=int, default=64, help="of each of its instants")
    options.add_argument("--costs", action="store_true", help="only what a refocus costs")
    arguments = options.parse_args()
    common.start(arguments)
    console.print(costs() if arguments.costs else quality(arguments))


def quality(arguments: argparse.Namespace):
    """Each motion, with defocus and without, beside the mean of many instants."""
    result = common.table(
        f"moving, {arguments.res}x{arguments.res}, {arguments.spp} samples a pixel: dB against "
        f"{arguments.instants} instants; floor: of the reference's own noise",
        ["motion", "f-number", "instants", *METHODS, "paper", "still", "floor", "sampling s"],
    )
    for name in arguments.motions:
        motion = pm.Motion.load(SCENE.parent / "motions" / f"{name}.toml")
        for f_number in arguments.f_numbers:
            scene = mi.load_file(
                str(SCENE), optimize=False, res=arguments.res, spp=arguments.spp,
                f_number=f_number,
            )  # fmt: skip
            halves = [reference(scene, motion, arguments, half) for half in (0, 1)]
            expected = sum(halves) / 2
            samples, seconds = _samples(scene, motion)
            pictures = {m: np.array(pm.focus(samples, method=m)) for m in (*METHODS, "paper")}
            still, _ = _samples(scene, None)
            pictures["still"] = np.array(pm.focus(still))
            quality = [f"{psnr(of, expected):.1f}" for of in pictures.values()]
            floor = psnr(halves[0], halves[1]) + 6.02
            result.add_row(
                name, f"{f_number:g}", str(samples.instants), *quality, f"{floor:.1f}",
                f"{seconds:.1f}",
            )  # fmt: skip
            stem = f"{name}_{f_number:g}"
            for method in METHODS:
                common.write_comparison(
                    common.OUTPUT / "motion", stem, method, pictures[method], expected
                )
    return result


def _samples(scene: mi.Scene, motion: pm.Motion | None) -> tuple[pm.PointSamples, float]:
    """The samples, and the seconds that it took to take them when kernels were compiled."""
    pm.render_samples(scene, motion=motion, spp=16)
    found = []
    _, seconds = timed(lambda: found.append(pm.render_samples(scene, motion=motion)))
    return found[0], seconds


def reference(
    scene: mi.Scene, motion: pm.Motion, arguments: argparse.Namespace, half: int
) -> np.ndarray:
    """The mean of instants, every second one of twice as many, that a `thinlens` renders."""
    sensor = pm.potmesil_sensor(scene.sensors()[0])
    camera, shutter = sensor.camera(), motion.shutter_of(sensor.camera())
    shapes = PosedShapes(scene, motion.shapes)
    count, total = arguments.instants, 0.0
    for i in range(count // 2):
        frame = motion.frame + shutter.frame_when((2 * i + half + 0.5) / count)
        shapes.place(motion.transforms_at(shapes.centres, frame))
        placed(sensor, motion.camera_at(camera, frame))
        lens = thinlens_sensor(sensor, spp=arguments.reference_spp)
        total = total + np.array(mi.render(scene, sensor=lens, seed=2 * i + half), np.float64)
    shapes.place({})
    placed(sensor, camera)
    return total / (count // 2)


def _refocused(session: pm.FocusSession, lenses: Iterator[pm.ThinLens]):
    return session.focus(next(lenses))


def costs():
    """A refocus of a wall that moves by so many pixels, beside one that stands still."""
    result = common.table(
        "moving, 512x512, 16 samples a pixel, layered: seconds (medians of 5)",
        ["path in pixels", "f-number", "instants", "sampling", "first focus", "refocus", "/ still"],
    )
    f_number = F_NUMBERS[0]
    scene = mi.load_file(str(SCENE), optimize=False, res=512, spp=16, f_number=f_number)
    camera = scene.sensors()[0].camera()
    still = None
    for pixels in (0, *LENGTHS):
        angle = math.degrees(math.atan(pixels / camera.focal_length_pixels))
        motion = pm.Motion.from_dict(
            {"camera": {"pan": [[0, -180 - angle / 2], [1, -180 + angle / 2]]}, "shutter": {}}
        )
        samples, sampling = _samples(scene, motion)
        session = pm.FocusSession(samples)
        lenses = iter([samples.lens.replace(focus_distance=8 + i / 10) for i in range(20)])
        focus = functools.partial(_refocused, session, lenses)
        _, first, steady = first_and_steady(focus, 5)
        still = steady if still is None else still
        result.add_row(
            str(pixels), f"{f_number:g}", str(samples.instants), f"{sampling:.2f}",
            f"{first:.2f}", f"{steady:.3f}", f"{steady / still:.2f}",
        )  # fmt: skip
    return result


if __name__ == "__main__":
    main()
