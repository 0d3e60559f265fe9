"""Pictures of a stack that are formed by the workers of a cluster."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._cluster import Cluster, TaskError
from .._progress import reported
from .._threads import Behind
from ..focusing.session import FocusSession
from ..samples.point_samples import PointSamples
from .forming import Forming
from .plan import StackItem, StackPlan


@dataclasses.dataclass(frozen=True)
class FormingJob:
    """Forms the pictures of a plan, of samples in a file.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``plan``                      without its items, which are the tasks
    ``method``, ``picture``       how pictures are formed, see :class:`.forming.Forming`
    ``writes``                    whether they are written, or come back
    ============================  ==========================================================
    """

    plan: StackPlan
    method: Any
    picture: dict[str, Any]
    writes: bool

    def prepared(self, file: Path | None) -> Forming:
        """What forms the pictures."""
        assert file is not None
        return Forming(FocusSession(PointSamples.load(file), self.method), **self.picture)

    def do(self, prepared: Forming, task: StackItem) -> np.ndarray | None:
        """Form a picture; ``None`` where it is written."""
        picture = prepared.form(task)
        if not self.writes:
            return picture
        prepared.write(self.plan, task, picture)
        return None


def do_elsewhere(
    cluster: Cluster,
    forming: Forming,
    plan: StackPlan,
    items: Sequence[StackItem],
) -> None:
    """Form and write ``items`` of a plan as :meth:`.forming.Forming.do` does, by a cluster.

    What there is of all pictures is made here. Raises :class:`potmesil_mi._cluster.TaskError`,
    which names the picture that could not be made.
    """
    names = [str(plan.paths(item)[0]) for item in items]
    job = FormingJob(
        dataclasses.replace(plan, items=()),
        forming.session.method,
        forming.picture_elsewhere(),
        cluster.shared,
    )
    with Behind() as behind, reported() as report:
        forming.do_common(plan, behind)
        if not items:
            return
        file = cluster.scratch / "common.samples"
        forming.samples.save(file)
        for item, found in cluster.do(job, items, names, report, file):
            if isinstance(found, TaskError):
                raise found
            if found is not None:
                behind.do(functools.partial(forming.write, plan, item, found))
