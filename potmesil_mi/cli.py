"""The command line: ``potmesil render``, ``focus``, ``compare`` and ``dof``."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
import warnings
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mitsuba as mi

from ._image import PICTURES, require_writable, write_picture
from .evaluation.compare import (
    DIFFERENCE_FACTOR,
    FLOOR_MARGIN,
    REFERENCE_SPP,
    compare,
    output_paths,
)
from .evaluation.metrics import require_extra
from .filters.filters import FILTERS, as_filters
from .focusing.api import METHODS, OPTIONS, check_options, film_options, focus
from .optics.lens import FILMS, ThinLens
from .samples.point_samples import PointSamples
from .tracing.hidden_surface import render_samples
from .tracing.sampling import PATTERNS, Sampling
from .tracing.sensor import has_lens, pick_sensor, potmesil_sensor

VARIANTS = ("cuda_ad_rgb", "llvm_ad_rgb")

RENDER_EXAMPLES = """
examples:
  potmesil render scenes/figure11.xml -o figure11c.png
  potmesil render scenes/figure11.xml -D focus_distance=290 -o figure11d.exr -o figure11d.png
  potmesil render kitchen.xml --f-number 2 --focus-distance 1.2 -o kitchen.png --samples kitchen.exr

A potmesil sensor is rendered through its lens, a thinlens with its aperture and focus, and a
perspective, which has no lens, with the one that the options describe; the field of view stays.
An integrator `focus` in the scene says how; any other gives the radiance.
"""

FOCUS_EXAMPLES = """
examples:
  potmesil focus kitchen.exr --focus-distance 3.5 -o far.png
  potmesil focus kitchen.exr --f-number 8 --method paper --tables 200 -o sharper.exr
  potmesil focus kitchen.exr --filter star:points=6 --filter fade:amount=0.3 -o star.png
"""

COMPARE_EXAMPLES = f"""
examples:
  potmesil compare scenes/figure11.xml -D res=256 -o figure11
  potmesil compare scenes/terrace.xml -D width=384 -D height=256 --spp 64 -o output/
  potmesil compare kitchen.xml --f-number 2 --focus-distance 1.2 --reference-floor 55

