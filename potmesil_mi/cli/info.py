"""``potmesil info``: what there is to focus on, and what a lens makes of it."""

from __future__ import annotations

import argparse
import functools
from typing import TYPE_CHECKING, Any

from .._units import said_length
from .options import add_lens, add_picture, add_scene, add_variant
from .report import Report, about_picture, console
from .taking import SCENE, probed, samples_of_file, scene_with_lens

if TYPE_CHECKING:
    import mitsuba as mi

    from ..samples.point_samples import PointSamples

INFO_EXAMPLES = """
examples:
  potmesil info example:figure11
  potmesil info example:figure11 -D res=128 --f-number 2.8 --focus-on center --map circles.png
  potmesil render example:figure11 -D res=64 -o sharp.png --samples figure11.samples
  potmesil info figure11.samples --focus-at 50%,40% --json

Of a scene a few samples a pixel are taken. The map shows in colour what is blurred: orange what is
nearer than the focus, blue what is beyond, grey what is sharp; an .exr has the diameters in pixels.
"""

MOST_SURFACES = 40
"""Surfaces that are listed, those of the largest area first."""


def info_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil info``; returns the examples."""
    add_scene(command, "the scene, a file of `render --samples`, or a picture with its depth")
    command.add_argument(
        "--map", metavar="FILE", help="picture to write, .png, .jpg or .exr, of the circle of "
        "confusion of each pixel",
    )  # fmt: skip
    add_variant(command)
    add_lens(command)
    add_picture(command)
    return INFO_EXAMPLES


def info(options: argparse.Namespace) -> None:
    """``potmesil info``: what is seen, how far away it is, and how a lens blurs it."""
    from .._files import require_writable
    from .._image import PICTURES, write_picture
    from ..samples.circles import circle_colors
    from ..samples.maps import circle_map

    if options.map is not None:
        require_writable(options.map, PICTURES)
    if options.scene.lower().endswith(SCENE):
        scene, sensor = scene_with_lens(options, pinholes=True)
        samples = probed(scene, sensor, options.spp)
        found = {**about(samples), "sampling_bytes": _memory_of_sampling(scene, sensor, samples)}
    else:
        samples = samples_of_file(options.scene, options)
        found = {**about(samples), **_about_samples(samples)}
    if options.json:
        Report(options).values(found)
    else:
        _print(options.scene, found)
    if options.map is not None:
        circles = circle_map(samples)
        if options.map.lower().endswith(".exr"):
            write_picture(circle_colors(circles), options.map, maps={"coc": circles})
        else:
            write_picture(circle_colors(circles), options.map)
        Report(options).line(f"wrote {options.map}")


def about(samples: PointSamples) -> dict[str, Any]:
    """What there is to tell of what samples see, lengths in scene units, as JSON has it."""
    from ..focusing.memory import memory_of_focus
    from ..focusing.methods import Layered
    from ..samples.circles import surface_depths
    from ..samples.depth_range import DepthRange

    camera, depths = samples.camera, DepthRange.of(samples)
    found: dict[str, Any] = {
        "width": camera.crop_size[0],
        "height": camera.crop_size[1],
        "projection": camera.projection,
        "nearest": depths.nearest,
        "farthest": depths.farthest,
        "has_sky": depths.has_sky,
        **about_picture(samples, samples.lens),
        "lens": samples.lens.to_dict(),
        "focus_bytes": round(memory_of_focus(samples, Layered())),
    }
    if camera.projection == "perspective":
        found["x_fov"] = camera.x_fov
    found["surfaces"] = [one._asdict() for one in surface_depths(samples)]
    return found


def _about_samples(samples: PointSamples) -> dict[str, Any]:
    """What there is to tell of samples in a file, beside what they see."""
    found = {"samples": len(samples), "spp": samples.spp, "bytes": samples.nbytes}
    widest, lens = dict(samples.provenance), samples.lens.to_dict()
    if "widest_diameter" in widest and float(widest["widest_diameter"]) > 0:
        diameter = float(widest["widest_diameter"]) * lens["millimeters_per_unit"]
        found["min_f_number"] = lens["focal_length"] / diameter
    return {**found, "provenance": widest}


def _memory_of_sampling(scene: mi.Scene, sensor: mi.Sensor, samples: PointSamples) -> int:
    """Bytes that sampling takes, as often as the scene says, without what is around the film."""
    from ..tracing.memory import memory_of_sampling
    from ..tracing.onward import has_specular
    from ..tracing.sampling import Sampling

    sampling = getattr(scene.integrator(), "sampling", Sampling())
    crop, spp = samples.crop_window, int(sensor.sampler().sample_count())
    return round(memory_of_sampling(crop, crop, spp, sampling, has_specular(scene)))


def _print(source: str, found: dict[str, Any]) -> None:
    """Print it for people."""
    from rich.box import SIMPLE
    from rich.table import Table

    unit = found.get("millimeters_per_unit")
    length = functools.partial(said_length, unit=unit)

    facts = {"picture": f"{found['width']}x{found['height']} pixels, {found['projection']}"}
    if "x_fov" in found:
        facts["picture"] += f", {found['x_fov']:.4g} degrees across"
    if "samples" in found:
        facts["samples"] = (
            f"{found['samples']:,}, {found['spp']} a pixel, {found['bytes'] / 1e6:,.0f} MB"
        )
    sky = ", and the sky" if found["has_sky"] else ""
    if unit is not None:
        facts["unit"] = f"a scene unit is {unit:g} mm (--units says otherwise)"
    facts["depth"] = f"{length(found['nearest'])} to {length(found['farthest'])}{sky}"
    facts["lens"] = _lens(found)
    if found["largest_circle_pixels"] > 0:
        facts["lens"] += f", focused at {length(found['focus_distance'])}"
    facts["sharp"] = f"{length(found['sharp_from'])} to {length(found['sharp_to'])} (to a pixel)"
    facts["circles"] = f"up to {found['largest_circle_pixels']:.3g} pixels in diameter"
    if "min_f_number" in found:
        facts["serves"] = f"apertures up to f/{found['min_f_number']:.3g}"
    sampling = found.get("sampling_bytes")
    takes = "" if sampling is None else f"sampling {sampling / 1e9:.2f} GB or more, "
    facts["memory"] = f"{takes}a focus {found['focus_bytes'] / 1e9:.2f} GB, about"
    printer = console()
    printer.print(f"{source}")
    for name, text in facts.items():
        printer.print(f"  {name:<9}{text}", soft_wrap=True)
    table = Table(box=SIMPLE)
    for name in ("surface", "of the picture", "nearest", "median", "farthest", "circle (pixels)"):
        table.add_column(name, justify="left" if name == "surface" else "right")
    surfaces = found["surfaces"]
    for one in surfaces[:MOST_SURFACES]:
        depths = (length(one[name]) for name in ("nearest", "median", "farthest"))
        circle = f"{one['circle'] + 0.0:.3g}"  # no -0
        table.add_row(one["name"], f"{100 * one['share']:.1f} %", *depths, circle)
    printer.print(table)
    if len(surfaces) > MOST_SURFACES:
        printer.print(f"and {len(surfaces) - MOST_SURFACES} more, which --json has")


def _lens(found: dict[str, Any]) -> str:
    lens = found["lens"]
    if "half_angle" in found:
        return f"telecentric, {found['half_angle']:g} degrees"
    if found["aperture_radius"] == 0:
        return "a pinhole"
    return f"{lens['focal_length']:.4g} mm, f/{found['f_number']:.3g}"
