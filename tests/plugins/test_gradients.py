"""Derivatives of pictures in the parameters of their scene, through `mi.render`."""

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.evaluation import thinlens_sensor
from scenes import OTHERS, still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")

DIRECT = {"type": "prb", "max_depth": 2}
FOCUS = {"type": "focus", "nested": DIRECT, "refine": 0.0}
POINT_SAMPLES = {"type": "point_samples", "nested": DIRECT}
SKY = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
LENS = {"focal_length": 50.0, "frame_width": 40.0, "f_number": 0.7, "focus_distance": 2.0}
"""With units of 10 cm: circles of several pixels."""
WALL, LAMP = "wall.bsdf.reflectance.value", "lamp.intensity.value"
TEXELS = "wall.bsdf.reflectance.data"


def out_of_focus(integrator, *, spp=4, texels=0, **parameters):
    """The ball in focus, and the wall behind it not, which has so many texels on a side."""
    sensor = {**LENS, "millimeters_per_unit": 100.0, **parameters.pop("sensor", {})}
    if texels > 0:
        size = texels, texels, 3
        texture = np.random.default_rng(4).uniform(0.2, 0.8, size).astype(np.float32)
        parameters["wall"] = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f()
            .translate([0, 0, 4])
            .rotate([0, 1, 0], 180)
            .scale([1.2, 1.2, 1]),
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "bitmap", "data": mi.TensorXf(texture), "raw": True},
            },
        }
    return still_life(integrator, spp=spp, sensor=sensor, **parameters)


def enabled(scene, *keys):
    parameters = mi.traverse(scene)
    for key in keys:
        dr.enable_grad(parameters[key])
    parameters.update()
    return parameters


def weights_of(shape, seed=0):
    values = np.random.default_rng(seed).uniform(0, 1, shape).astype(np.float32)
    return mi.TensorXf(values)


def backward(scene, parameters, key, weights, **options):
    """The gradient of the weighted sum of a picture."""
    dr.set_grad(parameters[key], 0)
    picture = mi.render(scene, parameters, seed=3, seed_grad=5, **options)
    dr.backward(dr.sum(picture[..., : weights.shape[2]] * weights, axis=None))
    return np.array(dr.grad(parameters[key]))


def forward(scene, parameters, key, direction, **options):
    """The derivative of a picture."""
    dr.set_grad(parameters[key], direction)
    picture = mi.render(scene, parameters, seed=3, seed_grad=5, **options)
    dr.forward_to(picture)
    return np.array(dr.grad(picture))


# ---------------------------------------------------------------- through the pinhole


@pytest.mark.parametrize(
    ("pixel_format", "channels", "rfilter"),
    [("rgb", 3, "box"), ("rgba", 3, "tent"), ("luminance", 1, "gaussian")],
)
def test_point_samples_have_the_derivatives_of_the_nested_integrator(
    pixel_format, channels, rfilter
):
    film = {"pixel_format": pixel_format, "rfilter": {"type": rfilter}}
    scene = still_life(POINT_SAMPLES, film=film, lamp=SKY)
    parameters, prb = enabled(scene, WALL), mi.load_dict(DIRECT)
    weights = weights_of((16, 24, channels))
    mine = backward(scene, parameters, WALL, weights)
    theirs = backward(scene, parameters, WALL, weights, integrator=prb)
    assert np.abs(theirs).min() > 1
    np.testing.assert_allclose(mine, theirs, rtol=1e-4)
    mine = forward(scene, parameters, WALL, 1.0)[..., :channels]
    theirs = forward(scene, parameters, WALL, 1.0, integrator=prb)[..., :channels]
    assert np.abs(theirs).max() > 0.5
    np.testing.assert_allclose(mine, theirs, atol=1e-5)


def test_colours_have_derivatives_beside_aovs():
    aov = {"type": "aov", "aovs": "dd:depth", "nested": {"type": "path", "max_depth": 2}}
    scene = still_life({**POINT_SAMPLES, "nested": aov})
    parameters, weights = enabled(scene, WALL), weights_of((16, 24, 3))
    plain = still_life(POINT_SAMPLES)
    expected = backward(plain, enabled(plain, WALL), WALL, weights)
    np.testing.assert_allclose(backward(scene, parameters, WALL, weights), expected, rtol=1e-4)
    derivative = forward(scene, parameters, WALL, 1.0)
    assert derivative.shape == (16, 24, 9)
    assert not derivative[..., 3:].any()
    assert derivative[..., :3].any()


def test_an_optimiser_finds_a_colour():
    scene = still_life(POINT_SAMPLES, spp=2)
    target = mi.render(scene, seed=100)[..., :3]
    parameters = mi.traverse(scene)
    optimiser = mi.ad.Adam(lr=0.1)
    optimiser[WALL] = mi.Color3f(0.5)
    for step in range(30):
        parameters.update(optimiser)
        picture = mi.render(scene, parameters, seed=step)[..., :3]
        dr.backward(dr.mean(dr.square(picture - target), axis=None))
        optimiser.step()
    found = np.array(dr.detach(optimiser[WALL])).ravel()
    np.testing.assert_allclose(found, [0.2, 0.4, 0.7], atol=0.03)


