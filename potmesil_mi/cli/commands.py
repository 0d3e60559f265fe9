"""What the commands do, and which options they have."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._units import MILLIMETERS, Length
from .cluster import add_tiles, given_forming
from .given import (
    given_denoise,
    given_form,
    given_method,
    given_sampling,
    stated_unit,
    unit_of,
)
from .options import (
    add_denoise,
    add_filter,
    add_lens,
    add_maps,
    add_method,
    add_motion,
    add_output,
    add_picture,
    add_samples,
    add_sampling,
    add_scene,
    add_units,
    add_variant,
    f_number,
    length,
    millimeters,
)
from .report import Report, console
from .taking import Opened, samples_of_file, scene_with_lens, set_variant, shows_coverage

if TYPE_CHECKING:
    import mitsuba as mi
    import numpy as np

    from .._image import PictureForm
    from ..samples.maps import MapName
    from ..samples.point_samples import PointSamples

# ---------------------------------------------------------------- render

RENDER_EXAMPLES = """
examples:
  potmesil render example:figure11 -D res=128 -D focus_distance=290 -o sphere.exr -o sphere.png
  potmesil render example:figure11 -D res=128 --f-number 2.8 -o wide.png --samples wide.samples
  potmesil render example:moving -D res=128 --motion example:motions/ball -o ball.png

A potmesil sensor is rendered through its lens, a thinlens with its aperture and focus, and a
perspective, which has no lens, with the one that the options describe; the field of view stays. An
orthographic gets a telecentric lens: --half-angle and --focus-distance.
An integrator `focus` in the scene says how; any other gives the radiance.
"""


def render_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil render``; returns the examples."""
    add_output(command)
    add_maps(command)
    add_scene(command)
    add_samples(command)
    add_denoise(command, "what the scene's integrator says")
    add_sampling(command)
    add_motion(command)
    add_lens(command)
    add_method(command)
    add_tiles(command)
    add_filter(command)
    return RENDER_EXAMPLES


def render(options: argparse.Namespace) -> None:
    """``potmesil render``: a scene through the lens."""
    from ..filters.base import as_filters
    from ..focusing.aovs import focus_aovs
    from ..samples.formed import attributes_of_formed
    from ..samples.maps import maps_of

    report, form = Report(options), given_form(options)
    _check_outputs(options.output, form, options.samples, options.maps)
    filters = as_filters(options.filter)
    opened = Opened.of(options)
    with given_forming(options) as form_picture:
        samples = opened.sampled(options, opened.sampling_for(options.maps))
        maps = maps_of(samples, tuple(options.maps))
        picture = form_picture(
            samples,
            method=opened.method,
            filters=filters or opened.filters,
            rfilter=opened.film.rfilter(),
            alpha=opened.has_alpha,
        )
    if opened.focus_aovs and _has_maps(options.output):
        maps |= focus_aovs(samples, method=opened.method, rfilter=opened.film.rfilter())
    _write(picture, attributes_of_formed(samples, opened.method), options.output, maps, form)
    kept = [options.samples] if options.samples and not opened.not_kept else []
    report.written([*options.output, *kept], samples)
    opened.require_kept()


# ---------------------------------------------------------------- focus

FOCUS_EXAMPLES = """
examples:
  potmesil render example:figure11 -D res=128 -o cube.png --samples figure11.samples
  potmesil focus figure11.samples --focus-distance 980 -o far.png
  potmesil focus figure11.samples --f-number 8 --method paper --tables 99 -o sharper.exr
  potmesil focus figure11.samples --filter star:points=6 --filter fade:amount=0.3 -o star.png
  potmesil focus figure11.samples --tiles 2x2 -o tiled.png

  potmesil render example:figure10 -D res=128 --maps depth -o sharp.exr -o sharp.png
  potmesil focus sharp.exr --f-number 5.6 --focus-distance 290 -o near.png
  potmesil focus sharp.png --depth sharp.exr --depth-kind z --fov 36 --f-number 4 \\
    --focus-distance 550 --millimeters-per-unit 1 -o middle.png

A picture of another program and its depth do as well as samples; what it does not say of the camera
and the lens, options say.
"""


