import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.samples.columns import TWINS
from potmesil_mi.tracing import passes, replay
from potmesil_mi.tracing.replay import Replay, is_whole
from potmesil_mi.tracing.transmission import VeilKinds
from scenes import still_life, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

DIRECT = {"type": "prb", "max_depth": 2}
"""Of a point lamp it has no noise."""

GLOBAL = {"type": "prb", "max_depth": 3}
INTENSITY, WALL = "lamp.intensity.value", "wall.bsdf.reflectance.value"
SKY = {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 0.5, 0.25]}}


def pane(bsdf):
    """A pane before the left of the wall."""
    place = mi.ScalarTransform4f().translate([-0.8, 0, 3]).rotate([0, 1, 0], 150).scale([0.5, 1, 1])
    return {"type": "rectangle", "to_world": place, "bsdf": {"type": bsdf}}


def replayed(scene, samples, **options):
    return Replay.of(scene, scene.sensors()[0], scene.integrator(), samples, **options)


def enabled(scene, key, grad=None):
    """The scene's parameters, one with gradients: ``grad``, by default its own value."""
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[key])
    dr.set_grad(parameters[key], dr.detach(parameters[key]) if grad is None else grad)
    return parameters


@pytest.mark.parametrize(
    ("sampling", "sensor"),
    [
        ({"refine": 1.0}, {}),
        ({"pattern": "uniform"}, {}),
        ({"pattern": "adaptive"}, {}),
        ({}, {"type": "potmesil_orthographic", "half_angle": 20.0, "focus_distance": 2.0}),
    ],
    ids=["sampler", "uniform", "adaptive", "orthographic"],
)
def test_the_ray_of_every_sample_is_replayed(sampling, sensor):
    """Radiance is proportional to the only lamp's intensity, so its derivative tells it."""
    scene = still_life(DIRECT, sensor=sensor)
    samples = pm.render_samples(scene, seed=3, sampling=pm.Sampling(**sampling))
    assert (samples.layer > 0).sum() > 20
    assert samples.window != samples.crop_window
    parameters = enabled(scene, INTENSITY)
    again = replayed(scene, samples)
    assert len(again.which) == len(samples)
    np.testing.assert_allclose(np.array(again.forward(parameters)), samples.rgb, atol=1e-6)


def test_hidden_sky_is_replayed_from_beyond_everything():
    scene = still_life(GLOBAL, lamp=SKY)
    samples = pm.render_samples(scene)
    sky = (samples.layer > 0) & ~np.isfinite(samples.z)
    assert sky.any()
    derivative = replayed(scene, samples).forward(enabled(scene, "lamp.radiance.value"))
    np.testing.assert_allclose(np.array(derivative)[sky], samples.rgb[sky], atol=1e-6)


@pytest.mark.parametrize("integrator", ["prb", "path"])
def test_derivatives_are_those_of_radiance_with_the_same_seed(integrator):
    """Those of the film's pixels, which come first, have the random numbers that they had."""
    scene = still_life({"type": integrator, "max_depth": 3}, lamp=SKY)
    even, film = pm.Sampling(refine=0), slice(24 * 16 * 4)
    samples = pm.render_samples(scene, seed=3, sampling=even)
    parameters, step = mi.traverse(scene), 0.01
    sides = []
    for side in (-step, step):
        parameters[WALL] = mi.Color3f(0.2, 0.4, 0.7) + side
        parameters.update()
        sides.append(pm.render_samples(scene, seed=3, sampling=even).rgb[film])
    parameters[WALL] = mi.Color3f(0.2, 0.4, 0.7)
    parameters.update()
    parameters = enabled(scene, WALL, 1.0)
    derivative = np.array(replayed(scene, samples, seed=3).forward(parameters))[film]
    expected = (sides[1] - sides[0]) / (2 * step)
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(derivative, expected, atol=2e-3)


@pytest.mark.parametrize(
    ("integrator", "pattern"), [("prb", "sampler"), ("prb", "uniform"), ("path", "sampler")]
)
def test_backward_is_the_transpose_of_forward(integrator, pattern):
    scene = still_life({"type": integrator, "max_depth": 3}, lamp=SKY)
    samples = pm.render_samples(scene, sampling=pm.Sampling(pattern))
    given = np.random.default_rng(0).normal(size=samples.rgb.shape).astype(np.float32) + 1
    direction = mi.Color3f(0.5, -1.0, 2.0)
    parameters = enabled(scene, WALL, direction)
    again = replayed(scene, samples, seed=3)
    forward = np.array(again.forward(parameters))
    np.testing.assert_array_equal(np.array(dr.grad(parameters[WALL])), np.array(direction))
    dr.set_grad(parameters[WALL], 0)
    again.backward(parameters, mi.TensorXf(given))
    backward = np.array(dr.grad(parameters[WALL])).ravel() @ np.array(direction).ravel()
    assert np.vdot(given, forward) == pytest.approx(backward, rel=1e-5)


