"""The doing of a plan: pictures are formed one after the other, and written meanwhile."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from .._files import write_json
from .._image import write_maps
from .._progress import reported, step_progress
from .._threads import Behind
from .._version import package_version
from ..filters.base import FilterFunction
from ..focusing.film import TabulatedFilter
from ..focusing.session import FocusSession
from ..optics.lens import ThinLens
from ..samples.circles import in_units_of
from ..samples.formed import attributes_of_formed
from ..samples.maps import circles_of, depth_map, normal_map
from ..samples.point_samples import PointSamples
from .describing import DEPTH_KIND, METRES, camera_told, ends_of_depth, lens_told, samples_told
from .foci import Lens
from .layouts import write_depth, write_formed, write_pinhole
from .plan import FORMAT, StackItem, StackPlan

if TYPE_CHECKING:
    from ..focusing.film import ReconstructionFilter

T = TypeVar("T")

NORMALS = ("normal.X", "normal.Y", "normal.Z")
"""Channels of the map of normals."""

Failed = Callable[[str, Exception], None]
"""Is told of what could not be made, and why."""


class Forming:
    """Forms and writes the pictures of plans of the same samples.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``session``                   the samples, and what is found out about them once
    ``rfilter``, ``alpha``,       as in :meth:`potmesil_mi.FocusSession.focus`
    ``filters``
    ============================  ==========================================================
    """

    def __init__(
        self,
        session: FocusSession,
        rfilter: ReconstructionFilter | None = None,
        alpha: bool = False,
        filters: tuple[FilterFunction, ...] = (),
    ) -> None:
        self.session = session
        session.accept_any_focus()
        self._picture: dict[str, Any] = {"rfilter": rfilter, "alpha": alpha, "filters": filters}
        self._mapped: set[Path] = set()

    @property
    def samples(self) -> PointSamples:
        """The samples of which pictures are formed."""
        return self.session.samples

    def picture_elsewhere(self) -> dict[str, Any]:
        """How pictures are formed, as another process may have it."""
        rfilter = self._picture["rfilter"]
        return {**self._picture, "rfilter": rfilter and TabulatedFilter.of(rfilter)}

    @functools.cached_property
    def depth(self) -> np.ndarray:
        """The map of their depths."""
        return depth_map(self.samples)

    @functools.cached_property
    def ends(self) -> tuple[float, float]:
        """The nearest and the farthest depth in the picture."""
        return ends_of_depth(self.samples)

    @functools.cached_property
    def pinhole(self) -> np.ndarray:
        """The picture that the pinhole takes, all in focus, without special effects."""
        return np.array(
            self.session.focus(pinhole_of(self.samples.lens), rfilter=self._picture["rfilter"])
        )

    def do(self, plan: StackPlan, items: Iterable[StackItem], failed: Failed | None = None) -> None:
        """Form and write ``items`` of a plan, and what there is of all of them.

        What cannot be made ``failed`` is told of, and the rest is made; ``None``: the error of the
        first is raised.
        """
        items = list(items)
        with Behind() as behind, reported() as report:
            self.do_common(plan, behind)
            for done, item in enumerate(items):
                what = str(plan.paths(item)[0])
                with step_progress(report, f"Picture {item.index}", done, len(items)):
                    picture = _attempted(functools.partial(self.form, item), what, failed)
                if picture is not None:
                    write = functools.partial(self.write, plan, item, picture)
                    behind.do(functools.partial(_attempted, write, what, failed))

    def do_common(self, plan: StackPlan, behind: Behind) -> None:
        """Form what there is of all pictures of a plan, and have it written ``behind``."""
        self._do_maps(plan, behind)
        behind.do(lambda: write_json(Path(plan.files.stack), self.told(plan)))

    def form(self, item: StackItem) -> np.ndarray:
        """The picture of an item."""
        return np.array(self.session.focus(item.lens, **self._picture))

    def write(self, plan: StackPlan, item: StackItem, picture: np.ndarray) -> None:
        """Write an item's picture, and what is told of it last: then it is done."""
        said = attributes_of_formed(self.samples, self.session.method, item.lens)
        _, circles, described = plan.files_of(item)
        described.unlink(missing_ok=True)  # It may tell of the picture that was here before.
        write_formed(picture, item.index, plan.files, said)
        if circles is not None:
            diameters = circles_of(
                self.depth, in_units_of(self.samples, item.lens), self.samples.camera
            )
            write_maps({"coc": diameters}, circles, said)
        about = self.about("potmesil picture", plan)
        write_json(described, {**about, **self.told_of(plan, item)})

    def told_of(self, plan: StackPlan, item: StackItem) -> dict[str, Any]:
        """What is told of a picture."""
        pictures, circles, described = plan.files_of(item)
        told = {
            **lens_told(in_units_of(self.samples, item.lens), self.samples.camera, self.ends),
            **plan.told_of(item),
            "files": [plan.files.told(path) for path in pictures],
            "described": plan.files.told(described),
        }
        return told if circles is None else {**told, "circles": plan.files.told(circles)}

    def told(self, plan: StackPlan) -> dict[str, Any]:
        """What is told of the stack."""
        pictures = [self.told_of(plan, item) for item in plan.items]
        return {**self.about(FORMAT, plan), "pictures": pictures}

    def about(self, form: str, plan: StackPlan) -> dict[str, Any]:
        """What is told of the stack as well as of each of its pictures."""
        return {
            "format": form,
            "format_version": 1,
            "potmesil_mi": package_version(),
            "samples": samples_told(self.samples),
            "camera": camera_told(self.samples),
            "depth": {
                "kind": METRES if plan.files.layout == "fod500" else DEPTH_KIND,
                "nearest": self.ends[0],
                "farthest": self.ends[1],
            },
            "maps": {name: plan.files.told(path) for name, path in plan.map_paths().items()},
            **plan.how,
            **plan.extra,
        }

    def _do_maps(self, plan: StackPlan, behind: Behind) -> None:
        """Write what there is once for all pictures; each run writes the same."""
        if self._mapped == set(plan.map_paths().values()):  # by another plan
            return
        self._mapped = set(plan.map_paths().values())
        lens = pinhole_of(self.samples.lens)
        said = attributes_of_formed(self.samples, self.session.method, lens)
        if "depth" in plan.maps:
            unit = lens.millimeters_per_unit if isinstance(lens, ThinLens) else 1000.0
            behind.do(lambda: write_depth(self.depth, plan.files, said, unit))
        if "normals" in plan.maps:
            planes = np.moveaxis(normal_map(self.samples), 2, 0)
            normals = dict(zip(NORMALS, planes, strict=True))
            behind.do(lambda: write_maps(normals, plan.files.normals, said))
        if "pinhole" in plan.maps:
            picture = self.pinhole
            behind.do(lambda: write_pinhole(picture, plan.files, said))


def _attempted(job: Callable[[], T], what: str, failed: Failed | None) -> T | None:
    """What a job gives; ``None`` where it fails, of which ``failed`` is told if it is given."""
    try:
        return job()
    except Exception as error:
        if failed is None:
            raise
        failed(what, error)
        return None


def pinhole_of(lens: Lens) -> Lens:
    """A lens of the same kind that has all in focus."""
    if isinstance(lens, ThinLens):
        return lens.replace(aperture_radius=0.0, aperture="disc", squeeze=1.0, vignetting=0.0)
    return lens.replace(half_angle=0.0)
