"""Converged `thinlens` pictures, kept in files: what focused pictures are compared with.

Mitsuba's own `thinlens` renders a scene with one seed after another until the noise of their mean
is known to be small. Small lamps, whose blurred discs would take it millions of samples a pixel,
are left to `LampLight`, which samples the lens from the lamp's side. References are kept in
`output/thinlens_quality/` and used again; delete them to start anew.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import common
import drjit as dr
import mitsuba as mi
import numpy as np
from common import console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

import potmesil_mi as pm
from potmesil_mi.evaluation import thinlens_sensor
from potmesil_mi.evaluation.metrics import decibels, mean_square

FOLDER = common.OUTPUT / "thinlens_quality"
FIRST_SEED = 1000
LAMP_SIDE = 1024
"""Samples of each lamp and seed are the square of this."""

Encoding = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass
class Reference:
    """Sums of the pictures of even and of odd seeds, of which there are equally many."""

    path: Path
    spp: int
    even: np.ndarray
    odd: np.ndarray
    count: int = 0

    @classmethod
    def open(cls, path: Path, size: tuple[int, int], spp: int) -> Reference:
        """What is kept at ``path``, or an empty one of ``size``, width and height."""
        if path.exists():
            with np.load(path) as kept:
                return cls(path, spp, kept["even"], kept["odd"], int(kept["count"]))
        shape = (size[1], size[0], 3)
        return cls(path, spp, np.zeros(shape), np.zeros(shape))

    @property
    def mean(self) -> np.ndarray:
        return (self.even + self.odd) / self.count

    @property
    def floor(self) -> float:
        """PSNR of the noise of the mean of all seeds, linear RGB clipped to [0, 1]."""
        return self.floor_as(lambda linear: linear)

    def floor_as(self, encoding: Encoding) -> float:
        """The same of the picture as ``encoding`` writes it.

        The halves are independent, so their difference has the variance of each twice, and
        their mean half that of each: a quarter of the mean squared difference.
        """
        if self.count == 0:
            return -math.inf
        halves = (encoding(sums / (self.count / 2)) for sums in (self.even, self.odd))
        return decibels(mean_square(*halves) / 4)

    def add_pair(self, render: Callable[[int], np.ndarray]) -> None:
        """Add one seed to either half, and keep the result."""
        for half in (self.even, self.odd):
            half += np.array(render(FIRST_SEED + self.count))
            self.count += 1
        self.path.parent.mkdir(parents=True, exist_ok=True)
        temporary = self.path.with_name(f"{self.path.name}.{os.getpid()}.part")
        with open(temporary, "wb") as file:
            np.savez(file, even=self.even, odd=self.odd, count=self.count)
        temporary.replace(self.path)


def make_references(
    path: Path,
    scene: mi.Scene,
    lenses: list[pm.ThinLens],
    *,
    floor: float,
    encodings: tuple[Encoding, ...] = (lambda linear: linear,),
    most_seeds: int = 64,
    spp: int = 289,
    lamps: str | None = None,
) -> list[Reference]:
    """One for each lens: kept ones, and as many seeds more as they need.

    ``scene`` was loaded from ``path``; ``spp`` samples a pixel are taken with each seed, until
    the noise is at ``floor`` dB in each of the ``encodings``. Lamps are the shapes whose names
    begin with ``lamps``; see :class:`LampLight`.
    """
    size = tuple(int(n) for n in scene.sensors()[0].film().crop_size())
    references = [Reference.open(kept_at(path, size, lens, spp), size, spp) for lens in lenses]

    def lowest(reference: Reference) -> float:
        return min(reference.floor_as(encoding) for encoding in encodings)

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[state]}"),
        TimeElapsedColumn(),
    )
    with LampLight(scene, lamps) as light, Progress(*columns, console=console) as progress:
        for lens, reference in zip(lenses, references, strict=True):
            kept = reference.count
            # Noise in dB does not tell how far there is to go, but seeds do, roughly.
            task = progress.add_task(
                f"{path.stem}, f/{lens.f_number:g}, {lens.focus_distance:g}",
                total=None,
                state="first pair of seeds",
            )
            while lowest(reference) < floor and reference.count < most_seeds:
                reference.add_pair(
                    lambda seed, lens=lens: (
                        np.array(thinlens(scene, lens, spp, seed)()) + light.through(lens, seed)
                    )
                )
                needed = reference.count * 10 ** ((floor - lowest(reference)) / 10)
                progress.update(
                    task,
                    completed=reference.count,
                    total=min(max(needed, reference.count), most_seeds),
                    state=f"{reference.count} seeds, noise floor {lowest(reference):.1f} dB",
                )
            state = f"{reference.count} seeds ({kept} kept), noise floor {lowest(reference):.1f} dB"
            progress.update(task, completed=1, total=1, state=state)
    return references


def thinlens(
    scene: mi.Scene, lens: pm.ThinLens, spp: int, seed: int, sampler: str = "orthogonal"
) -> Callable[[], mi.TensorXf]:
    """A function that renders with the built-in sensor at the place of the scene's."""
    equivalent = thinlens_sensor(scene.sensors()[0], lens, sampler=sampler, spp=spp)
    spp = equivalent.sampler().sample_count()
    nested = scene.integrator().nested
    return lambda: mi.render(scene, sensor=equivalent, integrator=nested, spp=spp, seed=seed)


