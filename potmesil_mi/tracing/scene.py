"""Mitsuba's side of the door: what a scene's sensor says about camera and lens."""

from __future__ import annotations

import math
from operator import itemgetter
from typing import Any

import mitsuba as mi
import numpy as np

from ..optics.lens import FULL_FRAME_WIDTH, ThinLens


def require_vectorised_variant(what: str) -> None:
    """Raise ``RuntimeError`` unless an LLVM or CUDA variant is set."""
    variant = mi.variant()
    if variant is None or variant.startswith("scalar"):
        raise RuntimeError(
            f"{what}: needs a vectorised variant, but mi.variant() is {variant}; call "
            "mi.set_variant('cuda_ad_rgb', 'llvm_ad_rgb') before the scene is loaded"
        )


def pick_sensor(scene: mi.Scene, sensor: int | mi.Sensor) -> mi.Sensor:
    """The sensor itself, or the scene's sensor of that number."""
    if isinstance(sensor, mi.Sensor):
        return sensor
    if not isinstance(sensor, int):
        raise TypeError(f"sensor={sensor!r}: must be a sensor or its number in the scene")
    count = len(scene.sensors())
    if not 0 <= sensor < count:
        raise ValueError(f"sensor={sensor}: the scene has {count}, numbered from 0")
    return scene.sensors()[sensor]


def has_lens(sensor: mi.Sensor) -> bool:
    """Whether the sensor has an aperture: a ``potmesil`` or ``thinlens``."""
    return hasattr(sensor, "lens") or "aperture_radius" in mi.traverse(sensor)


def potmesil_sensor(sensor: mi.Sensor, **lens: Any) -> mi.Sensor:
    """A ``potmesil`` sensor in the place of ``sensor``, with its film and sampler.

    ``lens`` are parameters of :class:`potmesil_mi.ThinLens` that replace what the sensor says.
    A ``potmesil`` sensor keeps its other parameters. A ``thinlens`` keeps its field of view,
    aperture and focus; a ``perspective`` its field of view, with an f-number of ``inf`` unless
    one is given; both are taken as scenes in metres (``millimeters_per_unit`` 1000) on a frame
    36 mm wide. A sensor's own ``srf``, which Mitsuba does not tell, is lost. Raises ``TypeError``
    for any other sensor, ``ValueError`` for bad parameters.
    """
    if hasattr(sensor, "lens"):
        if not lens:
            return sensor
        thin_lens = sensor.lens().replace(**lens)
        camera = sensor.camera()
        to_world = np.array(camera.to_world)
        clip = {"near_clip": camera.near_clip, "far_clip": camera.far_clip}
        offset = camera.principal_point_offset
    else:
        parameters = mi.traverse(sensor)
        if "x_fov" not in parameters or "to_world" not in parameters:
            raise TypeError(
                f"sensor: must be a potmesil, perspective or thinlens sensor, not "
                f"{sensor.class_name()}"
            )
        thin_lens = _lens_of(parameters, lens)
        to_world = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
        clip = {name: float(parameters[name]) for name in ("near_clip", "far_clip")}
        offset = tuple(_item(parameters, f"principal_point_offset_{axis}", 0.0) for axis in "xy")
    replacement = mi.load_dict(
        {
            "type": "potmesil",
            "id": sensor.id() or "potmesil",
            "film": sensor.film(),
            "sampler": sensor.sampler(),
            "to_world": mi.ScalarTransform4f(to_world),
            "shutter_open": sensor.shutter_open(),
            "shutter_close": sensor.shutter_open() + sensor.shutter_open_time(),
            "principal_point_offset_x": offset[0],
            "principal_point_offset_y": offset[1],
            **clip,
            **sensor_parameters(thin_lens),
        }
    )
    if sensor.get_medium() is not None:
        replacement.set_medium(sensor.get_medium())
    return replacement


def sensor_parameters(lens: ThinLens) -> dict[str, Any]:
    """The lens as the parameters of the sensor ``potmesil``, numbers and text.

    Where the film is, is called ``image_distance`` there: a sensor's ``film`` is what has pixels.
    """
    parameters = lens.to_dict()
    parameters["image_distance"] = parameters.pop("film")
    return parameters