def focus_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil focus``; returns the examples."""
    command.add_argument(
        "samples", metavar="SAMPLES|PICTURE",
        help="file of `render --samples`, or a picture with its depth",
    )  # fmt: skip
    add_output(command)
    add_maps(command)
    add_denoise(command, "no")
    add_lens(command)
    add_method(command)
    add_tiles(command)
    add_filter(command)
    add_picture(command)
    return FOCUS_EXAMPLES


def refocus(options: argparse.Namespace) -> None:
    """``potmesil focus``: samples through another lens."""
    from concurrent.futures import ThreadPoolExecutor

    from ..filters.base import as_filters

    report, form = Report(options), given_form(options)
    _check_outputs(options.output, form, maps=options.maps)
    for source in (options.samples, options.depth):
        if source:
            _require_apart(source, options.output)
    method = given_method(options)
    filters = as_filters(options.filter)

    # The samples are read while what takes longest to import is imported. Pictures are formed
    # without a variant, too, which takes a fifth of a second to set.
    with ThreadPoolExecutor(1) as pool:
        loading = pool.submit(_loaded, options)
        if options.variant is not None:
            set_variant(options.variant)
        from ..focusing import layered  # noqa: F401
        from ..samples.formed import attributes_of_formed
        from ..samples.maps import maps_of

        samples = loading.result()
    if options.denoise:
        samples = samples.denoised()
    maps = maps_of(samples, tuple(options.maps))
    alpha = shows_coverage(options.samples, samples)
    with given_forming(options) as form_picture:
        picture = form_picture(samples, method=method, filters=filters, alpha=alpha)
    _write(picture, attributes_of_formed(samples, method), options.output, maps, form)
    report.written(options.output, samples)


def _loaded(options: argparse.Namespace) -> PointSamples:
    """The samples of a file with the lens of the options, and what methods ask of them first."""
    samples = samples_of_file(options.samples, options)
    _ = samples.spp, samples.is_crowded
    return samples


# ---------------------------------------------------------------- compare

COMPARE_EXAMPLES = """
examples:
  potmesil compare example:figure11 -D res=64 -o compared/
  potmesil compare example:figure11 -D res=48 --spp 4 --denoise --reference-floor 40 --budget 5

Writes focused, thinlens, reference and difference, each as .exr and .png; thinlens is that of about
equal error, or of equal samples where its error stays the larger; difference is that of focused and
reference, x {difference_factor:g}. Needs pip install 'potmesil_mi[compare]'.
"""


def compare_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil compare``; returns the examples."""
    from ..evaluation.comparison import BUDGET
    from ..evaluation.reference import FLOOR_MARGIN, REFERENCE_SPP
    from ..evaluation.report import DIFFERENCE_FACTOR

    command.add_argument(
        "-o", "--output", metavar="FOLDER|PREFIX",
        help="where to write the pictures: in a folder, or PREFIX-focused.exr and so on; "
        "without it only the measurements are printed",
    )  # fmt: skip
    add_variant(command)
    add_scene(command)
    command.add_argument(
        "--reference-spp", type=int, metavar="N", default=REFERENCE_SPP,
        help="most samples a pixel of the reference (default %(default)s)",
    )  # fmt: skip
    command.add_argument(
        "--reference-floor", type=float, metavar="DB",
        help="PSNR of the reference's own noise at which it is done (default: "
        f"{FLOOR_MARGIN:g} dB above the focused picture's)",
    )  # fmt: skip
    command.add_argument(
        "--budget", type=float, metavar="SECONDS", default=BUDGET,
        help="for all that thinlens renders, about (default %(default)g)",
    )  # fmt: skip
    add_denoise(command, "what the scene's integrator says")
    add_sampling(command)
    add_lens(command)
    add_method(command)
    return COMPARE_EXAMPLES.format(difference_factor=DIFFERENCE_FACTOR)


def against_thinlens(options: argparse.Namespace) -> None:
    """``potmesil compare``: the focused picture beside a ray-traced one."""
    from ..evaluation.comparison import compare
    from ..evaluation.metrics import require_extra
    from ..evaluation.report import output_paths
    from ..plugins.settings import FocusSettings

    require_extra()
    if options.output:
        output_paths(options.output)
    method = given_method(options)
    scene, sensor = scene_with_lens(options)
    integrator = scene.integrator()
    if isinstance(integrator, FocusSettings):
        method = given_method(options, integrator.method)
    comparison = compare(
        scene,
        sensor,
        spp=options.spp,
        seed=options.seed,
        sampling=given_sampling(options, integrator, unit_of(sensor)),
        reference_spp=options.reference_spp,
        reference_floor=options.reference_floor,
        budget=options.budget,
        denoise=given_denoise(options, integrator),
        method=method,
    )
    written = list(comparison.write(options.output)) if options.output else []
    if options.json:
        numbers = {**comparison.numbers(), "written": list(map(str, written))}
        Report(options).values(numbers)
        return
    printer = console()
    printer.print(comparison.table())
    printer.print(comparison.summary())
    for path in written:
        print(path)


# ---------------------------------------------------------------- dof

DOF_EXAMPLES = """
examples:
  potmesil dof                      # Table 1 of the paper
  potmesil dof --focal-length 50 --f-number 1.8 --focus-distance 1000 2000 inf
"""


