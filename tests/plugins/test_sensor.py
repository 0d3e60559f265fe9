"""Sensor `potmesil`: to an integrator it is `perspective`; beside that it describes a lens."""

import math
import os
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from potmesil_mi import ThinLens, potmesil_sensor
from potmesil_mi.optics.camera import FOV_AXES
from potmesil_mi.plugins.derivatives import LENS_PARAMETERS
from potmesil_mi.tracing.sensor import sensor_parameters

REPOSITORY = Path(__file__).parents[2]
ORIGIN, TARGET = [1.0, -2.0, 3.5], [0.0, 1.0, -1.0]


def film(width=48, height=32, **parameters):
    """A film that no variant has anything to say about."""
    pixels = "luminance" if "mono" in mi.variant() else "rgb"
    size = {"width": width, "height": height}
    return {"type": "hdrfilm", "pixel_format": pixels, **size, **parameters}


def load(kind="potmesil", **parameters):
    """A sensor on a small film; `potmesil` has an f-number of 5.6 unless an aperture is given."""
    if kind == "potmesil" and "aperture_radius" not in parameters:
        parameters = {"f_number": 5.6, **parameters}
    given = {name: item for name, item in parameters.items() if item is not None}
    return mi.load_dict({"type": kind, "film": film(), **given})


def placed():
    """A general position, as `to_world`."""
    return mi.ScalarTransform4f().look_at(origin=ORIGIN, target=TARGET, up=[0, 1, 0])


def components(ray, weight, count):
    """Origin, direction, length, time, wavelengths and weight below each other."""
    parts = (ray.o, ray.d, ray.maxt, ray.time, ray.wavelengths, weight)
    arrays = [np.array(part) for part in parts]
    rows = [array.reshape(-1, 1) if count == 1 else np.atleast_2d(array) for array in arrays]
    return np.concatenate([np.broadcast_to(r, (len(r), count)) for r in rows if r.size])


def rays(sensor, count=64, aperture=None):
    """Rays for `count` random samples, of every component one row: (components, count)."""
    samples = np.random.default_rng(1981).random((6, count), dtype=np.float32)
    if aperture is not None:
        samples[4:] = np.array(aperture)[:, None]

    def trace(time, wavelength, x, y, u, v):
        return sensor.sample_ray(time, wavelength, mi.Point2f(x, y), mi.Point2f(u, v))

    if mi.variant().startswith("scalar"):
        columns = [components(*trace(*map(float, column)), 1) for column in samples.T]
        return np.concatenate(columns, axis=1)
    return components(*trace(*map(mi.Float, samples)), count)


def one_ray(sensor, x, y):
    """Origin and direction of the ray at (x, y), from 0 to 1 over the crop window."""
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    return np.array(ray.o).ravel(), np.array(ray.d).ravel()


def assert_same_rays(one, other, tolerance=1e-5, **options):
    expected = rays(other, **options)
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(rays(one, **options), expected, rtol=tolerance, atol=tolerance)


def value(parameter):
    """A traversed parameter as a plain number."""
    return float(np.array(parameter).item())


# ---------------------------------------------------------------- what a sensor says of itself


@pytest.mark.parametrize("times", [(0.0, 0.0), (1.5, 4.0)])
def test_accessors_give_what_was_asked_for(variants, times):
    sensor = load(
        to_world=placed(),
        near_clip=0.5,
        far_clip=35.0,
        focus_distance=15.0,
        shutter_open=times[0],
        shutter_close=times[1],
    )
    assert (sensor.near_clip(), sensor.far_clip(), sensor.focus_distance()) == (0.5, 35, 15)
    assert (sensor.shutter_open(), sensor.shutter_open_time()) == (times[0], times[1] - times[0])
    assert not sensor.needs_aperture_sample()
    assert sensor.id() == "potmesil"
    assert load(id="main").id() == "main"
    assert "focus_distance=15.0" in str(sensor)
    np.testing.assert_allclose(
        np.array(sensor.world_transform().matrix).reshape(4, 4),
        np.array(placed().matrix),
        atol=1e-6,
    )


def test_defaults_are_a_normal_lens_in_a_scene_in_metres(variants):
    sensor = load()
    assert sensor.lens() == ThinLens(50.0, 5.6, math.inf, millimeters_per_unit=1000)
    assert (sensor.near_clip(), sensor.far_clip()) == (pytest.approx(0.01), 10000)
    np.testing.assert_allclose(one_ray(sensor, 0.5, 0.5), [[0, 0, 0.01], [0, 0, 1]], atol=1e-7)


def test_bounding_box_is_the_pinhole(variants):
    sensor, builtin = load(to_world=placed()), load("perspective", to_world=placed())
    box = sensor.bbox()
    np.testing.assert_allclose(np.array(box.min).ravel(), ORIGIN, atol=1e-6)
    np.testing.assert_allclose(np.array(box.max).ravel(), ORIGIN, atol=1e-6)
    assert type(box) is type(builtin.bbox())


def test_camera_describes_the_pinhole(variants):
    sensor = load(
        film=film(48, 32, crop_offset_x=3, crop_offset_y=5, crop_width=20, crop_height=10),
        to_world=placed(),
        focal_length=85.0,
        near_clip=0.5,
        far_clip=35.0,
        principal_point_offset_x=0.25,
        principal_point_offset_y=-0.125,
        shutter_open=0.5,
        shutter_close=2.0,
    )
    camera = sensor.camera()
    assert (camera.film_size, camera.crop_offset, camera.crop_size) == ((48, 32), (3, 5), (20, 10))
    assert camera.x_fov == math.degrees(2 * math.atan(36 / 2 / 85))
    assert (camera.near_clip, camera.far_clip) == (0.5, 35)
    assert camera.principal_point_offset == (0.25, -0.125)
    assert (camera.shutter_open, camera.shutter_close) == (0.5, 2)
    np.testing.assert_allclose(camera.to_world, np.array(placed().matrix), atol=1e-6)


