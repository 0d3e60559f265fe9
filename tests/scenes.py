"""Small scenes for the tests."""

import dataclasses
from pathlib import Path

import mitsuba as mi
import numpy as np

import potmesil_mi as pm

SCENES = Path(__file__).parent.parent / "scenes"
OTHERS = Path(__file__).parent.parent.parent / "shared" / "scenes"

LENS = {"focal_length": 50.0, "frame_width": 40.0, "f_number": 0.25, "focus_distance": 2.0}


def diffuse(*rgb):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": rgb}}


def still_life(integrator=None, *, film=None, sensor=None, spp=4, sampler="independent", **shapes):
    """A sphere at 2 m and a wall at 4 m, lit by a lamp; left and right of the wall is nothing."""
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator or {"type": "path", "max_depth": 3},
            "sensor": {
                **({} if "type" in (sensor or {}) else {"type": "potmesil", **LENS}),
                "film": {
                    "type": "hdrfilm",
                    "width": 24,
                    "height": 16,
                    "pixel_format": "rgb",
                    "component_format": "float32",
                    "rfilter": {"type": "box"},
                    **(film or {}),
                },
                "sampler": {"type": sampler, "sample_count": spp},
                **(sensor or {}),
            },
            "ball": {
                "type": "sphere",
                "center": [0, 0, 2.3],
                "radius": 0.3,
                "bsdf": {
                    "type": "diffuse",
                    "reflectance": {"type": "rgb", "value": [0.8, 0.3, 0.1]},
                },
            },
            "wall": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f()
                .translate([0, 0, 4])
                .rotate([0, 1, 0], 180)
                .scale([1.2, 3, 1]),
                "bsdf": {
                    "type": "diffuse",
                    "reflectance": {"type": "rgb", "value": [0.2, 0.4, 0.7]},
                },
            },
            "lamp": {
                "type": "point",
                "position": [2, 3, -1],
                "intensity": {"type": "rgb", "value": [30, 30, 25]},
            },
            **shapes,
        }
    )


def papers_scene(res=64, **parameters):
    """Figure 11 of the paper."""
    return mi.load_file(str(SCENES / "figure11.xml"), optimize=False, res=res, **parameters)


def synthetic(count=2000, *, size=(20, 14), seed=0, **fields):
    """Samples without a scene: random places, colours and depths."""
    rng = np.random.default_rng(seed)
    width, height = size
    camera = pm.Camera(
        film_size=size,
        crop_offset=(0, 0),
        crop_size=size,
        x_fov=40.0,
        to_world=tuple(map(tuple, np.eye(4).tolist())),
    )
    columns = {
        "x": rng.uniform(0, width, count),
        "y": rng.uniform(0, height, count),
        "rgb": rng.uniform(0, 1, (count, 3)),
        "alpha": np.ones(count),
        "z": rng.uniform(1, 5, count),
        "surface": rng.integers(1, 4, count),
        "weight": rng.uniform(0.5, 1.5, count),
        "camera": camera,
        "lens": pm.ThinLens(50.0, 2.0, 2.0, millimeters_per_unit=1000.0),
        "surfaces": {1: "one", 2: "two", 3: "three"},
    }
    return pm.PointSamples(**{**columns, **fields})


def evenly_spread(size, per_side=4, **fields):
    """Samples of equal weight, one in each of per_side x per_side squares of every pixel."""
    columns, rows = (n * per_side for n in size)
    y, x = np.divmod(np.arange(rows * columns), columns)
    jitter = np.random.default_rng(5).uniform(0.01, 0.99, (2, rows * columns))
    return synthetic(
        rows * columns,
        size=size,
        x=(x + jitter[0]) / per_side,
        y=(y + jitter[1]) / per_side,
        weight=np.full(rows * columns, 1 / per_side**2),
        **fields,
    )


def overscanned(count=8000, *, film=(40, 30), crop=(2, 3, 20, 14), margin=5, seed=1):
    """Samples in three layers, of a crop window and ``margin`` pixels around it."""
    rng = np.random.default_rng(seed)
    left, top, width, height = crop
    window = (left - margin, top - margin, width + 2 * margin, height + 2 * margin)
    camera = dataclasses.replace(
        synthetic(1).camera, film_size=film, crop_offset=(left, top), crop_size=(width, height)
    )
    return synthetic(
        count,
        seed=seed,
        camera=camera,
        window=window,
        x=rng.uniform(window[0], left + width + margin, count),
        y=rng.uniform(window[1], top + height + margin, count),
        alpha=rng.integers(0, 3, count) / 2,
        layer=rng.integers(0, 3, count),
    )


def pinhole_mean(samples, whole=False):
    """The weighted mean of what the pinhole sees in each pixel, (H, W, 3); NaN for none.

    In the crop window, or in the ``whole`` window that was sampled.
    """
    left, top, width, height = samples.window
    samples = samples.visible()
    pixel = samples.pixel()
    total = np.bincount(pixel, samples.weight, width * height)
    with np.errstate(invalid="ignore"):
        rgb = [
            np.bincount(pixel, samples.weight * c, width * height) / total for c in samples.rgb.T
        ]
    mean = np.stack(rgb, axis=-1).reshape(height, width, 3)
    if whole:
        return mean
    column, row = samples.camera.crop_offset
    width, height = samples.camera.crop_size
    return mean[row - top : row - top + height, column - left : column - left + width]


def behind_a_bar(lens=None):
    """A near bar, a card in the middle, and lamps far away that both cover in part, 96 x 64."""
    rgb, depth = np.full((64, 96, 3), 0.05), np.full((64, 96), 8.0)
    down, across = np.mgrid[:64, :96]
    rgb[(across // 8 + down // 8) % 2 == 0] *= 2
    for x, y, color in ((28, 16, (40, 20, 8)), (62, 22, (10, 20, 40)), (70, 50, (40, 6, 6))):
        rgb[np.hypot(across - x, down - y) < 2.5] = color
    rgb[30:56, 44:72], depth[30:56, 44:72] = (0.1, 0.5, 0.2), 2.0
    rgb[34:38, 48:68] = 0.8
    rgb[:, 24:32], depth[:, 24:32] = (0.6, 0.3, 0.2), 0.8
    rgb[::6, 24:32] = 0.1
    lens = lens or pm.ThinLens(50.0, 0.7, 2.0, millimeters_per_unit=1000.0)
    surface = np.select([depth == 0.8, depth == 2.0], [1, 2], 3).astype(np.uint32)
    return pm.PointSamples.from_image(
        *(rgb, depth),
        depth_kind="z",
        camera=40.0,
        lens=lens,
        surface=surface,
        surfaces={1: "bar", 2: "card", 3: "lamps"},
        antialiased=False,
    )
