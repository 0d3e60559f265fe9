"""``potmesil dataset``: stacks of scenes, cameras, lenses, apertures and foci, by a recipe."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._units import length_of
from .cluster import add_many, given_cluster
from .given import range_of, unit_of
from .options import (
    LENS_OPTIONS,
    SAMPLING_OPTIONS,
    FileAction,
    add_denoise,
    add_method,
    add_variant,
)
from .report import Report
from .stack import how_formed, scene_told
from .taking import Opened, sampling_for, tell_done

if TYPE_CHECKING:
    from .._cluster import Cluster
    from ..motion.motion import Motion
    from ..stacks.forming import Failed, Forming
    from ..stacks.layouts import StackFiles
    from ..stacks.plan import StackPlan
    from ..stacks.recipe import Recipe, StackDraw, View
    from ..tracing.sensor import LensSensor

INDEX = "dataset.json"
"""The file that tells of all stacks."""

DATASET_EXAMPLES = """
examples:
  potmesil dataset example:recipes/figure11 -o data/
  potmesil dataset example:recipes/figure11 -o parts/ --shard 1/2

A recipe, for example:

  seed = 7
  [[scenes]]
  path = "kitchen.xml"
  [sampling]
  spp = 64
  [cameras]
  count = 4
  pan = { uniform = [-5, 5] }
  [apertures]
  count = 2
  f_number = { log_uniform = [1.4, 16] }
  [foci]
  count = 5
  distance = { reciprocal_uniform = [0.5, 10] }

Samples of a scene are taken once for each camera. What is there already stays. What cannot be made
is told at the end, and the rest is made. docs/howto/stacks.md has all that a recipe may say.
"""


def dataset_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil dataset``; returns the examples."""
    command.add_argument(
        "recipe", metavar="RECIPE.toml", action=FileAction, help="what there is to be, see below"
    )
    command.add_argument(
        "-o", "--output", metavar="FOLDER", required=True, help="where it is written"
    )
    add_many(command, "the stacks of each camera", "cameras", "pictures")
    add_variant(command)
    add_denoise(command, "what the scenes' integrators say")
    add_method(command)
    return DATASET_EXAMPLES


def dataset(options: argparse.Namespace) -> None:
    """``potmesil dataset``: the samples of each view once, then its stacks."""
    from .._files import require_writable, write_json
    from ..animation.frames import chosen_frames
    from ..stacks.recipe import Recipe

    report = Report(options)
    recipe = Recipe.load(options.recipe)
    _require_sampling(options.recipe, recipe)
    views = recipe.views()
    chosen = [views[i] for i in chosen_frames(range(len(views)), None, options.shard)]
    folder = Path(options.output)
    write_json(require_writable(folder / INDEX, (".json",)), _told(recipe, views, folder))
    making = _Making(options, recipe, views, folder)
    counts, failures = [0, 0], []
    with given_cluster(options, folder) as cluster:
        if cluster is None:
            results = _made(making, chosen)
        else:
            results = _made_elsewhere(cluster, making, chosen)
        for found, failed in results:
            counts = [a + b for a, b in zip(counts, found, strict=True)]
            failures += failed
    if counts[0]:
        tell_done(report, "pictures", counts[0], counts[1], [], [])
    made = counts[1] - counts[0]
    report.files([folder / INDEX], f"{made} of {counts[1]} pictures were made")
    for name, failure in failures:
        print(f"potmesil: {name}: {failure}", file=sys.stderr)
    if failures:
        raise RuntimeError(
            f"{len(failures)} pictures or cameras could not be made, see above; the others are in "
            f"{folder}"
        )


Made = tuple[tuple[int, int], list[tuple[str, str]]]
"""Of a view: how many pictures were there, and there are; what could not be made, and why."""


@dataclasses.dataclass(frozen=True)
class _Making:
    """Makes the stacks of views: a job for workers, too."""

    options: argparse.Namespace
    recipe: Recipe
    views: list[View]
    folder: Path

    def prepared(self, file: Path | None = None) -> _Opening:
        """What opens the scenes."""
        return _Opening(self.options, self.recipe, self.views)

    def do(self, prepared: _Opening, task: View) -> Made:
        """Make the stacks of a view."""
        failures: list[tuple[str, str]] = []

        def failed(what: str, error: Exception) -> None:
            failures.append((what, str(error)))

        counts = 0, 0
        try:
            counts = _do_view(prepared, task, self.folder, failed)
        except Exception as error:
            failed(_name_of(task), error)
        return counts, failures


