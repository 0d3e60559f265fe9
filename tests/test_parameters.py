"""Every public callable refuses wrong types and values by name, and gives no NaN.

A row of ``ROWS`` is a call that succeeds. Each of its parameters in turn takes every value of
``WRONG``: then the call either succeeds, and nothing in its result is NaN, or it raises an error
that names the parameter, shows the value and says what is allowed, in few words. A callable without
a row, and a parameter that its row does not have, fails. So do the parameters of plugins, in a
scene and where ``mi.traverse`` shows them.
"""

from __future__ import annotations

import builtins
import contextlib
import dataclasses
import functools
import importlib
import inspect
import itertools
import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi._image import write_picture
from potmesil_mi.living.page import read_pictures
from potmesil_mi.optics.lens import LensChanges
from potmesil_mi.plugins import PLUGINS
from scenes import still_life, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")


def a_function(*_, **__):
    raise AssertionError("is not to be called")


class Shown:
    """An object of no use."""

    def __repr__(self):
        return "an object"


WRONG = {
    "None": None,
    "True": True,
    "text": "text",
    "empty text": "",
    "bytes": b"",
    "object": Shown(),
    "function": a_function,
    "class": Shown,
    "[]": [],
    "()": (),
    "{}": {},
    "nan": math.nan,
    "inf": math.inf,
    "-inf": -math.inf,
    "-1": -1,
    "0": 0,
    "0.5": 0.5,
    "1e-320": 1e-320,
    "1e300": 1e300,
    "10**400": 10**400,
    "10**5000": 10**5000,
    "1j": 1j,
    "array": np.ones((2, 3, 1)),
    "array of text": np.array(["text"]),
    "array of nan": np.array([math.nan]),
    "too long": [1.0] * 7,
    "of None": [None, None],
    "of nan": (math.nan,) * 3,
    "of text": {"text": "text"},
}

SHAPES = r"shape \(|components"
SHOWN = {
    "None": "None|must be given",
    "text": "text|'t'",
    "empty text": "''",
    "function": "<function a_f",
    "class": "class .*Shown",
    "[]": rf"\[\]|{SHAPES}",
    "()": rf"\(\)|\[\]|{SHAPES}",
    "{}": r"\{\}|must be given|must have",
    "inf": "(?<!-)inf",
    "0": r"(?<![\d.])0(\.0)?(?![\d.])",
    "1e-320": r"1\.?\d*e-320|9\.99989e-321",
    "1e300": r"1\.?\d*e\+?300",
    "10**400": r"10{10,}\.\.\.0{10,}|10{18}|1e\+18",
    "10**5000": "16610 bits",
    "array": r"\[\[1|\[1|shape \(2, 3, 1\)|components|1\.0",
    "array of text": "text",
    "array of nan": rf"nan|{SHAPES}",
    "too long": rf"1\.0|{SHAPES}",
    "of None": "None",
    "of nan": rf"nan|{SHAPES}",
    "of text": "text|must be given",
}
"""How errors show a value of ``WRONG``, as regular expressions, where it is not by its ``repr``."""

ALLOWED = r"\b(must|needs)\b|there is no such file|not a (parameter|field) of .*, which has"
"""What every refusal says, as a regular expression: what would not have been refused."""

SHOWN_BY_MITSUBA = {
    "True": r"=1\.0",
    "empty text": r"=\[\]",
    "1e-320": r"=0\.0",
    "1e300": "inf",
    "10**400": r"9\.99\d*e\+17",
}
"""The same of what Mitsuba may have made of them: arrays, and numbers of 32 bits."""

LONGEST = 400
"""Characters of an error, without the names of files."""

CALLED = {
    "filters": "filters?",
    "filter_2": "filter(_2)?",
    "values": "values|text|[a-z_]+: must be given",
}
"""Parameters that errors call otherwise, as regular expressions: those of filters speak of the
filter, those of tables of what is unknown or missing in them."""

OF_SCENES = {
    name: value
    for name, value in WRONG.items()
    if type(value) in (bool, str, int, float) and name != "10**5000"
} | {"10**400": 10**18}
"""What a scene can say of a plugin's parameter."""


class Row(NamedTuple):
    """A call that succeeds, and how its errors call what its signature calls otherwise."""

    function: Callable[..., Any]
    arguments: Mapping[str, Any]
    called: Mapping[str, str] = {}
    """By regular expressions."""
    extra: Mapping[str, Any] = {}
    """Names that ``**`` of the signature stands for, ``...`` where the call must not have them."""
    refused: str = ""
    """What the call itself is refused for, after its parameters are checked: it would be long."""


LENS_OPTIONS = {
    "focus_distance": 2.0,
    "millimeters_per_unit": 1000.0,
    "film": "focal",
    "aperture": "disc",
    "squeeze": 1.0,
    "vignetting": 0.0,
}
LENS_VALUES = {"focal_length": 50.0, "f_number": 2.0, "frame_width": 36.0, **LENS_OPTIONS}
TRACK = pm.Track.of([[0, 1.0], [10, 2.0]])
VECTOR = pm.VectorTrack.of([1.0, 2.0, 3.0])
CAMERA = synthetic(1).camera
THIN = synthetic(1).lens
TELECENTRIC = pm.TelecentricLens(2.0, 2.0)
SHUTTER = pm.Shutter()
MOTION = pm.Motion(pm.CameraMove(pan=TRACK), {"one": pm.ShapeMove(angle=TRACK)}, SHUTTER)
ANIMATION = pm.Animation(
    range(3), {"f_number": TRACK}, (pm.AnimatedFilter("fade", {"amount": 0.5}),)
)
CENTRES = {"one": np.zeros(3)}
PICTURE = np.full((4, 6, 3), 0.5)


def few(**fields):
    return synthetic(60, size=(6, 4), **fields)


