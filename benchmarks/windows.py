"""How near pictures of mirrors, glass, veils and smoke come to Mitsuba's own `thinlens`.

Each stands a metre from a lens of 6 cm radius, before stripes 4 m away; what a mirror shows is
behind the camera. The lens is focused on the thing and on the stripes. Beside the figures stand
those of a `thinlens` of the same sampler and as many samples, and the noise of the reference.

    python benchmarks/windows.py                              # 96x96, 64 samples, minutes
    python benchmarks/windows.py --only mirror slab --spp 16
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import common
import mitsuba as mi
import numpy as np
from common import console

import potmesil_mi as pm
from potmesil_mi.evaluation.metrics import psnr
from potmesil_mi.evaluation.reference import Reference

METHODS = ("layered", "lightfield")
RADIUS = 0.06
FOCUS_DISTANCES = (4.0, 1.0)
GLASS = {"type": "dielectric"}
PLAIN = {"type": "conductor", "material": "none"}


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--res", type=int, default=96, help="pixels each way")
    options.add_argument("--spp", type=int, default=64, help="point samples a pixel")
    options.add_argument("--reference-spp", type=int, default=4096, help="of the reference")
    options.add_argument("--sampler", default="multijitter", help="of all pictures")
    options.add_argument("--only", nargs="+", choices=list(THINGS), help="these things")
    arguments = options.parse_args()
    common.start(arguments)
    columns = ("focused at", *METHODS, "thinlens", "noise", "samples / mi.render", "windows")
    result = common.table("PSNR in dB of linear RGB", ("thing", *columns))
    for name in arguments.only or THINGS:
        for focus_distance in FOCUS_DISTANCES:
            result.add_row(name, *row(name, focus_distance, arguments))
    console.print(result)


def row(name: str, focus_distance: float, arguments: Any) -> list[str]:
    """The figures of one thing at one focus."""
    scene = scene_of(name, focus_distance, arguments.res, arguments.sampler, arguments.spp)

    def render(spp: int, number: int) -> np.ndarray:
        return np.array(mi.render(scene, spp=spp, seed=number + 1))[..., :3]

    reference = Reference(render)
    made = []

    def sample() -> int:
        made[:] = [pm.render_samples(scene, spp=arguments.spp, sampling=pm.Sampling(refine=0))]
        return len(made[0])

    rendered, _, seconds = common.first_and_steady(lambda: render(arguments.spp, 1 << 20))
    _, _, sampling = common.first_and_steady(sample)
    samples = made[0]
    pictures = [np.array(pm.focus(samples, method=method)) for method in METHODS]
    reference.converge(pictures[0], arguments.reference_spp, None, lambda *_: None)
    figures = [psnr(picture, reference.mean) for picture in (*pictures, rendered)]
    through = 0.0 if samples.through is None else float((samples.through > 0).mean())
    return [
        f"{focus_distance:g}",
        *(f"{figure:.1f}" for figure in (*figures, reference.floor)),
        f"{sampling / seconds:.1f}",
        f"{through:.0%}",
    ]


def scene_of(name: str, focus_distance: float, res: int, sampler: str, spp: int) -> mi.Scene:
    """One of ``THINGS`` before stripes."""
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volpath" if name == "smoke" else "path", "max_depth": 8},
            "sensor": {
                "type": "thinlens",
                "fov": 40,
                "aperture_radius": RADIUS,
                "focus_distance": focus_distance,
                "film": {
                    "type": "hdrfilm",
                    "width": res,
                    "height": res,
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": sampler, "sample_count": spp},
            },
            "wall": stripes(4, 180, 24),
            "behind": stripes(-2, 0, 40),
            **THINGS[name](),
        }
    )


def stripes(z: float, turn: float, count: int, radiance: float = 1.0) -> dict[str, Any]:
    """A wall of light and dark stripes that faces the camera."""
    pattern = {
        "type": "checkerboard",
        "color0": {"type": "rgb", "value": 0.0},
        "color1": {"type": "srgb", "color": [radiance] * 3, "unbounded": True},
        "to_uv": mi.ScalarTransform4f().scale([count, 0.001, 1]),
    }
    place = mi.ScalarTransform4f().translate([0, 0, z]).rotate([0, 1, 0], turn).scale(4)
    return {
        "type": "rectangle",
        "to_world": place,
        "emitter": {"type": "area", "radiance": pattern},
    }


def reflecting(thing: dict[str, Any]) -> dict[str, Any]:
    """``thing`` before stripes behind the camera that are nearer, and as bright as a street."""
    return {"thing": thing, "behind": stripes(-0.5, 0, 40, radiance=10.0)}


def square(bsdf: dict[str, Any], turn: float = 180) -> dict[str, Any]:
    place = mi.ScalarTransform4f().translate([0, 0, 1]).rotate([0, 1, 0], turn).scale(0.2)
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


def slab(bsdf: dict[str, Any]) -> dict[str, Any]:
    place = mi.ScalarTransform4f().translate([0, 0, 1]).scale([0.2, 0.2, 0.01])
    return {"type": "cube", "to_world": place, "bsdf": bsdf}


def ball(bsdf: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"type": "sphere", "center": [0, 0, 1], "radius": 0.2, "bsdf": bsdf, **more}


def rod(bsdf: dict[str, Any]) -> dict[str, Any]:
    """An upright cylinder, which has no image of points."""
    return {"type": "cylinder", "p0": [0, -1, 1], "p1": [0, 1, 1], "radius": 0.2, "bsdf": bsdf}


def pane(opacity: float) -> dict[str, Any]:
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    return square(
        {"type": "mask", "opacity": opacity, "nested": {"type": "twosided", "nested": black}}
    )


SMOKE = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 12.0}

THINGS: dict[str, Callable[[], dict[str, Any]]] = {
    "mirror": lambda: {"thing": square(PLAIN)},
    "tilted mirror": lambda: {"thing": square(PLAIN, 140)},
    "curved mirror": lambda: {"thing": ball(PLAIN)},
    "rough mirror": lambda: {"thing": square({**PLAIN, "type": "roughconductor", "alpha": 0.1})},
    "slab": lambda: {"thing": slab(GLASS)},
    "rough slab": lambda: {"thing": slab({"type": "roughdielectric", "alpha": 0.05})},
    "thin pane": lambda: {"thing": square({"type": "thindielectric"})},
    "reflecting pane": lambda: reflecting(square({"type": "thindielectric"})),
    "reflecting slab": lambda: reflecting(slab(GLASS)),
    "ball of glass": lambda: {"thing": ball(GLASS)},
    "rod of glass": lambda: {"thing": rod(GLASS)},
    "pane of 0.3": lambda: {"thing": pane(0.3)},
    "pane of 0.8": lambda: {"thing": pane(0.8)},
    "smoke": lambda: {"thing": ball({"type": "null"}, interior=SMOKE)},
}
"""What stands before the wall."""


if __name__ == "__main__":
    main()
