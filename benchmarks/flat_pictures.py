"""Flat pictures with depth, as Mitsuba itself writes them, beside point samples of first hits.

    python benchmarks/flat_pictures.py                              # figure 11, terrace, room
    python benchmarks/flat_pictures.py --folders ~/mitsuba-data/scenes --only cbox 'shape_*'

Mitsuba's `aov` integrator writes an EXR of colours and its own `depth`, which is along the ray and
filtered as the colours are; `PointSamples.from_image` reads it again. **First hits** are point
samples of as many rays, without hidden surfaces (`layers=1`), overscan, and the depth of what is
seen in mirrors, none of which a picture has; **all** have them. Judged by a `thinlens` of two
seeds, of which the noise is told. PSNR is of sRGB, clipped to [0, 1]. `--images` writes the
pictures.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import common
import mitsuba as mi
import numpy as np
from common import OUTPUT, console, srgb_psnr
from foreign_scenes import Case, scenes_in

import potmesil_mi as pm
from potmesil_mi.evaluation import thinlens_sensor

FOLDER = OUTPUT / "flat_pictures"

OWN = {
    "figure11": {"res": 256},
    "terrace": {"width": 384, "height": 216},
    "room": {"res": 192},
}
"""Scenes of the package and their sizes."""


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--folders", nargs="*", type=Path, default=[], help="scenes of others")
    options.add_argument("--only", nargs="+", metavar="NAME", help="of these names, or patterns")
    options.add_argument("--size", type=int, default=192, help="longest side of those, pixels")
    options.add_argument("--sampler", default="multijitter", help="of those")
    options.add_argument("--spp", type=int, default=64, help="samples a pixel")
    options.add_argument("--reference-spp", type=int, default=1024, help="of each of two seeds")
    options.add_argument("--images", action="store_true", help="write pictures and errors")
    options.set_defaults(aperture=1.0, rfilter="box", unmerged=False)
    arguments = options.parse_args()
    common.start(arguments)
    mi.set_log_level(mi.LogLevel.Error)
    FOLDER.mkdir(parents=True, exist_ok=True)
    table = common.table(
        f"{arguments.spp} samples a pixel, box filter",
        ("scene", "reference dB", "flat picture", "first hits", "all", "flat - first hits"),
    )
    for name, scene, sensor in subjects(arguments):
        found = compared(name, scene, sensor, arguments)
        cells = [f"{found[what]:.2f}" for what in ("noise", "flat", "first", "all")]
        table.add_row(name, *cells, f"{found['flat'] - found['first']:+.2f}")
    console.print(table)


def subjects(arguments: argparse.Namespace) -> Iterator[tuple[str, mi.Scene, mi.Sensor]]:
    """Names of scenes, and the sensors with a lens that they are looked at with."""
    if not arguments.folders:
        for name, defines in OWN.items():
            path = common.ROOT / "scenes" / f"{name}.xml"
            scene = mi.load_file(str(path), optimize=False, **defines)
            yield name, scene, scene.sensors()[0]
    for name, path in scenes_in(arguments.folders, arguments.only):
        try:
            case = Case.load(name, path, arguments)
        except ValueError as error:
            console.print(f"{name} is left out: {error}")
            continue
        yield name, case.scene, pm.potmesil_sensor(thinlens_sensor(case.sensor))


def compared(
    name: str, scene: mi.Scene, sensor: mi.Sensor, arguments: argparse.Namespace
) -> dict[str, float]:
    """PSNR in dB of the pictures, and of the reference's noise."""
    integrator = getattr(scene.integrator(), "nested", scene.integrator())
    camera, lens, spp = sensor.camera(), sensor.lens(), arguments.spp
    width, height = camera.film_size
    film = {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgba",
        "component_format": "float32",
    }
    sampler = {"type": "multijitter", "sample_count": spp}
    pinhole = mi.load_dict(
        {
            "type": "perspective",
            "fov": camera.x_fov,
            "to_world": mi.ScalarTransform4f(np.array(camera.to_world)),
            "near_clip": camera.near_clip,
            "far_clip": camera.far_clip,
            "principal_point_offset_x": camera.principal_point_offset[0],
            "principal_point_offset_y": camera.principal_point_offset[1],
            "film": film,
            "sampler": sampler,
        }
    )
    aov = mi.load_dict({"type": "aov", "aovs": "dd.y:depth", "nested": integrator})
    mi.render(scene, sensor=pinhole, integrator=aov, spp=spp)
    path = FOLDER / f"{name}.exr"
    pinhole.film().bitmap().write(str(path))
    halves = [
        np.array(
            mi.render(
                scene,
                sensor=thinlens_sensor(sensor, sampler="multijitter", spp=arguments.reference_spp),
                integrator=integrator,
                spp=arguments.reference_spp,
                seed=7 + seed,
            )
        )[..., :3]
        for seed in range(2)
    ]
    of_samples = {
        what: pm.render_samples(
            scene, sensor, integrator, spp=spp, sampling=pm.Sampling(refine=0, **options)
        )
        for what, options in (
            ("first", {"layers": 1, "overscan": 0, "virtual_depth": False}),
            ("all", {}),
        )
    }
    of_samples["flat"] = pm.PointSamples.from_image(
        path, camera=camera.x_fov, lens=lens, near=camera.near_clip
    )
    pictures = {what: np.array(pm.focus(of)) for what, of in of_samples.items()}
    reference = (halves[0] + halves[1]) / 2
    if arguments.images:
        for what, picture in (*pictures.items(), ("reference", reference)):
            common.write_png(FOLDER / f"{name}_{what}.png", picture)
    found = {what: srgb_psnr(picture, reference) for what, picture in pictures.items()}
    return {**found, "noise": srgb_psnr(*halves) + 10 * np.log10(4)}


if __name__ == "__main__":
    main()