SAMPLES = few()
FOCUS = {
    "lens": THIN,
    "psf": pm.Disc(),
    "rfilter": None,
    "alpha": False,
    "filters": ["fade:amount=0.5"],
}
POINTS = np.array([[0.1, 0.2, 3.0]])


def columns():
    """The columns that samples may have, all of them."""
    some = few()
    count = len(some)
    return {
        **fields_of(some),
        "through": np.zeros(count),
        "visibility": np.ones(count, np.uint64),
        "albedo": np.ones((count, 3)),
        "normal": np.zeros((count, 3)),
        "time": np.zeros(count),
        "motion": np.zeros((count, 3)),
        "visibility_radius": (0.1, 0.1),
        "aovs": np.zeros((count, 2)),
        "aov_names": ("dd.T", "si.I"),
    }


def fields_of(value):
    """The parameters of a dataclass; what begins with _ is the package's own."""
    own = [f.name for f in dataclasses.fields(value) if f.init and f.name[0] != "_"]
    return {name: getattr(value, name) for name in own}


class Things:
    """What rows need of files and scenes, made where it is asked for."""

    def __init__(self, folder):
        self.folder = folder

    def place(self, name):
        return str(self.folder / name)

    def _text(self, name, text):
        (self.folder / name).write_text(text, encoding="utf-8")
        return self.place(name)

    @functools.cached_property
    def motion_file(self):
        return self._text("motion.toml", "[shutter]\nclose = 1\n")

    @functools.cached_property
    def animation_file(self):
        return self._text("animation.toml", "frames = 3\n")

    @functools.cached_property
    def aperture_file(self):
        write_picture(np.ones((4, 4, 3)), self.place("aperture.png"))
        return self.place("aperture.png")

    @functools.cached_property
    def picture_file(self):
        write_picture(PICTURE, self.place("picture.exr"), maps={"Z": np.full((4, 6), 2.0)})
        return self.place("picture.exr")

    @functools.cached_property
    def page_file(self):
        pm.living_picture(SAMPLES, self.place("in.html"), f_numbers=[0.2], psnr=25.0)
        return self.place("in.html")

    @functools.cached_property
    def samples_file(self):
        SAMPLES.save(self.place("in.samples"))
        return self.place("in.samples")

    @functools.cached_property
    def scene(self):
        return still_life(spp=1)

    @functools.cached_property
    def small_scene(self):
        return still_life(spp=1, film={"width": 6, "height": 4})

    @functools.cached_property
    def perspective(self):
        return mi.load_dict({"type": "perspective"})

    @functools.cached_property
    def comparison(self):
        rendering = pm.evaluation.Rendering(PICTURE, 4.0, 1.0, 1.0, 0.1, 0.9, 0.1)
        return pm.evaluation.Comparison(
            focused=rendering,
            pinhole=rendering,
            equal_samples=rendering,
            equal_error=rendering,
            needed=pm.evaluation.EqualError(4.0, 1.0),
            sampler="multijitter",
            sampling=(1.0, 1.0),
            denoising=None,
            noise=0.1,
            bias=(0.1, 0.1),
            first_picture=1.0,
            point_samples=60,
            reference=PICTURE,
            reference_spp=4,
            floor=60.0,
            lens=THIN,
            method="layered",
        )

    @functools.cached_property
    def session(self):
        return pm.FocusSession(SAMPLES)


@pytest.fixture(scope="session")
def it(tmp_path_factory):
    return Things(tmp_path_factory.mktemp("parameters"))


FROM_IMAGE = {
    "rgb": PICTURE,
    "depth": np.full((4, 6), 2.0),
    "camera": 40.0,
    "lens": THIN,
    "depth_kind": "z",
    "near": None,
    "far": math.inf,
    "clip": "opengl",
    "reverse": False,
    "background": 9.0,
    "depth_scale": 1.0,
    "surface": np.ones((4, 6), np.uint32),
    "surfaces": {1: "one"},
    "antialiased": True,
    "hidden": "farther",
    "layer": None,
    "depth_channel": None,
}

