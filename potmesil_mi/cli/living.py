"""``potmesil living``: a page of HTML with a picture that whoever opens it refocuses."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .._memory import size_in_bytes
from .given import in_units, stated_unit
from .options import (
    OPTION_NAMES,
    add_scene,
    add_taking,
    f_number,
    length,
)
from .report import Report
from .taking import (
    SCENE,
    Opened,
    begun_with_file,
    samples_of_file,
    sampling_for,
)

if TYPE_CHECKING:
    from ..living.picture import LivingPicture
    from ..samples.point_samples import PointSamples
    from ..stacks.foci import Foci

LIVING_EXAMPLES = """
examples:
  potmesil render example:figure11 -D res=128 -o sharp.png --samples figure11.samples
  potmesil living figure11.samples --title 'Figure 11' -o figure11.html
  potmesil living example:lamps -D res=96 -D spp=4 --f-numbers 8 16 -o lamps.html
  potmesil living figure11.html lamps.html -o both.html

Open the page in any browser, also without a network: click or drag to focus, arrow keys, and a
slider or the wheel for the aperture. Between the pictures that it keeps it shows blends, and the
command says how near they come to what `potmesil focus` forms: PSNR in dB, of 8 bits in sRGB.
"""

ENDS = {**OPTION_NAMES, "near": "--near-plane", "far": "--far-plane"}
"""Names of options of a picture: --near and --far are the ends of the focus here."""


def living_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil living``; returns the examples."""
    from ..living.api import MAX_BYTES, PSNR

    add_scene(
        command, "the scene, a file of `render --samples`, a picture with its depth, or a page"
    )
    command.add_argument(
        "more", metavar="PAGE.html", nargs="*", help="further pages, which are put into one"
    )
    command.add_argument(
        "-o", "--output", metavar="FILE", required=True, help="page to write, .html"
    )
    command.add_argument("--title", default="", help="what the picture, or the page, is called")
    command.add_argument(
        "--f-numbers", type=f_number, nargs="+", metavar="N",
        help="apertures to choose from (default: the lens's own, and full stops beyond it)",
    )  # fmt: skip
    command.add_argument(
        "--near", type=length, metavar="U", dest="nearest",
        help="nearest focus (default: of what is in sight)",
    )  # fmt: skip
    command.add_argument(
        "--far", type=length, metavar="U", dest="farthest", help="farthest focus; inf is allowed"
    )
    command.add_argument(
        "--psnr", type=float, metavar="DB",
        help=f"what is aimed at, at the worst focus (default {PSNR:g})",
    )  # fmt: skip
    command.add_argument(
        "--max-bytes", metavar="SIZE",
        help=f"largest page, such as 2M (default {MAX_BYTES / 1e6:g} MB)",
    )  # fmt: skip
    add_taking(command, ENDS)
    return LIVING_EXAMPLES


def living(options: argparse.Namespace) -> None:
    """``potmesil living``: samples once, then the pictures that the page keeps."""
    from .._files import require_writable
    from ..living.page import HTML

    require_writable(options.output, HTML)
    report = Report(options)
    if options.scene.lower().endswith(HTML):
        _of_pages(options, report)
        return
    if options.more:
        raise ValueError(
            f"more={options.more[0]}: must be left out, for {options.scene} is no page"
        )
    made = _of_scene(options) if options.scene.lower().endswith(SCENE) else _of_file(options)
    kept = sum(len(level.places) for level in made.levels)
    apertures = ", ".join(f"f/{level.f_number:g}" for level in made.levels)
    report.files(
        [options.output],
        f"{kept} pictures at {apertures}; {made.worst:.1f} dB at the worst of {made.measured} "
        f"pairs of focus and aperture, {made.median:.1f} dB at the median",
    )


def _of_pages(options: argparse.Namespace, report: Report) -> None:
    """One page of several."""
    from ..living.api import living_page

    pictures = living_page([options.scene, *options.more], options.output, title=options.title)
    count = "1 picture" if len(pictures) == 1 else f"{len(pictures)} pictures"
    report.files([options.output], count)


def _of_scene(options: argparse.Namespace) -> LivingPicture:
    """That of a scene, sampled for the widest aperture and any focus."""
    foci = _apertures(options)
    opened = Opened.of(options, foci.first_lens() if foci else None)
    lens, sampling = opened.sensor.lens(), opened.sampling
    if foci:
        widest = sampling_for(lens, foci.lenses(lens), sampling).min_f_number
        sampling = dataclasses.replace(sampling, min_f_number=widest)
    samples = opened.sampled(options, sampling)
    how = {"method": opened.method, "rfilter": opened.film.rfilter()}
    made = _written(options, samples, {**how, "filters": options.filter or opened.filters})
    opened.require_kept()
    return made


def _of_file(options: argparse.Namespace) -> LivingPicture:
    """The same of samples in a file, or of a picture of another program."""
    method = begun_with_file(options)
    samples = samples_of_file(options.scene, options, _apertures(options))
    if options.denoise:
        samples = samples.denoised()
    return _written(options, samples, {"method": method, "filters": options.filter})


def _apertures(options: argparse.Namespace) -> Foci | None:
    """The apertures that are asked for, the widest first."""
    from ..stacks.foci import Foci

    return Foci(f_numbers=sorted(options.f_numbers)) if options.f_numbers else None


def _written(
    options: argparse.Namespace, samples: PointSamples, how: dict[str, Any]
) -> LivingPicture:
    from ..living.api import living_picture

    ends = {"near": options.nearest, "far": options.farthest}
    given = {name: value for name, value in ends.items() if value is not None}
    unit = stated_unit(options) or getattr(samples.lens, "millimeters_per_unit", None)
    found = {**how, **in_units(given, unit)}
    if options.psnr is not None:
        found["psnr"] = options.psnr
    if options.max_bytes is not None:
        found["max_bytes"] = size_in_bytes("max_bytes", options.max_bytes)
    f_numbers: Sequence[float] | None = options.f_numbers
    return living_picture(
        samples, options.output, f_numbers=f_numbers, title=options.title, **found
    )