def test_camera_projects_a_ray_back_to_its_pixel(variant_llvm):
    """The pixel coordinates that `Camera` documents, from depth and `focal_length_pixels`."""
    crop = {"crop_offset_x": 3, "crop_offset_y": 5, "crop_width": 20, "crop_height": 10}
    sensor = load(film=film(48, 32, **crop), to_world=placed(), focal_length=24.0)
    camera = sensor.camera()
    origin, direction = one_ray(sensor, 0.3, 0.8)
    x, y, z, _ = np.linalg.inv(camera.to_world) @ [*(origin + 5 * direction), 1]
    pixel = np.array([48, 32]) / 2 - camera.focal_length_pixels * np.array([x, y]) / z
    np.testing.assert_allclose(pixel, [3 + 0.3 * 20, 5 + 0.8 * 10], atol=1e-4)


# ---------------------------------------------------------------- rays


@pytest.mark.parametrize("near_clip", [0.1, 2.0])
def test_rays_start_on_the_near_plane_and_end_on_the_far_plane(variants, near_clip):
    sensor = load(to_world=placed(), near_clip=near_clip, far_clip=20.0)
    traced = rays(sensor)
    origin, direction, maxt, time = traced[:3], traced[3:6], traced[6], traced[7]
    ahead = np.subtract(TARGET, ORIGIN) / np.linalg.norm(np.subtract(TARGET, ORIGIN))
    depth = ahead @ (origin - np.array(ORIGIN)[:, None])
    np.testing.assert_allclose(np.linalg.norm(direction, axis=0), 1, atol=1e-6)
    np.testing.assert_allclose(depth, near_clip, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(depth + maxt * (ahead @ direction), 20, rtol=1e-5)
    # All rays pass through the pinhole.
    to_origin = origin - np.array(ORIGIN)[:, None]
    np.testing.assert_allclose(np.cross(to_origin, direction, axis=0), 0, atol=1e-5)
    np.testing.assert_array_equal(
        time, np.random.default_rng(1981).random((6, 64), dtype=np.float32)[0]
    )
    np.testing.assert_allclose(one_ray(sensor, 0.5, 0.5)[1], ahead, atol=1e-6)


def test_the_image_is_upright_with_its_first_pixel_at_the_left_and_top(variants):
    """Camera space has x to the left and y up."""
    _, direction = one_ray(load(), 0.01, 0.01)
    assert direction[0] > 0.1
    assert direction[1] > 0.1


@pytest.mark.parametrize("size", [(48, 32), (24, 60)], ids=["landscape", "portrait"])
@pytest.mark.parametrize("fov", [34.0, 80.0])
@pytest.mark.parametrize("axis", FOV_AXES)
def test_field_of_view_spans_the_film_along_its_axis(variant_llvm, axis, fov, size):
    sensor = load(film=film(*size), fov=fov, fov_axis=axis, to_world=placed())
    longer = "x" if size[0] > size[1] else "y"
    shorter = "y" if longer == "x" else "x"
    side = {"larger": longer, "smaller": shorter}.get(axis, axis)
    edges = {
        "x": [(0, 0.5), (1, 0.5)],
        "y": [(0.5, 0), (0.5, 1)],
        "diagonal": [(0, 0), (1, 1), (0, 1), (1, 0)],
    }[side]
    _, ahead = one_ray(sensor, 0.5, 0.5)
    for x, y in edges:
        angle = math.degrees(math.acos(one_ray(sensor, x, y)[1] @ ahead))
        assert angle == pytest.approx(fov / 2, abs=1e-3)


def test_ray_differentials_are_the_rays_of_the_next_pixels(variants):
    sensor = load(film=film(480, 320), to_world=placed())
    centre = mi.Point2f(0.3, 0.6)
    ray, _ = sensor.sample_ray_differential(0.25, 0.5, centre, mi.Point2f(0.5))
    assert ray.has_differentials
    assert value(ray.time) == 0.25
    origin, direction = np.array(ray.o).ravel(), np.array(ray.d).ravel()
    np.testing.assert_allclose((origin, direction), one_ray(sensor, 0.3, 0.6), atol=1e-6)
    beside, below = one_ray(sensor, 0.3 + 1 / 480, 0.6), one_ray(sensor, 0.3, 0.6 + 1 / 320)
    np.testing.assert_allclose(
        [np.array(ray.o_x).ravel(), np.array(ray.d_x).ravel()], beside, atol=1e-6
    )
    np.testing.assert_allclose(
        [np.array(ray.o_y).ravel(), np.array(ray.d_y).ravel()], below, atol=1e-6
    )


def test_ray_differentials_are_orthogonal_at_the_centre(variant_llvm):
    sensor = load(film=film(480, 320), to_world=placed())
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
    along_x, along_y = (np.array(d - ray.d).ravel() for d in (ray.d_x, ray.d_y))
    # Square pixels: equal lengths, at a right angle.
    length = 36 / 50 / 480
    assert np.linalg.norm(along_x) == pytest.approx(length, rel=1e-3)
    assert np.linalg.norm(along_y) == pytest.approx(length, rel=1e-3)
    assert abs(along_x @ along_y) < 2e-3 * length**2


# ---------------------------------------------------------------- spectra


def flat(*wavelengths):
    return {"type": "spectrum", "value": [(wavelength, 1.0) for wavelength in wavelengths]}


def test_wavelengths_are_visible_unless_the_sensor_says_otherwise(variant_spectral):
    def sampled(**parameters):
        interaction = dr.zeros(mi.SurfaceInteraction3f)
        wavelengths, weight = load(**parameters).sample_wavelengths(
            interaction, mi.Float([0.1, 0.4, 0.9])
        )
        assert np.array(weight).min() > 0
        return np.array(wavelengths)

    visible = sampled()
    assert visible.min() >= mi.MI_CIE_MIN
    assert visible.max() <= mi.MI_CIE_MAX
    infrared = sampled(srf=flat(1200, 1400))
    assert infrared.min() >= 1200
    assert infrared.max() <= 1400


def test_rays_carry_the_sampled_wavelengths_and_their_weights(variant_spectral):
    sensor = load(srf=flat(500, 600))
    wavelengths, weights = rays(sensor)[8:12], rays(sensor)[12:]
    assert wavelengths.shape == weights.shape == (4, 64)
    assert wavelengths.min() >= 500
    assert wavelengths.max() <= 600
    np.testing.assert_allclose(weights, 100, rtol=1e-5)  # uniform over 100 nm
    assert_same_rays(sensor, load("perspective", srf=flat(500, 600), fov=sensor.lens().fov))


def test_a_response_of_both_sensor_and_film_is_refused(variant_spectral):
    special = {"type": "specfilm", "width": 8, "height": 8, "band": flat(500, 600)}
    with pytest.raises(RuntimeError, match="Spectral response function"):
        load(srf=flat(500, 600), film=special)
    wavelengths = rays(load(film=special))[8:12]
    assert wavelengths.min() >= 500
    assert wavelengths.max() <= 600


# ---------------------------------------------------------------- the same as `perspective`

AS_PERSPECTIVE = {
    "plain": {},
    "placed": {"to_world": placed},
    "crop": {
        "film": lambda: film(
            48, 32, crop_offset_x=7, crop_offset_y=3, crop_width=31, crop_height=20
        )
    },
    "portrait": {"film": lambda: film(20, 50), "to_world": placed},
    **{f"fov_{axis}": {"fov": 63.0, "fov_axis": axis} for axis in FOV_AXES},
    "narrow": {"fov": 0.5, "far_clip": 1e6},
    "principal_point": {"principal_point_offset_x": 0.2, "principal_point_offset_y": -0.4},
    "clip": {"near_clip": 0.7, "far_clip": 9.0},
    "shutter": {"shutter_open": 1.0, "shutter_close": 3.0},
    "all": {
        "film": lambda: film(30, 70, crop_offset_x=3, crop_width=11, crop_height=64),
        "to_world": placed,
        "fov": 100.0,
        "fov_axis": "diagonal",
        "principal_point_offset_x": -0.1,
        "principal_point_offset_y": 0.3,
        "near_clip": 0.2,
        "far_clip": 500.0,
    },
}


@pytest.mark.parametrize("case", AS_PERSPECTIVE.values(), ids=AS_PERSPECTIVE)
def test_rays_are_those_of_perspective(case, variants):
    shared = {name: v() if callable(v) else v for name, v in ({"fov": 40.0} | case).items()}
    sensor, builtin = load(**shared), load("perspective", **shared)
    assert_same_rays(sensor, builtin)
    for name in ("shutter_open", "shutter_open_time", "near_clip", "far_clip"):
        assert getattr(sensor, name)() == pytest.approx(getattr(builtin, name)(), rel=1e-7)


@pytest.mark.parametrize("image_distance", ["focal", "focused"])
def test_fov_of_the_lens_is_that_of_perspective(variant_llvm, image_distance):
    """At 0.4 m a film at the focused image sees less than one at the focal length."""
    parameters = {"focal_length": 85.0, "focus_distance": 0.4, "image_distance": image_distance}
    film_distance = 85 if image_distance == "focal" else 85 * 400 / 315
    fov = math.degrees(2 * math.atan(18 / film_distance))
    assert_same_rays(load(**parameters), load("perspective", fov=fov))


@pytest.mark.parametrize("given_one", [{}, {"focal_length": 85.0}, {"frame_width": 24.0}], ids=str)
def test_fov_sets_the_millimetres_that_are_not_given(variant_llvm, given_one):
    sensor = load(fov=50.0, fov_axis="y", **given_one)
    assert_same_rays(sensor, load("perspective", fov=50.0, fov_axis="y"))
    for name, millimetres in (given_one or {"frame_width": 36}).items():
        assert getattr(sensor.lens(), name) == millimetres


INTEGRATORS = {
    "path": {"type": "path", "max_depth": 4},
    "direct": {"type": "direct"},
    "prb": {"type": "prb", "max_depth": 4},
    "volpath": {"type": "volpath", "max_depth": 4},
    "aov": {
        "type": "aov",
        "aovs": "depth:depth,position:position,normal:sh_normal,uv:uv",
        "image": {"type": "path", "max_depth": 3},
    },
}


def cornell_pictures(integrator):
    """The same scene through `perspective` and through `potmesil`, with one seed."""
    scene = mi.cornell_box()
    sensor = scene.pop("sensor")
    shared = {
        "film": film(16, 12),
        "sampler": {"type": "independent", "sample_count": 4},
        "to_world": sensor["to_world"],
        "fov": 39.3077,
        "fov_axis": "smaller",
        "near_clip": 0.001,
        "far_clip": 100.0,
    }
    scene["integrator"] = integrator
    pictures = []
    for kind in ({"type": "perspective"}, {"type": "potmesil", "f_number": 5.6}):
        loaded = mi.load_dict({**scene, "sensor": {**shared, **kind}})
        pictures.append(np.array(mi.render(loaded, seed=3)))
    return pictures


def assert_same_pictures(pictures):
    builtin, ours = pictures
    assert builtin.shape[:2] == (12, 16)
    assert builtin.std() > 0.05  # there is something to see
    np.testing.assert_allclose(ours, builtin, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("integrator", INTEGRATORS.values(), ids=INTEGRATORS)
def test_integrators_render_the_same_picture_as_with_perspective(integrator, variant_llvm):
    assert_same_pictures(cornell_pictures(integrator))


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral", "scalar_rgb"])
def test_every_kind_of_variant_renders_the_same_picture_as_with_perspective(variant):
    mi.set_variant(variant)
    assert_same_pictures(cornell_pictures(INTEGRATORS["path"]))


# ---------------------------------------------------------------- position and angles


@pytest.mark.parametrize(
    ("pan", "tilt", "swing"),
    [(0, 0, 0), (30, 0, 0), (0, 20, 0), (0, 0, 40), (30, 20, 40), (-100, -60, 170)],
)
def test_pan_tilt_swing_and_origin_are_a_to_world(variants, pan, tilt, swing):
    to_world = (
        mi.ScalarTransform4f()
        .translate(ORIGIN)
        .rotate([0, 1, 0], -pan)
        .rotate([1, 0, 0], -tilt)
        .rotate([0, 0, 1], swing)
    )
    by_angles = load(origin=ORIGIN, pan=pan, tilt=tilt, swing=swing)
    np.testing.assert_allclose(
        np.array(by_angles.world_transform().matrix).reshape(4, 4),
        np.array(to_world.matrix),
        atol=1e-6,
    )
    assert_same_rays(by_angles, load(to_world=to_world))


def test_each_angle_and_the_origin_may_be_left_out(variant_llvm):
    assert_same_rays(load(pan=30.0), load(origin=[0, 0, 0], pan=30, tilt=0, swing=0))
    assert_same_rays(load(origin=ORIGIN), load(to_world=mi.ScalarTransform4f().translate(ORIGIN)))


# ---------------------------------------------------------------- parameters that are updated

EXPOSED = {
    "focal_length": 50.0,
    "focus_distance": 2.0,
    "frame_width": 36.0,
    "millimeters_per_unit": 1000.0,
    "near_clip": 0.5,
    "far_clip": 100.0,
    "principal_point_offset_x": 0.0,
    "principal_point_offset_y": 0.0,
}


@pytest.mark.parametrize("aperture", [{"f_number": 4.0}, {"aperture_radius": 0.25}], ids="_".join)
def test_traverse_exposes_the_lens_and_the_projection(variants, aperture):
    parameters = mi.traverse(load(**EXPOSED, **aperture))
    for name, number in (EXPOSED | aperture).items():
        assert value(parameters[name]) == number
    assert {"to_world", "shutter_open", "film.size"} <= set(parameters.keys())
    assert {"f_number", "aperture_radius", "x_fov"} <= set(parameters.keys())


@pytest.mark.parametrize(
    ("name", "new"),
    [
        ("focal_length", 85.0),
        ("frame_width", 24.0),
        ("focus_distance", 0.75),
        ("millimeters_per_unit", 250.0),
        ("near_clip", 0.25),
        ("far_clip", 7.0),
        ("principal_point_offset_x", 0.25),
        ("principal_point_offset_y", -0.5),
    ],
)
@pytest.mark.parametrize("image_distance", ["focal", "focused"])
def test_updates_act_as_if_the_sensor_were_loaded_with_them(
    variant_llvm, name, new, image_distance
):
    options = {"to_world": placed(), "image_distance": image_distance}
    # A scene unit of 100 mm leaves room for all of these.
    before = EXPOSED | {"millimeters_per_unit": 100.0}
    updated, expected = load(**before, **options), load(**(before | {name: new}), **options)
    parameters = mi.traverse(updated)
    parameters[name] = new
    parameters.update()
    assert updated.lens() == expected.lens()
    assert updated.camera() == expected.camera()
    assert_same_rays(updated, expected, tolerance=1e-6)


def test_updated_focal_length_has_the_rays_of_perspective(variant_llvm):
    sensor = load(focal_length=50.0)
    parameters = mi.traverse(sensor)
    parameters["focal_length"] = 85.0
    parameters.update()
    fov = math.degrees(2 * math.atan(18 / 85))
    assert_same_rays(sensor, load("perspective", fov=fov))


@pytest.mark.parametrize(("name", "new"), [("f_number", 11.0), ("aperture_radius", 0.125)])
def test_updated_aperture_reaches_the_lens_and_leaves_the_rays(variant_llvm, name, new):
    sensor = load(focus_distance=2.0, **{name: 0.5})
    before = rays(sensor)
    parameters = mi.traverse(sensor)
    parameters[name] = new
    parameters.update()
    assert getattr(sensor.lens(), name) == new
    assert sensor.lens().focus_distance == 2
    np.testing.assert_array_equal(rays(sensor), before)


def test_updated_to_world_moves_and_turns_the_camera(variants):
    sensor = load()
    parameters = mi.traverse(sensor)
    # In vectorised variants the parameter is a transformation of arrays.
    parameters["to_world"] = type(parameters["to_world"])(np.array(placed().matrix))
    parameters.update()
    assert_same_rays(sensor, load(to_world=placed()))
    np.testing.assert_allclose(np.array(sensor.bbox().min).ravel(), ORIGIN, atol=1e-6)
    np.testing.assert_allclose(np.array(sensor.camera().to_world)[:3, 3], ORIGIN, atol=1e-6)


def test_a_film_that_is_resized_is_followed_as_by_perspective(variant_llvm):
    sensors = [load(fov=40.0), load("perspective", fov=40.0)]
    for sensor in sensors:
        parameters = mi.traverse(sensor)
        parameters["film.size"] = [20, 44]
        parameters["film.crop_size"] = [10, 6]
        parameters["film.crop_offset"] = [3, 2]
        parameters.update()
    assert_same_rays(*sensors)
    assert sensors[0].camera().film_size == (20, 44)
    assert sensors[0].camera().crop_size == (10, 6)


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("f_number", 0.0),
        ("focal_length", -50.0),
        ("focal_length", 2001.0),  # beyond the focused distance
        ("focus_distance", 0.03125),
        ("frame_width", 0.0),
        ("millimeters_per_unit", math.nan),
        ("near_clip", 0.0),
        ("near_clip", 100.0),
        ("far_clip", 0.25),
    ],
)
def test_bad_updates_are_refused_and_can_be_put_right(variant_llvm, name, bad):
    sensor = load(**EXPOSED, f_number=4.0)
    lens, before = sensor.lens(), rays(sensor)
    parameters = mi.traverse(sensor)
    good = value(parameters[name])
    named = {"focal_length": "focus_distance=2" if bad > 0 else name, "near_clip": "_clip="}
    parameters[name] = bad
    with pytest.raises(ValueError, match=named.get(name, f"{name}=")):
        parameters.update()
    parameters[name] = good
    parameters.update()
    assert sensor.lens() == lens
    np.testing.assert_array_equal(rays(sensor), before)