ROWS: dict[str, Callable[[Things], Row]] = {
    "ThinLens": lambda it: Row(pm.ThinLens, {**LENS_VALUES, "aperture_radius": None}),
    "ThinLens by its radius": lambda it: Row(
        pm.ThinLens, {**LENS_VALUES, "f_number": None, "aperture_radius": 0.01, "film": "focused"}
    ),
    "ThinLens.of_field_of_view": lambda it: Row(
        pm.ThinLens.of_field_of_view,
        {"fov": 40.0, "focal_length": 50.0, "frame_width": None},
        extra={"f_number": 2.0, "aperture_radius": None, **LENS_OPTIONS},
    ),
    "ThinLens.of_field_of_view by the frame": lambda it: Row(
        pm.ThinLens.of_field_of_view,
        {"fov": 40.0, "focal_length": None, "frame_width": 36.0},
        extra={"f_number": None, "aperture_radius": 0.01, **LENS_OPTIONS, "film": "focused"},
    ),
    "ThinLens.from_dict": lambda it: Row(pm.ThinLens.from_dict, {"values": THIN.to_dict()}),
    "ThinLens.replace": lambda it: Row(
        THIN.replace, {}, extra={**LENS_VALUES, "aperture_radius": None, "half_angle": ...}
    ),
    "ThinLens.in_units": lambda it: Row(THIN.in_units, {"millimeters_per_unit": 10.0}),
    "ThinLens.image_distance": lambda it: Row(THIN.image_distance, {"depth": 3.0}),
    "ThinLens.circle_of_confusion": lambda it: Row(THIN.circle_of_confusion, {"depth": 3.0}),
    "ThinLens.hyperfocal_distance": lambda it: Row(THIN.hyperfocal_distance, {"acuity": 1e-3}),
    "ThinLens.depth_of_field": lambda it: Row(THIN.depth_of_field, {"acuity": 1e-3}),
    "TelecentricLens": lambda it: Row(pm.TelecentricLens, fields_of(TELECENTRIC)),
    "TelecentricLens.from_dict": lambda it: Row(
        pm.TelecentricLens.from_dict, {"values": TELECENTRIC.to_dict()}
    ),
    "TelecentricLens.replace": lambda it: Row(
        TELECENTRIC.replace,
        {},
        extra={
            **fields_of(TELECENTRIC),
            **dict.fromkeys(LensChanges.__annotations__.keys() - fields_of(TELECENTRIC), ...),
        },
    ),
    "TelecentricLens.circle_of_confusion": lambda it: Row(
        TELECENTRIC.circle_of_confusion, {"depth": 3.0}
    ),
    "TelecentricLens.depth_of_field": lambda it: Row(TELECENTRIC.depth_of_field, {"circle": 0.1}),
    "Disc": lambda it: Row(pm.Disc, {}),
    "Polygon": lambda it: Row(pm.Polygon, fields_of(pm.Polygon())),
    "Lommel": lambda it: Row(pm.Lommel, fields_of(pm.Lommel())),
    "ImageAperture": lambda it: Row(pm.ImageAperture, {"transmission_map": np.ones((3, 3))}),
    "ImageAperture.load": lambda it: Row(pm.ImageAperture.load, {"filename": it.aperture_file}),
    "aperture_of": lambda it: Row(
        pm.aperture_of, {"description": "polygon:blades=5"}, {"description": "aperture"}
    ),
    "parse_filter": lambda it: Row(pm.parse_filter, {"text": "star"}, {"text": "filter"}),
    "Camera": lambda it: Row(pm.Camera, fields_of(CAMERA)),
    "Camera.from_dict": lambda it: Row(pm.Camera.from_dict, {"values": CAMERA.to_dict()}),
    "Camera.looking_at": lambda it: Row(
        pm.Camera.looking_at,
        {
            "eye": (0, 0, 0),
            "target": (0, 0, 1),
            "up": (0, 1, 0),
            "film_size": (6, 4),
            "x_fov": 40.0,
        },
        extra={
            name: value
            for name, value in fields_of(CAMERA).items()
            if name not in ("film_size", "x_fov", "to_world", "crop_size")
        }
        | {"crop_size": (6, 4)},
    ),
    **{
        f"Camera.{name}": lambda it, name=name: Row(getattr(CAMERA, name), {"axes": "mitsuba"})
        for name in ("camera_from_world", "clip_from_camera", "world_from_camera")
    },
    "Camera.camera_from_pixel": lambda it: Row(
        CAMERA.camera_from_pixel, {"pixels": [[3.0, 2.0]], "depth": 2.0, "axes": "mitsuba"}
    ),
    "Camera.world_from_pixel": lambda it: Row(
        CAMERA.world_from_pixel, {"pixels": [[3.0, 2.0]], "depth": 2.0}
    ),
    "Camera.depth_from_world": lambda it: Row(CAMERA.depth_from_world, {"points": POINTS}),
    "Camera.pixel_from_camera": lambda it: Row(
        CAMERA.pixel_from_camera, {"points": POINTS, "axes": "mitsuba", "behind": "refuse"}
    ),
    "Camera.pixel_from_world": lambda it: Row(
        CAMERA.pixel_from_world, {"points": POINTS, "behind": "refuse"}
    ),
    "Window.of": lambda it: Row(
        pm.Window.of, {"values": (0, 0, 6, 4), "name": "window"}, {"values": "window"}
    ),
    "Window.tiles": lambda it: Row(pm.Window(0, 0, 6, 4).tiles, {"size": 2}),
    "Star": lambda it: Row(pm.Star, fields_of(pm.Star())),
    "Diffraction": lambda it: Row(pm.Diffraction, fields_of(pm.Diffraction())),
    "Defocus": lambda it: Row(pm.Defocus, {"radius": 0.1}),
    "Fade": lambda it: Row(pm.Fade, fields_of(pm.Fade(0.5))),
    "apply_filters": lambda it: Row(
        pm.apply_filters,
        {
            "picture": PICTURE,
            "filters": ["star", "fade:amount=0.5"],
            "lens": THIN,
            "pixels_per_mm": 0.5,
        },
    ),
    "Equation20": lambda it: Row(pm.Equation20, fields_of(pm.Equation20())),
    "Layered": lambda it: Row(pm.Layered, fields_of(pm.Layered())),
    "LightField": lambda it: Row(pm.LightField, fields_of(pm.LightField())),
    "focus": lambda it: Row(
        pm.focus,
        {
            "samples": SAMPLES,
            **FOCUS,
            "method": "layered",
            "lens_points": 4,
            "tables": 3,
            "inverse_square": False,
            "squares": 1,
            "tiles": (2, 1),
        },
    ),
    "focus_distance_at": lambda it: Row(
        pm.focus_distance_at, {"samples": SAMPLES, "x": 2.5, "y": 1.5}
    ),
    "focus_distance_of": lambda it: Row(
        pm.focus_distance_of, {"samples": SAMPLES, "name": "center"}
    ),
    "interactive": lambda it: Row(
        pm.interactive,
        {
            "source": it.small_scene,
            "lens": THIN.replace(f_number=math.inf),
            "method": "layered",
            "filters": ["fade:amount=0.5"],
            "sensor": 0,
            "spp": 1,
            "seed": 0,
            "sampling": None,
        },
        refused="lens",
    ),
    "interactive of samples": lambda it: Row(
        pm.interactive,
        {
            "source": SAMPLES,
            "lens": THIN,
            "method": "layered",
            "filters": ["fade:amount=0.5"],
            "sensor": 0,
            "spp": 0,
            "seed": 0,
            "sampling": None,
        },
    ),
    "circle_map": lambda it: Row(pm.circle_map, {"samples": SAMPLES, "lens": THIN}),
    "FocusSession": lambda it: Row(
        pm.FocusSession, {"samples": SAMPLES, "method": "layered", "max_bytes": 1 << 20}
    ),
    "FocusSession.focus": lambda it: Row(it.session.focus, FOCUS),
    "Sampling": lambda it: Row(pm.Sampling, fields_of(pm.Sampling(focus_range=(1, 2), clamp=1.0))),
    "render_samples": lambda it: Row(
        pm.render_samples,
        {
            "scene": it.scene,
            "sensor": 0,
            "integrator": it.scene.integrator(),
            "spp": 1,
            "seed": 0,
            "sampling": pm.Sampling(refine=0, layers=1, overscan=0),
            "lens": None,
            "motion": None,
        },
    ),
    "potmesil_sensor": lambda it: Row(
        pm.potmesil_sensor,
        {"sensor": it.scene.sensors()[0]},
        extra={
            **LENS_VALUES,
            "f_number": 2.0,
            "frame_width": 40.0,
            "aperture_radius": None,
            "half_angle": ...,
        },
    ),
    "potmesil_sensor of a perspective": lambda it: Row(
        pm.potmesil_sensor,
        {"sensor": it.perspective},
        extra={
            **LENS_OPTIONS,
            "focal_length": 50.0,
            "frame_width": None,
            "f_number": 2.0,
            "aperture_radius": None,
            "half_angle": ...,
        },
    ),
    "PointSamples": lambda it: Row(pm.PointSamples, columns()),
    "PointSamples.replace": lambda it: Row(few(**columns()).replace, {}, extra=columns()),
    "PointSamples.from_image": lambda it: Row(pm.PointSamples.from_image, FROM_IMAGE),
    "PointSamples.from_image of a file": lambda it: Row(
        pm.PointSamples.from_image,
        {
            **FROM_IMAGE,
            "rgb": it.picture_file,
            "depth": None,
            "lens": {"f_number": 2.0, "focus_distance": 2.0, "millimeters_per_unit": 1000.0},
            "surface": None,
            "surfaces": None,
            "depth_channel": "Z",
        },
        {"camera": "camera|fov", "lens": "lens|must be given|text"},
    ),
    "PointSamples.crop": lambda it: Row(SAMPLES.crop, {"window": (1, 1, 3, 2), "halo": 1}),
    "PointSamples.merge": lambda it: Row(SAMPLES.merge, {"lens": THIN, "tolerance": 0.1}),
    "PointSamples.save": lambda it: Row(SAMPLES.save, {"path": it.place("out.samples")}),
    "PointSamples.load": lambda it: Row(pm.PointSamples.load, {"path": it.samples_file}),
    "PointSamples.chosen": lambda it: Row(SAMPLES.chosen, {"which": slice(0, 5)}),
    "aov_maps": lambda it: Row(pm.aov_maps, {"samples": SAMPLES}),
    "focus_aovs": lambda it: Row(
        pm.focus_aovs, {"samples": SAMPLES, "lens": THIN, "method": "layered", "rfilter": None}
    ),
    "motion_vectors": lambda it: Row(
        pm.motion_vectors,
        {"channels": np.ones((5, 2)), "convention": "pixels", "exposure": 0.5},
    ),
    "example": lambda it: Row(pm.example, {"name": "terrace"}),
    "progress": lambda it: Row(pm.progress, {"callback": a_function}),
    "Key": lambda it: Row(pm.Key, {"frame": 0.0, "value": 1.0, "easing": "ease"}),
    "Track": lambda it: Row(pm.Track, {"keys": TRACK.keys, "scale": "linear", "unit": "mm"}),
    "Track.of": lambda it: Row(
        pm.Track.of, {"value": 1.0, "scale": "linear"}, {"value": "value|must be a number|keys"}
    ),
    "Track.at": lambda it: Row(TRACK.at, {"frame": 3.0}),
    "VectorTrack": lambda it: Row(pm.VectorTrack, fields_of(VECTOR)),
    "VectorTrack.of": lambda it: Row(
        pm.VectorTrack.of, {"value": [1.0, 2.0, 3.0]}, {"value": "value|must be three numbers"}
    ),
    "VectorTrack.at": lambda it: Row(VECTOR.at, {"frame": 3.0}),
    "CameraMove": lambda it: Row(
        pm.CameraMove,
        {
            "origin": VECTOR,
            "target": None,
            "up": None,
            "pan": TRACK,
            "tilt": TRACK,
            "swing": TRACK,
            "zoom": TRACK,
        },
    ),
    "CameraMove with a target": lambda it: Row(
        pm.CameraMove,
        {
            "origin": VECTOR,
            "target": VECTOR,
            "up": VECTOR,
            "pan": None,
            "tilt": None,
            "swing": None,
            "zoom": TRACK,
        },
    ),
    "CameraMove.from_dict": lambda it: Row(pm.CameraMove.from_dict, {"values": {"pan": 1.0}}),
    "CameraMove.at": lambda it: Row(pm.CameraMove(pan=TRACK).at, {"camera": CAMERA, "frame": 1.0}),
    "ShapeMove": lambda it: Row(
        pm.ShapeMove,
        {"translate": VECTOR, "angle": TRACK, "axis": VECTOR, "scale": TRACK, "pivot": VECTOR},
    ),
    "ShapeMove.from_dict": lambda it: Row(pm.ShapeMove.from_dict, {"values": {"angle": 1.0}}),
    "ShapeMove.at": lambda it: Row(
        pm.ShapeMove(angle=TRACK).at, {"frame": 1.0, "centre": np.zeros(3)}
    ),
    "Shutter": lambda it: Row(pm.Shutter, fields_of(SHUTTER)),
    "Shutter.from_dict": lambda it: Row(pm.Shutter.from_dict, {"values": {"close": 0.5}}),
    "Shutter.frame_when": lambda it: Row(SHUTTER.frame_when, {"light": 0.5}),
    "Motion": lambda it: Row(pm.Motion, fields_of(MOTION)),
    "Motion.load": lambda it: Row(pm.Motion.load, {"path": it.motion_file}),
    "Motion.from_dict": lambda it: Row(pm.Motion.from_dict, {"values": {"shutter": {"close": 1}}}),
    "Motion.during": lambda it: Row(MOTION.during, {"shutter": SHUTTER}),
    "Motion.shutter_of": lambda it: Row(pm.Motion().shutter_of, {"camera": CAMERA}),
    "Motion.camera_at": lambda it: Row(MOTION.camera_at, {"camera": CAMERA, "frame": 1.0}),
    "Motion.transforms_at": lambda it: Row(
        MOTION.transforms_at, {"centres": CENTRES, "frame": 1.0}
    ),
    "AnimatedFilter": lambda it: Row(
        pm.AnimatedFilter, {"name": "fade", "parameters": {"amount": TRACK}}
    ),
    "AnimatedFilter.at": lambda it: Row(
        pm.AnimatedFilter("star", {"length": TRACK}).at, {"frame": 1.0}
    ),
    "Animation": lambda it: Row(
        pm.Animation,
        {
            **fields_of(ANIMATION),
            "camera": pm.CameraMove(pan=TRACK),
            "shapes": {"one": pm.ShapeMove(angle=TRACK)},
            "shutter": SHUTTER,
        },
    ),
    "Animation.load": lambda it: Row(pm.Animation.load, {"path": it.animation_file}),
    "Animation.from_dict": lambda it: Row(pm.Animation.from_dict, {"values": {"frames": 3}}),
    "Animation.lens_at": lambda it: Row(ANIMATION.lens_at, {"lens": THIN, "frame": 1.0}),
    "Animation.lenses": lambda it: Row(ANIMATION.lenses, {"lens": THIN}),
    "Animation.filters_at": lambda it: Row(ANIMATION.filters_at, {"frame": 1.0}),
    "Animation.motion_at": lambda it: Row(ANIMATION.motion_at, {"frame": 1.0}),
    "Animation.camera_at": lambda it: Row(
        pm.Animation(range(3), camera=pm.CameraMove(pan=TRACK)).camera_at,
        {"camera": CAMERA, "frame": 1.0},
    ),
    "Animation.transforms_at": lambda it: Row(
        pm.Animation(range(3), shapes={"one": pm.ShapeMove(angle=TRACK)}).transforms_at,
        {"centres": CENTRES, "frame": 1.0},
    ),
    "Animation.pictures": lambda it: Row(
        ANIMATION.pictures,
        {
            "session": it.session,
            "frames": [1],
            "lens": THIN,
            "filters": [],
            "rfilter": None,
            "alpha": False,
        },
    ),
    "focal_stack": lambda it: Row(
        pm.focal_stack,
        {
            "samples": SAMPLES,
            "distances": [2.0, 3.0],
            "near": None,
            "far": None,
            "count": None,
            "f_numbers": [2.0],
            "lenses": None,
            "method": "paper",
            "rfilter": None,
            "alpha": False,
            "filters": [],
        },
    ),
    "focal_stack at equal steps": lambda it: Row(
        pm.focal_stack,
        {
            "samples": it.session,
            "distances": None,
            "near": 2.0,
            "far": 3.0,
            "count": 2,
            "f_numbers": None,
            "lenses": None,
            "method": None,
            "rfilter": None,
            "alpha": False,
            "filters": [],
        },
    ),
    "LivingPicture.from_dict": lambda it: Row(
        pm.LivingPicture.from_dict,
        {"values": read_pictures(it.page_file)[0].to_dict()},
        {"values": "values|form"},
    ),
    "living_picture": lambda it: Row(
        pm.living_picture,
        {
            "samples": few(lens=THIN.replace(focal_length=500.0)),
            "path": it.place("page.html"),
            "f_numbers": [0.5],
            "near": 2.0,
            "far": 3.0,
            "psnr": 25.0,
            "max_bytes": 1 << 20,
            "title": "Few",
            "method": "layered",
            "rfilter": None,
            "filters": [],
        },
    ),
    "living_page": lambda it: Row(
        pm.living_page,
        {"paths": [it.page_file], "path": it.place("pages.html"), "title": "One"},
        {"paths": "paths|path|text"},
    ),
    "evaluation.thinlens_sensor": lambda it: Row(
        pm.evaluation.thinlens_sensor,
        {"sensor": it.perspective, "lens": THIN, "sampler": "independent", "spp": 4},
    ),
    "evaluation.Comparison.write": lambda it: Row(
        it.comparison.write, {"output": it.place("comparison")}
    ),
    "evaluation.compare": lambda it: Row(
        pm.evaluation.compare,
        {
            "scene": it.small_scene,
            "sensor": 0,
            "integrator": it.scene.integrator(),
            "spp": 1,
            "seed": 0,
            "sampling": pm.Sampling(refine=0),
            "reference_spp": 2,
            "reference_floor": 1.0,
            "budget": 0.0,
            "denoise": False,
            "method": "layered",
            "lens_points": 4,
            "tables": 3,
            "inverse_square": False,
            "squares": 1,
        },
        refused="film",
    ),
}


