"""Tiles of a picture that are formed by the workers of a cluster."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..._cluster import Begun, Cluster, TaskError
from ..._progress import ProgressCallback
from ...samples.point_samples import PointSamples
from ..film import TabulatedFilter
from ..session import Asked
from .forming import Doing
from .stages import TileForming, TileTask


@dataclasses.dataclass(frozen=True)
class TilesJob:
    """Does stages of tiles of samples in a file, as is ``asked``."""

    asked: Asked

    def prepared(self, file: Path | None) -> TileForming:
        """What does the stages, and keeps what it has found out about tiles."""
        assert file is not None
        return TileForming(self.asked, PointSamples.load(file))

    def do(self, prepared: TileForming, task: TileTask) -> Any:
        """Do a stage with a tile."""
        return prepared.do(task)


@contextlib.contextmanager
def tiles_elsewhere(cluster: Cluster, samples: PointSamples) -> Iterator[Doing]:
    """What does the stages of tiles of ``samples``, within the block, by a cluster.

    It raises :class:`potmesil_mi._cluster.TaskError`, which names the tile that could not be made.
    """
    file = cluster.scratch / "common.samples"
    begun: list[Begun] = []

    def doing(
        asked: Asked, tasks: Sequence[TileTask], report: ProgressCallback
    ) -> Iterator[tuple[TileTask, Any]]:
        if not begun:
            samples.save(file)
            begun.append(cluster.begun(TilesJob(_without_the_rest(asked)), file))
        names = [f"tile {tuple(task.tile.core)}" for task in tasks]
        for task, found in begun[0].do(tasks, names, report):
            if isinstance(found, TaskError):
                raise found
            yield task, found

    yield doing
    for each in begun:
        each.forget()


def _without_the_rest(asked: Asked) -> Asked:
    """What tiles need, and what another process can have."""
    rfilter = asked.rfilter and TabulatedFilter.of(asked.rfilter)
    return asked._replace(filters=(), rfilter=rfilter)