def test_without_gradients_the_derivative_is_zero():
    scene = still_life(POINT_SAMPLES)
    integrator, parameters = scene.integrator(), mi.traverse(scene)
    derivative = integrator.render_forward(scene, parameters)
    assert derivative.shape == (16, 24, 8)
    assert not np.array(derivative).any()
    integrator.render_backward(scene, parameters, dr.ones(mi.TensorXf, (16, 24, 8)))


# ---------------------------------------------------------------- through the lens


@pytest.mark.parametrize("key", [WALL, LAMP, TEXELS])
def test_the_gradient_is_that_of_finite_differences(key):
    """The picture is linear in the colours of what is lit by a lamp alone, so a step may be long.

    The derivative is taken with the samples of its own seed.
    """
    scene = out_of_focus(FOCUS, spp=16, texels=4 if key == TEXELS else 0)
    parameters, weights = enabled(scene, key), weights_of((16, 24, 3))
    value = dr.detach(parameters[key])
    kind, start = type(value), np.array(value)
    direction = start * np.random.default_rng(2).uniform(0.5, 1, start.shape).astype(np.float32)
    gradient = np.vdot(backward(scene, parameters, key, weights), direction)
    if key != TEXELS:  # A bitmap copies its texels, and mi.render does not follow that forwards.
        derivative = forward(scene, parameters, key, kind(direction))
        assert np.vdot(derivative, np.array(weights)) == pytest.approx(gradient, rel=1e-4)
    dr.disable_grad(parameters[key])
    sides = []
    for step in (-0.1, 0.1):
        parameters[key] = kind(start + step * direction)
        parameters.update()
        sides.append(np.array(mi.render(scene, seed=5)))
    expected = np.vdot(sides[1] - sides[0], np.array(weights)) / 0.2
    assert expected > 5
    assert gradient == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("kind", "name"),
    [("potmesil", "focus_distance"), ("potmesil", "f_number"), ("thinlens", "aperture_radius")],
)
def test_the_lens_has_the_derivative_that_focus_has(kind, name):
    scene = out_of_focus(FOCUS)
    sensor = scene.sensors()[0]
    if kind == "thinlens":
        sensor = thinlens_sensor(sensor)
    parameters = mi.traverse(sensor)
    dr.enable_grad(parameters[name])
    parameters.update()
    weights = weights_of((16, 24, 3))
    picture = mi.render(scene, parameters, sensor=sensor, seed=3, seed_grad=5)
    dr.backward(dr.sum(picture * weights, axis=None))
    samples = pm.render_samples(scene, sensor, seed=5, sampling=pm.Sampling(refine=0))
    value = mi.Float(dr.detach(parameters[name]))
    dr.enable_grad(value)
    dr.backward(
        dr.sum(pm.focus(samples, samples.lens.replace(**{name: value})) * weights, axis=None)
    )
    expected = np.array(dr.grad(value))
    assert abs(expected) > 0.01
    np.testing.assert_allclose(np.array(dr.grad(parameters[name])), expected, rtol=1e-4)


def test_materials_and_the_lens_have_derivatives_at_once():
    scene = out_of_focus(FOCUS)
    keys = WALL, "sensor.f_number"
    weights, alone = weights_of((16, 24, 3)), []
    for key in keys:
        parameters = enabled(scene, key)
        alone.append(backward(scene, parameters, key, weights))
        dr.disable_grad(parameters[key])
    parameters = enabled(scene, *keys)
    backward(scene, parameters, WALL, weights)
    for key, expected in zip(keys, alone, strict=True):
        np.testing.assert_allclose(np.array(dr.grad(parameters[key])), expected, rtol=1e-4)
    dr.set_grad(parameters[keys[1]], 1.0)
    derivative = forward(scene, parameters, WALL, 1.0)
    together = sum(np.sum(of) for of in alone)
    assert np.vdot(derivative, np.array(weights)) == pytest.approx(together, rel=1e-3)


@pytest.mark.slow
def test_a_texture_out_of_focus_has_the_gradient_of_a_ray_traced_lens():
    """The wall goes on behind the ball, whose edge is out of focus, too.

    The weights of pixels have no mean, so that the edges count, where pictures differ somewhat.
    """
    key, scene = TEXELS, out_of_focus(FOCUS, spp=64, texels=6, sensor={"focus_distance": 2.5})
    parameters = enabled(scene, key)
    weights = weights_of((16, 24, 3)) - 0.5
    thinlens = thinlens_sensor(scene.sensors()[0], sampler="multijitter", spp=2500)
    pinhole = pm.potmesil_sensor(scene.sensors()[0], f_number=1e6)
    prb = mi.load_dict(DIRECT)
    mine = backward(scene, parameters, key, weights)
    judge = backward(scene, parameters, key, weights, sensor=thinlens, integrator=prb)
    sharp = backward(scene, parameters, key, weights, sensor=pinhole, integrator=prb, spp=64)
    norm = np.linalg.norm(judge)
    assert np.linalg.norm(mine - judge) < 0.04 * norm
    assert np.linalg.norm(sharp - judge) > 0.4 * norm