PLUGIN_ROWS = {
    "potmesil": {
        "with lengths": {
            "focal_length": 50.0,
            "f_number": 2.0,
            "focus_distance": 2.0,
            "frame_width": 36.0,
            "millimeters_per_unit": 1000.0,
            "image_distance": "focal",
            "squeeze": 1.0,
            "vignetting": 0.0,
            "near_clip": 0.1,
            "far_clip": 100.0,
            "principal_point_offset_x": 0.0,
            "principal_point_offset_y": 0.0,
            "shutter_open": 0.0,
            "shutter_close": 0.0,
            "pan": 0.0,
            "tilt": 0.0,
            "swing": 0.0,
            "origin": [0.0, 0.0, 0.0],
        },
        "with a field of view": {"fov": 40.0, "fov_axis": "x", "aperture_radius": 0.01},
        "with blades": {
            "f_number": 2.0,
            "aperture": "polygon",
            "blades": 5,
            "blade_rotation": 10.0,
            "blade_curvature": 0.5,
        },
        "with diffraction": {
            "f_number": 2.0,
            "aperture": "lommel",
            "wavelengths": "550",
            "truncated": False,
            "argument": "paper",
        },
        "with a picture": {"f_number": 2.0, "aperture": "image", "aperture_image": ...},
    },
    "potmesil_orthographic": {
        "with a lens": {
            "half_angle": 2.0,
            "focus_distance": 2.0,
            "aperture": "disc",
            "squeeze": 1.0,
            "near_clip": 0.1,
            "far_clip": 100.0,
            "shutter_open": 0.0,
            "shutter_close": 0.0,
        },
    },
    "point_samples": {
        "with all": {
            "pattern": "sampler",
            "threshold": 0.1,
            "subdivisions": 2,
            "layers": 2,
            "overscan": 1,
            "min_f_number": 1.0,
            "virtual_depth": True,
            "refine": 0.25,
            "focus_range": "1/2",
            "features": False,
            "clamp": 1.0,
            "motion": ...,
        }
    },
}
PLUGIN_ROWS["focus"] = {
    "with all": {
        **PLUGIN_ROWS["point_samples"]["with all"],
        "method": "layered",
        "lens_points": 4,
        "tables": 3,
        "inverse_square": False,
        "squares": 1,
        "filter": "star",
        "filter_2": "fade:amount=0.5",
        "denoise": False,
        "focus_aovs": False,
    }
}

