"""An exposure: samples at several instants of it, each of which knows its path between them.

Mitsuba has no motion: the scene is posed for each instant, and sampled as one that stands still.
What a shape, or the camera, does during the part of the exposure that a sample stands for moves
the sample along with its surface, as section 3.1 of Potmesil & Chakravarty (1981) has in mind.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import mitsuba as mi
import numpy as np

from .._progress import reported
from ..motion.motion import Motion
from ..motion.shutter import Shutter
from ..optics.camera import Camera
from ..optics.camera.vectors import transform_points
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens
from ..samples.columns import Columns
from ..samples.point_samples import PointSamples
from ..samples.raster import Window
from .passes import sample_count
from .posing import PosedShapes
from .sensor import placed
from .shapes import registry_index, surface_ids
from .sweeping import Ends, Sweep

LONGEST_PATH = 10.0
"""Pixels that a sample moves in the part of the exposure that it stands for, where there may be as
many instants as that takes."""

MOST_INSTANTS = 16
"""Most instants, unless more are asked for."""

PROBES = 64
"""Rays on a side of the crop window that look for the longest path in it."""

PROBED = 5
"""Times at which they do."""

LEAST_PATH = 0.01
"""Pixels below which nothing moves: blur of that length changes no pixel by more than 1e-3."""

STEPS = 16
"""Steps of the exposure in which paths are followed: they may come back to where they began."""

LEAST_INSTANTS = 4
"""Instants, at least, of a shutter that is not open wholly all the time."""

LONGEST = 2.0
"""Longest path of a sample during its part of the exposure, in diagonals of the picture."""

MOST_CHANGE = 1.9
"""Most change of a depth meanwhile, as a part of it: half of it is before, and half after."""

TINY = 1e-12
"""What is added up to so much is nothing."""

LEAST_CHANGE = 1e-4
"""Part of its depth by which a thing comes nearer or goes away, at least."""

BEYOND = 1e4
"""How far what is infinitely far is, for its path, in multiples of the farthest depth."""

Sampled = Callable[[int, int, "Sweep | None"], PointSamples]
"""Samples of the scene as it is posed: how many a pixel, of which seed, and what moves."""


class _Part(NamedTuple):
    """A part of an exposure: the frames at which it begins, is half over in light, and ends."""

    begin: float
    middle: float
    end: float


def exposed(
    scene: mi.Scene, sensor: mi.Sensor, motion: Motion, spp: int, seed: int, sampled: Sampled
) -> PointSamples:
    """Samples of an exposure, ``spp`` a pixel in all of its instants.

    ``sensor`` is a ``potmesil`` or ``potmesil_orthographic``. The scene and the sensor are left as
    they were found.
    """
    poses = _Poses(scene, sensor, motion)
    try:
        shutter = motion.shutter_of(poses.camera)
        whole = _parts(shutter, motion.frame, 1)[0]
        longest = poses.longest_path(whole)
        moves = longest >= LEAST_PATH
        count = shutter.instants
        if count is None:
            count = min(math.ceil(longest / LONGEST_PATH), MOST_INSTANTS)
            if shutter.profile != "box" and moves:
                count = max(count, LEAST_INSTANTS)
        count = max(1, min(count, spp))
        reach = min(longest / count, poses.diagonal) / 2
        found = []
        with reported() as report:
            for i, part in enumerate(_parts(shutter, motion.frame, count)):
                report("Exposing", i / count)
                poses.place(part.middle)
                share = sample_count(sensor.sampler(), spp // count + (i < spp % count))
                sweep = poses.sweep(part, reach) if moves else None
                samples = sampled(share, _seed(seed, i), sweep)
                if moves:
                    samples = _in_motion(samples, poses, part, (i + 0.5) / count)
                found.append(samples)
        poses.place(whole.middle)
        return _joined(found, sensor.camera(), sensor.lens())
    finally:
        poses.restore()


def require_motions(scene: mi.Scene, sensor: mi.Sensor, motions: Sequence[Motion]) -> None:
    """Raise what :func:`exposed` would raise for motions, of the same shapes, of an animation."""
    centres, camera = PosedShapes(scene, motions[0].shapes).centres, sensor.camera()
    for motion in motions:
        for part in _parts(motion.shutter_of(camera), motion.frame, 1):
            for frame in part:
                motion.camera_at(camera, frame)
                motion.transforms_at(centres, frame)


def _parts(shutter: Shutter, frame: float, count: int) -> list[_Part]:
    """``count`` parts of an exposure in which equally much light comes in."""
    at = [frame + shutter.frame_when(i / (2 * count)) for i in range(2 * count + 1)]
    return [_Part(*at[2 * i : 2 * i + 3]) for i in range(count)]


def _seed(seed: int, instant: int) -> int:
    """The seed of an instant: that of the picture for the first."""
    if instant == 0:
        return seed
    return int(mi.sample_tea_32(mi.UInt32(seed), mi.UInt32(instant ^ 0x5EED))[0][0])


class _Seen(NamedTuple):
    """What the pinhole sees at a ``frame``: pixels, depth and ids of surfaces, (N,) each."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    surface: np.ndarray
    frame: float