def test_an_update_to_a_to_world_with_scale_is_refused(variant_llvm):
    parameters = mi.traverse(load())
    parameters["to_world"] = mi.AffineTransform4f().scale(2.0)
    with pytest.raises(ValueError, match="to_world: must not scale"):
        parameters.update()


EXACT = ThinLens(43.3, 5.6, 0.29, frame_width=35.9, millimeters_per_unit=1000.1)
"""None of its numbers is one in single precision."""


def test_the_lens_is_exactly_what_was_asked_for(variants):
    assert load(**sensor_parameters(EXACT)).lens() == EXACT


def test_the_lens_stays_exact_in_what_is_not_updated(variant_llvm):
    sensor = load(**sensor_parameters(EXACT))
    parameters = mi.traverse(sensor)
    parameters["near_clip"] = 0.2
    parameters["f_number"] = 8.0
    parameters.update()
    assert sensor.lens() == EXACT.replace(f_number=8.0)


def test_scalar_variants_cannot_update_numbers_and_say_so():
    """A limit of Mitsuba for plugins in Python, whose numbers are there no objects."""
    mi.set_variant("scalar_rgb")
    parameters = mi.traverse(load(focus_distance=2.0))
    with pytest.raises(TypeError, match="float"):
        parameters["focus_distance"] = 3.0