def _made(making: _Making, views: list[View]) -> Iterator[Made]:
    """Make the stacks of views, one after the other."""
    from .._progress import reported, step_progress

    opening = making.prepared()
    with reported() as report:
        for done, view in enumerate(views):
            with step_progress(report, _name_of(view), done, len(views)):
                made = making.do(opening, view)
            yield made


def _made_elsewhere(cluster: Cluster, making: _Making, views: list[View]) -> Iterator[Made]:
    """Make the stacks of views by a cluster."""
    from .._cluster import TaskError
    from .._progress import reported

    cluster.require_shared("a data set")
    names = [_name_of(view) for view in views]
    with reported() as report:
        for _, found in cluster.do(making, views, names, report):
            if isinstance(found, TaskError):
                yield (0, 0), [(found.name, found.why)]
            else:
                yield found


@dataclasses.dataclass
class _Opening:
    """Opens the scenes of views, each once while its views follow each other."""

    options: argparse.Namespace
    recipe: Recipe
    views: list[View]
    scene: tuple[str, int] | None = None
    opened: Opened | None = None

    def options_of(self, view: View) -> argparse.Namespace:
        """What the options of ``render`` would say of a view."""
        sampling = dict.fromkeys(SAMPLING_OPTIONS) | dict(self.recipe.sampling)
        return argparse.Namespace(
            **{
                **vars(self.options),
                **dict.fromkeys(LENS_OPTIONS),
                "spp": 0,
                **sampling,
                "units": view.units,
                "focus_at": None,
                "focus_on": None,
                "scene": view.path,
                "define": list(view.define.items()),
                "sensor": view.sensor,
                "seed": view.seed,
                "samples": None,
                "bit_depth": self.recipe.form.get("bit_depth"),
                "quality": self.recipe.form.get("quality"),
            }
        )

    def of(self, view: View) -> Opened:
        """The scene of a view. Raises ``ValueError`` for one with a motion of its own."""
        if self.opened is None or self.scene != (view.name, view.sensor):
            self.opened = None
            # The lens of the sensor must not depend on which view comes first here.
            views = [one for one in self.views if one.name == view.name]
            lenses = [one.first_lens() for one in views if one.sensor == view.sensor]
            lens = lenses[0]
            if "half_angle" in lens:
                lens = {**lens, "half_angle": max(one["half_angle"] for one in lenses)}
            self.opened = Opened.of(self.options_of(view), lens)
            self.scene = view.name, view.sensor
        if self.opened.motion is not None:
            raise ValueError(f"motion: {view.path} has one, which a data set must not have")
        return self.opened


def _do_view(opening: _Opening, view: View, folder: Path, failed: Failed) -> tuple[int, int]:
    """The stacks of a view; returns how many pictures were there already, and how many there are.

    ``failed`` is told of pictures that cannot be made.
    """
    opened, options = opening.of(view), opening.options_of(view)
    lens = opened.sensor.lens()
    how = {
        **scene_told(options),
        "camera_number": view.camera,
        "turn": view.turn,
        "move": view.move,
        **how_formed(options, opened.method, opened.filters),
    }
    plans, lenses = [], []
    for stack in view.stacks:
        try:
            plans.append(_plan(opening.recipe, view, stack, folder, lens, how))
        except (ValueError, TypeError, OSError) as error:
            failed(_name_of(view, stack), error)
            continue
        lenses += [item.lens for item in plans[-1].items]
    to_do = [(plan, plan.to_do(range(len(plan.items)), options.overwrite)) for plan in plans]
    left = [(plan, items) for plan, items in to_do if items or plan.lacks_maps]
    count = sum(len(plan.items) for plan in plans)
    if left:
        forming = _forming(opening, view, opened, lenses)
        for plan, items in left:
            forming.do(plan, items, failed)
    return count - sum(len(items) for _, items in to_do), count


def _forming(opening: _Opening, view: View, opened: Opened, lenses: list[Any]) -> Forming:
    """What forms the pictures of a view, whose samples serve all ``lenses``."""
    from ..focusing.session import FocusSession
    from ..stacks.foci import warn_of_no_focus
    from ..stacks.forming import Forming

    sampling = sampling_for(opened.sensor.lens(), lenses, opened.sampling)
    if "normals" in opening.recipe.maps:
        sampling = dataclasses.replace(sampling, features=True)
    motion = _motion(view, opened.sensor)
    samples = opened.sampled(opening.options_of(view), sampling, view.seed, motion)
    warn_of_no_focus(samples, lenses)
    session = FocusSession(samples, opened.method)
    return Forming(session, opened.film.rfilter(), opened.has_alpha, opened.filters)


