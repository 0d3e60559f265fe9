"""Orthographic sensors: their rays, the depth of their samples, and pictures beside Mitsuba's."""

import math

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from scenes import diffuse, still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")

LENS = pm.TelecentricLens(6.0, 2.2)
SIZE = 48


def sensor(kind="orthographic", scale=(1.3, 1.3, 1.0), **parameters):
    return {
        "type": kind,
        "to_world": mi.ScalarTransform4f().scale(list(scale)),
        **parameters,
    }


def scene(**shapes):
    film = {"width": SIZE, "height": SIZE}
    return still_life(sensor=sensor(), film=film, spp=16, sampler="multijitter", **shapes)


def boxes():
    shapes = {}
    for number, (x, y, z) in enumerate([(-0.7, 0.5, 1.6), (0.6, 0.6, 2.2), (-0.5, -0.6, 3.0)]):
        to_world = mi.ScalarTransform4f().translate([x, y, z]).rotate([0.6, 0, 0.8], 40).scale(0.3)
        shapes[f"box{number}"] = {
            "type": "cube",
            "to_world": to_world,
            "bsdf": diffuse(0.2 + 0.3 * number, 0.5, 0.7 - 0.3 * number),
        }
    return scene(**shapes)


def sheared_views(scene, lens, views, spp=4):
    """The mean of orthographic views from so many points of the lens: what Mitsuba would see."""
    base = np.array(mi.traverse(scene.sensors()[0])["to_world"].matrix).reshape(4, 4)
    number = np.arange(views) + 0.5
    angle = number * math.pi * (3 - math.sqrt(5))
    u, v = np.sqrt(number / views) * np.array([np.cos(angle), np.sin(angle)])
    slope = math.tan(math.radians(lens.half_angle))
    mean = 0.0
    for i in range(views):
        shear = np.eye(4)
        shear[:2, 2] = slope * u[i], slope * v[i]
        shear[:2, 3] = -shear[:2, 2] * lens.focus_distance
        view = mi.load_dict(
            {
                "type": "orthographic",
                "to_world": mi.ScalarTransform4f(shear @ base),
                "film": scene.sensors()[0].film(),
                "sampler": {"type": "multijitter", "sample_count": spp},
            }
        )
        mean = mean + np.array(mi.render(scene, sensor=view, seed=i), dtype=np.float64) / views
    return mean


def psnr(picture, reference):
    clipped = np.clip(picture, 0, 1) - np.clip(reference, 0, 1)
    return -10 * math.log10(np.mean(clipped**2))


@pytest.mark.parametrize("make", [scene, boxes])
def test_pictures_are_those_of_sheared_orthographic_views(make):
    made = make()
    reference = sheared_views(made, LENS, 200)
    samples = pm.render_samples(made, lens=LENS)
    for method in ("layered", "lightfield"):
        assert psnr(np.array(pm.focus(samples, method=method)), reference) >= 40, method


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (2.0, 2.0, 1.0), (1.5, 1.5, 3.0)])
def test_rays_are_those_of_orthographic(scale):
    film = {"type": "hdrfilm", "width": 12, "height": 8, "crop_width": 5, "crop_offset_x": 3}
    turn = mi.ScalarTransform4f().translate([1, 2, 3]).rotate([0.6, 0.8, 0], 30).scale(list(scale))
    shared = {"film": film, "to_world": turn, "near_clip": 0.5, "far_clip": 20.0}
    theirs = mi.load_dict({"type": "orthographic", **shared})
    by_name = mi.load_dict(
        {"type": "potmesil_orthographic", "half_angle": 6.0, "focus_distance": 2.0, **shared}
    )
    in_its_place = pm.potmesil_sensor(theirs, half_angle=6.0, focus_distance=2.0)
    at = mi.Point2f(np.random.default_rng(0).random((2, 100)).astype(np.float32))
    ray, _ = theirs.sample_ray(0.0, 0.5, at, mi.Point2f(0.5))
    for mine in (by_name, in_its_place):
        other, _ = mine.sample_ray(0.0, 0.5, at, mi.Point2f(0.5))
        for name in ("o", "d", "maxt"):
            a, b = (np.array(getattr(each, name)) for each in (ray, other))
            np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)
        assert mine.lens() == pm.TelecentricLens(6.0, 2.0)


