"""Frames of an animation that are formed by the workers of a cluster."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._cluster import Cluster, TaskError
from .._progress import reported
from .._worker import Job
from ..focusing.film import TabulatedFilter
from ..focusing.session import FocusSession
from ..samples.formed import attributes_of_formed
from ..samples.point_samples import PointSamples
from .animation import Animation
from .frames import FrameFiles

if TYPE_CHECKING:
    from ..filters.base import FilterFunction
    from ..focusing.film import ReconstructionFilter
    from ..focusing.methods import Method

Said = Callable[[int], "dict[str, Any]"]
"""Gives what is said of a frame in its files."""


@dataclasses.dataclass(frozen=True)
class FramesJob:
    """Forms frames of an animation whose samples are all the same, in a file.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``animation``, ``files``      what frames there are, and where they are written
    ``method``, ``picture``       how pictures are formed, see :meth:`.Animation.pictures`
    ``writes``                    whether they are written, or come back
    ============================  ==========================================================
    """

    animation: Animation
    files: FrameFiles
    method: Method
    picture: dict[str, Any]
    writes: bool

    def prepared(self, file: Path | None) -> FocusSession:
        """The samples, and what is found out about them once."""
        assert file is not None
        return FocusSession(PointSamples.load(file), self.method)

    def do(self, prepared: FocusSession, task: int) -> np.ndarray | None:
        """Form a frame; ``None`` where it is written."""
        ((_, picture),) = self.animation.pictures(prepared, [task], **self.picture)
        if not self.writes:
            return np.array(picture)
        self.files.write(task, picture, said_of(self.animation, prepared)(task))
        return None


def said_of(animation: Animation, session: FocusSession) -> Said:
    """What is said of each frame in its files."""
    samples = session.samples

    def said(frame: int) -> dict[str, Any]:
        lens = animation.lens_at(samples.lens, frame)
        return attributes_of_formed(samples, session.method, lens)

    return said


def frames_elsewhere(
    cluster: Cluster,
    animation: Animation,
    session: FocusSession,
    frames: Sequence[int],
    files: FrameFiles,
    *,
    filters: Sequence[FilterFunction] = (),
    rfilter: ReconstructionFilter | None = None,
    alpha: bool = False,
) -> None:
    """Form and write frames of the same samples by a cluster.

    Parameters are those of :meth:`.Animation.pictures`. Raises
    :class:`potmesil_mi._cluster.TaskError`, which names the frame that could not be made.
    """
    picture = {
        "filters": tuple(filters),
        "rfilter": rfilter and TabulatedFilter.of(rfilter),
        "alpha": alpha,
    }
    file = cluster.scratch / "common.samples"
    session.samples.save(file)
    job = FramesJob(animation, files, session.method, picture, cluster.shared)
    do_frames(cluster, job, frames, files, said_of(animation, session), file)


def do_frames(
    cluster: Cluster,
    job: Job,
    frames: Sequence[int],
    files: FrameFiles,
    said: Said | None = None,
    file: Path | None = None,
) -> None:
    """Do a job whose tasks are frames; those that come back are written, with what is ``said``."""
    names = [str(files.of(frame)[0]) for frame in frames]
    with reported() as report:
        for frame, found in cluster.do(job, frames, names, report, file):
            if isinstance(found, TaskError):
                raise found
            if found is not None:
                files.write(frame, found, said and said(frame))
