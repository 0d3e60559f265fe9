"""``potmesil stack``: pictures of the same samples at many distances, apertures, or lenses."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from .cluster import add_many, given_cluster
from .given import given_form, in_units, renamed, stated_unit, with_units
from .options import (
    OPTION_NAMES,
    add_form,
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
    shows_coverage,
    source_of,
    tell_done,
)

if TYPE_CHECKING:
    from .._cluster import Cluster
    from ..filters.base import FilterFunction
    from ..focusing.methods import Method
    from ..stacks.foci import Foci, Lens
    from ..stacks.forming import Forming
    from ..stacks.layouts import StackFiles
    from ..stacks.plan import StackItem, StackPlan

STACK_EXAMPLES = """
examples:
  potmesil render example:figure11 -D res=128 -o sharp.png --samples figure11.samples
  potmesil stack figure11.samples --near 290 --far 2000 --count 9 -o 'out/{:04d}.exr' --depth-map
  potmesil stack figure11.samples --near 290 --far 2000 --count 9 -o 'part/{:04d}.png' --shard 1/3
  potmesil stack example:figure11 -D res=64 --distances 290 inf --f-numbers 2 4 -o 'f/{:04d}.png'

--lenses lenses.csv, for example; a field that is empty is the lens's own:

  focus_distance,f_number,aperture
  0.8,2.8,disc
  inf,,polygon:blades=6

Samples are taken once. stack.json tells of all pictures, and a .json beside each of it alone: lens,
camera, circles of confusion, seeds. Pictures that are there already, of this very lens, stay.
"""

PLANES = {**OPTION_NAMES, "near": "--near-plane", "far": "--far-plane"}
"""Names of options of a picture: --near and --far are the ends of the stack here."""

MAPS = {
    "depth_map": ("depth", "depth along the axis of each pixel, once for all pictures"),
    "circle_map": (
        "circles",
        "diameter of the circle of confusion of each pixel, a map a picture",
    ),
    "normals": ("normals", "shading normal in the world of each pixel, once for all pictures"),
    "pinhole": ("pinhole", "the picture of a pinhole, all in focus, once"),
}
"""Options of the maps: what they are called in a plan, and their help."""


def stack_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil stack``; returns the examples."""
    from ..stacks.layouts import LAYOUTS

    add_scene(command, "the scene, a file of `render --samples`, or a picture with its depth")
    command.add_argument(
        "-o", "--output", metavar="PATTERN", action="append", required=True,
        help="pictures to write, such as out/{:04d}.exr (or .png, .jpg, .tif), with their number "
        "in the braces; may be given several times. With --layout fod500 how names begin, such as "
        "fod/000012",
    )  # fmt: skip
    group = command.add_argument_group("lenses of the stack")
    for name, metavar, text in (
        ("distances", "U", "focused distances in scene units; inf is allowed"),
        ("f-numbers", "N", "aperture numbers, with each of which all distances are focused on"),
    ):
        kind = length if name == "distances" else f_number
        group.add_argument(f"--{name}", type=kind, nargs="+", metavar=metavar, help=text)
    group.add_argument(
        "--near", type=length, metavar="U", dest="nearest",
        help="in place of --distances: the nearest of --count of them, at equal steps of 1/U, in "
        "which circles of confusion change evenly (with a telecentric lens, of U)",
    )  # fmt: skip
    group.add_argument(
        "--far", type=length, metavar="U", dest="farthest", help="the farthest; inf is allowed"
    )
    group.add_argument("--count", type=int, help="how many, 2 at least")
    group.add_argument(
        "--lenses", metavar="FILE", help="in place of all these a table of lenses, .csv or .toml"
    )
    for name, (_, text) in MAPS.items():
        command.add_argument(f"--{name.replace('_', '-')}", action="store_true", help=text)
    command.add_argument(
        "--layout", choices=LAYOUTS, default=LAYOUTS[0],
        help="names and forms of the files: plain (default), or fod500, that of DefocusNet's data",
    )  # fmt: skip
    add_many(command, "each picture", "pictures", "pictures")
    add_form(command)
    add_taking(command, PLANES)
    return STACK_EXAMPLES


def stack(options: argparse.Namespace) -> None:
    """``potmesil stack``: samples once, then the pictures."""
    from ..filters.base import as_filters

    report = Report(options)
    foci = _foci(options)
    files = _files(options, len(foci))
    filters = as_filters(options.filter)
    if options.scene.lower().endswith(SCENE):
        made = _of_scene(options, foci, files, filters)
    else:
        made = _of_file(options, foci, files, filters)
    report.files([*files.pictures, files.stack], f"{made} of {len(foci)} pictures were made")


def _foci(options: argparse.Namespace) -> Foci:
    """What the options say of the lenses."""
    from ..samples.files import holds_samples
    from ..stacks.foci import Foci, read_table

    unit = stated_unit(options)
    given = {name: getattr(options, name) for name in ("distances", "nearest", "farthest")}
    given = {name: value for name, value in given.items() if value is not None}
    # A scene and samples know what their unit is, and a picture of another program does not.
    knows = options.scene.lower().endswith(SCENE) or holds_samples(options.scene)
    given = with_units(given) if unit is None and knows else in_units(given, unit)
    ends = given.get("nearest"), given.get("farthest"), options.count
    table = None if options.lenses is None else read_table(options.lenses)
    with _ends_renamed():
        return Foci(given.get("distances"), *ends, options.f_numbers, table)


def _lenses_of(foci: Foci, lens: Lens, options: argparse.Namespace) -> list[Lens]:
    """All lenses of a stack, of the ``lens`` at hand."""
    from ..motion.track import named

    table = contextlib.nullcontext() if options.lenses is None else named(options.lenses)
    with table, _ends_renamed():
        return foci.lenses(lens)