@pytest.mark.parametrize("name", [*EXPOSED, "f_number", "to_world"])
def test_parameters_are_differentiable_as_far_as_their_flags_say(variant_llvm, name):
    """Pictures are, in those of the lens: `test_gradients.py` has these."""
    sensor = load(**EXPOSED, f_number=4.0, image_distance="focused")
    parameters = mi.traverse(sensor)
    if parameters.flags(name) & mi.ParamFlags.NonDifferentiable or name in LENS_PARAMETERS:
        return
    variable = mi.Float(0.0 if name == "to_world" else EXPOSED.get(name, 4.0))
    dr.enable_grad(variable)
    parameters[name] = (
        mi.AffineTransform4f().translate(mi.Vector3f(variable, 0, 0))
        if name == "to_world"
        else variable
    )
    parameters.update()
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(0.3, 0.6), mi.Point2f(0.5))
    result = dr.sum(ray.o + ray.d)
    assert dr.grad_enabled(result), f"{name} is said to be differentiable"
    dr.backward(result)
    assert dr.grad(variable)[0] != 0


# ---------------------------------------------------------------- the equivalent `thinlens`

LENSES = {
    "focal": {"focus_distance": 1.3, "image_distance": "focal"},
    "focused": {"focus_distance": 1.3, "image_distance": "focused"},
    "close_up": {"focal_length": 105.0, "focus_distance": 0.3, "image_distance": "focused"},
    "radius": {"aperture_radius": 0.05, "focus_distance": 4.0},
    "infinity": {"focus_distance": math.inf},
    "pinhole": {"f_number": math.inf, "focus_distance": 2.0},
}


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_rays_are_those_through_the_middle_of_the_equivalent_thinlens(lens, variants):
    sensor = load(**lens, to_world=placed())
    thin = sensor.lens().to_thinlens()
    builtin = load(thin.pop("type"), **thin, to_world=placed())
    assert_same_rays(sensor, builtin, aperture=(0.5, 0.5))


