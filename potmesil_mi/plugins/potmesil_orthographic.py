"""Sensor ``potmesil_orthographic``: parallel rays, and the telecentric lens of their picture."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .._validation import shown
from ..optics.camera import Camera
from ..optics.telecentric import TelecentricLens
from .projective import CLIPPING, ProjectiveSensor, number_from

LENS_PARAMETERS = {"half_angle": None, "focus_distance": None, "squeeze": 1.0}
"""Numbers of the lens, and their defaults; those without must be given."""


class PotmesilOrthographicSensor(ProjectiveSensor):
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

    ``mi.traverse`` exposes the numbers of the lens, the clipping planes and ``to_world``, of which
    the last is differentiable. Bad values raise ``ValueError`` or ``TypeError``. An update of
    the parameters does so, too, and then the sensor and its parameters stay as they were.
    """

    plugin = "potmesil_orthographic"

    m_lens: TelecentricLens

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        for name, default in LENS_PARAMETERS.items():
            if default is None and name not in props:
                raise ValueError(f"{name}: must be given for {self.plugin}")
        lens = {name: number_from(props, name, to) for name, to in LENS_PARAMETERS.items()}
        self._expose(
            **lens, **{name: number_from(props, name, to) for name, to in CLIPPING.items()}
        )
        self.m_lens = TelecentricLens(**lens, aperture=props.get("aperture", "disc"))
        self._update()
        self._keep()

    def _update(self) -> None:
        """What follows from the parameters: the lens, the camera, and the projection."""
        self.m_lens = self.m_lens.replace(**self._changes(LENS_PARAMETERS))
        self._require_clipping()
        self.m_camera = self._camera()
        film = self.film()
        self._set_projection(
            mi.orthographic_projection(
                film.size(),
                film.crop_size(),
                film.crop_offset(),
                self.m_near_clip,
                self.m_far_clip,
            )
        )

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
            raise ValueError(f"to_world={shown(matrix)}: must not shear")
        near = self.near_clip() * float(scale[2])
        return self._camera_of(
            x_fov=0.0,
            to_world=tuple(map(tuple, matrix.tolist())),
            near_clip=near,
            # The near plane is scaled with the axis, and a ray's length is not.
            far_clip=near + (self.far_clip() - self.near_clip()),
            projection="orthographic",
            film_width=2 * float(scale[0]),
        )

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Expose the lens, the clipping planes and the placement to ``mi.traverse``."""
        super().traverse(callback)
        for name in (*LENS_PARAMETERS, *CLIPPING):
            callback.put(name, getattr(self, f"m_{name}"), mi.ParamFlags.NonDifferentiable)
        flags = mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous
        callback.put("to_world", self.m_to_world, flags)

    def camera(self) -> Camera:
        """The orthographic camera that takes the samples."""
        return self.m_camera

    def sample_ray(
        self,
        time: mi.Float,
        sample1: mi.Float,
        sample2: mi.Point2f,
        sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """A ray along the axis; ``sample2`` is the position in the crop window, 0 to 1."""
        ray, weight = self._ray_of(time, sample1, active)
        to_world = self.world_transform()
        ray.o = to_world @ (self.m_sample_to_camera @ mi.Point3f(sample2.x, sample2.y, 0))
        ray.d = dr.normalize(to_world @ mi.Vector3f(0, 0, 1))
        ray.maxt = self.m_far_clip - self.m_near_clip
        return ray, weight

    def to_string(self) -> str:
        """Text for the log and for ``print``."""
        return (
            f"PotmesilOrthographicSensor[\n  lens = {self.m_lens},\n"
            f"  near_clip = {self.near_clip()},\n  far_clip = {self.far_clip()},\n"
            f"  film = {self.film()},\n  to_world = {self._matrix().tolist()}\n]"
        )
