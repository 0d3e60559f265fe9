"""Sensor ``potmesil_orthographic``: parallel rays, and the telecentric lens of their picture."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..optics.camera import Camera
from ..optics.telecentric import TelecentricLens

NUMBERS = {
    "half_angle": None,
    "focus_distance": None,
    "squeeze": 1.0,
    "near_clip": 1e-2,
    "far_clip": 1e4,
}
"""Parameters that are numbers, and their defaults; those without must be given."""


class PotmesilOrthographicSensor(mi.Sensor):
    r"""Orthographic camera with a telecentric lens.

    Any integrator sees the rays of ``orthographic`` with the same film and ``to_world``. The
    integrators ``focus`` and ``point_samples`` also read the lens.

    .. pluginparameters::

     * - half_angle
       - |float|
       - Of the cone of light that a point of the film takes in, in degrees, 0 to 80.
     * - focus_distance
       - |float|
       - Depth U of the focused plane in scene units along the axis.
     * - aperture
       - |string|
       - Its shape as text: ``disc``, ``polygon:blades=6``, ... (Default: disc)
     * - squeeze
       - |float|
       - Of an anamorphic lens: height of highlights to their width, 1 to 4. (Default: 1)
     * - to_world
       - |transform|
       - Camera-to-world transformation. As for ``orthographic`` its scale is the size of the
         film, which is two units wide without; x and y must be scaled alike.
     * - near_clip, far_clip
       - |float|
       - Clipping planes, as in ``orthographic``. (Default: 0.01 and 10000)
     * - shutter_open, shutter_close, film, sampler, srf
       - |float|, |film|, |sampler|, |spectrum|
       - As in ``orthographic``.

    Bad values raise ``ValueError`` or ``TypeError``; after an update of the parameters too.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_needs_sample_3 = False
        if not self.id():  # mi.traverse names an object without an id by its address
            self.set_id("potmesil_orthographic")
        values: dict[str, Any] = {}
        for name, default in NUMBERS.items():
            if default is None and name not in props:
                raise ValueError(f"{name}: must be given for potmesil_orthographic")
            value = props.get(name, default)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise TypeError(f"{name}={value!r}: must be a number")
            values[name] = float(value)
        for name, value in values.items():
            setattr(self, f"m_{name}", mi.Float(value))
        lens = {name: values[name] for name in ("half_angle", "focus_distance", "squeeze")}
        self.m_lens = TelecentricLens(**lens, aperture=props.get("aperture", "disc"))
        self._update()

    def _update(self) -> None:
        """What follows from the parameters: the lens, the camera, and the sensor of the rays."""
        # Only what was changed is taken from the single-precision parameters.
        changes: dict[str, Any] = {}
        for name in ("half_angle", "focus_distance", "squeeze"):
            value = _item(getattr(self, f"m_{name}"))
            if value != _item(mi.Float(getattr(self.m_lens, name))):
                changes[name] = value
        self.m_lens = self.m_lens.replace(**changes)
        self.m_camera = self._camera()
        self.m_parallel = mi.load_dict(
            {
                "type": "orthographic",
                "film": self.film(),
                "to_world": mi.ScalarTransform4f(self._matrix()),
                "near_clip": self.near_clip(),
                "far_clip": self.far_clip(),
            }
        )

    def _matrix(self) -> np.ndarray:
        """The camera-to-world matrix with its scale, shape (4, 4)."""
        return np.array(self.world_transform().matrix, dtype=np.float64).reshape(4, 4)

    def _camera(self) -> Camera:
        """The camera, whose ``to_world`` does not scale."""
        matrix = self._matrix()
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        if not (scale > 0).all():
            raise ValueError(f"to_world: must not scale an axis by 0, but by {scale}")
        if not np.isclose(scale[0], scale[1], rtol=1e-3):
            raise ValueError(
                f"to_world: must scale x and y alike, but scales them by {scale[0]} and {scale[1]}"
            )
        matrix[:3, :3] /= scale
        if not np.allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-3):
            raise ValueError("to_world: must not shear")
        film = self.film()
        size, crop_offset, crop_size = film.size(), film.crop_offset(), film.crop_size()
        near = self.near_clip() * float(scale[2])
        return Camera(
            film_size=(int(size.x), int(size.y)),
            crop_offset=(int(crop_offset.x), int(crop_offset.y)),
            crop_size=(int(crop_size.x), int(crop_size.y)),
            x_fov=0.0,
            to_world=tuple(map(tuple, matrix.tolist())),
            near_clip=near,
            # The near plane is scaled with the axis, and a ray's length is not.
            far_clip=near + (self.far_clip() - self.near_clip()),
            shutter_open=self.shutter_open(),
            shutter_close=self.shutter_open() + self.shutter_open_time(),
            projection="orthographic",
            film_width=2 * float(scale[0]),
        )

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Expose the lens, the clipping planes and the placement to ``mi.traverse``."""
        super().traverse(callback)
        for name in NUMBERS:
            callback.put(name, getattr(self, f"m_{name}"), mi.ParamFlags.NonDifferentiable)
        callback.put("to_world", self.m_to_world, mi.ParamFlags.NonDifferentiable)

    def parameters_changed(self, keys: list[str]) -> None:
        """Check the parameters again and follow them."""
        super().parameters_changed(keys)
        self._update()

    def lens(self) -> TelecentricLens:
        """The lens that the parameters describe."""
        return self.m_lens

    def camera(self) -> Camera:
        """The orthographic camera that takes the samples."""
        return self.m_camera

    def near_clip(self) -> float:
        """Nearest depth that is rendered, in units of the axis of ``to_world``."""
        return _item(self.m_near_clip)

    def far_clip(self) -> float:
        """Farthest depth that is rendered, as ``orthographic`` counts it."""
        return _item(self.m_far_clip)

    def focus_distance(self) -> float:
        """Depth of the focused plane in scene units."""
        return self.m_lens.focus_distance

    def sample_ray(
        self,
        time: mi.Float,
        sample1: mi.Float,
        sample2: mi.Point2f,
        sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """A ray along the axis; ``sample2`` is the position in the crop window, 0 to 1."""
        wavelengths, weight = self.sample_wavelengths(
            dr.zeros(mi.SurfaceInteraction3f), sample1, active
        )
        ray, _ = self.m_parallel.sample_ray(time, sample1, sample2, sample3, active)
        ray.wavelengths = wavelengths
        return ray, weight

    def bbox(self) -> mi.BoundingBox3f:
        """That of ``orthographic``: none."""
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        """Text for the log and for ``print``."""
        return (
            f"PotmesilOrthographicSensor[\n  lens = {self.m_lens},\n"
            f"  near_clip = {self.near_clip()},\n  far_clip = {self.far_clip()},\n"
            f"  film = {self.film()},\n  to_world = {self._matrix().tolist()}\n]"
        )


def _item(value: Any) -> float:
    """A one-element Dr.Jit array, or a number in scalar variants, as a Python number."""
    return float(value if isinstance(value, (int, float)) else value[0])
