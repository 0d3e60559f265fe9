"""How near pictures through a telecentric lens come to Mitsuba's own orthographic views.

Mitsuba has no telecentric sensor, but the mean of `orthographic` views that are sheared about the
focused plane, one for each point of the lens, is what one would see. Two scenes are rendered so,
and the same lens focuses point samples of the unsheared view.

    python benchmarks/telecentric.py                          # 256x256, 400 views, minutes
    python benchmarks/telecentric.py --res 64 --views 128     # a quick try
"""

from __future__ import annotations

import math
from typing import Any

import common
import mitsuba as mi
import numpy as np
from common import console

import potmesil_mi as pm
from potmesil_mi.evaluation.metrics import psnr

METHODS = ("layered", "lightfield", "paper")
GOAL = 45.0


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--res", type=int, default=256, help="pixels each way")
    options.add_argument("--views", type=int, default=400, help="sheared views of each reference")
    options.add_argument("--view-spp", type=int, default=4, help="samples a pixel of each view")
    options.add_argument("--spp", type=int, default=16, help="point samples a pixel")
    arguments = options.parse_args()
    common.start(arguments)
    console.print(f"PSNR in dB beside {arguments.views} sheared orthographic views, half-angle 6°")
    for focus_distance in (2.0, 4.0):
        for make in (still_life, boxes):
            scene = make(arguments.res, arguments.spp)
            lens = pm.TelecentricLens(6.0, focus_distance)
            halves = reference(scene, lens, arguments.views, arguments.view_spp)
            converged = (halves[0] + halves[1]) / 2
            # Noise of the mean: half the difference of the halves.
            floor = psnr(converged + (halves[0] - halves[1]) / 2, converged)
            samples = pm.render_samples(scene, lens=lens)
            figures = {
                method: psnr(np.array(pm.focus(samples, method=method)), converged)
                for method in METHODS
            }
            console.print(
                f"{make.__name__:10}  focused at {focus_distance:g}:",
                *(f"{name} {figure:.1f}" for name, figure in {**figures, "floor": floor}.items()),
            )
    console.print(f"Goal: layered at least {GOAL:g} dB")


def reference(
    scene: mi.Scene, lens: pm.TelecentricLens, views: int, spp: int
) -> tuple[np.ndarray, np.ndarray]:
    """Means of every other sheared view, float64 (H, W, 3) each, seen from points of the lens."""
    sensor = scene.sensors()[0]
    matrix = np.array(mi.traverse(sensor)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    slope = math.tan(math.radians(lens.half_angle))
    halves: list[Any] = [0.0, 0.0]
    for number, point in enumerate(spread(views)):
        # In camera space x += tan(a) u (U - z): the focused plane stays where it is.
        shear = np.eye(4)
        shear[:2, 2] = -slope * point
        shear[:2, 3] = slope * point * lens.focus_distance
        scale = np.diag([*np.linalg.norm(matrix[:3, :3], axis=0), 1])
        view = mi.load_dict(
            {
                "type": "orthographic",
                "film": sensor.film(),
                "sampler": {"type": "multijitter", "sample_count": spp},
                "to_world": mi.ScalarTransform4f(matrix @ np.linalg.inv(scale) @ shear @ scale),
            }
        )
        picture = np.array(mi.render(scene, sensor=view, spp=spp, seed=number), dtype=np.float64)
        halves[number % 2] = halves[number % 2] + picture
    return halves[0] / math.ceil(views / 2), halves[1] / (views // 2)


def spread(count: int) -> np.ndarray:
    """Points of the unit disc, (count, 2), that fill it evenly: a sunflower.

    Neighbours in number are far from each other, so every other one fills it, too.
    """
    number = np.arange(count) + 0.5
    angle = number * math.pi * (3 - math.sqrt(5))
    return np.sqrt(number / count)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def camera(res: int, spp: int, half_width: float) -> dict[str, Any]:
    """An orthographic sensor at the origin that looks along z."""
    return {
        "type": "orthographic",
        "to_world": mi.ScalarTransform4f().scale([half_width, half_width, 1]),
        "film": {
            "type": "hdrfilm",
            "width": res,
            "height": res,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "multijitter", "sample_count": spp},
    }


def diffuse(*rgb: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": rgb}}


def chequered(size: float) -> dict[str, Any]:
    return {
        "type": "diffuse",
        "reflectance": {
            "type": "checkerboard",
            "color0": {"type": "rgb", "value": [0.15, 0.3, 0.5]},
            "color1": {"type": "rgb", "value": [0.7, 0.7, 0.6]},
            "to_uv": mi.ScalarTransform4f().scale([size, size, 1]),
        },
    }


def wall(depth: float) -> dict[str, Any]:
    to_world = mi.ScalarTransform4f().translate([0, 0, depth]).rotate([0, 1, 0], 180).scale(5)
    return {"type": "rectangle", "to_world": to_world, "bsdf": chequered(12)}


LIGHTS = {
    "lamp": {
        "type": "point",
        "position": [3, 4, -3],
        "intensity": {"type": "rgb", "value": [60, 60, 55]},
    },
    "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.2}},
}


def still_life(res: int, spp: int) -> mi.Scene:
    """A ball before a chequered wall."""
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": camera(res, spp, 1.4),
            "ball": {
                "type": "sphere",
                "center": [0.1, -0.1, 2.5],
                "radius": 0.6,
                "bsdf": diffuse(0.8, 0.3, 0.1),
            },
            "wall": wall(4.5),
            **LIGHTS,
        }
    )


def boxes(res: int, spp: int) -> mi.Scene:
    """Boxes, turned, at depths from 1.5 to 5, before a chequered wall."""
    random = np.random.default_rng(3)
    shapes = {}
    for number in range(9):
        x, y = (number % 3 - 1) * 0.8, (number // 3 - 1) * 0.8
        place = [
            x + random.uniform(-0.2, 0.2),
            y + random.uniform(-0.2, 0.2),
            1.5 + 3.5 * number / 8,
        ]
        axis = random.normal(size=3)
        axis /= np.linalg.norm(axis)
        turned = mi.ScalarTransform4f().translate(place).rotate(axis, random.uniform(0, 180))
        shapes[f"box{number}"] = {
            "type": "cube",
            "to_world": turned.scale(0.28),
            "bsdf": diffuse(*random.uniform(0.1, 0.8, 3)),
        }
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": camera(res, spp, 1.4),
            "wall": wall(6.0),
            **shapes,
            **LIGHTS,
        }
    )


if __name__ == "__main__":
    main()
