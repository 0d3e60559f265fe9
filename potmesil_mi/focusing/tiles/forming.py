"""A picture that is formed by tiles, one after the other or by the workers of a cluster."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from ... import _backend as jit
from ..._progress import ProgressCallback, progress, reported
from ...filters.base import FilterFunction
from ...optics.lens import ThinLens
from ...optics.psf import PointSpreadFunction
from ...optics.telecentric import TelecentricLens
from ...samples.point_samples import PointSamples
from ..film import ReconstructionFilter
from ..methods import Equation20, Method, VisibleMethod, visibility_for
from ..session import Asked, asked, forming, memo_of
from .cutting import Grid, Tile, tiles_of
from .stages import TileForming, TileTask, known_by

Doing = Callable[[Asked, Sequence[TileTask], ProgressCallback], Iterable[tuple[TileTask, Any]]]
"""Does a stage with all tiles: gives each task with what it gave, in any order."""


def focus_by_tiles(
    samples: PointSamples,
    lens: ThinLens | TelecentricLens | None,
    method: Method,
    tiles: Any,
    psf: PointSpreadFunction | None = None,
    rfilter: ReconstructionFilter | None = None,
    alpha: bool = False,
    filters: Sequence[FilterFunction | str] = (),
    doing: Doing | None = None,
) -> jit.TensorXf:
    """The picture of :func:`potmesil_mi.focus`, formed by ``tiles``, (columns, rows).

    They are formed one after the other, or by what is ``doing`` that. Raises what
    ``potmesil_mi.focus`` does, and ``ValueError`` for what cannot be formed by tiles.
    """
    memo = memo_of(samples)
    grid = Grid.of(tiles, samples.crop_window)
    wanted = asked(samples, lens, method, memo, psf, rfilter, alpha, filters, by_tiles=True)
    _require_possible(samples, method)
    with forming:
        definite = wanted._replace(method=_definite(wanted, samples))
        work = TileForming(definite, samples)
        choices = work.begun()
        cut = tiles_of(grid, work.samples, choices, rfilter)
        crop = samples.crop_window
        picture = np.zeros((*crop.shape, 3 + wanted.alpha), np.float32)
        with reported() as report:
            for number, stage in enumerate(work.stages):
                tasks = [TileTask(stage, tile, choices) for tile in cut]
                listen = _part_of(report, number, len(work.stages))
                each = (
                    _one_by_one(work, tasks, listen)
                    if doing is None
                    else doing(definite, tasks, listen)
                )
                told: dict[Tile, Sequence[Any]] = {}
                for task, found in each:
                    if stage == "picture":
                        picture[task.tile.core.slices_in(crop)] = found
                    else:
                        told[task.tile] = found
                if stage != "picture":
                    choices = known_by(choices, [told[tile] for tile in cut])
        return wanted.filtered(picture, work.samples)


def _require_possible(samples: PointSamples, method: Method) -> None:
    """Raise ``ValueError`` for what is not known to be formed by tiles as it is as a whole."""
    if not isinstance(method, (VisibleMethod, Equation20)):
        raise ValueError(
            f"method={method}: must be layered, lightfield or paper where a picture is formed by "
            "tiles"
        )
    if isinstance(method, VisibleMethod) and samples.moves:
        raise ValueError(
            f"tiles: must be left out for samples of an exposure, unless method={method.name} is "
            "paper"
        )
    if not samples.window.covers(samples.crop_window):
        raise ValueError(
            f"tiles: must be left out where the window of the samples {tuple(samples.window)} does "
            f"not cover the crop window {tuple(samples.crop_window)}"
        )


def _definite(wanted: Asked, samples: PointSamples) -> Method:
    """The method with the options that it has for all samples."""
    method = wanted.method
    changed: Any = method
    if isinstance(method, VisibleMethod):
        points = visibility_for(method, wanted.exposures(samples)[0]).lens_points
        return dataclasses.replace(changed, squares=wanted.subpixels, lens_points=points)
    return dataclasses.replace(changed, squares=wanted.subpixels)


def _part_of(report: ProgressCallback, number: int, count: int) -> ProgressCallback:
    """Tells how far one of ``count`` parts of a job is."""

    def tell(text: str, share: float | None) -> None:
        report("Focusing", None if share is None else (number + share) / count)

    return tell


def _one_by_one(
    work: TileForming, tasks: Sequence[TileTask], report: ProgressCallback
) -> Iterator[tuple[TileTask, Any]]:
    """Do a stage with one tile after the other.

    Stages go through them to and fro, so that what is kept of the last ones is of use.
    """
    forwards = work.stages.index(tasks[0].stage) % 2 == 0
    for done, task in enumerate(tasks if forwards else tasks[::-1], 1):
        with progress(lambda text, share: None):
            found = work.do(task)
        yield task, found
        report("Focusing", done / len(tasks))