SENSORS = {
    "potmesil": {"type": "potmesil", "f_number": 2.0},
    "potmesil_orthographic": {
        "type": "potmesil_orthographic",
        "half_angle": 2.0,
        "focus_distance": 2.0,
    },
}
CLIPPED_AND_SHUT = {
    "near_clip": 0.5,
    "far_clip": 50.0,
    "shutter_open": 0.25,
    "shutter_open_time": 0.5,
}
TRAVERSED: dict[str, dict[str, Any]] = {
    "potmesil": {
        **CLIPPED_AND_SHUT,
        "focal_length": 35.0,
        "f_number": 4.0,
        "aperture_radius": 0.25,
        "focus_distance": 3.0,
        "frame_width": 24.0,
        "x_fov": 30.0,
        "millimeters_per_unit": 10.0,
        "squeeze": 2.0,
        "vignetting": 0.5,
        "principal_point_offset_x": 0.125,
        "principal_point_offset_y": -0.125,
        "to_world": "a turn",
    },
    "potmesil_orthographic": {
        **CLIPPED_AND_SHUT,
        "half_angle": 4.0,
        "focus_distance": 3.0,
        "squeeze": 2.0,
        "to_world": "a turn",
    },
    "point_samples": {},
    "focus": {},
}
"""What ``mi.traverse`` shows of the plugins themselves, and a value that each may be set to."""

