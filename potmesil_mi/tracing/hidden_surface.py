"""The hidden-surface stage: point samples of a scene, seen through a pinhole.

Section 3.1 of Potmesil & Chakravarty (1981), with any of Mitsuba's sampling integrators in the
place of the paper's ray tracer.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import require_vectorised_variant
from .._progress import track
from .._validation import require_whole
from ..optics.blur import widest_radius_per_vergence
from ..samples.point_samples import PointSamples
from .disocclusion import disoccluded, overscan
from .sampling import Sampling
from .sensor import pick_sensor, potmesil_sensor
from .shapes import closed_shapes, registry_index, surface_ids
from .virtual_depth import has_specular, passes_straight, seen

PROBES = 512
"""Rays on a side that look for how far overscan must reach."""

WAVEFRONT = 1 << 22
"""Most rays that are traced at once, or those of one pixel if it has more: memory is bounded."""


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
        stage = _HiddenSurfaceStage(scene, sensor, integrator, spp, seed, sampling)
        columns = stage.run()
    return PointSamples(
        **columns,
        camera=sensor.camera(),
        lens=sensor.lens(),
        surfaces=stage.surfaces,
        window=stage.window,
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
        sampling: Sampling,
    ) -> None:
        self.scene, self.sensor, self.integrator, self.seed = scene, sensor, integrator, seed
        self.sampling = sampling
        self.ids, self.surfaces = surface_ids(scene)
        self.follows = sampling.virtual_depth and has_specular(scene)
        self.closed = closed_shapes(scene) if sampling.layers > 1 else None
        self.sampler = sensor.sampler().clone()
        if spp > 0:
            self.sampler.set_sample_count(spp)
        self.spp = self.sampler.sample_count()
        self.sampler.set_samples_per_wavefront(self.spp)
        self.passes = 0
        film = sensor.film()
        self.crop_size = tuple(int(n) for n in film.crop_size())
        self.crop_offset = tuple(int(n) for n in film.crop_offset())
        if self.crop_size[0] * self.crop_size[1] == 1:
            raise ValueError("film: its crop window has 1x1 pixels, must have more than one")
        self.lens = sensor.lens()
        if sampling.min_f_number is not None:
            self.lens = self.lens.replace(f_number=sampling.min_f_number)
        self.window = self._window()

    def run(self) -> dict[str, Any]:
        """The columns of :class:`PointSamples`."""
        if self.sampling.pattern == "sampler":
            kept = self._by_sampler()
            self._add_hidden(kept, self.spp)
            return kept.columns()
        if self.sampling.pattern == "uniform":
            columns = self._uniform()
        else:
            columns = self._adaptive(self.sampling.threshold, self.sampling.subdivisions)
        lattice = columns.pop("lattice")
        kept = _Columns(len(columns["x"]))
        kept.add(columns, layer=0)
        self._add_hidden(kept, 1)
        return {**kept.columns(), "lattice": lattice}

    def _by_sampler(self) -> _Columns:
        """``spp`` samples in each pixel where the sampler puts them, pixel by pixel.

        The crop window comes first, so that its rays are those of ``mi.render``.
        """
        (left, top), (width, height) = self.crop_offset, self.crop_size
        row, column = np.divmod(np.arange(width * height), width)
        parts = [(column + left, row + top)]
        first, above, wide, high = self.window
        row, column = np.divmod(np.arange(wide * high), wide)
        column, row = column + first, row + above
        beyond = (column < left) | (column >= left + width)
        beyond |= (row < top) | (row >= top + height)
        if beyond.any():
            parts.append((column[beyond], row[beyond]))
        pixels = sum(len(column) for column, _ in parts)
        # Room for the hidden ones, too: memory that is not written to costs nothing.
        kept = _Columns(pixels * self.spp * min(self.sampling.layers, 2))
        per_pass = max(1, WAVEFRONT // self.spp)
        passes = [
            (column[first : first + per_pass], row[first : first + per_pass])
            for column, row in parts
            for first in range(0, len(column), per_pass)
        ]
        for column, row in track(passes, "Sampling"):
            count = len(column) * self.spp
            self._seed(count)
            pixel = dr.arange(mi.UInt32, count) // dr.opaque(mi.UInt32, self.spp)
            corner = mi.Point2f(
                dr.gather(mi.Float, mi.Float(column.astype(np.float32)), pixel),
                dr.gather(mi.Float, mi.Float(row.astype(np.float32)), pixel),
            )
            position = corner + self.sampler.next_2d()
            traced = self._trace(position)
            traced["x"], traced["y"] = _within(position.x, corner.x), _within(position.y, corner.y)
            kept.add(_to_host(traced), weight=1 / self.spp, layer=0)
        return kept

    def _uniform(self) -> dict[str, Any]:
        """The paper's grid of corners, middles of edges and centres of the pixels."""
        width, height = self.window[2:]
        iy, ix = np.divmod(np.arange((2 * width + 1) * (2 * height + 1)), 2 * width + 1)
        columns = self._at_lattice(ix, iy, 2)
        return {**columns, "weight": np.full(len(ix), 0.25), "lattice": 2}

    def _adaptive(self, threshold: float, subdivisions: int) -> dict[str, Any]:
        """Pixel corners, subdivided where they differ: the paper's antialiasing (figure 8).

        A sample's weight is a quarter of the area of the squares, not divided further, of which
        it is a corner; on the border of the window the squares beyond it are taken for the
        mirror image of those inside.
        """
        lattice = 1 << subdivisions
        width, height = self.window[2:]
        stride = width * lattice + 1
        side = lattice
        corner_y, corner_x = np.divmod(np.arange(width * height), width)
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
            (known % stride, width * lattice),
            (known // stride, height * lattice),
        ):
            weight[(position == 0) | (position == last)] *= 2
        return {**columns, "weight": weight, "lattice": lattice}

    def _at_lattice(self, ix: np.ndarray, iy: np.ndarray, lattice: int) -> dict[str, np.ndarray]:
        """Samples at (ix, iy) / lattice pixels of the window, each of ``spp`` paths."""
        left, top = self.window[:2]
        x = (ix / lattice + left).astype(np.float32)
        y = (iy / lattice + top).astype(np.float32)
        return self._averaged(x, y, self._trace, "Sampling")

    def _averaged(
        self, x: np.ndarray, y: np.ndarray, trace: Callable[..., dict[str, Any]], label: str
    ) -> dict[str, np.ndarray]:
        """Samples at (x, y), float32 (N,) in pixels of the film, each of ``spp`` paths."""
        columns = _empty_columns(len(x))
        points = max(1, WAVEFRONT // self.spp)
        for start in track(range(0, len(x), points), label):
            stop = min(start + points, len(x))
            self._seed((stop - start) * self.spp)
            index = dr.arange(mi.UInt32, (stop - start) * self.spp)
            index //= dr.opaque(mi.UInt32, self.spp)
            position = mi.Point2f(
                dr.gather(mi.Float, mi.Float(x[start:stop]), index),
                dr.gather(mi.Float, mi.Float(y[start:stop]), index),
            )
            for name, values in _to_host(trace(position)).items():
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

    def _window(self) -> tuple[int, int, int, int]:
        """Left, top, width and height of what is sampled: the crop window and overscan."""
        (left, top), (width, height) = self.crop_offset, self.crop_size
        margin = self.sampling.overscan
        if margin is not None:
            return left - margin, top - margin, width + 2 * margin, height + 2 * margin
        lens = self.lens.plain()
        if lens.aperture_radius == 0:
            return left, top, width, height
        side = max(width, height)
        spacing = 2 * side / PROBES
        start = spacing / 2 - side / 2
        x = np.arange(left + start, left + width + side / 2, spacing)
        y = np.arange(top + start, top + height + side / 2, spacing)
        x, y = (axis.ravel().astype(np.float32) for axis in np.meshgrid(x, y))
        ray, _ = self._primary_ray(mi.Point2f(x, y), mi.Float(0.5), self.sensor.shutter_open())
        z = np.array(self._seen(mi.Ray3f(ray))[0])
        crop = (left, top, width, height)
        return overscan(x, y, z, spacing, crop, lens, self.sensor.camera())

    def _trace(self, position: mi.Point2f) -> dict[str, Any]:
        """Radiance, depth and surface of the rays through ``position``, in pixels of the film.

        The sampler is asked in the order in which Mitsuba's own integrators ask it, so that
        the rays and the radiance are theirs.
        """
        ray, ray_weight = self._sampled_ray(position)
        depth, hit, _ = self._seen(mi.Ray3f(ray))
        return self._shaded(ray, ray_weight, depth, hit, mi.Bool(True))

    def _sampled_ray(self, position: mi.Point2f) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """The ray of a sample, with time and wavelengths that the sampler gives."""
        sensor, sampler = self.sensor, self.sampler
        time = sensor.shutter_open()
        if sensor.shutter_open_time() > 0:
            time += sampler.next_1d() * sensor.shutter_open_time()
        wavelength_sample = sampler.next_1d() if mi.is_spectral else mi.Float(0)
        return self._primary_ray(position, wavelength_sample, time)

    def _primary_ray(
        self, position: mi.Point2f, wavelength_sample: mi.Float, time: mi.Float
    ) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """The ray through ``position``, in pixels of the film, and its weight."""
        scale = dr.rcp(mi.ScalarVector2f(self.crop_size))
        offset = -mi.ScalarVector2f(self.crop_offset) * scale
        ray, weight = self.sensor.sample_ray_differential(
            time, wavelength_sample, dr.fma(position, scale, offset), mi.Point2f(0.5)
        )
        ray.scale_differential(dr.rsqrt(mi.ScalarFloat(self.spp)))
        return ray, weight

    def _shaded(
        self,
        ray: mi.RayDifferential3f,
        ray_weight: mi.Spectrum,
        depth: mi.Float,
        hit: mi.SurfaceInteraction3f,
        active: mi.Bool,
    ) -> dict[str, Any]:
        """Radiance along ``ray``, with the depth and the surface of what it shows."""
        radiance, valid, _ = mi.SamplingIntegrator.sample(
            self.integrator, self.scene, self.sampler, ray, self.sensor.get_medium(), active
        )
        return {
            "rgb": _to_rgb(radiance * ray_weight, ray.wavelengths),
            "alpha": dr.select(valid, mi.Float(1), mi.Float(0)),
            "z": depth,
            "surface": dr.gather(mi.UInt32, self.ids, registry_index(hit), hit.is_valid()),
        }

    def _seen(self, ray: mi.Ray3f) -> tuple[mi.Float, mi.SurfaceInteraction3f, mi.Bool]:
        """Depth and surface of what a primary ray shows, and whether in a mirror."""
        hit = self._first_hit(ray)
        if not self.follows:
            return self._depth(hit), hit, mi.Bool(False)
        return self._shown_at(ray, hit)

    def _shown_at(
        self, ray: mi.Ray3f, hit: mi.SurfaceInteraction3f
    ) -> tuple[mi.Float, mi.SurfaceInteraction3f, mi.Bool]:
        """Depth and surface of what a primary ray's hit shows, if that is a mirror or a pane."""
        to_world = self.sensor.world_transform()
        axis = to_world @ mi.Vector3f(0, 0, 1)
        return seen(self.scene, to_world @ mi.Point3f(0), ray, hit, axis)

    def _depth(self, hit: mi.SurfaceInteraction3f) -> mi.Float:
        """Depth along the camera's axis, infinite where nothing was hit."""
        depth = (self.sensor.world_transform().inverse() @ hit.p).z
        return dr.select(hit.is_valid(), depth, dr.inf)

    def _add_hidden(self, kept: _Columns, group: int) -> None:
        """Add the surfaces behind, layer by layer.

        ``group`` samples after each other are in one pixel, where the sampler keeps them together.
        """
        first = kept.columns()
        chosen = self._may_hide(first, group)
        for layer in range(1, self.sampling.layers):
            chosen = np.flatnonzero(chosen)
            if len(chosen) == 0:
                break
            behind = self._behind(first["x"][chosen], first["y"][chosen], layer, group)
            behind["weight"] = first["weight"][chosen]
            seen = behind["z"] > 0
            kept.add({name: values[seen] for name, values in behind.items()}, layer=layer)
            goes_on = np.zeros(len(first["x"]), dtype=bool)
            goes_on[chosen] = seen & np.isfinite(behind["z"])
            chosen = np.repeat(goes_on.reshape(-1, group).any(axis=1), group)

    def _may_hide(self, columns: dict[str, Any], group: int) -> np.ndarray:
        """Which samples, bool (N,), may have something behind them that the lens sees.

        ``group`` samples after each other are in one pixel.
        """
        z = columns["z"]
        nearest_of, farthest_of = (
            np.asarray(dr.block_reduce(op, mi.Float(z), group))
            for op in (dr.ReduceOp.Min, dr.ReduceOp.Max)
        )
        scale = widest_radius_per_vergence(self.lens, self.sensor.camera(), float(nearest_of.min()))
        if self.sampling.layers == 1 or scale == 0:
            return np.zeros(len(z), dtype=bool)
        left, top, width, height = self.window
        column = np.clip(np.floor(columns["x"][::group]).astype(np.int64) - left, 0, width - 1)
        row = np.clip(np.floor(columns["y"][::group]).astype(np.int64) - top, 0, height - 1)
        pixel = row * width + column
        nearest = np.full(width * height, np.inf, dtype=np.float32)
        farthest = np.zeros(width * height, dtype=np.float32)
        np.minimum.at(nearest, pixel, nearest_of)
        np.maximum.at(farthest, pixel, farthest_of)
        farthest[farthest == 0] = np.inf
        shape = (height, width)
        chosen = disoccluded(nearest.reshape(shape), farthest.reshape(shape), scale)
        return np.repeat(chosen.ravel()[pixel], group)

    def _behind(
        self, x: np.ndarray, y: np.ndarray, layer: int, group: int
    ) -> dict[str, np.ndarray]:
        """Samples of the surface behind ``layer`` others; z is 0 where there is none."""

        def trace(position: mi.Point2f) -> dict[str, Any]:
            return self._trace_behind(position, mi.UInt32(layer))

        if group == 1:
            return self._averaged(x, y, trace, "Hidden surfaces")
        columns = _empty_columns(len(x))
        size = max(1, WAVEFRONT // group) * group
        for start in track(range(0, len(x), size), "Hidden surfaces"):
            part = slice(start, start + size)
            self._seed(len(x[part]))
            for name, values in _to_host(trace(mi.Point2f(x[part], y[part]))).items():
                columns[name][part] = values
        return {**columns, "x": x, "y": y}

    def _trace_behind(self, position: mi.Point2f, layer: mi.UInt32) -> dict[str, Any]:
        """What the rays through ``position`` meet behind ``layer`` surfaces; z = 0 for nothing.

        The far sides of closed shapes, and what is inside them, no lens sees: they are passed.
        """
        ray, ray_weight = self._sampled_ray(position)
        _, hit, mirrored = self._seen(mi.Ray3f(ray))
        end = ray(ray.maxt)

        def goes_in(hit: mi.SurfaceInteraction3f) -> mi.Float:
            """1 where the ray goes into a closed shape, -1 where it comes out, 0 for others."""
            side = dr.gather(mi.Float, self.closed, registry_index(hit), hit.is_valid())
            return -side * dr.sign(dr.dot(hit.n, ray.d))

        def onwards(hit: mi.SurfaceInteraction3f) -> mi.Ray3f:
            further = hit.spawn_ray(ray.d)
            further.maxt = dr.dot(end - further.o, ray.d)
            return further

        def step(
            active: mi.Bool,
            hit: mi.SurfaceInteraction3f,
            origin: mi.Point3f,
            inside: mi.Float,
            passed: mi.UInt32,
        ) -> tuple[Any, ...]:
            further = onwards(hit)
            hit = self.scene.ray_intersect(further, active)
            origin = mi.Point3f(further.o)
            counts = active & (inside == 0) & ~self._is_left_out(hit)
            if self.follows:
                counts &= ~passes_straight(hit, counts)
            # Never inside fewer than no shapes: the camera may have been in one from the start.
            inside = dr.maximum(inside + goes_in(hit), 0)
            passed = passed + dr.select(counts, mi.UInt32(1), mi.UInt32(0))
            return active & hit.is_valid() & (passed < layer), hit, origin, inside, passed

        active = hit.is_valid() & ~mirrored
        inside = dr.maximum(goes_in(hit), 0)
        state = (active, hit, mi.Point3f(ray.o), inside, mi.UInt32(0))
        _, behind, origin, _, passed = dr.while_loop(state, lambda active, *_: active, step)
        there = active & (passed == layer)
        ray.o = dr.select(there, origin, ray.o)
        ray.maxt = dr.dot(end - ray.o, ray.d)
        depth, shown = self._depth(behind), behind
        if self.follows:
            depth, shown, _ = self._shown_at(mi.Ray3f(ray), behind)
        return self._shaded(ray, ray_weight, dr.select(there, depth, 0), shown, there)

    def _first_hit(self, ray: mi.Ray3f) -> mi.SurfaceInteraction3f:
        """The surface that the nested integrator sees first: it may leave out area lights."""
        hit = self.scene.ray_intersect(ray)
        if not self.integrator.hide_emitters:
            return hit

        def step(active: mi.Bool, hit: mi.SurfaceInteraction3f) -> tuple[Any, Any]:
            hit = self.scene.ray_intersect(hit.spawn_ray(ray.d), active)
            return active & self._is_left_out(hit), hit

        state = (self._is_left_out(hit), hit)
        return dr.while_loop(state, lambda active, _: active, step)[1]

    def _is_left_out(self, hit: mi.SurfaceInteraction3f) -> mi.Bool:
        """Whether the nested integrator does not show the surface, for it may hide lamps."""
        if not self.integrator.hide_emitters:
            return mi.Bool(False)
        return hit.is_valid() & hit.shape.is_emitter()


def _within(position: mi.Float, corner: mi.Float) -> mi.Float:
    """``position`` left of ``corner + 1``, to which single precision may round it up."""
    end = corner + 1
    below = end - dr.maximum(dr.abs(end), 1) * dr.epsilon(mi.Float)
    return dr.minimum(position, below)


def _to_rgb(radiance: mi.Spectrum, wavelengths: mi.Spectrum) -> mi.Color3f:
    """Radiance in linear sRGB, whatever the variant counts it in."""
    if mi.is_polarized:
        radiance = mi.unpolarized_spectrum(radiance)
    if mi.is_spectral:
        return mi.spectrum_to_srgb(radiance, wavelengths)
    return mi.Color3f(radiance.x) if mi.is_monochromatic else radiance


class _Columns:
    """Samples as they come in, in memory that is taken at once and used as it is filled."""

    def __init__(self, capacity: int) -> None:
        self.count = 0
        self.arrays = _empty_columns(capacity)
        self.arrays["weight"] = _empty(mi.Float, capacity)
        self.arrays["layer"] = _empty(mi.UInt8, capacity)

    def add(self, columns: dict[str, np.ndarray], **same: float) -> None:
        """Samples after those that there are; in ``same`` is what they have in common."""
        end = self.count + len(columns["x"])
        if end > len(self.arrays["x"]):
            more = 2 * end - self.count
            for name, array in self.arrays.items():
                self.arrays[name] = np.empty((more, *array.shape[1:]), dtype=array.dtype)
                self.arrays[name][: self.count] = array[: self.count]
        for name, values in (columns | same).items():
            self.arrays[name][self.count : end] = values
        self.count = end

    def columns(self) -> dict[str, np.ndarray]:
        """The samples so far."""
        return {name: array[: self.count] for name, array in self.arrays.items()}


def _empty_columns(count: int) -> dict[str, np.ndarray]:
    columns = {name: _empty(mi.Float, count) for name in ("x", "y", "alpha", "z")}
    columns["rgb"] = _empty(mi.Float, 3 * count).reshape(count, 3)
    columns["surface"] = _empty(mi.UInt32, count)
    return columns


def _empty(kind: type, count: int) -> np.ndarray:
    """Memory for numbers; on the CPU of Dr.Jit, which keeps it for the next samples.

    What NumPy gives back to the system is slow to get again.
    """
    if dr.backend_v(kind) == dr.JitBackend.LLVM:
        return np.asarray(dr.empty(kind, count))
    return np.empty(count, dtype=np.asarray(dr.empty(kind, 1)).dtype)


def _to_host(columns: dict[str, Any]) -> dict[str, np.ndarray]:
    """All columns as NumPy arrays, by one kernel: each asked for alone would trace again.

    On the CPU they are Dr.Jit's own memory, not copies of it.
    """
    interleaved = {name: dr.ravel(values) for name, values in columns.items()}
    dr.eval(interleaved)
    count = dr.width(interleaved["z"])
    return {
        name: np.asarray(values).reshape(count, -1) if name == "rgb" else np.asarray(values)
        for name, values in interleaved.items()
    }