@pytest.mark.parametrize("image_distance", ["focal", "focused"])
@pytest.mark.parametrize("depth", [0.4, 0.9, 1.2, 3.0, 50.0])
def test_equation_8_is_the_circle_that_the_equivalent_thinlens_traces(
    variant_llvm, depth, image_distance
):
    """Rays from a point's image on the film, through the lens's rim, back to its plane."""
    lens = load(f_number=2.0, focus_distance=1.2, image_distance=image_distance).lens()
    thin = lens.to_thinlens()
    builtin = load(thin.pop("type"), **thin)
    # Of samples in the square, the edge x = 0 becomes part of the rim.
    rim = mi.Point2f(0.0, mi.Float(np.linspace(0, 1, 9, dtype=np.float32)))
    ray, _ = builtin.sample_ray(0.0, 0.5, mi.Point2f(0.5), rim)
    origin, direction = np.array(ray.o, np.float64), np.array(ray.d, np.float64)
    point = origin + (depth - origin[2]) / direction[2] * direction
    diameter = 2 * np.hypot(point[0], point[1]) / depth * lens.film_distance
    np.testing.assert_allclose(diameter, abs(lens.circle_of_confusion(depth)), atol=2e-6)


# ---------------------------------------------------------------- potmesil_sensor()


def shared_parameters():
    return {
        "film": film(48, 32, crop_offset_x=7, crop_offset_y=3, crop_width=31, crop_height=20),
        "sampler": {"type": "independent", "sample_count": 9},
        "to_world": placed(),
        "fov": 63.0,
        "fov_axis": "diagonal",
        "near_clip": 0.7,
        "far_clip": 90.0,
        "shutter_open": 0.5,
        "shutter_close": 2.0,
    }