SEVERAL = {"two": [1.0, 2.0], "no": []}
"""Numbers of which a parameter is one."""

TRANSFORMS = {
    "nan": lambda: mi.Transform4f(np.full((4, 4), math.nan)),
    "far away": lambda: mi.Transform4f().translate([math.inf, 0, 0]),
    "flat": lambda: mi.Transform4f().scale([1, 1, 0]),
    "a shear": lambda: mi.Transform4f(np.eye(4) + np.eye(4, k=1) * [1, 1, 0, 0]),
    "two": lambda: mi.Transform4f().translate([mi.Float(1, 2), 0, 0]),
    "a turn": lambda: mi.Transform4f().rotate([0, 1, 0], 30),
}
"""Wrong values of ``to_world``, and one that is right."""

OF_MITSUBA = {"(nested)", "to_world", "film", "sampler", "srf", "..."}
"""Parameters of plugins that are objects, which Mitsuba checks."""

ASKED_BY_THE_PACKAGE = {
    pm.Aperture: (
        "circle_kernel",
        "corner_area",
        "points",
        "profiles",
        "table",
        "transmission",
        "upright_kernel",
    ),
    pm.Filter: ("kernel",),
    pm.ImageAperture: ("overlaps",),
    pm.Method: (
        "check",
        "default_squares",
        "form",
        "form_attached",
        "points_for",
        "squares_for",
    ),
    pm.PointSpreadFunction: ("table",),
    pm.Window: (
        "contains",
        "covers",
        "grown",
        "intersection",
        "pixel_of",
        "relative_to",
        "shows",
        "slices_in",
        "subdivided",
    ),
}
"""Methods that a class of one's own may have, too: the focus stage calls them, many times, with
what it has checked; and those of ``Window``, which says that it checks nothing."""

OF_ALL_SPECS = ("member", "of_parameters", "parse")
"""Class methods of each family; ``aperture_of`` and ``parse_filter`` stand for them."""

NO_ROWS = {
    "Aperture": "is a base class",
    "Filter": "is a base class",
    "FocusWarning": "is a category of warnings",
    "Method": "is a base class",
    "PointSpreadFunction": "is a protocol",
    "DepthOfField": "is a result",
    "Window": "checks nothing: Window.of does",
    "evaluation.Comparison": "is a result",
    "evaluation.Rendering": "is a result",
    "evaluation.EqualError": "is a result",
    "FocalStack": "is a result",
    "LivingPicture": "is a result",
    "PointSamples.view": "checks nothing: chosen does",
    "PointSamples.joined": "joins columns of the package's own",
}


