"""The hidden-surface stage: point samples of a scene, seen through a pinhole.

Section 3.1 of Potmesil & Chakravarty (1981), with any of Mitsuba's sampling integrators in the
place of the paper's ray tracer.
"""

from __future__ import annotations

import dataclasses
from numbers import Real
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .checks import require_whole
from .progress import track
from .samples import PointSamples
from .scene import pick_sensor, potmesil_sensor, require_vectorised_variant, surface_ids

WAVEFRONT = 1 << 22
"""Most rays that are traced at once, or those of one pixel if it has more: memory is bounded."""

PATTERNS = ("sampler", "uniform", "adaptive")


@dataclasses.dataclass(frozen=True)
class Sampling:
    """Where the image is sampled.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``pattern``                   ``sampler`` (default): the positions of the sensor's own
                                  sampler, N samples a pixel. ``uniform``: the paper's grid
                                  of (2W+1) x (2H+1) corners, edge middles and centres.
                                  ``adaptive``: pixel corners, and where they differ, the
                                  paper's recursive subdivision in 2x2 squares
    ``threshold``                 ``adaptive``: a square is subdivided where a corner differs
                                  from the mean of the four by more than this in any of R, G,
                                  B, clipped to [0, 1]; >= 0 (default 25/255, the paper's)
    ``subdivisions``              ``adaptive``: largest number of subdivisions of a pixel,
                                  0 to 8 (default 2)
    ============================  ==========================================================

    On the grids of ``uniform`` and ``adaptive`` N samples a pixel are N paths averaged at each
    point. Raises ``ValueError`` or ``TypeError`` that names the parameter.
    """

    pattern: str = "sampler"
    threshold: float = 25 / 255
    subdivisions: int = 2

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise ValueError(f"pattern={self.pattern!r}: must be one of {', '.join(PATTERNS)}")
        if not isinstance(self.threshold, Real):
            raise TypeError(f"threshold={self.threshold!r}: must be a number >= 0")
        if not self.threshold >= 0:
            raise ValueError(f"threshold={self.threshold}: must be >= 0")
        require_whole("subdivisions", self.subdivisions, 0, 8)


def render_samples(
    scene: mi.Scene,
    sensor: int | mi.Sensor = 0,
    integrator: mi.Integrator | None = None,
    *,
    spp: int = 0,
    seed: int = 0,
    sampling: Sampling | None = None,
) -> PointSamples:
    """Point samples of ``scene``: position, radiance, depth and surface of every primary ray.

    ``sensor`` is one, or its number in the scene; a ``perspective`` or ``thinlens`` is sampled
    through the pinhole at its place (see :func:`potmesil_mi.scene.potmesil_sensor`).
    ``integrator`` gives the radiance; by default the scene's, and what is nested in a ``focus``
    or ``point_samples``. ``spp`` samples a pixel, by default as many as the sampler's count;
    some samplers round it up. With one pass (up to 4M rays) and the same ``seed`` the rays are
    those of ``mi.render`` with the same integrator.

    Raises ``ValueError`` for an empty scene or bad parameters, ``TypeError`` for a sensor or
    integrator that cannot be used, ``RuntimeError`` in scalar variants.
    """
    require_vectorised_variant("render_samples")
    sensor = potmesil_sensor(pick_sensor(scene, sensor))
    integrator = integrator or scene.integrator()
    if hasattr(integrator, "nested"):
        sampling = sampling or integrator.sampling
        integrator = integrator.nested
    if not isinstance(integrator, mi.SamplingIntegrator):
        name = "None" if integrator is None else integrator.class_name()
        raise TypeError(f"integrator: {name} given, must be a sampling integrator, such as path")
    if mi.has_flag(sensor.film().flags(), mi.FilmFlags.Special):
        raise TypeError("film: must be a film of colours, such as hdrfilm, not a special one")
    sampling = sampling or Sampling()
    require_whole("spp", spp, 0, 2**32 - 1)
    require_whole("seed", seed, 0, 2**32 - 1)
    with dr.suspend_grad():
        stage = _HiddenSurfaceStage(scene, sensor, integrator, spp, seed)
        columns = stage.run(sampling)
    return PointSamples(
        **columns, camera=sensor.camera(), lens=sensor.lens(), surfaces=stage.surfaces
    )