def test_potmesil_sensor_sees_what_a_perspective_saw(variants):
    builtin = load(
        "perspective",
        id="viewer",
        principal_point_offset_x=0.1,
        principal_point_offset_y=-0.2,
        **shared_parameters(),
    )
    sensor = potmesil_sensor(builtin, f_number=4, focus_distance=3, focal_length=85)
    assert_same_rays(sensor, builtin)
    assert sensor.film() is builtin.film()
    assert sensor.sampler() is builtin.sampler()
    assert sensor.id() == "viewer"
    assert (sensor.near_clip(), sensor.far_clip()) == (builtin.near_clip(), builtin.far_clip())
    assert (sensor.shutter_open(), sensor.shutter_open_time()) == (0.5, 1.5)
    lens = sensor.lens()
    assert (lens.f_number, lens.focus_distance, lens.focal_length) == (4, 3, 85)
    assert lens.millimeters_per_unit == 1000


def test_potmesil_sensor_of_a_perspective_is_a_pinhole_by_default(variant_llvm):
    lens = potmesil_sensor(load("perspective", fov=40.0)).lens()
    assert (lens.f_number, lens.aperture_radius) == (math.inf, 0)
    assert (lens.frame_width, lens.focus_distance) == (36, math.inf)


@pytest.mark.parametrize("image_distance", ["focal", "focused"])
def test_potmesil_sensor_keeps_aperture_and_focus_of_a_thinlens(variants, image_distance):
    builtin = load("thinlens", aperture_radius=0.03125, focus_distance=2.5, **shared_parameters())
    sensor = potmesil_sensor(builtin, film=image_distance)
    assert_same_rays(sensor, builtin, aperture=(0.5, 0.5))
    assert sensor.lens().aperture_radius == 0.03125
    assert sensor.lens().focus_distance == 2.5
    # And back: the thin lens that it came from.
    thin = sensor.lens().to_thinlens()
    assert (thin["aperture_radius"], thin["focus_distance"]) == (0.03125, 2.5)
    assert thin["fov"] == pytest.approx(value(mi.traverse(builtin)["x_fov"]), rel=1e-6)


def test_potmesil_sensor_replaces_what_it_is_told_to(variant_llvm):
    builtin = load("thinlens", fov=40.0, aperture_radius=0.03125, focus_distance=2.5)
    lens = potmesil_sensor(builtin, f_number=4, millimeters_per_unit=100).lens()
    assert (lens.f_number, lens.focus_distance, lens.millimeters_per_unit) == (4, 2.5, 100)
    assert lens.fov == pytest.approx(40, rel=1e-6)


def test_potmesil_sensor_leaves_a_potmesil_sensor_alone(variant_llvm):
    sensor = load(focus_distance=2.0)
    assert potmesil_sensor(sensor) is sensor


def test_potmesil_sensor_changes_the_lens_of_a_potmesil_sensor(variants):
    shared = shared_parameters() | {
        "image_distance": "focused",
        "frame_width": 24.0,
        "principal_point_offset_x": 0.1,
        "principal_point_offset_y": -0.2,
        "focus_distance": 2.0,
        "id": "viewer",
    }
    sensor = load(**shared)
    refocused = potmesil_sensor(sensor, focus_distance=0.7, f_number=11)
    assert refocused.lens() == sensor.lens().replace(focus_distance=0.7, f_number=11)
    assert refocused.film() is sensor.film()
    assert refocused.sampler() is sensor.sampler()
    assert refocused.id() == "viewer"
    assert sensor.lens().focus_distance == 2
    # The film moves out with the image, so what it sees is another pinhole's view.
    fov = refocused.lens().fov
    assert fov < sensor.lens().fov
    there = shared | {"fov": fov, "fov_axis": "x"}
    for name in ("image_distance", "frame_width", "focus_distance"):
        there.pop(name)
    assert_same_rays(refocused, load("perspective", **there))