CORNELL_BOX = OTHERS / "cbox" / "cbox-rgb.xml"


@pytest.mark.slow
@pytest.mark.skipif(not Path(CORNELL_BOX).exists(), reason="needs scenes of others")
def test_the_cornell_box_has_the_gradient_of_a_ray_traced_lens():
    scene = mi.load_file(str(CORNELL_BOX), res=24)
    keys = [name for name, _ in mi.traverse(scene) if name.endswith("reflectance.value")]
    parameters = enabled(scene, *keys)
    sensor = pm.potmesil_sensor(scene.sensors()[0], focus_distance=1000.0, aperture_radius=80.0)
    nested = {"type": "prb", "max_depth": 4}
    weights = dr.ones(mi.TensorXf, (24, 24, 3))
    gradients = []
    for integrator, through, spp in (
        ({"type": "focus", "nested": nested}, sensor, 64),
        (nested, thinlens_sensor(sensor), 1024),
    ):
        for key in keys:
            dr.set_grad(parameters[key], 0)
        mi.load_dict(integrator).render_backward(
            scene, parameters, weights, sensor=through, seed=1, spp=spp
        )
        gradients.append(np.concatenate([np.array(dr.grad(parameters[key])) for key in keys]))
    mine, judge = gradients
    assert np.linalg.norm(mine - judge) < 0.02 * np.linalg.norm(judge)


# ---------------------------------------------------------------- what has no derivatives


def refused(scene, key, error, match):
    with pytest.raises(error, match=match):
        scene.integrator().render_backward(
            scene, enabled(scene, key), dr.ones(mi.TensorXf, (16, 24, 3))
        )


def test_a_picture_that_has_lost_its_derivatives_is_refused(monkeypatch):
    scene = still_life(POINT_SAMPLES)
    constant = dr.zeros(mi.TensorXf, (16, 24, 3))
    monkeypatch.setattr(type(scene.integrator()), "form_attached", lambda *_: constant)
    refused(scene, WALL, NotImplementedError, "point_samples: the picture has no derivatives in")


@pytest.mark.parametrize("key", ["wall.vertex_positions", "ball.to_world"])
def test_where_shapes_are_has_no_derivative(key):
    mesh = mi.load_dict({"type": "cube"})
    shapes = {"wall": mesh} if key.startswith("wall") else {}
    scene = still_life(FOCUS, **shapes)
    parameters = mi.traverse(scene)
    if key not in parameters:
        key = next(name for name, _ in parameters if name.endswith("vertex_positions"))
    refused(scene, key, NotImplementedError, f"{key}: has gradients enabled.* where shapes are")


@pytest.mark.parametrize("name", ["to_world", "x_fov", "focal_length"])
def test_what_the_camera_sees_has_no_derivative(name):
    refused(
        still_life(FOCUS),
        f"sensor.{name}",
        NotImplementedError,
        f"{name}: has gradients.* f_number",
    )


def test_a_film_that_follows_the_focus_has_no_derivative():
    scene = still_life(FOCUS, sensor={"image_distance": "focused"})
    refused(scene, "sensor.focus_distance", NotImplementedError, "image_distance=focal has one")


@pytest.mark.parametrize("plugin", ["focus", "point_samples"])
def test_what_is_clamped_has_no_derivative(plugin):
    scene = still_life({"type": plugin, "nested": DIRECT, "clamp": 3.0})
    refused(scene, WALL, ValueError, r"clamp=3\.0: must not be given")


def test_what_is_denoised_has_no_derivative():
    pytest.importorskip("mitsuba_oidn", reason="needs mitsuba-oidn: pip install '.[denoise]'")
    refused(still_life({**FOCUS, "denoise": True}), WALL, ValueError, "denoise=True: must be false")


def test_images_in_mirrors_have_no_derivative():
    place = mi.ScalarTransform4f().translate([-0.8, 0, 3]).rotate([0, 1, 0], 150).scale([0.5, 1, 1])
    mirror = {"type": "rectangle", "to_world": place, "bsdf": {"type": "conductor"}}
    refused(out_of_focus(FOCUS, mirror=mirror), WALL, ValueError, "virtual_depth=True: must be")


def test_patterns_have_no_derivative_in_the_film_of_point_samples():
    scene = still_life({**POINT_SAMPLES, "pattern": "uniform"})
    refused(scene, WALL, NotImplementedError, "pattern=uniform: must be sampler")


def test_the_sensor_tells_in_what_it_can_be_differentiated():
    parameters = mi.traverse(still_life(FOCUS))
    for name in ("focus_distance", "f_number", "aperture_radius"):
        assert parameters.flags(f"sensor.{name}") == mi.ParamFlags.Differentiable.value
    assert parameters.flags("sensor.squeeze") == mi.ParamFlags.NonDifferentiable.value
