"""Gradients of materials and lights through the lens, beside those of `thinlens` and `prb`.

    python benchmarks/gradients_render.py                                  # the wall and the card
    python benchmarks/gradients_render.py --scenes ../shared/scenes/cbox/cbox-rgb.xml

A wall with a texture stands out of focus behind a card with an edge. For fixed random weights of
the pixels the gradient of the weighted sum of the picture is compared: of all texels of the wall,
of the card's colour, of the lamp's radiance. The judge is `thinlens` with `prb` and many samples,
in two independent halves, without whose noise the error is told; what noise there is in it is told
beside it. Errors are relative to the norm of the gradient. `no lens` is `prb` through a pinhole.

In scenes of others the gradients are of all colours of reflectances and of radiances of lamps, and
the weights have the mean 1: what is of few numbers would else be noise of the light above all.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import common
import drjit as dr
import mitsuba as mi
import numpy as np
from common import console

import potmesil_mi as pm
from potmesil_mi.evaluation import thinlens_sensor

TEXELS = 16
LENS = {"focal_length": 50.0, "frame_width": 36.0, "f_number": 0.7, "millimeters_per_unit": 200.0}
PASS = 1 << 20
"""Paths of the judge at once."""


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--res", type=int, default=64)
    options.add_argument("--spp", type=int, nargs="+", default=[16, 64])
    options.add_argument("--reference-spp", type=int, default=16384)
    options.add_argument(
        "--repeats", type=int, default=4, help="seeds, over which errors are means"
    )
    options.add_argument("--max-depth", type=int, nargs="+", default=[2, 4])
    options.add_argument("--focus", type=float, nargs="+", default=[1.6, 2.5])
    options.add_argument("--scenes", type=Path, nargs="*", default=[])
    arguments = options.parse_args()
    common.start(arguments)
    mi.set_log_level(mi.LogLevel.Error)
    for path in arguments.scenes:
        scene = mi.load_file(str(path), res=arguments.res)
        middle = arguments.res / 2
        distance = pm.focus_distance_at(pm.render_samples(scene, spp=4), middle, middle)
        sensor = pm.potmesil_sensor(
            scene.sensors()[0], focus_distance=0.85 * distance, aperture_radius=distance / 30
        )
        measured(path.stem, scene, sensor, colours_of(scene), 4, arguments)
    for depth in arguments.max_depth if not arguments.scenes else []:
        for focus in arguments.focus:
            scene = wall_and_card(arguments.res, focus)
            keys = {
                "texture of the wall": "wall.bsdf.reflectance.data",
                "colour of the card": "card.bsdf.reflectance.value",
                "radiance of the lamp": "lamp.emitter.radiance.value",
            }
            name = f"focus {focus:g} m, max_depth {depth}"
            measured(name, scene, scene.sensors()[0], keys, depth, arguments)


def wall_and_card(res: int, focus: float) -> mi.Scene:
    """A textured wall 3 m away, and a card 1.6 m away whose edge stands before it."""
    place = mi.ScalarTransform4f()
    texels = np.random.default_rng(0).uniform(0.1, 0.9, (TEXELS, TEXELS, 3)).astype(np.float32)
    grey = {"type": "rgb", "value": [0.6, 0.5, 0.3]}
    texture = {"type": "bitmap", "data": mi.TensorXf(texels), "raw": True}
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "potmesil",
                **LENS,
                "focus_distance": focus,
                "film": {
                    "type": "hdrfilm",
                    "width": res,
                    "height": res,
                    "pixel_format": "rgb",
                    "component_format": "float32",
                    "rfilter": {"type": "box"},
                },
            },
            "wall": {
                "type": "rectangle",
                "to_world": place.translate([0, 0, 3]).rotate([0, 1, 0], 180).scale(1.6),
                "bsdf": {"type": "diffuse", "reflectance": texture},
            },
            "card": {
                "type": "rectangle",
                "to_world": place.translate([-0.45, 0.1, 1.6])
                .rotate([0, 0, 1], 12)
                .rotate([0, 1, 0], 180)
                .scale([0.4, 0.4, 1]),
                "bsdf": {"type": "diffuse", "reflectance": grey},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": place.translate([1.5, 2, -0.5])
                .look_at(origin=[0, 0, 0], target=[-1.5, -2, 3.5], up=[0, 0, 1])
                .scale(0.8),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 8.0}},
            },
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.2}},
        }
    )


def colours_of(scene: mi.Scene) -> dict[str, str]:
    """What gradients are of in a scene of others: each by itself."""
    names = [name for name, _ in mi.traverse(scene)]
    ends = ("reflectance.value", "radiance.value")
    return {name.removesuffix(".value"): name for name in names if name.endswith(ends)}


class Gradients:
    """Gradients of a weighted sum of the pixels, in some parameters of a scene."""

    def __init__(
        self, scene: mi.Scene, sensor: mi.Sensor, keys: dict[str, str], mean: float
    ) -> None:
        self.scene, self.keys, self.parameters = scene, keys, mi.traverse(scene)
        width, height = sensor.film().crop_size()
        weights = np.random.default_rng(1).normal(mean, size=(height, width, 3))
        self.weights = mi.TensorXf(weights.astype(np.float32))
        for key in keys.values():
            dr.enable_grad(self.parameters[key])
        self.parameters.update()

    def of(
        self, integrator: mi.Integrator, sensor: mi.Sensor, seed: int, spp: int
    ) -> dict[str, np.ndarray]:
        for key in self.keys.values():
            dr.set_grad(self.parameters[key], 0)
        integrator.render_backward(
            self.scene, self.parameters, self.weights, sensor=sensor, seed=seed, spp=spp
        )
        return {
            name: np.array(dr.grad(self.parameters[key])).astype(np.float64).ravel()
            for name, key in self.keys.items()
        }


def measured(
    name: str,
    scene: mi.Scene,
    sensor: mi.Sensor,
    keys: dict[str, str],
    depth: int,
    arguments: argparse.Namespace,
) -> None:
    """Print the table of a scene."""
    gradients = Gradients(scene, sensor, keys, 1.0 if arguments.scenes else 0.0)
    prb = mi.load_dict({"type": "prb", "max_depth": depth})
    nested = {"type": "prb", "max_depth": depth}
    judge = thinlens_sensor(sensor, sampler="independent")
    each = max(1, min(arguments.reference_spp, PASS // arguments.res**2))
    passes = max(2, arguments.reference_spp // each)
    halves = []
    for half in range(2):
        parts = [
            gradients.of(prb, judge, 1000 + 2 * number + half, each)
            for number in range(passes // 2)
        ]
        halves.append({key: np.mean([part[key] for part in parts], axis=0) for key in keys})
    table = common.table(
        f"{name}: error of gradients, in % of their norm", ["", "samples", *keys, "seconds"]
    )
    noise = [
        np.linalg.norm(halves[0][key] - halves[1][key]) / 2 / norm(halves, key) for key in keys
    ]
    judged = f"judge's noise ({passes * each} samples)"
    table.add_row(judged, "", *(f"{100 * each:.2f}" for each in noise), "")
    pinhole = pm.potmesil_sensor(sensor, f_number=math.inf)
    for spp in arguments.spp:
        rows: dict[str, Callable[[int], dict[str, np.ndarray]]] = {
            "focus, layered": taken(gradients, {"type": "focus", "nested": nested}, sensor, spp),
            "thinlens": taken(gradients, nested, judge, spp),
            "no lens": taken(gradients, nested, pinhole, spp),
        }
        for label, take in rows.items():
            take(0)
            began = time.perf_counter()
            found = [take(1 + seed) for seed in range(arguments.repeats)]
            seconds = (time.perf_counter() - began) / arguments.repeats
            errors = (f"{100 * error(found, halves, key):.2f}" for key in keys)
            table.add_row(label, str(spp), *errors, f"{seconds:.2f}")
            mean = {key: np.mean([each[key] for each in found], axis=0) for key in keys}
            if arguments.repeats > 1:
                errors = (f"{100 * error([mean], halves, key):.2f}" for key in keys)
                table.add_row(f"  mean of {arguments.repeats}", "", *errors, "")
    console.print(table)


def taken(
    gradients: Gradients, integrator: dict, sensor: mi.Sensor, spp: int
) -> Callable[[int], dict[str, np.ndarray]]:
    loaded = mi.load_dict(integrator)
    return lambda seed: gradients.of(loaded, sensor, seed, spp)


def norm(halves: list[dict[str, np.ndarray]], key: str) -> float:
    return math.sqrt(max(float(halves[0][key] @ halves[1][key]), 1e-30))


def error(
    found: list[dict[str, np.ndarray]], halves: list[dict[str, np.ndarray]], key: str
) -> float:
    """Root mean squared error without the noise of the judge, relative to the gradient."""
    a, b = (half[key] for half in halves)
    squared = float(np.mean([(each[key] - a) @ (each[key] - b) for each in found]))
    return math.sqrt(max(squared, 0)) / norm(halves, key)


if __name__ == "__main__":
    main()