def _lens_of(parameters: mi.SceneParameters, lens: dict[str, Any]) -> ThinLens:
    """The lens of a built-in sensor, of which ``lens`` replaces some parameters."""
    known: dict[str, Any] = {"millimeters_per_unit": 1000.0}
    if "aperture_radius" in parameters:
        known["aperture_radius"] = _item(parameters, "aperture_radius")
        known["focus_distance"] = _item(parameters, "focus_distance")
    else:
        known["f_number"] = math.inf
    if not lens.keys().isdisjoint({"f_number", "aperture_radius"}):
        known.pop("f_number", None)
        known.pop("aperture_radius", None)
    known.update(lens)
    fov = _item(parameters, "x_fov")
    if "aperture_radius" in known and known.keys().isdisjoint({"focal_length", "frame_width"}):
        # Field of view, aperture and focus make the picture. The frame only must leave the
        # focus outside the focal length, which that of a small scene in metres may not do.
        focused = known.get("focus_distance", math.inf) * known["millimeters_per_unit"]
        known["frame_width"] = min(FULL_FRAME_WIDTH, math.tan(math.radians(fov) / 2) * focused)
    return ThinLens.of_field_of_view(fov, **known)


def _item(parameters: mi.SceneParameters, name: str, default: float | None = None) -> float:
    if default is not None and name not in parameters:
        return default
    return float(np.array(parameters[name]).ravel()[0])


def surface_ids(scene: mi.Scene) -> tuple[mi.UInt32, dict[int, str]]:
    """Stable ids of the scene's surfaces.

    Returns a table that turns a shape's place in Dr.Jit's registry into its id, and the name of
    every id. Ids count from 1 in the order of the names, so that they are the same each time
    the scene is loaded; 0 is no surface. A shape without a name (an ``id`` in XML) is called by
    its type and its rank by place and size.
    """
    import drjit as dr

    shapes = list(scene.shapes())
    if not shapes:
        raise ValueError("scene: is empty, there must be at least one shape")
    unnamed = sorted((shape for shape in shapes if not shape.id()), key=_place)
    named = [(f"{s.class_name()}_{rank}", s) for rank, s in enumerate(unnamed, start=1)]
    named = sorted(
        named + [(shape.id(), shape) for shape in shapes if shape.id()], key=itemgetter(0)
    )
    places = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]) for _, shape in named]
    table = np.zeros(max(places) + 1, dtype=np.uint32)
    table[places] = np.arange(1, len(places) + 1)
    return mi.UInt32(table), {i: name for i, (name, _) in enumerate(named, 1)}


ORIENTATION_SAMPLES = 4096
"""Points of a closed shape from which is told on which side its normals are."""


def closed_shapes(scene: mi.Scene) -> mi.Float:
    """Which shapes enclose a volume, by their place in Dr.Jit's registry, as in ``surface_ids``.

    1 for those whose normals point out of it, -1 for those whose normals point into it, 0 for
    the others. Spheres and cylinders enclose one, and meshes each of whose edges joins two faces,
    in either direction one. Others, instances too, are taken for open.
    """
    import drjit as dr

    shapes = list(scene.shapes())
    places = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]) for shape in shapes]
    table = np.zeros(max(places) + 1, dtype=np.float32)
    table[places] = [_side_of_normals(shape) if _is_closed(shape) else 0 for shape in shapes]
    return mi.Float(table)


def _side_of_normals(shape: mi.Shape) -> float:
    """1 where the normals of a closed shape point outwards, else -1."""
    import drjit as dr

    place = dr.arange(mi.UInt32, ORIENTATION_SAMPLES)
    sample = mi.Point2f(
        (mi.Float(place) + 0.5) / ORIENTATION_SAMPLES, mi.radical_inverse_2(place, 0)
    )
    position = shape.sample_position(0.0, sample)
    middle = mi.Point3f(shape.bbox().center())
    dr.make_opaque(middle)  # no kernel of its own for each shape
    # By Gauss's theorem the flux of x - middle is three times the volume.
    flux = dr.mean(dr.dot(position.n, position.p - middle))
    return -1.0 if float(np.array(flux).ravel()[0]) < 0 else 1.0


def _is_closed(shape: mi.Shape) -> bool:
    parameters = mi.traverse(shape)
    if "vertex_positions" not in parameters:
        return shape.class_name() in ("Sphere", "Cylinder")
    positions = np.array(parameters["vertex_positions"]).reshape(-1, 3)
    faces = np.array(parameters["faces"]).reshape(-1, 3)
    # Vertices are doubled where normals or texture coordinates differ.
    vertex = np.unique(positions, axis=0, return_inverse=True)[1].ravel()[faces].astype(np.int64)
    edges = np.stack([vertex, np.roll(vertex, -1, axis=1)], axis=-1).reshape(-1, 2)
    edges = edges[edges[:, 0] != edges[:, 1]]
    count = len(positions)
    forth, back = edges @ [count, 1], edges @ [1, count]
    return len(np.unique(forth)) == len(forth) and np.array_equal(np.sort(forth), np.sort(back))


def _place(shape: mi.Shape) -> tuple[Any, ...]:
    box = shape.bbox()
    corners = [float(v) for corner in (box.min, box.max) for v in np.array(corner).ravel()]
    return shape.class_name(), *corners, shape.primitive_count()
