"""What the sensors ``potmesil`` and ``potmesil_orthographic`` share: a projection and a lens."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .._validation import require_not_before, require_number, shown
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens

CLIPPING = {"near_clip": 1e-2, "far_clip": 1e4}
"""Clipping planes and their defaults, as in Mitsuba's projective cameras."""


class ProjectiveSensor(mi.Sensor):
    """A sensor with a projection and a lens, as ``mi.ProjectiveCamera`` has them.

    A class in Python cannot derive from that one. A number that ``mi.traverse`` exposes is an
    attribute ``m_NAME``, a ``mi.Float`` of one element. The lens is what counts: where a number
    differs from the lens's, it has been changed.
    """

    plugin: str
    """The name under which Mitsuba knows it."""

    m_lens: ThinLens | TelecentricLens
    m_to_world: Any
    m_changing = False
    """Whether the parameters are being checked."""
    m_kept: dict[str, Any]
    """Copies of the exposed parameters when they were valid last."""
    m_near_clip: Any
    m_far_clip: Any
    m_camera_to_sample: Any
    """From camera space to the crop window, 0 to 1, and from there back; set by subclasses."""
    m_sample_to_camera: Any

    def __init__(self, props: mi.Properties) -> None:
        opened = number_from(props, "shutter_open", 0.0)
        require_number("shutter_open", opened)
        require_not_before(
            "shutter_close", number_from(props, "shutter_close", 0.0), "shutter_open", opened
        )
        super().__init__(props)
        self.m_needs_sample_3 = False
        if not self.id():  # mi.traverse names an object without an id by its address
            self.set_id(self.plugin)

    def _expose(self, **numbers: float) -> None:
        """Make ``mi.Float`` of the numbers that ``mi.traverse`` is to find."""
        for name, number in numbers.items():
            setattr(self, f"m_{name}", mi.Float(number))

    def _value(self, name: str) -> float:
        """The exposed number. Raises ``ValueError`` where it has become several, or none."""
        value = getattr(self, f"m_{name}")
        if not isinstance(value, (int, float)) and len(value) != 1:
            raise ValueError(f"{name}={shown(value)}: must be one number")
        return item(value)

    def _differs(self, name: str, number: float) -> bool:
        """Whether the exposed number is another one, in single precision."""
        return self._value(name) != item(mi.Float(number))

    def _changes(self, names: Iterable[str]) -> dict[str, Any]:
        """Those of the exposed numbers that are not the lens's, which stay exact otherwise."""
        return {
            name: self._value(name)
            for name in names
            if self._differs(name, getattr(self.m_lens, name))
        }

    def _follow(self, name: str, number: float) -> None:
        """Let the exposed number be this one, in place: whoever has traversed the sensor holds it.

        In scalar variants, where numbers are no objects, there is nothing to follow.
        """
        if self._differs(name, number):
            mi.set_property(getattr(self, f"m_{name}"), mi.Float(number))

    def _update(self) -> None:
        """Check the parameters, and set what follows from them."""
        raise NotImplementedError

    def parameters_changed(self, keys: list[str]) -> None:
        """Check the parameters again and follow them.

        Where one of them is wrong the sensor stays as it was, and so do its parameters.
        """
        if self.m_changing:  # Mitsuba's own method, called from here, comes back once.
            super().parameters_changed(keys)
            return
        lens, self.m_changing = self.m_lens, True
        try:
            super().parameters_changed(keys)
            require_number("shutter_open", self.shutter_open())
            require_number("shutter_open_time", self.shutter_open_time(), 0)
            if not keys or "to_world" in keys:
                self.m_to_world = self.m_to_world.update()  # its inverse, if the matrix was set
            self._update()
        except Exception:
            self.m_lens = lens
            self._restore()
            raise
        finally:
            self.m_changing = False
        self._keep()

    def _keep(self) -> None:
        """Keep what the parameters are now, which is valid."""
        self.m_kept = {
            name: type(value)(value) for name, value in mi.traverse(self) if "." not in name
        }

    def _restore(self) -> None:
        """Let the parameters be what was kept, in place, as :meth:`_follow` does."""
        exposed = mi.traverse(self)
        for name, kept in self.m_kept.items():
            if not np.array_equal(_numbers(exposed[name]), _numbers(kept)):
                exposed[name] = kept

    def _set_projection(self, camera_to_sample: Any) -> None:
        """Take the projection from camera space to the crop window, and its inverse."""
        self.m_camera_to_sample = mi.ProjectiveTransform4f(camera_to_sample.matrix)
        self.m_sample_to_camera = self.m_camera_to_sample.inverse()
        # Variables and no literals, so that one kernel serves every field of view and every scale.
        dr.make_opaque(
            self.m_camera_to_sample, self.m_sample_to_camera, self.m_near_clip, self.m_far_clip
        )

    def projection_transform(self) -> Any:
        """Camera space to the crop window, 0 to 1, with z 0 on the near plane and 1 on the far.

        The principal point is not in it, as it is not in that of ``perspective``.
        """
        return self.m_camera_to_sample

    def lens(self) -> ThinLens | TelecentricLens:
        """The lens that the parameters describe."""
        return self.m_lens

    def near_clip(self) -> float:
        """Nearest depth that is rendered, in units of the axis of ``to_world``."""
        return self._value("near_clip")

    def far_clip(self) -> float:
        """Farthest depth that is rendered, in units of the axis of ``to_world``."""
        return self._value("far_clip")

    def focus_distance(self) -> float:
        """Depth of the focused plane in scene units."""
        return float(self.m_lens.focus_distance)

    def _require_clipping(self) -> None:
        """Raise ``ValueError`` unless the clipping planes are in front of the camera, in order."""
        near, far = self.near_clip(), self.far_clip()
        if not 0 < near < math.inf:
            raise ValueError(f"near_clip={near}: must be > 0 and finite")
        if not near < far < math.inf:
            raise ValueError(f"far_clip={far}: must be beyond near_clip={near} and finite")

    def _matrix(self) -> np.ndarray:
        """The camera-to-world matrix with its scale, shape (4, 4).

        Raises ``ValueError`` unless it is one, of finite numbers.
        """
        matrix = _numbers(self.world_transform())
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise ValueError(f"to_world={shown(matrix)}: must be one matrix of finite numbers")
        return matrix

    def _camera_of(self, **fields: Any) -> Camera:
        """The camera with the sensor's film and shutter, and with ``fields``."""
        film = self.film()
        size, crop_offset, crop_size = film.size(), film.crop_offset(), film.crop_size()
        return Camera(
            film_size=(int(size.x), int(size.y)),
            crop_offset=(int(crop_offset.x), int(crop_offset.y)),
            crop_size=(int(crop_size.x), int(crop_size.y)),
            shutter_open=self.shutter_open(),
            shutter_close=self.shutter_open() + self.shutter_open_time(),
            **fields,
        )

    def _ray_of(
        self, time: mi.Float, sample1: mi.Float, active: mi.Bool
    ) -> tuple[Any, mi.Spectrum]:
        """A ray of zeros with this time and the wavelengths that ``sample1`` gives; its weight."""
        ray = dr.zeros(mi.Ray3f)
        ray.time = time
        ray.wavelengths, weight = self.sample_wavelengths(
            dr.zeros(mi.SurfaceInteraction3f), sample1, active
        )
        return ray, weight

    def bbox(self) -> mi.BoundingBox3f:
        """The position of the camera."""
        # A scalar variant, where no other has been set, has the type under its plain name alone.
        box = getattr(mi, "ScalarBoundingBox3f", mi.BoundingBox3f)
        return box(mi.ScalarPoint3f(self._matrix()[:3, 3]))


def number_from(props: mi.Properties, name: str, default: float | None = None) -> float:
    """A parameter that must be a number; without a default it must be given.

    Raises ``TypeError`` for anything else.
    """
    value = props[name] if default is None else props.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{name}={shown(value)}: must be a number")
    return float(value)


def item(value: Any) -> float:
    """A one-element Dr.Jit array, or a number in scalar variants, as a Python number."""
    return float(value if isinstance(value, (int, float)) else value[0])


def _numbers(value: Any) -> np.ndarray:
    """An exposed parameter as an array: () for a number, (4, 4) for a transformation."""
    return np.array(getattr(value, "matrix", value), dtype=np.float64).squeeze()