# ---------------------------------------------------------------- what there is


def own_callables() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Public functions, classes and their methods that take anything, by their names."""
    for prefix, module in (("", pm), ("evaluation.", pm.evaluation)):
        for name in module.__all__:
            value = getattr(module, name)
            if not callable(value):
                continue
            yield prefix + name, value
            if isinstance(value, type):
                for method in dir(value):
                    found = getattr(value, method)
                    own = getattr(found, "__module__", None) or ""
                    if method[0] != "_" and callable(found) and own.startswith("potmesil_mi"):
                        yield f"{prefix}{name}.{method}", found


def takes_nothing(function):
    return not set(inspect.signature(function).parameters) - {"self"}


def is_asked_by_the_package(name):
    kind, _, method = name.partition(".")
    return method in OF_ALL_SPECS or any(
        issubclass(getattr(pm, kind), base) and method in methods
        for base, methods in ASKED_BY_THE_PACKAGE.items()
        if method and isinstance(getattr(pm, kind), type)
    )


# ---------------------------------------------------------------- what comes of a call


def has_nan(value: Any) -> bool:
    """Whether anything in a result is not a number."""
    if isinstance(value, (float, complex, np.inexact)):
        return bool(np.isnan(value))
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fc" and bool(np.isnan(value).any())
    if isinstance(value, pm.ThinLens):
        return has_nan(value.parameters())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return has_nan(fields_of(value))
    if isinstance(value, Mapping):
        return any(map(has_nan, value.values()))
    if isinstance(value, (list, tuple)):
        return any(map(has_nan, value))
    if type(value).__module__.startswith("drjit"):
        return has_nan(np.array(value))
    return False


def result_of(function, arguments):
    """What a call gives, with all that it gives one after the other."""
    result = function(**arguments)
    if isinstance(result, Path):  # Before Python 3.13 it is a context manager, too.
        return result
    if isinstance(result, contextlib.AbstractContextManager):
        with result:
            return None
    return list(itertools.islice(result, 100)) if isinstance(result, Iterator) else result


def is_named(name: str, message: str) -> bool:
    """Whether an error says the parameter and something of it."""
    return re.search(rf"(?<![\w.])({name})(?![\w(])", message) is not None


REFUSALS = (ValueError, TypeError, OSError, NotImplementedError)

PATHS = {"path", "output", "filename", "aperture_image", "motion", "rgb", "depth"}
"""Parameters that may be files; errors of files name the file."""


def how_shown(kind: str) -> str:
    """The regular expression by which an error shows the value of ``WRONG`` of that kind."""
    return SHOWN.get(kind) or re.escape(repr(WRONG[kind]))


def how_shown_by_mitsuba(kind: str) -> str:
    """The same of a value that Mitsuba has handed on."""
    return (
        f"{how_shown(kind)}|{SHOWN_BY_MITSUBA[kind]}"
        if kind in SHOWN_BY_MITSUBA
        else how_shown(kind)
    )


def fault_of_refusal(error, called, shown, file=None) -> str | None:
    """What is wrong with an error, which must say what is ``called`` and what is ``shown`` so.

    It may say the name of a ``file`` in place of the first. Of a parameter that is unknown no value
    is shown.
    """
    message = str(error)
    if not isinstance(error, REFUSALS) or isinstance(error, np.linalg.LinAlgError):
        wrong = "raw"
    elif not (is_named(called, message) or (file is not None and file in message)):
        wrong = "unnamed"
    elif not re.search(f"{shown}|not a parameter of", message):
        wrong = "not shown"
    elif not re.search(ALLOWED, message):
        wrong = "without what is allowed"
    elif len(message) > LONGEST:
        wrong = "too long"
    else:
        return None
    return f"{wrong} {type(error).__name__}: {message[:LONGEST]}"


def fault_of(function, arguments, name, called, shown) -> str | None:
    """What is wrong with the outcome of a call, one of whose ``arguments`` is."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            result = result_of(function, arguments)
        except AssertionError:
            raise
        except Exception as error:
            is_file = name in PATHS and isinstance(arguments[name], str)
            file = arguments[name] if is_file else None
            fault = fault_of_refusal(error, called, shown, file)
            if fault is not None:
                return fault
        else:
            if has_nan(result):
                return "NaN in the result"
    wrong = [one for one in told if not is_meant(one)]
    return f"warning {wrong[0].category.__name__}: {wrong[0].message}" if wrong else None


def is_meant(warning) -> bool:
    """Whether a warning is one that the package gives on purpose."""
    text = str(warning.message)
    purposely = warning.category in (UserWarning, pm.FocusWarning)
    return purposely or text.startswith("dropped ")


def told(faults):
    return "\n" + "\n".join(faults)


# ---------------------------------------------------------------- the tests


def test_every_public_callable_has_a_row():
    missing = [
        name
        for name, function in own_callables()
        if name not in ROWS
        and name not in NO_ROWS
        and not takes_nothing(function)
        and not is_asked_by_the_package(name)
    ]
    assert not missing, told(missing)


def test_every_exception_is_needed():
    names = {name for name, _ in own_callables()}
    assert not [name for name in NO_ROWS if name in ROWS or name not in names]