def _plan(
    recipe: Recipe, view: View, stack: StackDraw, folder: Path, lens: Any, how: dict[str, Any]
) -> StackPlan:
    from ..stacks.plan import StackPlan

    files = _files(recipe, view, stack, folder)
    extra = {"number": stack.number, "lens_number": stack.lens, "aperture_number": stack.aperture}
    plan = StackPlan.of(stack.lenses(lens), files, how=how, maps=recipe.maps, extra=extra)
    plan.check([view.path])
    return plan


def _files(recipe: Recipe, view: View, stack: StackDraw, folder: Path) -> StackFiles:
    """The files of a stack; those of all stacks of a view are beside their folders."""
    from ..stacks.layouts import StackFiles, fod500_files, shared_files

    if recipe.layout == "fod500":
        return fod500_files(str(folder / f"{stack.number:06d}"), len(stack.foci))
    shared = folder / view.name / f"{view.sensor}-{view.camera:03d}"
    own = shared / f"l{stack.lens:02d}-a{stack.aperture:02d}"
    number = str(own / "{:04d}")
    return StackFiles(
        tuple(number + ending for ending in recipe.endings),
        form=recipe.form,
        circles=f"{number}.coc.exr",
        described=f"{number}.json",
        **shared_files(shared, own),
    )


def _name_of(view: View, stack: StackDraw | None = None) -> str:
    name = f"{view.name}, sensor {view.sensor}, camera {view.camera}"
    return name if stack is None else f"{name}, lens {stack.lens}, aperture {stack.aperture}"


def _motion(view: View, sensor: LensSensor) -> Motion | None:
    """What puts the camera where a view has it; ``None`` where the sensor has it."""
    import numpy as np

    from ..motion.camera_move import ANGLES, CameraMove
    from ..motion.motion import Motion
    from ..motion.track import Track, VectorTrack
    from ..optics.camera import angles_of

    if not any(view.turn.values()) and not any(view.move):
        return None
    own = sensor.camera().world_from_camera()
    axes = own[:3, :3] / np.linalg.norm(own[:3, :3], axis=0)
    unit = unit_of(sensor)
    right, up, ahead = (length_of(f"move[{i}]", one, unit) for i, one in enumerate(view.move))
    origin = own[:3, 3] + axes @ (-right, up, ahead)
    angles = dict(zip(ANGLES, map(float, angles_of(axes)), strict=True))
    turned: dict[str, Any] = {
        name: Track.of(angles[name] + float(view.turn[name])) for name in ANGLES
    }
    return Motion(CameraMove(origin=VectorTrack.of(origin.tolist()), **turned))


def _require_sampling(path: str, recipe: Recipe) -> None:
    """Raise for a ``[sampling]`` that is none, with the file and the key."""
    from .._validation import require_whole
    from ..tracing.sampling import Sampling

    sampling = dict(recipe.sampling)
    try:
        require_whole("spp", sampling.pop("spp", 0), 0, 2**32 - 1)
        if isinstance(sampling.get("focus_range"), str):  # which may be of lengths with units
            sampling["focus_range"] = range_of(sampling["focus_range"], 1.0)
        for name in sampling:
            if name not in SAMPLING_OPTIONS:
                known = ", ".join(("spp", *SAMPLING_OPTIONS))
                raise ValueError(f"{name}: unknown, must be one of {known}")
        Sampling(**sampling)
    except (ValueError, TypeError) as error:
        raise type(error)(f"{path}: [sampling].{error}") from error


def _told(recipe: Recipe, views: list[View], folder: Path) -> dict[str, Any]:
    """What is told of the data set: the same by each of its parts."""
    from .._version import package_version
    from ..samples.provenance import file_name

    told = []
    for view in views:
        of = view.to_dict()
        for stack, values in zip(view.stacks, of["stacks"], strict=True):
            files = _files(recipe, view, stack, folder)
            values["stack"] = Path(files.stack).relative_to(folder).as_posix()
            values["foci"] = {k: v for k, v in values["foci"].items() if v is not None}
        told.append({**of, "path": file_name(view.path)})
    return {
        "format": "potmesil dataset",
        "format_version": 1,
        "potmesil_mi": package_version(),
        "seed": recipe.seed,
        "layout": recipe.layout,
        "maps": sorted(recipe.maps),
        "sampling": dict(recipe.sampling),
        "views": told,
    }
