"""Scenes of others: found in folders, loaded, and looked at through a lens.

**Lens.** A scene's `thinlens` keeps its lens. A `perspective` gets one: focused on the median depth
of what is seen in the middle third of the picture, with the aperture whose largest circle of
confusion is 3 % of the picture's width, the nearest and the farthest percent of the surfaces left
out; at most a quarter of the focus distance wide.
"""

from __future__ import annotations

import argparse
import dataclasses
import fnmatch
import hashlib
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mitsuba as mi
import numpy as np
from common import OUTPUT, console
from references import scene_version

from potmesil_mi.evaluation import thinlens_sensor

FOLDER = OUTPUT / "scenes_of_others"
LARGEST_CIRCLE = 0.03
"""Diameter of the largest circle of confusion, in widths of the picture."""
WIDEST = 0.25
"""Largest diameter of the lens, in focus distances."""


def scenes_in(folders: list[Path], only: list[str] | None) -> Iterator[tuple[str, Path]]:
    """Names and paths of XML files that no other includes; ``scene.xml`` is named by its folder."""
    for folder in folders:
        paths = sorted(folder.rglob("*.xml")) if folder.is_dir() else [folder]
        included = {path for one in paths for path in included_by(one)}
        for path in paths:
            name = path.parent.name if path.stem == "scene" else path.stem
            wanted = only is None or any(fnmatch.fnmatch(name, pattern) for pattern in only)
            if wanted and path.resolve() not in included:
                yield name, path


def included_by(path: Path) -> Iterator[Path]:
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError:
        return
    for include in root.iter("include"):
        yield (path.parent / include.get("filename", "")).resolve()


@dataclasses.dataclass
class Case:
    """A scene and the sensor that it is looked at with.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``sensor``                    a ``thinlens``, of the wanted size, with the scene's own
                                  sampler and reconstruction filter
    ``own_lens``                  whether the scene has that lens, else it was chosen
    ``what``                      what a reference depends on
    ============================  ==========================================================
    """

    name: str
    scene: mi.Scene
    sensor: mi.Sensor
    own_lens: bool
    what: str

    @classmethod
    def load(cls, name: str, path: Path, arguments: argparse.Namespace) -> Case:
        """Raises what Mitsuba raises, and ``ValueError`` for a sensor without a thin lens."""
        began = time.perf_counter()
        merged = {"optimize": False} if arguments.unmerged else {}
        scene = mi.load_file(str(path), **merged)
        if not isinstance(scene, mi.Scene) or not scene.sensors():
            raise ValueError("no sensor")
        given = scene.sensors()[0]
        if given.class_name() not in ("PerspectiveCamera", "ThinLensCamera"):
            raise ValueError(f"sensor {given.class_name()}")
        parameters = mi.traverse(given)
        plan = {**pinhole(given), "film": film(given.film(), arguments)}
        if arguments.sampler:
            plan["sampler"] = {"type": arguments.sampler}
        own = "aperture_radius" in parameters and scalar(parameters["aperture_radius"]) > 0
        if own:
            radius, focus = (scalar(parameters[n]) for n in ("aperture_radius", "focus_distance"))
        else:
            radius, focus = chosen_lens(scene, mi.load_dict(plan))
        radius *= arguments.aperture
        plan |= {"type": "thinlens", "aperture_radius": radius, "focus_distance": focus}
        sensor = mi.load_dict(plan)
        what = (
            f"{scene_version(path)} {sensor.film().size()} {sensor.film().rfilter()} "
            f"{radius:.5g} {focus:.5g}"
        )
        console.print(
            f"\n[bold]{name}[/bold]: {len(scene.shapes())} shapes, "
            f"{scene.integrator().class_name()}, {sensor.film().rfilter().class_name()}, "
            f"{sensor.sampler().class_name()}, loaded in {time.perf_counter() - began:.1f} s"
        )
        return cls(name, scene, sensor, own, what)

    @property
    def place(self) -> Path:
        digest = hashlib.sha256(self.what.encode()).hexdigest()[:12]
        return FOLDER / "references" / f"{self.name}_{digest}.npz"

    @property
    def size(self) -> tuple[int, int]:
        width, height = self.sensor.film().size()
        return int(width), int(height)

    def render(self, sensor: mi.Sensor, spp: int, seed: int) -> np.ndarray:
        picture = mi.render(
            self.scene, sensor=sensor, integrator=self.scene.integrator(), spp=spp, seed=seed
        )
        return np.array(picture)[..., :3]

    def thinlens(self, spp: int, seed: int, sampler: str | None = None) -> Callable[[], np.ndarray]:
        """A function that renders with ``sampler``, by default the scene's own."""
        sensor = self.sensor
        if sampler is not None:
            sensor = thinlens_sensor(sensor, sampler=sampler, spp=spp)
        return lambda: self.render(sensor, spp, seed)


def pinhole(sensor: mi.Sensor) -> dict[str, Any]:
    """The `perspective` at the place of a sensor, with its film and sampler."""
    parameters = mi.traverse(sensor)
    return {
        "type": "perspective",
        "fov": scalar(parameters["x_fov"]),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(matrix(parameters["to_world"])),
        "near_clip": scalar(parameters["near_clip"]),
        "far_clip": scalar(parameters["far_clip"]),
        "film": sensor.film(),
        "sampler": sensor.sampler(),
    }


def film(given: mi.Film, arguments: argparse.Namespace) -> dict[str, Any]:
    """The film in the wanted size, without a crop window."""
    scale = arguments.size / max(given.size())
    width, height = (max(1, round(scale * float(side))) for side in given.size())
    return {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "pixel_format": "rgb",
        "component_format": "float32",
        "rfilter": {"type": arguments.rfilter} if arguments.rfilter else given.rfilter(),
    }


def scalar(value: Any) -> float:
    return float(np.array(value).ravel()[0])


def matrix(transform: Any) -> np.ndarray:
    return np.array(transform.matrix, dtype=np.float64).reshape(4, 4)


def chosen_lens(scene: mi.Scene, sensor: mi.Sensor) -> tuple[float, float]:
    """Radius and focus distance in scene units, as the head of this file says.

    Raises ``ValueError`` where the picture shows no surface.
    """
    width, height = (int(side) for side in sensor.film().size())
    row, column = (np.ravel(n) + 0.5 for n in np.mgrid[:height, :width])
    at = mi.Point2f(column / width, row / height)
    ray, _ = sensor.sample_ray(0.0, 0.5, at, 0.5)
    hit = scene.ray_intersect_preliminary(ray)
    place = matrix(mi.traverse(sensor)["to_world"])
    points = np.array(ray(hit.t)).reshape(3, -1)
    forward = place[:3, 2] / np.linalg.norm(place[:3, 2])
    seen = np.array(hit.is_valid())
    depth = forward @ np.where(seen, points - place[:3, 3:], 1)
    if not seen.any():
        raise ValueError("the picture shows no surface")
    middle = (np.abs(column / width - 0.5) < 1 / 6) & (np.abs(row / height - 0.5) < 1 / 6)
    focus = float(np.median(depth[seen & middle] if (seen & middle).any() else depth[seen]))
    farthest, nearest = np.percentile(1 / depth[seen], (1, 99))
    away = max(nearest - 1 / focus, 1 / focus - farthest)
    slope = 2 * math.tan(math.radians(scalar(mi.traverse(sensor)["x_fov"])) / 2)
    widest = WIDEST * focus / 2
    return min(LARGEST_CIRCLE * slope / (2 * away), widest) if away > 0 else widest, focus