@pytest.mark.parametrize("kind", ["perspective", "potmesil"])
def test_potmesil_sensor_keeps_the_medium_that_the_camera_is_in(variant_llvm, kind):
    fog = mi.load_dict({"type": "homogeneous", "albedo": 0.5, "sigma_t": 0.1})
    sensor = potmesil_sensor(load(kind, fov=40.0, medium=fog), f_number=8)
    assert sensor.get_medium() is fog


@pytest.mark.parametrize("kind", ["distant", "radiancemeter"])
def test_potmesil_sensor_refuses_what_has_no_field_of_view(variant_llvm, kind):
    sensor = load(kind, film=film(1, 1, rfilter={"type": "box"}))
    with pytest.raises(TypeError, match="must be a potmesil, perspective, thinlens or "):
        potmesil_sensor(sensor, f_number=4)


def test_potmesil_sensor_refuses_bad_parameters(variant_llvm):
    builtin = load("perspective", fov=40.0)
    with pytest.raises(ValueError, match="f_number=0: "):
        potmesil_sensor(builtin, f_number=0)
    with pytest.raises(ValueError, match=r"focus_distance=0\.01: "):
        potmesil_sensor(load(), focus_distance=0.01)
    with pytest.raises(ValueError, match=r"f_number=4, aperture_radius=0\.1: exactly one"):
        potmesil_sensor(builtin, f_number=4, aperture_radius=0.1)
    with pytest.raises(ValueError, match="must not both be given with fov"):
        potmesil_sensor(builtin, focal_length=50, frame_width=24)


# ---------------------------------------------------------------- XML

XML = """<sensor version="3.0.0" type="potmesil" id="from_xml">
  <float name="focal_length" value="43.3"/>
  <float name="{aperture}" value="5.6"/>
  <float name="focus_distance" value="{focus_distance}"/>
  <float name="frame_width" value="35.9"/>
  <float name="millimeters_per_unit" value="10"/>
  <string name="image_distance" value="focused"/>
  <string name="aperture" value="disc"/>
  {place}
  <float name="near_clip" value="0.5"/>
  <float name="far_clip" value="77"/>
  <float name="principal_point_offset_x" value="0.25"/>
  <float name="principal_point_offset_y" value="-0.5"/>
  <float name="shutter_open" value="1"/>
  <float name="shutter_close" value="3"/>
  <film type="hdrfilm">
    <integer name="width" value="40"/><integer name="height" value="30"/>
    <string name="pixel_format" value="luminance"/>
  </film>
</sensor>"""
PLACE_BY_ANGLES = """<point name="origin" value="1, -2, 3.5"/>
  <float name="pan" value="30"/><float name="tilt" value="20"/><float name="swing" value="-10"/>"""
PLACE_BY_MATRIX = """<transform name="to_world"><rotate z="1" angle="-10"/>
  <rotate x="1" angle="-20"/><rotate y="1" angle="-30"/>
  <translate x="1" y="-2" z="3.5"/></transform>"""


@pytest.mark.parametrize("place", [PLACE_BY_ANGLES, PLACE_BY_MATRIX], ids=["angles", "matrix"])
@pytest.mark.parametrize("focus_distance", [7.7, math.inf])
@pytest.mark.parametrize("aperture", ["f_number", "aperture_radius"])
def test_xml_says_all_that_a_dictionary_says(variants, aperture, focus_distance, place):
    sensor = mi.load_string(
        XML.format(aperture=aperture, focus_distance=focus_distance, place=place)
    )
    assert sensor.id() == "from_xml"
    assert sensor.lens() == ThinLens(
        43.3,
        focus_distance=focus_distance,
        frame_width=35.9,
        millimeters_per_unit=10,
        film="focused",
        **{aperture: 5.6},
    )
    expected = load(
        **sensor_parameters(sensor.lens()),
        film=film(40, 30),
        near_clip=0.5,
        far_clip=77.0,
        principal_point_offset_x=0.25,
        principal_point_offset_y=-0.5,
        shutter_open=1.0,
        shutter_close=3.0,
        origin=ORIGIN,
        pan=30.0,
        tilt=20.0,
        swing=-10.0,
    )
    assert_same_rays(sensor, expected)
    assert (sensor.shutter_open(), sensor.shutter_open_time()) == (1, 2)


def test_xml_with_a_field_of_view_is_rendered_in_a_scene(variant_llvm):
    scene = mi.load_string(
        """<scene version="3.0.0"><integrator type="direct"/>
        <sensor type="potmesil"><float name="fov" value="60"/><string name="fov_axis" value="y"/>
          <float name="f_number" value="2"/><float name="focus_distance" value="3"/>
          <film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="4"/>
          </film></sensor>
        <emitter type="constant"><float name="radiance" value="0.5"/></emitter></scene>"""
    )
    assert scene.sensors()[0].lens().focus_distance == 3
    np.testing.assert_allclose(np.array(mi.render(scene, spp=1)), 0.5, rtol=1e-5)


# ---------------------------------------------------------------- what is refused