def test_samples_are_replayed_in_parts(monkeypatch):
    scene = still_life({"type": "path", "max_depth": 2})
    samples = pm.render_samples(scene)
    parameters = enabled(scene, INTENSITY)
    monkeypatch.setattr(passes, "WAVEFRONT", 1000)
    again = replayed(scene, samples)
    assert len(samples) > 2000
    np.testing.assert_allclose(np.array(again.forward(parameters)), samples.rgb, atol=1e-6)
    dr.set_grad(parameters[INTENSITY], 0)
    again.backward(parameters, dr.ones(mi.TensorXf, samples.rgb.shape))
    total = np.array(dr.grad(parameters[INTENSITY])).ravel() * [30, 30, 25]
    np.testing.assert_allclose(total, samples.rgb.sum(axis=0), rtol=1e-4)


@pytest.mark.parametrize(
    ("variant", "lamp"),
    [("llvm_ad_mono", INTENSITY), ("llvm_ad_spectral", "lamp.intensity.d65.values")],
)
def test_other_variants_have_derivatives(variant, lamp):
    """The first rays have the wavelengths that they had."""
    mi.set_variant(variant)
    scene = still_life({"type": "path", "max_depth": 2}, film={"pixel_format": "luminance"})
    samples, film = pm.render_samples(scene, sampling=pm.Sampling(refine=0)), slice(24 * 16 * 4)
    derivative = np.array(replayed(scene, samples).forward(enabled(scene, lamp)))
    assert samples.rgb[film].max() > 0.1
    np.testing.assert_allclose(derivative[film], samples.rgb[film], atol=1e-4)


# ---------------------------------------------------------------- what cannot be replayed


def test_what_shares_its_ray_is_constant_and_a_warning_tells_it():
    scene = still_life({"type": "prb", "max_depth": 3}, pane=pane("thindielectric"))
    samples = pm.render_samples(scene)
    parameters = enabled(scene, INTENSITY)
    with pytest.warns(UserWarning, match=r"\d+% of the light.* virtual_depth=false"):
        again = replayed(scene, samples)
    derivative = np.array(again.forward(parameters))
    constant = ~np.isin(np.arange(len(samples)), again.which)
    assert (samples.layer[constant] >= TWINS).any()
    assert not derivative[constant].any()
    parted = (samples.layer == 0) & constant
    assert samples.rgb[parted].any()
    visible = (samples.layer == 0) & ~constant
    assert derivative[visible].mean() == pytest.approx(samples.rgb[visible].mean(), rel=0.05)


def test_without_virtual_depth_everything_is_replayed(recwarn):
    scene = still_life(DIRECT, pane=pane("thindielectric"))
    samples = pm.render_samples(scene, sampling=pm.Sampling(virtual_depth=False))
    again = replayed(scene, samples)
    assert len(again.which) == len(samples)
    assert not recwarn.list


def test_samples_of_one_ray_are_told_by_their_place():
    samples = synthetic(
        5,
        x=np.array([1.0, 1, 1, 2, 3]),
        y=np.array([2.0, 2, 3, 2, 2]),
        layer=np.array([0, 0, 0, 1, TWINS]),
    )
    assert is_whole(samples).tolist() == [False, False, True, True, False]


def test_what_moves_is_refused():
    scene = still_life(DIRECT)
    track = pm.VectorTrack.of([[0, [0, 0, 0]], [1, [1, 0, 0]]])
    move = pm.Motion(shapes={"ball": pm.ShapeMove(translate=track)}, shutter=pm.Shutter(0, 1))
    samples = pm.render_samples(scene, motion=move)
    with pytest.raises(ValueError, match="motion: must be None"):
        replayed(scene, samples)


def test_a_medium_that_parts_the_light_of_rays_is_refused(monkeypatch):
    """Its samples may stand for others, and are not told by their places."""
    scene = still_life(DIRECT)
    samples = pm.render_samples(scene)
    x, y = samples.x.copy(), samples.y.copy()
    x[1], y[1] = x[0], y[0]
    monkeypatch.setattr(replay, "veil_kinds", lambda *_: VeilKinds(surfaces=False, media=True))
    assert len(replayed(scene, samples).which) == len(samples)
    with pytest.raises(ValueError, match="virtual_depth=True: must be false"):
        replayed(scene, samples.replace(x=x, y=y))


def test_integrators_that_look_for_silhouettes_are_refused():
    scene = still_life({"type": "prb_projective"})
    samples = pm.render_samples(scene)
    with pytest.raises(TypeError, match=r"must not look for silhouettes.* prb has the same"):
        replayed(scene, samples)