class _Poses:
    """A scene and its sensor, which can be posed for any frame."""

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, motion: Motion) -> None:
        self.scene, self.sensor, self.motion = scene, sensor, motion
        self.shapes = PosedShapes(scene, motion.shapes)
        self.camera: Camera = sensor.camera()
        self.ids, surfaces = surface_ids(scene)
        self.surface_count = max(surfaces)
        self.moving = {id_: name for id_, name in surfaces.items() if name in motion.shapes}

    def place(self, frame: float) -> None:
        """Pose the scene."""
        if self.motion.camera is not None:
            placed(self.sensor, self.motion.camera_at(self.camera, frame))
        if self.motion.shapes:
            self.shapes.place(self._transforms(frame))

    def restore(self) -> None:
        """Put everything back to where it was."""
        if self.motion.camera is not None:
            placed(self.sensor, self.camera)
        if self.motion.shapes:
            self.shapes.place({})

    @property
    def diagonal(self) -> float:
        """Of the crop window, in pixels."""
        return math.hypot(*self.camera.crop_size)

    def paths(self, seen: _Seen, frames: Sequence[float]) -> Iterator[np.ndarray]:
        """By how much x, y and z change from each of the ``frames`` to the next, float64 (N, 3).

        A path ends where it comes as near as the near clipping plane, and is no longer than
        ``LONGEST`` diagonals.
        """
        far = ~np.isfinite(seen.z)
        depth = seen.z.astype(np.float64)
        depth[far] = BEYOND * max(depth[~far].max(initial=0.0), 1.0)
        pixels = np.stack([seen.x, seen.y], axis=-1).astype(np.float64)
        camera = self.motion.camera_at(self.camera, seen.frame)
        own = np.asarray(camera.camera_from_pixel(pixels, depth))
        world = transform_points(camera.world_from_camera(), own)
        places = (self._places(seen, own, world, frame) for frame in frames)
        for before, after in itertools.pairwise(places):
            path = after - before
            path[far, 2] = 0
            if self.camera.projection == "orthographic":
                path[far] = 0  # What is infinitely far is the same all over the picture.
            length = np.maximum(np.hypot(path[:, 0], path[:, 1]), TINY)
            deeper = np.maximum(np.abs(path[:, 2]), TINY)
            part = np.minimum(LONGEST * self.diagonal / length, MOST_CHANGE * depth / deeper)
            yield path * np.minimum(part, 1)[:, None]

    def _places(self, seen: _Seen, own: np.ndarray, world: np.ndarray, frame: float) -> np.ndarray:
        """Where what is ``seen`` is in the picture at a frame, x, y and z, (N, 3).

        ``own`` and ``world``, (N, 3), are where it is to the camera and in the world when it is
        seen.
        """
        camera, moved = self.motion.camera_at(self.camera, frame), world.copy()
        for id_, matrix in self._since(seen.frame, frame).items():
            which = seen.surface == id_
            moved[which] = transform_points(matrix, world[which])
        there = transform_points(camera.camera_from_world(), moved)
        depth = own[:, 2]
        near = np.minimum(camera.near_clip, depth)
        apart = depth - there[:, 2]
        part = np.where(there[:, 2] < near, (depth - near) / np.maximum(apart, TINY), 1)
        there = own + part[:, None] * (there - own)
        return np.column_stack([camera.pixel_from_camera(there), there[:, 2]])

    def _since(self, before: float, frame: float) -> dict[int, np.ndarray]:
        """What has moved surfaces, by their ids, since the frame ``before``: matrices (4, 4)."""
        first, last = self._transforms(before), self._transforms(frame)
        return {id_: last[name] @ np.linalg.inv(first[name]) for id_, name in self.moving.items()}

    def sweep(self, part: _Part, reach: float) -> Sweep:
        """What moves in a part of an exposure, things by up to ``reach`` pixels to each side."""
        own = np.linalg.inv(self._view(part.middle))
        ends = [
            Ends(self._since(part.middle, frame), self._view(frame) @ own)
            for frame in (part.begin, part.end)
        ]
        return Sweep.of(reach, self.surface_count, ends)

    def _view(self, frame: float) -> np.ndarray:
        """Where the camera stands and looks at a frame, (4, 4)."""
        return self.motion.camera_at(self.camera, frame).world_from_camera()

    def _transforms(self, frame: float) -> dict[str, np.ndarray]:
        """The matrices of shapes that move, by their names."""
        return self.motion.transforms_at(self.shapes.centres, frame)

    def longest_path(self, exposure: _Part) -> float:
        """The longest path in the picture, in pixels, of what moves during it.

        It is that of what is met in the crop window at some times, by how much circles of confusion
        change on it included, or that of the corners of a shape that moves, wherever it is.
        """
        if exposure.begin == exposure.end:
            return 0.0
        frames = np.linspace(exposure.begin, exposure.end, STEPS + 1).tolist()
        longest = self._longest_of_corners(frames)
        for frame in np.linspace(exposure.begin, exposure.end, PROBED).tolist():
            self.place(frame)
            seen = self._probed(frame)
            total = np.zeros(len(seen.z))
            for path in self.paths(seen, frames):
                length = np.hypot(path[:, 0], path[:, 1]) + self._blur_of(seen.z, path[:, 2])
                total += np.minimum(length, self.diagonal)
            longest = max(longest, float(total.max(initial=0)))
        return longest

    def _blur_of(self, z: np.ndarray, deeper: np.ndarray) -> np.ndarray:
        """By how much circles change, in pixels of radius, where depths z change, (N,)."""
        lens: ThinLens | TelecentricLens = self.sensor.lens().plain()
        if isinstance(lens, TelecentricLens):
            return np.abs(deeper) * float(lens.slope) * self.camera.pixels_per_unit
        radius = float(lens.aperture_radius) * self.camera.focal_length_pixels
        near = np.maximum(z - np.abs(deeper) / 2, self.camera.near_clip)
        return radius * np.abs(deeper) / near**2

    def _longest_of_corners(self, frames: Sequence[float]) -> float:
        """The longest path of corners of the bounding boxes of shapes that move, in pixels.

        It is as long as if they moved across the line of sight.
        """
        longest = 0.0
        for name in self.motion.shapes:
            corners, total = self.shapes.corners(name), 0.0
            places = [transform_points(self._transforms(frame)[name], corners) for frame in frames]
            for frame, (before, after) in zip(frames, itertools.pairwise(places), strict=False):
                camera = self.motion.camera_at(self.camera, frame)
                apart = np.linalg.norm(after - before, axis=1)
                if camera.projection == "orthographic":
                    pixels = apart * camera.pixels_per_unit
                else:
                    away = np.linalg.norm(before - camera.world_from_camera()[:3, 3], axis=1)
                    pixels = apart * camera.focal_length_pixels / np.maximum(away, camera.near_clip)
                total += min(float(pixels.max()), self.diagonal)
            longest = max(longest, total)
        return longest

    def _probed(self, frame: float) -> _Seen:
        """What is met in the crop window at a frame."""
        camera = self.motion.camera_at(self.camera, frame)
        (left, top), (width, height) = camera.crop_offset, camera.crop_size
        middles = (np.arange(PROBES) + 0.5) / PROBES
        x, y = (of.ravel() for of in np.meshgrid(left + middles * width, top + middles * height))
        ends = [
            np.asarray(camera.world_from_pixel(np.stack([x, y], axis=-1), np.full(x.shape, depth)))
            for depth in (camera.near_clip, 2 * camera.near_clip)
        ]
        per_depth = (ends[1] - ends[0]) / camera.near_clip
        length = np.linalg.norm(per_depth, axis=1)
        ray = mi.Ray3f(
            mi.Point3f(*(mi.Float(of.astype(np.float32)) for of in ends[0].T)),
            mi.Vector3f(*(mi.Float(of.astype(np.float32)) for of in (per_depth.T / length))),
        )
        hit = self.scene.ray_intersect(ray, coherent=True, ray_flags=mi.RayFlags.All)
        z = camera.near_clip + np.array(hit.t).astype(np.float64) / length
        index = np.where(np.isfinite(z), np.array(registry_index(hit)), 0)
        surface = np.where(np.isfinite(z), np.array(self.ids)[index], 0)
        return _Seen(x, y, z, surface, frame)