REFUSED = {
    "f_number_0": ({"f_number": 0.0}, "f_number=0.0: "),
    "f_number_negative": ({"f_number": -2.0}, "f_number=-2.0: "),
    "f_number_nan": ({"f_number": math.nan}, "f_number=nan: "),
    "f_number_text": ({"f_number": "5.6"}, "f_number='5.6': must be a number"),
    "f_number_bool": ({"f_number": True}, "f_number=True: must be a number"),
    "focal_length_0": ({"focal_length": 0.0}, "focal_length=0.0: "),
    "focal_length_negative": ({"focal_length": -50.0}, "focal_length=-50.0: "),
    "focal_length_text": ({"focal_length": "50mm"}, "focal_length='50mm': must be a number"),
    "focus_inside": ({"focus_distance": 0.01}, "focus_distance=0.01: "),
    "focus_at_focal_length": ({"focus_distance": 0.05}, "focus_distance=0.05: "),
    "focus_negative": ({"focus_distance": -1.0}, "focus_distance=-1.0: "),
    "both_apertures": ({"aperture_radius": 0.1}, "aperture_radius=0.1: exactly one"),
    "no_aperture": ({"f_number": None}, "f_number=None, aperture_radius=None: exactly one"),
    "radius_negative": ({"f_number": None, "aperture_radius": -0.1}, "aperture_radius=-0.1: "),
    "aperture_shape": ({"aperture": "heart"}, "aperture='heart': must be one of disc"),
    "frame_width_0": ({"frame_width": 0.0}, "frame_width=0.0: "),
    "unit_0": ({"millimeters_per_unit": 0.0}, "millimeters_per_unit=0.0: "),
    "image_distance": ({"image_distance": "far"}, "image_distance='far': "),
    "near_0": ({"near_clip": 0.0}, "near_clip=0.0: "),
    "near_at_far": ({"near_clip": 2.0, "far_clip": 2.0}, "far_clip=2.0: must be beyond near_clip"),
    "near_beyond_far": ({"near_clip": 3.0, "far_clip": 2.0}, "far_clip=2.0: must be beyond near"),
    "far_inf": ({"far_clip": math.inf}, "far_clip=inf: "),
    "principal_point_nan": ({"principal_point_offset_x": math.nan}, "principal_point_offset_x=nan"),
    "fov_0": ({"fov": 0.0}, "fov=0.0: "),
    "fov_180": ({"fov": 180.0}, "fov=180.0: "),
    "fov_axis": ({"fov": 40.0, "fov_axis": "z"}, "fov_axis='z': "),
    "fov_and_millimetres": (
        {"fov": 40.0, "focal_length": 50.0, "frame_width": 36.0},
        "must not both be given with fov",
    ),
    "pan_text": ({"pan": "left"}, "pan='left': must be a number"),
    "pan_nan": ({"pan": math.nan}, "pan=nan: must be finite"),
    "tilt_inf": ({"tilt": math.inf}, "tilt=inf: must be finite"),
    "origin_inf": ({"origin": [0, math.inf, 0]}, "origin=.*inf.*: must be three finite numbers"),
    "shutter": ({"shutter_open": 2.0, "shutter_close": 1.0}, "[Ss]hutter"),
    "unknown": ({"f_numbr": 5.6}, 'unreferenced property(.|\n)*"f_numbr"'),
}


@pytest.mark.parametrize(("parameters", "text"), REFUSED.values(), ids=REFUSED)
def test_bad_parameters_are_refused_by_name_and_value(variant_llvm, parameters, text):
    """Mitsuba hands a plugin's exception on as a RuntimeError with its text."""
    description = {"focus_distance": 2.0, "f_number": 5.6} | parameters
    with pytest.raises(RuntimeError, match=text):
        load(**description)


@pytest.mark.parametrize("name", ["pan", "tilt", "swing", "origin"])
def test_to_world_is_not_combined_with_position_and_angles(variant_llvm, name):
    with pytest.raises(RuntimeError, match="to_world: cannot be combined with origin, pan"):
        load(to_world=placed(), **{name: ORIGIN if name == "origin" else 5.0})


@pytest.mark.parametrize("scale", [2.0, 0.5, [1, 1, 3], 0.0], ids=str)
def test_a_to_world_with_scale_is_refused(variants, scale):
    with pytest.raises(RuntimeError, match="to_world: must not scale"):
        load(to_world=placed().scale(scale))


# ---------------------------------------------------------------- registration

USE = """
sensor = mi.load_dict({"type": "potmesil", "f_number": 5.6, "focus_distance": 2.0})
print(mi.variant(), sensor.lens().f_number, sensor.bbox().min)
"""
ORDERS = {
    "variant_then_import": "import mitsuba as mi\nmi.set_variant('scalar_rgb')\n"
    "import potmesil_mi\n" + USE,
    "import_then_variant": "import potmesil_mi, mitsuba as mi\n"
    "assert mi.variant() is None\nmi.set_variant('scalar_rgb')\n" + USE,
}


@pytest.mark.parametrize("code", ORDERS.values(), ids=ORDERS)
def test_the_plugin_is_there_in_either_order_of_import_and_set_variant(code):
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=REPOSITORY,
        env=os.environ,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (result.returncode, result.stdout) == (0, "scalar_rgb 5.6 [0, 0, 0]\n"), result.stderr


def test_the_plugin_follows_every_change_of_the_variant():
    classes = []
    for variant in ("llvm_ad_rgb", "scalar_rgb", "llvm_ad_rgb"):
        mi.set_variant(variant)
        sensor = load(fov=40.0)
        assert isinstance(sensor, mi.Sensor)
        assert sensor.variant_name() == variant
        assert_same_rays(sensor, load("perspective", fov=40.0))
        classes.append(type(sensor))
    assert classes[0] is not classes[1]


def test_a_sensor_outlives_a_visit_to_another_variant(variant_llvm):
    sensor = load(fov=40.0)
    before = rays(sensor)
    mi.set_variant("scalar_rgb")
    mi.set_variant("llvm_ad_rgb")
    np.testing.assert_array_equal(rays(sensor), before)