def test_depth_is_in_scene_units_however_the_axis_is_scaled():
    for scale in ((1.0, 1.0, 1.0), (1.0, 1.0, 2.0)):
        made = still_life(sensor=sensor(scale=scale))
        samples = pm.render_samples(made, lens=LENS)
        finite = samples.z[np.isfinite(samples.z)]
        assert finite.min() == pytest.approx(2.0, abs=0.02)
        assert finite.max() == pytest.approx(4.0, abs=1e-5)
        assert samples.camera.film_width == pytest.approx(2.0)


def test_points_are_where_the_camera_projects_them():
    samples = pm.render_samples(scene(), lens=LENS)
    ball = samples.surface == next(i for i, name in samples.surfaces.items() if name == "ball")
    visible = ball & (samples.layer == 0)
    pixels = np.stack([samples.x, samples.y], axis=1)[visible].astype(np.float64)
    points = samples.camera.world_from_pixel(pixels, samples.z[visible].astype(np.float64))
    np.testing.assert_allclose(np.linalg.norm(points - [0, 0, 2.3], axis=1), 0.3, atol=1e-5)


def test_a_plane_mirror_has_the_depth_of_its_image():
    mirror = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, 3]).rotate([0, 1, 0], 180).scale(3),
        "bsdf": {"type": "conductor"},
    }
    behind = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -1]).scale(9),
        "bsdf": diffuse(0.5, 0.5, 0.5),
    }
    made = still_life(sensor=sensor(), mirror=mirror, behind=behind)
    samples = pm.render_samples(made, lens=LENS, sampling=pm.Sampling(layers=1))
    # The mirror at 3 shows the wall 1 behind the camera, or the back of the ball before it.
    assert samples.z.max() == pytest.approx(7.0, abs=1e-4)


def test_overscan_reaches_as_far_as_circles_do():
    samples = pm.render_samples(scene(), lens=LENS)
    reach = math.tan(math.radians(6)) * 2 * SIZE / 2.6
    assert samples.window.left in (-math.ceil(reach) - 1, -math.ceil(reach))
    assert (samples.layer > 0).any()
    closed = pm.render_samples(scene(), lens=LENS.replace(half_angle=0.0))
    assert closed.window == closed.crop_window


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"focus_distance": 2.0}, "half_angle: must be given"),
        ({"half_angle": 90.0, "focus_distance": 2.0}, "half_angle=90"),
        ({"half_angle": 2.0, "focus_distance": 2.0, "scale": (1, 2, 1)}, "scale x and y alike"),
    ],
)
def test_a_bad_sensor_is_refused_by_name(parameters, message):
    with pytest.raises(Exception, match=message):
        mi.load_dict(sensor("potmesil_orthographic", **parameters))


def test_what_does_not_fit_is_refused_by_name():
    with pytest.raises(TypeError, match="half_angle must be given"):
        pm.render_samples(scene())
    with pytest.raises(ValueError, match="which is not orthographic"):
        pm.render_samples(still_life(), lens=LENS)
    with pytest.raises(TypeError, match="must be a TelecentricLens"):
        pm.render_samples(scene(), lens=pm.ThinLens(50.0, 2.0))
    with pytest.raises(ValueError, match="min_f_number"):
        pm.render_samples(scene(), lens=LENS, sampling=pm.Sampling(min_f_number=2.0))
    with pytest.raises(ValueError, match="is orthographic, must be perspective"):
        pm.evaluation.compare(scene())


def test_the_integrator_focus_renders_through_a_telecentric_sensor():
    lens = {"half_angle": 6.0, "focus_distance": 2.2}
    made = still_life(
        {"type": "focus", "nested": {"type": "path", "max_depth": 3}},
        sensor=sensor("potmesil_orthographic", **lens),
    )
    samples = pm.render_samples(made, seed=3)
    assert samples.lens == LENS
    np.testing.assert_allclose(
        np.array(mi.render(made, seed=3)), np.array(pm.focus(samples)), atol=1e-5
    )


def test_the_sensor_follows_its_parameters():
    lens = {"half_angle": 6.0, "focus_distance": 2.2}
    updated = mi.load_dict(sensor("potmesil_orthographic", **lens))
    parameters = mi.traverse(updated)
    parameters["focus_distance"] = 3.0
    parameters["to_world"] = mi.Transform4f().scale([2.0, 2.0, 1.0])
    parameters.update()
    assert updated.lens() == pm.TelecentricLens(6.0, 3.0)
    assert updated.camera().film_width == pytest.approx(4.0)