def _in_motion(samples: PointSamples, poses: _Poses, part: _Part, time: float) -> PointSamples:
    """Samples of the ``part`` of an exposure that is half over at a ``time`` of it, 0 to 1."""
    surface = samples.surface
    if samples.through is not None:
        # An image moves with the camera, and not as the thing that it is of.
        surface = np.where(samples.through > 0, 0, surface)
    which = np.arange(len(samples))
    if poses.motion.camera is None:
        which = np.flatnonzero(np.isin(surface, list(poses.moving)))
    path = np.zeros((len(samples), 3), np.float32)
    if len(which) > 0:
        places = samples.x[which], samples.y[which], samples.z[which], surface[which]
        (path[which],) = poses.paths(_Seen(*places, part.middle), (part.begin, part.end))
    moves = np.hypot(path[:, 0], path[:, 1]).max(initial=0) >= LEAST_PATH
    moves |= bool((np.abs(path[:, 2]) >= LEAST_CHANGE * samples.z).any())
    return samples.replace(
        time=np.full(len(samples), time, np.float32),
        motion=path if moves else None,
    )


def _joined(
    found: list[PointSamples], camera: Camera, lens: ThinLens | TelecentricLens
) -> PointSamples:
    """The samples of the instants of an exposure as one: each has its part of a pixel's area.

    ``camera`` and ``lens`` are those at the middle of the exposure.
    """
    if len(found) == 1:
        return found[0] if found[0].motion is not None else found[0].replace(time=None)
    columns = Columns.joined(found)
    weight = columns.weight / np.float32(len(found))
    names: Mapping[int, str] = found[0].surfaces
    known = next((of.visibility_radius for of in found if of.visibility is not None), None)
    provenance = dict(found[0].provenance)
    provenance |= {"instants": len(found), "spp": sum(int(of.provenance["spp"]) for of in found)}
    return PointSamples(
        **vars(dataclasses.replace(columns, weight=weight)),
        camera=camera,
        lens=lens,
        surfaces=names,
        lattice=found[0].lattice,
        window=_around([of.window for of in found]),
        visibility_radius=known if columns.visibility is not None else None,
        provenance=provenance,
        aov_names=found[0].aov_names,
    )


def _around(windows: list[Window]) -> Window:
    """The least window that covers all."""
    left, top = min(of.left for of in windows), min(of.top for of in windows)
    right, bottom = max(of.right for of in windows), max(of.bottom for of in windows)
    return Window(left, top, right - left, bottom - top)
