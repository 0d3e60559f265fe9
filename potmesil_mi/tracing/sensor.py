"""What a scene's sensor says about camera and lens, and the ``potmesil`` sensor in its place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import mitsuba as mi
import numpy as np

from .._validation import require_kind, shown
from ..optics.camera import Camera
from ..optics.lens import FULL_FRAME_WIDTH, AnyLensChanges, ThinLens
from ..optics.lens_checks import distance_in_mm, in_numbers
from ..optics.telecentric import TelecentricLens
from ..optics.usable import require_usable_view

if TYPE_CHECKING:
    from typing_extensions import Unpack


@runtime_checkable
class LensSensor(Protocol):
    """A sensor that knows its camera and its lens, as ``potmesil`` does.

    It is told by its methods and not by its class, which is made anew for each variant.
    """

    def camera(self) -> Camera:
        """The pinhole that takes the samples."""

    def lens(self) -> ThinLens | TelecentricLens:
        """The lens that the parameters describe."""


def pick_sensor(scene: mi.Scene, sensor: int | mi.Sensor) -> mi.Sensor:
    """The sensor itself, or the scene's sensor of that number.

    Raises ``TypeError`` for other than a sensor or a number, ``ValueError`` for a number that the
    scene does not have.
    """
    require_kind("scene", scene, mi.Scene, "a scene, as mi.load_file gives")
    if isinstance(sensor, mi.Sensor):
        return sensor
    require_kind("sensor", sensor, int, "a sensor or its number in the scene")
    count = len(scene.sensors())
    if not 0 <= sensor < count:
        raise ValueError(
            f"sensor={shown(sensor)}: must be 0 to {count - 1}, a number of a sensor of the scene"
        )
    return scene.sensors()[sensor]


def has_lens(sensor: mi.Sensor) -> bool:
    """Whether the sensor has an aperture: a ``potmesil`` or ``thinlens``."""
    return isinstance(sensor, LensSensor) or "aperture_radius" in mi.traverse(sensor)


def potmesil_sensor(sensor: mi.Sensor, **lens: Unpack[AnyLensChanges]) -> mi.Sensor:
    """A ``potmesil`` sensor in the place of ``sensor``, with its film and sampler.

    ``lens`` are parameters of :class:`potmesil_mi.ThinLens` that replace what the sensor says.
    A ``potmesil`` sensor keeps its other parameters. A ``thinlens`` keeps its field of view,
    aperture and focus; a ``perspective`` its field of view, with an f-number of ``inf`` unless
    one is given; both are taken as scenes in metres (``millimeters_per_unit`` 1000) on a frame
    36 mm wide, or less where a pinhole or an aperture radius has a nearer focus. An
    ``orthographic`` becomes a ``potmesil_orthographic``, and ``lens`` are parameters of
    :class:`potmesil_mi.TelecentricLens`, of which ``half_angle`` and ``focus_distance`` must be
    given. A ``perspective`` or ``orthographic`` that states a ``focus_distance`` keeps it. A
    sensor's own ``srf`` is lost, for Mitsuba does not tell it. Raises ``TypeError`` for any other
    sensor, ``ValueError`` for bad parameters.
    """
    if is_orthographic(sensor):
        return _orthographic_sensor(sensor, lens)
    if isinstance(sensor, LensSensor):
        if not lens:
            return sensor
        thin_lens: Any = sensor.lens()
        thin_lens = thin_lens.replace(**lens)
        camera = sensor.camera()
        to_world = np.array(camera.to_world)
        clip = {"near_clip": camera.near_clip, "far_clip": camera.far_clip}
        offset = camera.principal_point_offset
    else:
        parameters = mi.traverse(sensor)
        if "x_fov" not in parameters or "to_world" not in parameters:
            raise TypeError(
                f"sensor: must be a potmesil, perspective, thinlens or orthographic sensor, not "
                f"{sensor.class_name()}"
            )
        thin_lens = _lens_of(sensor, parameters, lens)
        to_world = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
        clip = {name: float(parameters[name]) for name in ("near_clip", "far_clip")}
        offset = (
            _item(parameters, "principal_point_offset_x", 0.0),
            _item(parameters, "principal_point_offset_y", 0.0),
        )
    require_usable_view(thin_lens)
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


def placed(sensor: mi.Sensor, camera: Camera) -> None:
    """Let a ``potmesil`` or ``potmesil_orthographic`` sensor stand where ``camera`` stands.

    It gets its field of view, too.
    """
    parameters = mi.traverse(sensor)
    names = {key.split(".")[-1]: key for key, _ in parameters}
    key = names["to_world"]
    own, matrix = sensor.camera(), np.array(camera.to_world)
    if camera.projection == "orthographic":
        # The size of its film is a part of the sensor's matrix.
        before = np.array(sensor.world_transform().matrix, dtype=np.float64).reshape(4, 4)
        matrix = matrix @ np.linalg.inv(own.to_world) @ before
    elif camera.x_fov != own.x_fov:
        parameters[names["x_fov"]] = mi.Float(camera.x_fov)
    parameters[key] = type(parameters[key])(matrix)
    parameters.update()


def is_orthographic(sensor: mi.Sensor) -> bool:
    """Whether the sensor's rays are parallel: ``orthographic`` or ``potmesil_orthographic``.

    Raises ``TypeError`` for what is no sensor.
    """
    require_kind("sensor", sensor, mi.Sensor, "a sensor, as scene.sensors() has")
    if isinstance(sensor, LensSensor):
        return sensor.camera().projection == "orthographic"
    return bool(sensor.class_name() == "OrthographicCamera")


def stated_focus_distance(sensor: mi.Sensor) -> float | None:
    """The ``focus_distance`` that a built-in sensor states, in scene units; ``None`` for none.

    Mitsuba's projective cameras keep one without using it. It is the far clipping plane where a
    scene says nothing. One that is not positive means nothing either.
    """
    if not isinstance(sensor, mi.ProjectiveCamera):
        return None
    distance = float(np.array(sensor.focus_distance()).item())
    return distance if distance > 0 and distance != sensor.far_clip() else None


def with_lens(sensor: mi.Sensor, lens: TelecentricLens | None) -> mi.Sensor:
    """A sensor as :func:`potmesil_sensor` gives it, with ``lens`` in the place of its own.

    Raises ``TypeError`` for another lens than a telecentric one, and ``ValueError`` for a sensor
    that is not orthographic.
    """
    if lens is None:
        return potmesil_sensor(sensor)
    if not isinstance(lens, TelecentricLens):
        raise TypeError(
            f"lens={shown(lens)}: must be a TelecentricLens; potmesil_sensor puts a ThinLens "
            "before a perspective sensor"
        )
    if not is_orthographic(sensor):
        raise ValueError(
            f"lens={shown(lens)}: must not be a TelecentricLens for the sensor "
            f"{sensor.class_name()}, which is not orthographic"
        )
    parameters: Any = lens.parameters()
    return potmesil_sensor(sensor, **parameters)


def _orthographic_sensor(sensor: mi.Sensor, lens: Mapping[str, Any]) -> mi.Sensor:
    """A ``potmesil_orthographic`` in the place of one, or of an ``orthographic``."""
    changes: Any = lens
    if isinstance(sensor, LensSensor):
        if not lens:
            return sensor
        own: Any = sensor.lens()
        telecentric = own.replace(**changes)
    else:
        stated = stated_focus_distance(sensor)
        if stated is not None:
            changes = {"focus_distance": stated, **lens}
        for name in ("half_angle", "focus_distance"):
            if name not in changes:
                raise TypeError(
                    f"sensor: an orthographic one has no lens, for which {name} must be given; "
                    "see TelecentricLens"
                )
        telecentric = TelecentricLens(0.0, 0.0).replace(**changes)
    parameters = mi.traverse(sensor)
    replacement = mi.load_dict(
        {
            "type": "potmesil_orthographic",
            "id": sensor.id() or "potmesil_orthographic",
            "film": sensor.film(),
            "sampler": sensor.sampler(),
            "to_world": mi.ScalarTransform4f(
                np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
            ),
            "shutter_open": sensor.shutter_open(),
            "shutter_close": sensor.shutter_open() + sensor.shutter_open_time(),
            **{name: _item(parameters, name) for name in ("near_clip", "far_clip")},
            **{k: v for k, v in telecentric.to_dict().items() if k != "type"},
        }
    )
    if sensor.get_medium() is not None:
        replacement.set_medium(sensor.get_medium())
    return replacement


def sensor_parameters(lens: ThinLens) -> dict[str, Any]:
    """The lens as the parameters of the sensor ``potmesil``, numbers and text.

    Its parameter ``image_distance`` is the lens's ``film``, for the ``film`` of a sensor is what
    has pixels.
    """
    parameters = lens.to_dict()
    parameters["image_distance"] = parameters.pop("film")
    return parameters


def _lens_of(
    sensor: mi.Sensor, parameters: mi.SceneParameters, lens: Mapping[str, Any]
) -> ThinLens:
    """The lens of a built-in sensor, of which ``lens`` replaces some parameters."""
    known: dict[str, Any] = {"millimeters_per_unit": 1000.0}
    if "aperture_radius" in parameters:
        known["aperture_radius"] = _item(parameters, "aperture_radius")
        known["focus_distance"] = _item(parameters, "focus_distance")
    else:
        known["f_number"] = math.inf
        stated = stated_focus_distance(sensor)
        if stated is not None:
            known["focus_distance"] = stated
    if not lens.keys().isdisjoint({"f_number", "aperture_radius"}):
        known.pop("f_number", None)
        known.pop("aperture_radius", None)
    known = in_numbers({**known, **lens}, lens.get("millimeters_per_unit", 1000.0))
    fov = _item(parameters, "x_fov")
    f_number = known.get("f_number")
    in_units = "aperture_radius" in known or (isinstance(f_number, float) and f_number == math.inf)
    if in_units and known.keys().isdisjoint({"focal_length", "frame_width"}):
        # Field of view, aperture and focus make the picture. The frame must only be so narrow that
        # the focal length is less than the focus, which may be millimetres in a small scene.
        distance = known.get("focus_distance", math.inf)
        focused = distance_in_mm(distance, known["millimeters_per_unit"])
        narrow = math.tan(math.radians(fov) / 2) * focused
        if 0 < narrow < FULL_FRAME_WIDTH:
            known["frame_width"] = narrow
    return ThinLens.of_field_of_view(fov, **known)


def _item(parameters: mi.SceneParameters, name: str, default: float | None = None) -> float:
    """A parameter as a Python number, or ``default`` where the sensor has none of that name."""
    if default is not None and name not in parameters:
        return default
    return float(np.array(parameters[name]).ravel()[0])