def dof_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil dof``; returns the examples."""
    command.add_argument(
        "--focal-length", type=millimeters, default=55.0, help="in mm, or with a unit (default 55)"
    )
    command.add_argument(
        "--f-number", type=f_number, nargs="+", default=[5.6, 11, 22], metavar="N",
        help="aperture numbers (default 5.6 11 22)",
    )  # fmt: skip
    command.add_argument(
        "--focus-distance", type=length, nargs="+", metavar="U",
        default=[Length(mm, None) for mm in (2000, 980, 550, 290)],
        help="focused distances in scene units, or with a unit, 1.2m; inf is allowed (default 2000 "
        "980 550 290)",
    )  # fmt: skip
    command.add_argument(
        "--millimeters-per-unit", type=float, metavar="S", help="size of a scene unit (default 1)"
    )
    add_units(command)
    return DOF_EXAMPLES


def dof(options: argparse.Namespace) -> None:
    """``potmesil dof``: a table of depths of field."""
    from ..optics.lens import ThinLens

    rows = []
    stated = stated_unit(options)
    unit = 1.0 if stated is None else stated
    for number in options.f_number:
        for distance in options.focus_distance:
            lens = ThinLens(
                options.focal_length,
                number,
                distance.in_units(unit),
                millimeters_per_unit=unit,
            )
            near, far = lens.depth_of_field()
            rows.append(
                {
                    "f_number": number,
                    "focus_distance": lens.focus_distance,
                    "far": far,
                    "near": near,
                    "depth_of_field": far - near,
                    "lens_diameter_mm": lens.lens_diameter,
                }
            )
    if options.json:
        Report(options).values({"focal_length": options.focal_length, "rows": rows})
    else:
        _print_depths(options.focal_length, unit, rows)


def _print_depths(focal_length: float, size: float, rows: Sequence[Mapping[str, float]]) -> None:
    """Print depths of field as a table, as the paper's is."""
    from rich.box import SIMPLE
    from rich.table import Table

    names = {millimeters: name for name, millimeters in MILLIMETERS.items()}
    unit = names.get(size, "units")
    digits = 0 if unit == "mm" else 3
    table = Table(box=SIMPLE, title=f"Depth of field of a {focal_length:g} mm lens")
    for heading in ("Aperture", "Focused distance", "U+", "U-", "Depth of field"):
        table.add_column(heading if heading == "Aperture" else f"{heading}\n({unit})")
        table.columns[-1].justify = "right"
    for row in rows:
        near, far = (
            round(limit, digits) if math.isfinite(limit) else limit
            for limit in (row["near"], row["far"])
        )
        table.add_row(
            f"f/{row['f_number']:g}",
            f"{row['focus_distance']:g}",
            *(f"{value:.{digits}f}" for value in (far, near, far - near)),
        )
    printer = console()
    printer.print(table)
    diameters = {row["f_number"]: row["lens_diameter_mm"] for row in rows}
    texts = (f"{diameter:.2f} mm at f/{number:g}" for number, diameter in diameters.items())
    printer.print(f"Lens diameter is {', '.join(texts)}")


# ---------------------------------------------------------------- output


def _check_outputs(
    pictures: Sequence[str],
    form: PictureForm,
    samples: str | None = None,
    maps: Sequence[MapName] = (),
) -> None:
    """Find out before a long rendering that its result cannot be written."""
    from .._files import require_each_once, require_writable
    from .._image import PICTURES, require_format

    if maps and not _has_maps(pictures):
        raise ValueError(f"maps={' '.join(maps)}: only an EXR has them; name one with -o")

    require_each_once(pictures)
    for path in pictures:
        require_writable(path, PICTURES)
    require_format(pictures, **form)
    if samples:
        from ..samples.files import ENDINGS

        require_writable(samples, ENDINGS)
        _require_apart(samples, pictures)


def _has_maps(pictures: Sequence[str]) -> bool:
    """Whether any of the files has room for further channels."""
    return any(path.lower().endswith(".exr") for path in pictures)


def _require_apart(source: str, pictures: Sequence[str]) -> None:
    if Path(source).resolve() in {Path(path).resolve() for path in pictures}:
        raise ValueError(f"{source}: the picture must not take the place of what it is made of")


def _write(
    picture: mi.TensorXf,
    said: Mapping[str, Any],
    paths: Sequence[str],
    maps: Mapping[str, np.ndarray],
    form: PictureForm,
) -> None:
    """Write a picture in a ``form``, with what is ``said`` of it, and with maps beside it."""
    from .._image import write_picture

    for path in paths:
        write_picture(picture, path, said, maps, **form)