# ---------------------------------------------------------------- lamps


class LampLight:
    """The light of small lamps through a lens, sampled from their side.

    Lamps are discs parallel to the film that shine with a constant radiance and light nothing
    else. While in context they are dark, so that a rendering has all but their light, and
    :meth:`through` has that alone. With the film's box filter, both add up to the picture: seen
    from any one point of the lens, a lamp covers the same area of the film, all of it with the
    lamp's radiance. So points of the lamp and of the lens are drawn evenly, and where nothing
    stands between them, their share of that light falls on the film where the lens sends it.
    """

    def __init__(self, scene: mi.Scene, prefix: str | None) -> None:
        self.scene = scene
        self.camera = scene.sensors()[0].camera()
        shapes = [s for s in scene.shapes() if prefix is not None and s.id().startswith(prefix)]
        self.keys = [f"{shape.id()}.emitter.radiance.value" for shape in shapes]
        self.parameters = mi.traverse(scene)
        self.radiance = np.array([np.array(self.parameters[key]).ravel() for key in self.keys])
        place = np.linalg.inv(np.array(self.camera.to_world))
        to_camera = [
            place @ np.array(mi.traverse(s)["to_world"].matrix).reshape(4, 4) for s in shapes
        ]
        self.centers = np.array([matrix[:3, 3] for matrix in to_camera])
        self.radii = np.array([np.linalg.norm(matrix[:3, 0]) for matrix in to_camera])
        if not np.allclose([m[2, :2] for m in to_camera], 0, atol=1e-6):
            raise ValueError(f"{prefix}: lamps must be discs parallel to the film")

    def __enter__(self) -> LampLight:
        self._shine(np.zeros_like(self.radiance))
        return self

    def __exit__(self, *_: object) -> None:
        self._shine(self.radiance)

    def _shine(self, radiance: np.ndarray) -> None:
        for key, value in zip(self.keys, radiance, strict=True):
            self.parameters[key] = mi.Color3f(*(float(v) for v in value))
        self.parameters.update()

    def through(self, lens: pm.ThinLens, seed: int) -> np.ndarray:
        """What the lamps add to the picture of ``lens``, (H, W, 3)."""
        width, height = self.camera.film_size
        flat = dr.zeros(mi.Float, 3 * width * height)
        if len(self.radii) > 0:
            index = dr.arange(mi.UInt32, len(self.radii) * LAMP_SIDE**2)
            number = index // LAMP_SIDE**2
            pixel, seen = self._landing(lens, number, index - number * LAMP_SIDE**2, seed)
            scale = self.camera.focal_length_pixels / self.centers[:, 2]
            pixels = math.pi * (self.radii * scale) ** 2
            for channel, radiance in enumerate(self.radiance.T):
                light = dr.gather(mi.Float, mi.Float(radiance * pixels / LAMP_SIDE**2), number)
                dr.scatter_add(flat, light, pixel * 3 + channel, seen)
        return np.array(flat).reshape(height, width, 3)

    def _landing(
        self, lens: pm.ThinLens, number: mi.UInt32, sample: mi.UInt32, seed: int
    ) -> tuple[mi.UInt32, mi.Bool]:
        """Pixels where samples of lamps fall, and which of them do so at all."""
        random = mi.PCG32(size=dr.width(number), initstate=seed)
        jitter, inside = (
            mi.Point2f(random.next_float32(), random.next_float32()) for _ in range(2)
        )
        row = sample // LAMP_SIDE
        even = (mi.Point2f(sample - row * LAMP_SIDE, row) + jitter) / LAMP_SIDE
        opening = mi.warp.square_to_uniform_disk_concentric(even) * lens.aperture_radius
        spot = mi.warp.square_to_uniform_disk_concentric(inside)
        spot *= dr.gather(mi.Float, mi.Float(self.radii), number)
        center = (dr.gather(mi.Float, mi.Float(axis), number) for axis in self.centers.T)
        lamp = mi.Point3f(*center) + mi.Point3f(spot.x, spot.y, 0)

        to_world = mi.Transform4f(np.array(self.camera.to_world))
        origin = to_world @ mi.Point3f(opening.x, opening.y, 0)
        ray = mi.Ray3f(origin, to_world @ lamp - origin, 1 - 1e-4, 0.0, [])
        slope = mi.Point2f(lamp.x, lamp.y) / lamp.z
        slope += opening * (1 / lens.focus_distance - 1 / lamp.z)
        width, height = self.camera.film_size
        # In camera space x is to the left and y up.
        x = width / 2 - slope.x * self.camera.focal_length_pixels
        y = height / 2 - slope.y * self.camera.focal_length_pixels
        on_film = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        pixel = mi.UInt32(dr.maximum(y, 0)) * width + mi.UInt32(dr.maximum(x, 0))
        return pixel, on_film & ~self.scene.ray_test(ray, on_film)