@pytest.mark.parametrize("name", ROWS)
def test_wrong_values_are_refused_by_name(name, it, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    row = ROWS[name](it)
    known = {
        p
        for p, of in inspect.signature(row.function).parameters.items()
        if p[0] != "_"
        if of.kind != of.VAR_KEYWORD
    }
    assert known == set(row.arguments), "the row must have the parameters of the signature"
    given = {**row.arguments, **row.extra}
    valid = {name: value for name, value in given.items() if value is not ...}
    if row.refused:
        with pytest.raises(ValueError, match=rf"^{row.refused}\b"):
            result_of(row.function, valid)
    else:
        result = result_of(row.function, valid)
        assert not has_nan(result)
    faults = []
    for parameter in given:
        for kind, value in WRONG.items():
            arguments = {**valid, parameter: value}
            called = row.called.get(parameter, CALLED.get(parameter, parameter))
            fault = fault_of(row.function, arguments, parameter, called, how_shown(kind))
            if fault is not None and not (row.refused and is_named(row.refused, fault)):
                faults.append(f"{parameter} = {kind}: {fault}")
    assert not faults, told(faults)


def of_plugin(error):
    """The error in Python that one of Mitsuba ends with."""
    found = re.findall(r"^(\w+Error): (.*)", str(error), re.MULTILINE)
    return getattr(builtins, found[-1][0])(found[-1][1]) if found else error


def documented(plugin):
    """The parameters that the documentation of a plugin has."""
    _, class_name = PLUGINS[plugin]
    text = getattr(importlib.import_module(f"potmesil_mi.plugins.{plugin}"), class_name).__doc__
    names = re.findall(r"\* - (.*?)\n\s+- \|", text.partition("pluginparameters")[2], re.DOTALL)
    return {name.strip() for some in names for name in some.split(",")}


@pytest.mark.parametrize("plugin", PLUGINS)
def test_every_parameter_of_a_plugin_has_a_row(plugin):
    known = {name for row in PLUGIN_ROWS[plugin].values() for name in row}
    assert known == documented(plugin) - OF_MITSUBA


@pytest.mark.parametrize(
    ("plugin", "row"), [(plugin, row) for plugin, rows in PLUGIN_ROWS.items() for row in rows]
)
def test_plugins_refuse_wrong_values_by_name(plugin, row, it, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files = {"motion": it.motion_file, "aperture_image": it.aperture_file}
    valid = {name: files[name] if v is ... else v for name, v in PLUGIN_ROWS[plugin][row].items()}

    def loaded(**parameters):
        nested = {"nested": {"type": "path"}} if PLUGINS[plugin][0] == "integrator" else {}
        try:
            made = mi.load_dict({"type": plugin, **nested, **parameters})
        except RuntimeError as error:
            raise of_plugin(error) from error
        return (made.camera(), made.lens()) if PLUGINS[plugin][0] == "sensor" else None

    assert not has_nan(loaded(**valid))
    faults = []
    for parameter in valid:
        for kind, value in OF_SCENES.items():
            arguments, called = {**valid, parameter: value}, CALLED.get(parameter, parameter)
            fault = fault_of(loaded, arguments, parameter, called, how_shown_by_mitsuba(kind))
            if fault is not None:
                faults.append(f"{parameter} = {kind}: {fault}")
    assert not faults, told(faults)


@pytest.mark.parametrize("plugin", PLUGINS)
def test_every_parameter_that_mitsuba_traverses_has_a_row(plugin):
    made = mi.load_dict(SENSORS.get(plugin) or {"type": plugin, "nested": {"type": "path"}})
    assert {name for name, _ in mi.traverse(made) if "." not in name} == set(TRAVERSED[plugin])


@pytest.mark.parametrize(
    ("plugin", "name"), [(plugin, name) for plugin, names in TRAVERSED.items() for name in names]
)
def test_a_refused_update_leaves_a_sensor_as_it_was(plugin, name):
    """Mitsuba itself refuses to set some of the values."""
    sensor = mi.load_dict(SENSORS[plugin])
    parameters = mi.traverse(sensor)

    def state():
        shown = {name: str(parameters[name]) for name in TRAVERSED[plugin]}
        return str(sensor), sensor.camera(), shown

    valid = TRAVERSED[plugin][name]
    if name == "to_world":
        tried = [(made(), r"\d|nan") for kind, made in TRANSFORMS.items() if kind != valid]
        valid = TRANSFORMS[valid]()
    else:
        tried = [(value, how_shown_by_mitsuba(kind)) for kind, value in OF_SCENES.items()]
        tried += [(value, r"=\[(1, 2)?\]") for value in SEVERAL.values()]
    faults = []
    before = initial = state()
    for value, shown in tried:
        with contextlib.suppress(TypeError, RuntimeError):  # Mitsuba's.
            parameters[name] = value
        try:
            parameters.update()
        except Exception as error:
            fault = fault_of_refusal(error, name, shown)
            if fault is not None or state() != before:
                faults.append(f"{value!r}: {fault or 'has changed the sensor'}")
        else:
            before = state()
            if has_nan((sensor.camera(), sensor.lens())):
                faults.append(f"{value!r}: NaN in the sensor")
    parameters[name] = valid
    parameters.update()
    assert state() != initial
    assert name == "to_world" or np.array(parameters[name]) == np.float32(valid)
    assert not faults, told(faults)


@pytest.mark.parametrize("plugin", SENSORS)
def test_a_refused_update_leaves_the_rays(plugin):
    sensor = mi.load_dict(SENSORS[plugin])
    parameters = mi.traverse(sensor)

    def ray():
        made, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(0.25, 0.75), mi.Point2f(0))
        return np.array([*made.o, *made.d, made.maxt])

    before = ray()
    parameters["focus_distance"] = 3.0
    parameters["near_clip"] = -1.0
    parameters["to_world"] = TRANSFORMS["a turn"]()
    with pytest.raises(ValueError, match="near_clip=-1"):
        parameters.update()
    np.testing.assert_array_equal(ray(), before)
    parameters["to_world"] = TRANSFORMS["a turn"]()
    parameters.update()
    assert (ray() != before).any()