Writes focused, thinlens, reference and difference, each as .exr and .png; thinlens is that of about
equal error, or of equal samples where its error stays the larger; difference is that of focused and
reference, x {DIFFERENCE_FACTOR:g}. Needs pip install 'potmesil_mi[compare]'.
"""

DOF_EXAMPLES = """
examples:
  potmesil dof                      Table 1 of the paper
  potmesil dof --focal-length 50 --f-number 1.8 --focus-distance 1000 2000 inf
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0, 1 for an error, 130 for Ctrl-C.

    Wrong usage ends in ``SystemExit(2)``.
    """
    options = _parser().parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            options.command(options)
    except KeyboardInterrupt:
        print("potmesil: interrupted", file=sys.stderr)
        return 130
    except (ValueError, TypeError, OSError, RuntimeError, ImportError) as error:
        print(f"potmesil: error: {error}", file=sys.stderr)
        return 1
    return 0


def render(options: argparse.Namespace) -> None:
    """``potmesil render``: a scene through the lens."""
    _check_outputs(options.output, options.samples)
    check_options(**_focus_options(options))
    filters = as_filters(options.filter)
    scene, sensor = _scene_with_lens(options)
    integrator = scene.integrator()
    samples = render_samples(
        scene,
        sensor,
        integrator,
        spp=options.spp,
        seed=options.seed,
        sampling=_sampling(options, integrator),
    )
    if options.samples:
        samples.save(options.samples)
    picture = focus(
        samples,
        filters=filters or getattr(integrator, "filters", ()),
        **film_options(sensor.film()),
        **{**getattr(integrator, "options", {}), **_focus_options(options)},
    )
    _write(picture, options.output)


def refocus(options: argparse.Namespace) -> None:
    """``potmesil focus``: samples through another lens."""
    _check_outputs(options.output)
    _require_apart(options.samples, options.output)
    check_options(**_focus_options(options))
    filters = as_filters(options.filter)
    _set_variant(options.variant)
    samples = PointSamples.load(options.samples)
    lens = samples.lens.replace(**_lens_options(options))
    picture = focus(samples, lens, filters=filters, **_focus_options(options))
    _write(picture, options.output)


def against_thinlens(options: argparse.Namespace) -> None:
    """``potmesil compare``: the focused picture beside a ray-traced one."""
    require_extra()
    if options.output:
        output_paths(options.output)
    check_options(**_focus_options(options))
    scene, sensor = _scene_with_lens(options)
    comparison = compare(
        scene,
        sensor,
        spp=options.spp,
        seed=options.seed,
        sampling=_sampling(options, scene.integrator()),
        reference_spp=options.reference_spp,
        reference_floor=options.reference_floor,
        **{**getattr(scene.integrator(), "options", {}), **_focus_options(options)},
    )
    console = _console()
    console.print(comparison.table())
    console.print(comparison.summary())
    for path in comparison.write(options.output) if options.output else ():
        print(path)


def dof(options: argparse.Namespace) -> None:
    """``potmesil dof``: a table of depths of field."""
    from rich.box import SIMPLE
    from rich.table import Table

    unit = "mm" if options.millimeters_per_unit == 1 else "units"
    digits = 0 if unit == "mm" else 3
    table = Table(box=SIMPLE, title=f"Depth of field of a {options.focal_length:g} mm lens")
    for heading in ("Aperture", "Focused distance", "U+", "U-", "Depth of field"):
        table.add_column(heading if heading == "Aperture" else f"{heading}\n({unit})")
        table.columns[-1].justify = "right"
    diameters = []
    for f_number in options.f_number:
        for distance in options.focus_distance:
            lens = ThinLens(
                options.focal_length,
                f_number,
                distance,
                millimeters_per_unit=options.millimeters_per_unit,
            )
            near, far = (round(limit, digits) if math.isfinite(limit) else limit
                         for limit in lens.depth_of_field())  # fmt: skip
            table.add_row(
                f"f/{f_number:g}",
                f"{distance:g}",
                *(f"{value:.{digits}f}" for value in (far, near, far - near)),
            )
        diameters.append(f"{lens.lens_diameter:.2f} mm at f/{f_number:g}")
    console = _console()
    console.print(table)
    console.print(f"Lens diameter is {', '.join(diameters)}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="potmesil",
        description="Lens and aperture camera of Potmesil & Chakravarty (1981) for Mitsuba 3.",
    )
    parser.add_argument("--version", action="version", version=version("potmesil_mi"))
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    command = _command(
        commands, "render", "render a Mitsuba scene through the lens", RENDER_EXAMPLES, render
    )
    _add_output(command)
    _add_scene(command)
    command.add_argument(
        "--samples", metavar="FILE.exr", help="keep the point samples in a deep EXR"
    )
    _add_sampling(command)
    _add_lens(command)
    _add_method(command)
    _add_filter(command)

    command = _command(
        commands, "focus", "form a picture from point samples", FOCUS_EXAMPLES, refocus
    )
    command.add_argument("samples", metavar="SAMPLES.exr", help="deep EXR of `render --samples`")
    _add_output(command)
    _add_lens(command)
    _add_method(command)
    _add_filter(command)

    command = _command(
        commands,
        "compare",
        "compare a focused picture with a ray-traced one: error and time",
        COMPARE_EXAMPLES,
        against_thinlens,
    )
    command.add_argument(
        "-o", "--output", metavar="FOLDER|PREFIX",
        help="where to write the pictures: in a folder, or PREFIX-focused.exr and so on; "
        "without it only the measurements are printed",
    )  # fmt: skip
    _add_variant(command)
    _add_scene(command)
    command.add_argument(
        "--reference-spp", type=int, metavar="N", default=REFERENCE_SPP,
        help="most samples a pixel of the reference (default %(default)s)",
    )  # fmt: skip
    command.add_argument(
        "--reference-floor", type=float, metavar="DB",
        help="PSNR of the reference's own noise at which it is done (default: "
        f"{FLOOR_MARGIN:g} dB above the focused picture's)",
    )  # fmt: skip
    _add_sampling(command)
    _add_lens(command)
    _add_method(command)

    command = _command(
        commands, "dof", "print depths of field; by default the paper's Table 1", DOF_EXAMPLES, dof
    )
    command.add_argument("--focal-length", type=float, default=55.0, help="in mm (default 55)")
    command.add_argument(
        "--f-number", type=float, nargs="+", default=[5.6, 11, 22], metavar="N",
        help="aperture numbers (default 5.6 11 22)",
    )  # fmt: skip
    command.add_argument(
        "--focus-distance", type=float, nargs="+", default=[2000, 980, 550, 290], metavar="U",
        help="focused distances in scene units; inf is allowed (default 2000 980 550 290)",
    )  # fmt: skip
    command.add_argument(
        "--millimeters-per-unit", type=float, default=1.0, help="size of a scene unit (default 1)"
    )
    return parser


def _command(commands: Any, name: str, summary: str, examples: str, run: Any) -> Any:
    command = commands.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}.",
        epilog=examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.set_defaults(command=run)
    return command


def _add_scene(command: argparse.ArgumentParser) -> None:
    command.add_argument("scene", metavar="SCENE.xml", help="the scene")
    command.add_argument(
        "-D", "--define", metavar="KEY=VALUE", action="append", default=[], type=_definition,
        help="value of a $KEY in the scene; may be given several times",
    )  # fmt: skip
    command.add_argument("--sensor", type=int, default=0, help="number of the sensor (default 0)")
    command.add_argument(
        "--spp", type=int, default=0, help="samples a pixel (default: the sampler's count)"
    )
    command.add_argument("--seed", type=int, default=0, help="of the random numbers (default 0)")


def _add_output(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "-o", "--output", metavar="FILE", action="append", required=True,
        help="picture to write, linear float .exr or sRGB .png, .jpg; may be given several times",
    )  # fmt: skip
    _add_variant(command)


def _add_variant(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "-m", "--variant", default=",".join(VARIANTS),
        help="Mitsuba variants, of which the first that works is taken (default %(default)s)",
    )  # fmt: skip


def _add_sampling(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("sampling", "default: what the scene's integrator says")
    group.add_argument("--pattern", choices=PATTERNS, help="where the image is sampled")
    group.add_argument(
        "--threshold", type=float, help="adaptive: intensity difference that is subdivided"
    )
    group.add_argument("--subdivisions", type=int, help="adaptive: most subdivisions, 0 to 8")
    group.add_argument(
        "--layers", type=int, help="surfaces along a ray, for what near edges uncover (default 2)"
    )
    group.add_argument(
        "--overscan", type=int, metavar="PIXELS",
        help="beyond each side (default: as far as circles of confusion reach)",
    )  # fmt: skip
    group.add_argument(
        "--min-f-number", type=float, metavar="N",
        help="widest aperture that the samples must serve (default: the lens's)",
    )  # fmt: skip
    group.add_argument(
        "--virtual-depth", action=argparse.BooleanOptionalAction,
        help="what is seen in mirrors has the depth of its image (default: yes)",
    )  # fmt: skip


def _add_lens(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("lens", "default: what the scene or the samples say")
    group.add_argument("--f-number", type=float, metavar="N", help="aperture number F/D")
    group.add_argument(
        "--aperture-radius", type=float, metavar="R", help="in scene units, in place of --f-number"
    )
    group.add_argument(
        "--focus-distance", type=float, metavar="U", help="in scene units along the axis, or inf"
    )
    group.add_argument("--focal-length", type=float, metavar="F", help="in mm")
    group.add_argument("--frame-width", type=float, metavar="W", help="width of the film in mm")
    group.add_argument(
        "--millimeters-per-unit", type=float, metavar="S", help="size of a scene unit in mm"
    )
    group.add_argument("--film", choices=FILMS, help="film at F, or at the focused image")
    group.add_argument(
        "--aperture", metavar="SHAPE",
        help="disc, polygon:blades=6,rotation=15,curvature=0.2, image:filename=heart.png, or "
        "lommel:wavelengths=610/550/465",
    )  # fmt: skip
    group.add_argument(
        "--squeeze", type=float, metavar="RATIO", help="anamorphic: height of highlights to width"
    )
    group.add_argument(
        "--vignetting", type=float, metavar="SHARE", help="of the lens's rim, in the corners"
    )


def _add_method(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("focus stage")
    group.add_argument(
        "--method", choices=METHODS,
        help="layered: what is visible (default); lightfield: the same, finer; paper: equation 20",
    )  # fmt: skip
    group.add_argument(
        "--lens-points", type=int,
        help="points of the lens from which visibility is found (layered 32, lightfield 128)",
    )  # fmt: skip
    group.add_argument("--tables", type=int, help="paper: number of depth tables (default 73)")
    group.add_argument(
        "--inverse-square", action=argparse.BooleanOptionalAction,
        help="paper: weight samples by 1/z^2 (default: yes)",
    )  # fmt: skip
    group.add_argument(
        "--squares", type=int, help="squares on a side of a pixel (layered 1, others 2)"
    )


def _add_filter(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("special effects")
    group.add_argument(
        "--filter", metavar="NAME:PARAMETER=VALUE,...", action="append", default=[],
        help=f"{', '.join(FILTERS)}, such as star:points=6,length=0.1,threshold=2; may be given "
        "several times, in order, and takes the place of the scene's",
    )  # fmt: skip


def _scene_with_lens(options: argparse.Namespace) -> tuple[mi.Scene, mi.Sensor]:
    """The scene, and its sensor with the lens of the options."""
    _set_variant(options.variant)
    # Optimised loading merges meshes of one material, and with them their ids and names.
    scene = mi.load_file(options.scene, optimize=False, **dict(options.define))
    if scene.integrator() is None:
        raise ValueError(f"{options.scene}: has no integrator")
    sensor = pick_sensor(scene, options.sensor)
    lens = _lens_options(options)
    if not has_lens(sensor) and lens.keys().isdisjoint({"f_number", "aperture_radius"}):
        raise ValueError(
            f"{options.scene}: its sensor has no lens; describe one with --f-number (or "
            "--aperture-radius) and --focus-distance"
        )
    return scene, potmesil_sensor(sensor, **lens)


def _lens_options(options: argparse.Namespace) -> dict[str, Any]:
    names = (
        "f_number",
        "aperture_radius",
        "focus_distance",
        "focal_length",
        "frame_width",
        "millimeters_per_unit",
        "film",
        "aperture",
        "squeeze",
        "vignetting",
    )
    return _given(options, names)


def _sampling(options: argparse.Namespace, integrator: mi.Integrator) -> Sampling:
    names = [field.name for field in dataclasses.fields(Sampling)]
    sampling = getattr(integrator, "sampling", Sampling())
    return dataclasses.replace(sampling, **_given(options, names))


def _focus_options(options: argparse.Namespace) -> dict[str, Any]:
    return _given(options, OPTIONS)


def _given(options: argparse.Namespace, names: Sequence[str]) -> dict[str, Any]:
    values = {name: getattr(options, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def _definition(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        raise argparse.ArgumentTypeError(f"{text!r}: must be KEY=VALUE")
    return key, value


def _check_outputs(pictures: Sequence[str], samples: str | None = None) -> None:
    """Find out before a long rendering that its result cannot be written."""
    for path in pictures:
        require_writable(path, PICTURES)
    if samples:
        require_writable(samples, [".exr"])
        _require_apart(samples, pictures)


def _require_apart(samples: str, pictures: Sequence[str]) -> None:
    if Path(samples).resolve() in {Path(path).resolve() for path in pictures}:
        raise ValueError(f"{samples}: the picture must not take the place of its samples")


def _set_variant(names: str) -> None:
    mi.set_variant(*names.split(","))


def _write(picture: mi.TensorXf, paths: Sequence[str]) -> None:
    for path in paths:
        write_picture(picture, path)


def _console() -> Any:
    from rich.console import Console

    return Console(highlight=False, width=None if sys.stdout.isatty() else 100)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"potmesil: warning: {message}", file=sys.stderr)
