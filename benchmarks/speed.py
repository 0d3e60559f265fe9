"""How long a refocus takes as circles grow, and what 1920x1080 needs of memory.

    python benchmarks/speed.py                     # the paper's scene, 1024x1024
    python benchmarks/speed.py --scene thicket
    python benchmarks/speed.py --memory            # 1920x1080, peak of the whole process
    python benchmarks/speed.py --thread            # beside another Python thread, as in a notebook
    python benchmarks/speed.py --hidden --res 512  # what hidden layers cost

The scene is sampled once for each aperture, which is chosen so that the largest circle at the
focus distance has the diameter that is asked for. For speed beside `thinlens` at equal error:
`potmesil compare scenes/figure11.xml`.
"""

from __future__ import annotations

import argparse
import statistics
import threading

import common
import mitsuba as mi
import numpy as np
from common import console, peak_memory, timed

import potmesil_mi as pm


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--scene", default="figure11", help="name of a scene in scenes/")
    options.add_argument("--res", type=int, default=1024, help="pixels each way")
    options.add_argument("--spp", type=int, default=16)
    options.add_argument("--focus-distance", type=float, default=550.0)
    options.add_argument(
        "--diameters", type=float, nargs="+", default=[10, 20, 40, 80, 160], metavar="PIXELS"
    )
    options.add_argument("--method", default="layered")
    options.add_argument("--repeats", type=int, default=7)
    options.add_argument("--memory", action="store_true", help="1920x1080 and one diameter, 100")
    options.add_argument("--thread", action="store_true", help="beside an idle Python thread")
    options.add_argument("--hidden", action="store_true", help="sampling with and without layers")
    arguments = options.parse_args()
    common.start(arguments)
    if arguments.hidden:
        console.print(hidden_layers(arguments))
        return
    if arguments.memory:
        arguments.diameters = [100]
    if arguments.thread:
        threading.Thread(target=threading.Event().wait, daemon=True).start()

    rows = common.table(
        f"{arguments.scene}, {arguments.spp} samples a pixel, {arguments.method}, focused at "
        f"{arguments.focus_distance:g}",
        ["largest circle", "f-number", "samples", "sampling s", "first focus s", "refocus s",
         "times the first"],
    )  # fmt: skip
    times = []
    for diameter in arguments.diameters:
        scene = load(arguments)
        sensor = scene.sensors()[0]
        f_number = f_number_for(scene, diameter, arguments.focus_distance)
        lens = sensor.lens().replace(f_number=f_number, focus_distance=arguments.focus_distance)
        sampling = pm.Sampling(min_f_number=f_number)
        made = []
        _, seconds = timed(
            lambda scene=scene, sampling=sampling, made=made: made.append(
                pm.render_samples(scene, spp=arguments.spp, sampling=sampling)
            )
        )
        samples = made.pop()
        _, first = timed(lambda s=samples, lens=lens: pm.focus(s, lens, method=arguments.method))
        # A little off the distance each time, as one does to refocus.
        lenses = [
            lens.replace(focus_distance=arguments.focus_distance * (1 + step / 1000))
            for step in range(1, arguments.repeats + 1)
        ]
        steady = statistics.median(
            timed(lambda s=samples, lens=other: pm.focus(s, lens, method=arguments.method))[1]
            for other in lenses
        )
        times.append(steady)
        rows.add_row(
            f"{diameter:g} px", f"{f_number:.2f}", f"{len(samples):,}", f"{seconds:.2f}",
            f"{first:.2f}", f"{steady:.3f}", f"{steady / times[0]:.2f}",
        )  # fmt: skip
    console.print(rows)
    console.print(f"peak memory of the process: {peak_memory():.2f} GiB")


def hidden_layers(arguments: argparse.Namespace):
    """Seconds of sampling first hits only, and hidden surfaces too, in turns."""
    scene = load(arguments)
    times: dict[int, list[float]] = {1: [], 2: []}
    counts = {}
    for repeat in range(arguments.repeats + 1):
        for layers, seconds in times.items():
            made = []

            def sample(layers=layers, made=made, seed=repeat):
                sampling = pm.Sampling(layers=layers)
                made.append(
                    pm.render_samples(scene, spp=arguments.spp, seed=seed, sampling=sampling)
                )

            seconds.append(timed(sample)[1])
            counts[layers] = len(made.pop())
    rows = common.table(
        f"{arguments.scene}, {arguments.res}x{arguments.res}, {arguments.spp} samples a pixel",
        ["layers", "samples", "first s", "again s", "times first hits only"],
    )
    steady = {layers: statistics.median(seconds[1:]) for layers, seconds in times.items()}
    for layers, seconds in times.items():
        rows.add_row(
            str(layers), f"{counts[layers]:,}", f"{seconds[0]:.2f}", f"{steady[layers]:.3f}",
            f"{steady[layers] / steady[1]:.2f}",
        )  # fmt: skip
    return rows


def load(arguments: argparse.Namespace) -> mi.Scene:
    path = str(common.ROOT / "scenes" / f"{arguments.scene}.xml")
    if arguments.memory:
        scene = mi.load_file(path, optimize=False, res=1920)
        parameters = mi.traverse(scene)
        film = next(name for name in parameters.keys() if name.endswith("film.size"))  # noqa: SIM118
        parameters[film] = [1920, 1080]
        parameters[film.replace("size", "crop_size")] = [1920, 1080]
        parameters.update()
        return scene
    return mi.load_file(path, optimize=False, res=arguments.res)


def f_number_for(scene: mi.Scene, diameter: float, focus_distance: float) -> float:
    """The f-number at which the scene's largest circle, focused there, has that diameter."""
    sensor = scene.sensors()[0]
    probe = pm.render_samples(scene, spp=1, sampling=pm.Sampling(layers=1, overscan=0))
    lens = sensor.lens().replace(f_number=1.0, focus_distance=focus_distance)
    pixels_per_mm = probe.camera.focal_length_pixels / lens.film_distance
    circles = np.abs(lens.circle_of_confusion(probe.z.astype(np.float64))) * pixels_per_mm
    return float(circles.max()) / diameter


if __name__ == "__main__":
    main()
