"""Memory and time of a large picture: 1920x1080 at 64 samples a pixel.

Point samples of a scene with a `potmesil` sensor, the paper's by default, are rendered on a film
of any size and focused; after each step the largest memory of the process so far is printed.

    python benchmarks/memory.py
    python benchmarks/memory.py --width 3840 --height 2160 --spp 16 --method layered --limit 12
    python benchmarks/memory.py --scene scenes/terrace.xml
    python benchmarks/memory.py --width 480 --height 270       # a quick try
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import common
import mitsuba as mi
import numpy as np
from common import console

import potmesil_mi as pm
from potmesil_mi.focusing.memory import memory_of_focus
from potmesil_mi.tracing.sensor import sensor_parameters


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--scene", type=Path, default=common.SCENE)
    options.add_argument("--width", type=int, default=1920)
    options.add_argument("--height", type=int, default=1080)
    options.add_argument("--spp", type=int, default=64, help="point samples a pixel")
    options.add_argument("--f-number", type=float, default=5.6)
    options.add_argument(
        "--focus-distances", type=float, nargs="+", help="by default 290 and 2000 mm"
    )
    options.add_argument("--method", default="paper", help="layered, lightfield or paper")
    options.add_argument("--tables", type=int, default=73, help="of the method paper")
    options.add_argument("--limit", type=float, default=8.0, help="memory to stay within, in GiB")
    arguments = options.parse_args()
    common.start(arguments)
    steps = Steps()

    scene = mi.load_file(str(arguments.scene), optimize=False)
    sensor = wide(scene.sensors()[0], arguments.width, arguments.height, arguments.spp)
    steps.done("scene loaded")

    samples = steps.run("point samples", lambda: pm.render_samples(scene, sensor, seed=0))
    console.print(
        f"{len(samples):,} samples of {samples.nbytes / len(samples):.0f} bytes: "
        f"{samples.nbytes / 2**30:.2f} GiB"
    )
    needed = memory_of_focus(samples, pm.Method.parse(arguments.method))
    console.print(f"a focus is said to take {needed / 2**30:.2f} GiB beside them")
    in_units = samples.lens.millimeters_per_unit
    for distance in arguments.focus_distances or (290 / in_units, 2000 / in_units):
        lens = samples.lens.replace(f_number=arguments.f_number, focus_distance=distance)
        circle = np.abs(lens.circle_of_confusion(np.array([samples.z.min(), samples.z.max()])))
        circle = circle.max() * samples.camera.focal_length_pixels / lens.film_distance
        steps.run(
            f"focused at {distance:g}, circles up to {circle:.0f} pixels",
            lambda lens=lens: np.array(
                pm.focus(samples, lens, method=arguments.method, tables=arguments.tables)
            ),
        )
    console.print(steps.table)
    within = common.peak_memory() <= arguments.limit
    console.print(
        f"{'Within' if within else '[red]Beyond'} {arguments.limit:g} GiB: "
        f"{common.peak_memory():.2f} GiB"
    )
    sys.exit(0 if within else 1)


def wide(sensor: mi.Sensor, width: int, height: int, spp: int) -> mi.Sensor:
    """The same camera and lens with a film of another size."""
    camera, lens = sensor.camera(), sensor.lens()
    return mi.load_dict(
        {
            "type": "potmesil",
            "to_world": mi.ScalarTransform4f(np.array(camera.to_world)),
            "near_clip": camera.near_clip,
            "far_clip": camera.far_clip,
            "sampler": {"type": "multijitter", "sample_count": spp},
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            **sensor_parameters(lens),
        }
    )


class Steps:
    """Prints each step as it ends, and keeps them for the table."""

    def __init__(self) -> None:
        self.table = common.table("Memory", ["step", "seconds", "peak so far GiB", "now GiB"])
        self.began = time.perf_counter()

    def run(self, name: str, action: Callable[[], Any]) -> Any:
        """What ``action`` returns, timed."""
        console.print(f"{name} ...")
        self.began = time.perf_counter()
        result = action()
        self.done(name)
        return result

    def done(self, name: str) -> None:
        """Note the time since the last step began, and the memory."""
        seconds, peak = time.perf_counter() - self.began, common.peak_memory()
        console.print(f"{name}: {seconds:.1f} s, peak so far {peak:.2f} GiB")
        self.table.add_row(name, f"{seconds:.1f}", f"{peak:.2f}", common.memory_now())


if __name__ == "__main__":
    main()