# ---------------------------------------------------------------- where references are kept


def kept_at(path: Path, size: tuple[int, int], lens: pm.ThinLens, spp: int) -> Path:
    """The file of a reference, named by all that it depends on."""
    width, height = size
    resolution = f"{width}" if width == height else f"{width}x{height}"
    unit = {1.0: "mm", 1000.0: "m"}.get(lens.millimeters_per_unit, "")
    return FOLDER / (
        f"{scene_version(path)}_{resolution}_f{lens.f_number:g}_{lens.focus_distance:g}{unit}"
        f"_{spp}spp.npz"
    )


def scene_version(path: Path) -> str:
    """A digest of the scene, so that no reference outlives a change to it.

    Left out is what has no part in a reference: comments, the integrator `focus` around the
    nested one, the sampler, and what the name of the file tells: resolution and focus.
    """
    trees = list(scene_trees(path))
    for tree in trees:
        strip(tree)
    used = "".join(
        ElementTree.tostring(child, encoding="unicode")
        for tree in trees
        for child in tree
        if child.tag != "default"
    )
    digest = hashlib.sha256(mi.__version__.encode())
    for tree in trees:
        for default in tree.findall("default"):
            if f"${default.get('name')}" not in used:
                tree.remove(default)
        text = ElementTree.tostring(tree, encoding="unicode")
        digest.update(ElementTree.canonicalize(text, strip_text=True).encode())
    folders = [path.parent]
    folders += [path.parent / e.get("value", "") for tree in trees for e in tree.findall("path")]
    for tree in trees:
        for element in tree.iter("string"):
            files = (folder / element.get("value", "") for folder in folders)
            file = next(filter(Path.is_file, files), None)
            if element.get("name") == "filename" and file is not None:
                digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def scene_trees(path: Path, folder: Path | None = None) -> Iterator[ElementTree.Element]:
    """The scene file and those that it includes, whose names are relative to its folder."""
    folder = folder or path.parent
    root = ElementTree.parse(path).getroot()
    yield root
    for include in root.iter("include"):
        yield from scene_trees(folder / include.get("filename", ""), folder)


def strip(root: ElementTree.Element) -> None:
    """Take out what has no part in a reference."""
    for integrator in root.findall("integrator"):
        if integrator.get("type") == "focus":
            place = list(root).index(integrator)
            root.remove(integrator)
            root.insert(place, integrator.find("integrator"))
    for sensor in root.findall("sensor"):
        film = sensor.find("film")
        for parent, names in (
            (sensor, ("f_number", "focus_distance")),
            (film, ("width", "height")),
        ):
            for child in [c for c in parent or () if c.get("name") in names or c.tag == "sampler"]:
                parent.remove(child)