class _HiddenSurfaceStage:
    """One run over a scene: what all its passes share."""

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        integrator: mi.SamplingIntegrator,
        spp: int,
        seed: int,
    ) -> None:
        self.scene, self.sensor, self.integrator, self.seed = scene, sensor, integrator, seed
        self.ids, self.surfaces = surface_ids(scene)
        self.sampler = sensor.sampler().clone()
        if spp > 0:
            self.sampler.set_sample_count(spp)
        self.spp = self.sampler.sample_count()
        self.sampler.set_samples_per_wavefront(self.spp)
        self.passes = 0
        film = sensor.film()
        self.width, self.height = (int(n) for n in film.crop_size())
        self.left, self.top = (int(n) for n in film.crop_offset())
        if self.width * self.height == 1:
            raise ValueError("film: its crop window has 1x1 pixels, must have more than one")

    def run(self, sampling: Sampling) -> dict[str, Any]:
        """The columns of :class:`PointSamples` by the pattern that ``sampling`` names."""
        if sampling.pattern == "uniform":
            return self._uniform()
        if sampling.pattern == "adaptive":
            return self._adaptive(sampling.threshold, sampling.subdivisions)
        return self._by_sampler()

    def _by_sampler(self) -> dict[str, Any]:
        """``spp`` samples in each pixel where the sampler puts them, pixel by pixel."""
        pixels, per_pass = self.width * self.height, max(1, WAVEFRONT // self.spp)
        columns = _empty_columns(pixels * self.spp)
        start = 0
        for first in track(range(0, pixels, per_pass), "Sampling"):
            count = min(per_pass, pixels - first) * self.spp
            self._seed(count)
            index = dr.arange(mi.UInt32, count) // dr.opaque(mi.UInt32, self.spp)
            index += dr.opaque(mi.UInt32, first)
            y = index // self.width
            corner = mi.Point2f(
                mi.Point2i(index - y * self.width, y) + mi.Point2i(self.left, self.top)
            )
            position = corner + self.sampler.next_2d()
            traced = self._trace(position)
            # In single precision corner + 0.99999 may round up into the next pixel.
            below = 1 - dr.epsilon(mi.Float)
            traced["x"] = dr.minimum(position.x, (corner.x + 1) * below)
            traced["y"] = dr.minimum(position.y, (corner.y + 1) * below)
            for name, values in _to_host(traced).items():
                columns[name][start : start + count] = values
            start += count
        columns["weight"] = np.full(start, 1 / self.spp, dtype=np.float32)
        return columns

    def _uniform(self) -> dict[str, Any]:
        """The paper's grid of corners, middles of edges and centres of the pixels."""
        iy, ix = np.divmod(
            np.arange((2 * self.width + 1) * (2 * self.height + 1)), 2 * self.width + 1
        )
        columns = self._at_lattice(ix, iy, 2)
        return {**columns, "weight": np.full(len(ix), 0.25), "lattice": 2}

    def _adaptive(self, threshold: float, subdivisions: int) -> dict[str, Any]:
        """Pixel corners, subdivided where they differ: the paper's antialiasing (figure 8).

        A sample's weight is a quarter of the area of the squares, not divided further, of which
        it is a corner; on the border of the film the squares beyond it are taken for the
        mirror image of those inside.
        """
        lattice = 1 << subdivisions
        stride = self.width * lattice + 1
        side = lattice
        corner_y, corner_x = np.divmod(np.arange(self.width * self.height), self.width)
        squares = np.stack([corner_x, corner_y]) * lattice
        known = np.empty(0, dtype=np.int64)
        columns = _empty_columns(0)
        weight = np.empty(0)
        for level in range(subdivisions + 1):
            x, y = squares
            corners = np.stack(
                [(y + dy) * stride + x + dx for dy in (0, side) for dx in (0, side)], axis=1
            )
            new = np.setdiff1d(corners, known)
            added = self._at_lattice(new % stride, new // stride, lattice)
            order = np.argsort(np.concatenate([known, new]))
            known = np.concatenate([known, new])[order]
            weight = np.concatenate([weight, np.zeros(len(new))])[order]
            columns = {
                name: np.concatenate([columns[name], added[name]])[order] for name in columns
            }
            index = np.searchsorted(known, corners)
            rgb = np.clip(np.nan_to_num(columns["rgb"][index]), 0, 1)
            differs = (np.abs(rgb - rgb.mean(axis=1, keepdims=True)) > threshold).any(axis=(1, 2))
            if level == subdivisions:
                differs[:] = False
            quarter = (side / lattice) ** 2 / 4
            weight += quarter * np.bincount(index[~differs].ravel(), minlength=len(known))
            side //= 2
            x, y = squares[:, differs]
            squares = np.stack(
                [
                    np.concatenate([x + dx for _ in (0, side) for dx in (0, side)]),
                    np.concatenate([y + dy for dy in (0, side) for _ in (0, side)]),
                ]
            )
        for position, last in (
            (known % stride, self.width * lattice),
            (known // stride, self.height * lattice),
        ):
            weight[(position == 0) | (position == last)] *= 2
        return {**columns, "weight": weight, "lattice": lattice}

    def _at_lattice(self, ix: np.ndarray, iy: np.ndarray, lattice: int) -> dict[str, np.ndarray]:
        """Samples at (ix, iy) / lattice pixels of the crop window, each of ``spp`` paths."""
        columns = _empty_columns(len(ix))
        x = (ix / lattice + self.left).astype(np.float32)
        y = (iy / lattice + self.top).astype(np.float32)
        points = max(1, WAVEFRONT // self.spp)
        for start in track(range(0, len(ix), points), "Sampling"):
            stop = min(start + points, len(ix))
            self._seed((stop - start) * self.spp)
            index = dr.arange(mi.UInt32, (stop - start) * self.spp)
            index //= dr.opaque(mi.UInt32, self.spp)
            position = mi.Point2f(
                dr.gather(mi.Float, mi.Float(x[start:stop]), index),
                dr.gather(mi.Float, mi.Float(y[start:stop]), index),
            )
            for name, values in _to_host(self._trace(position)).items():
                paths = values.reshape(stop - start, self.spp, *values.shape[1:])
                averaged = name in ("rgb", "alpha")
                columns[name][start:stop] = paths.mean(axis=1) if averaged else paths[:, 0]
        return {**columns, "x": x, "y": y}

    def _seed(self, wavefront: int) -> None:
        """A random sequence of its own for each pass, and for the first that of the seed."""
        seed = self.seed
        if self.passes > 0:
            seed = int(mi.sample_tea_32(mi.UInt32(self.seed), mi.UInt32(self.passes))[0][0])
        self.sampler.seed(seed, wavefront)
        self.passes += 1

    def _trace(self, position: mi.Point2f) -> dict[str, Any]:
        """Radiance, depth and surface of the rays through ``position``, in pixels of the film.

        The sampler is asked in the order in which Mitsuba's own integrators ask it, so that
        the rays and the radiance are theirs.
        """
        sensor, sampler = self.sensor, self.sampler
        scale = dr.rcp(mi.ScalarVector2f(self.width, self.height))
        offset = -mi.ScalarVector2f(self.left, self.top) * scale
        time = sensor.shutter_open()
        if sensor.shutter_open_time() > 0:
            time += sampler.next_1d() * sensor.shutter_open_time()
        wavelength_sample = sampler.next_1d() if mi.is_spectral else mi.Float(0)
        ray, ray_weight = sensor.sample_ray_differential(
            time, wavelength_sample, dr.fma(position, scale, offset), mi.Point2f(0.5)
        )
        ray.scale_differential(dr.rsqrt(mi.ScalarFloat(self.spp)))

        hit = self._first_hit(mi.Ray3f(ray))
        depth = (sensor.world_transform().inverse() @ hit.p).z
        shape = dr.select(hit.instance != mi.ShapePtr(None), hit.instance, hit.shape)
        place = dr.reinterpret_array(mi.UInt32, shape)
        radiance, valid, _ = mi.SamplingIntegrator.sample(
            self.integrator, self.scene, sampler, ray, sensor.get_medium(), True
        )
        return {
            "rgb": _to_rgb(radiance * ray_weight, ray.wavelengths),
            "alpha": dr.select(valid, mi.Float(1), mi.Float(0)),
            "z": dr.select(hit.is_valid(), depth, dr.inf),
            "surface": dr.gather(mi.UInt32, self.ids, place, hit.is_valid()),
        }

    def _first_hit(self, ray: mi.Ray3f) -> mi.SurfaceInteraction3f:
        """The surface that the nested integrator sees first: it may leave out area lights."""
        hit = self.scene.ray_intersect(ray)
        if not self.integrator.hide_emitters:
            return hit

        def is_lamp(hit: mi.SurfaceInteraction3f) -> mi.Bool:
            return hit.is_valid() & hit.shape.is_emitter()

        def step(active: mi.Bool, hit: mi.SurfaceInteraction3f) -> tuple[Any, Any]:
            hit = self.scene.ray_intersect(hit.spawn_ray(ray.d), active)
            return active & is_lamp(hit), hit

        return dr.while_loop((is_lamp(hit), hit), lambda active, _: active, step)[1]


def _to_rgb(radiance: mi.Spectrum, wavelengths: mi.Spectrum) -> mi.Color3f:
    """Radiance in linear sRGB, whatever the variant counts it in."""
    if mi.is_polarized:
        radiance = mi.unpolarized_spectrum(radiance)
    if mi.is_spectral:
        return mi.spectrum_to_srgb(radiance, wavelengths)
    return mi.Color3f(radiance.x) if mi.is_monochromatic else radiance


def _empty_columns(count: int) -> dict[str, np.ndarray]:
    columns = {name: np.empty(count, dtype=np.float32) for name in ("x", "y", "alpha", "z")}
    columns["rgb"] = np.empty((count, 3), dtype=np.float32)
    columns["surface"] = np.empty(count, dtype=np.uint32)
    return columns


def _to_host(columns: dict[str, Any]) -> dict[str, np.ndarray]:
    """All columns as NumPy arrays, by one kernel: each asked for alone would trace again."""
    dr.eval(columns)
    arrays = {name: np.array(values) for name, values in columns.items()}
    return {name: array.T if array.ndim == 2 else array for name, array in arrays.items()}