@contextlib.contextmanager
def _ends_renamed() -> Iterator[None]:
    """Let errors of ``near`` and ``far`` speak of the options, which pictures have, too."""
    with renamed("near", "nearest"), renamed("far", "farthest"):
        yield


def _files(options: argparse.Namespace, count: int) -> StackFiles:
    """The files of a stack of ``count`` pictures. Raises ``ValueError`` for bad names."""
    from ..stacks.layouts import fod500_files, plain_files

    form = given_form(options)
    if options.layout == "plain":
        return plain_files(options.output, form)
    for name, value in form.items():
        raise ValueError(f"{name}={value!r}: must be left out for the layout {options.layout}")
    if len(options.output) > 1:
        raise ValueError(
            f"output={options.output[1]!r}: must be given once for the layout {options.layout}"
        )
    return fod500_files(options.output[0], count)


def asked_maps(options: argparse.Namespace) -> frozenset[str]:
    """What a plan is to have of the maps that the options ask for."""
    return frozenset(of for name, (of, _) in MAPS.items() if getattr(options, name))


def scene_told(options: argparse.Namespace) -> dict[str, Any]:
    """What says of what scene, and how, samples are taken."""
    told = source_of(options)
    spp = {"spp": options.spp} if options.spp else {}
    return {
        "source": told.pop("scene"),
        **told,
        "sensor": options.sensor,
        "seed": options.seed,
        **spp,
    }


def how_formed(
    options: argparse.Namespace, method: Method, filters: tuple[FilterFunction, ...]
) -> dict[str, Any]:
    """What says which pictures they are: where it changes they are made anew."""
    from ..filters.base import Filter

    texts = [one.describe() if isinstance(one, Filter) else repr(one) for one in filters]
    denoised = {} if options.denoise is None else {"denoise": options.denoise}
    return {"method": str(method), "filters": texts, **denoised, **given_form(options)}


def _of_scene(
    options: argparse.Namespace,
    foci: Foci,
    files: StackFiles,
    filters: tuple[FilterFunction, ...],
) -> int:
    """The stack of a scene, sampled as all of its lenses need it; how many pictures were made."""
    from ..focusing.session import FocusSession
    from ..stacks.forming import Forming

    opened = Opened.of(options, foci.first_lens())
    lens, filters = opened.sensor.lens(), filters or opened.filters
    how = {
        **scene_told(options),
        **how_formed(options, opened.method, filters),
    }
    plan = _plan(options, _lenses_of(foci, lens, options), files, how)
    items = _to_do(options, plan)
    if items is None:
        return 0
    sampling = sampling_for(lens, [item.lens for item in plan.items], opened.sampling)
    if options.normals:
        sampling = dataclasses.replace(sampling, features=True)
    with given_cluster(options, plan.files.folder) as cluster:
        session = FocusSession(opened.sampled(options, sampling), opened.method)
        forming = Forming(session, opened.film.rfilter(), opened.has_alpha, filters)
        _do(forming, plan, items, cluster)
    opened.require_kept()
    return len(items)


def _of_file(
    options: argparse.Namespace,
    foci: Foci,
    files: StackFiles,
    filters: tuple[FilterFunction, ...],
) -> int:
    """The same of samples in a file, or of a picture of another program."""
    from ..focusing.session import FocusSession
    from ..samples.provenance import file_name
    from ..stacks.forming import Forming

    method = begun_with_file(options)
    samples = samples_of_file(options.scene, options, foci)
    how = {"source": file_name(options.scene), **how_formed(options, method, filters)}
    plan = _plan(options, _lenses_of(foci, samples.lens, options), files, how)
    items = _to_do(options, plan)
    if items is None:
        return 0
    with given_cluster(options, plan.files.folder) as cluster:
        if options.denoise:
            samples = samples.denoised()
        alpha = shows_coverage(options.scene, samples)
        _do(Forming(FocusSession(samples, method), None, alpha, filters), plan, items, cluster)
    return len(items)


def _do(forming: Forming, plan: StackPlan, items: list[StackItem], cluster: Cluster | None) -> None:
    """Form and write the pictures, by a cluster if there is one."""
    from ..stacks.foci import warn_of_no_focus
    from ..stacks.workers import do_elsewhere

    warn_of_no_focus(forming.samples, [item.lens for item in plan.items])
    if cluster is None:
        forming.do(plan, items)
    else:
        do_elsewhere(cluster, forming, plan, items)


def _plan(
    options: argparse.Namespace, lenses: list[Lens], files: StackFiles, how: dict[str, Any]
) -> StackPlan:
    """The plan of the stack, all of whose files can be written."""
    from ..stacks.plan import StackPlan

    plan = StackPlan.of(lenses, files, how=how, maps=asked_maps(options))
    given = (options.scene, options.lenses, options.samples, options.depth)
    plan.check([source for source in given if source])
    return plan


def _to_do(options: argparse.Namespace, plan: StackPlan) -> list[StackItem] | None:
    """What is to be done of the plan; ``None`` where all is there."""
    from ..animation.frames import chosen_frames

    chosen = chosen_frames(range(len(plan.items)), None, options.shard)
    items = plan.to_do(chosen, options.overwrite)
    left = {item.index for item in items}
    done = [index for index in chosen if index not in left]
    if done:
        sources = [options.scene, *([options.lenses] if options.lenses else [])]
        old = plan.files.frames().older_than(done, sources)
        tell_done(Report(options), "pictures", len(done), len(chosen), old, sources)
    return items if items or plan.lacks_maps else None
