import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.tracing import passes
from scenes import pinhole_mean, still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")

PATH = {"type": "path", "max_depth": 3}

PRIMARY = {"layers": 1, "overscan": 0, "refine": 0}
"""Sampling of what the pinhole sees of the film, as often in each pixel, and no more."""

EVEN = pm.Sampling(refine=0)
"""Sampling of each pixel as often as of any other."""


def rendered(scene, **options):
    return np.array(mi.render(scene, integrator=mi.load_dict(PATH), **options))


@pytest.mark.parametrize("sampler", ["independent", "stratified", "multijitter", "orthogonal"])
def test_the_samples_are_those_of_mi_render(sampler):
    scene = still_life(sampler=sampler, spp=9)
    samples = pm.render_samples(scene, seed=5, sampling=EVEN)
    np.testing.assert_allclose(pinhole_mean(samples), rendered(scene, seed=5), atol=1e-6)


def test_the_samples_are_those_of_mi_render_in_a_crop_window():
    crop = {"crop_offset_x": 7, "crop_offset_y": 4, "crop_width": 11, "crop_height": 9}
    scene = still_life(film=crop, spp=8)
    samples = pm.render_samples(scene, seed=2, sampling=EVEN)
    assert samples.camera.crop_offset == (7, 4)
    first = slice(0, 11 * 9 * 8)
    np.testing.assert_array_equal(
        np.floor(samples.x[first]), np.tile(np.repeat(np.arange(7, 18), 8), 9)
    )
    np.testing.assert_array_equal(np.floor(samples.y[first]), np.repeat(np.arange(4, 13), 11 * 8))
    assert (samples.layer[first] == 0).all()
    np.testing.assert_allclose(pinhole_mean(samples), rendered(scene, seed=2), atol=1e-6)


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"])
def test_other_variants_give_the_radiance_of_mi_render(variant):
    mi.set_variant(variant)
    film = {"pixel_format": "luminance"} if variant == "llvm_ad_mono" else {}
    scene = still_life(spp=8, film=film)
    expected = rendered(scene, seed=1)
    if expected.shape[-1] == 1:
        expected = np.repeat(expected, 3, axis=-1)
    samples = pm.render_samples(scene, seed=1, sampling=EVEN)
    np.testing.assert_allclose(pinhole_mean(samples), expected, atol=1e-5)


@pytest.mark.parametrize("pixels", [1, 7, 24 * 3])
def test_passes_of_some_pixels_sample_the_same_film(monkeypatch, pixels):
    scene = still_life(spp=64)
    whole = pm.render_samples(scene, sampling=EVEN)
    monkeypatch.setattr(passes, "WAVEFRONT", 64 * pixels)
    in_passes = pm.render_samples(scene, sampling=EVEN)
    assert in_passes.window == whole.window
    np.testing.assert_array_equal(in_passes.visible().pixel(), whole.visible().pixel())
    difference = pinhole_mean(in_passes) - pinhole_mean(whole)
    assert np.abs(difference).mean() < 0.01
    jitter = in_passes.x[: 16 * 24 * 64].reshape(16, 24 * 64) % 1
    assert not np.array_equal(jitter[0], jitter[3]), "every pass must have jitter of its own"


def test_depth_is_along_the_axis_and_not_along_the_ray():
    scene = still_life(spp=16)
    samples = pm.render_samples(scene)
    names = samples.surfaces
    wall = np.array([names.get(i) == "wall" for i in samples.surface])
    assert wall.any()
    np.testing.assert_allclose(samples.z[wall], 4, rtol=1e-5)


def test_a_moved_and_turned_camera_sees_the_same_depths():
    placed = {"to_world": mi.ScalarTransform4f().rotate([0.6, 0, 0.8], 50).translate([4, 5, 6])}
    samples = pm.render_samples(still_life(spp=4), sampling=EVEN)
    matrix = placed["to_world"]
    scene = still_life(spp=4)
    ball = {"type": "sphere", "to_world": matrix.translate([0, 0, 2.3]).scale(0.3)}
    moved = still_life(spp=4, sensor=placed, ball=ball, wall={"type": "sphere", "radius": 1e-3})
    ball_depths = samples.z[samples.surface == 1]
    again = pm.render_samples(moved, sampling=EVEN)
    moved_depths = again.z[again.surface == 1]
    assert scene.sensors()[0].lens() == moved.sensors()[0].lens()
    np.testing.assert_allclose(np.sort(moved_depths), np.sort(ball_depths), rtol=1e-4)


def test_rays_that_hit_nothing_are_at_infinity_with_id_0():
    samples = pm.render_samples(still_life(spp=4))
    missed = samples.surface == 0
    assert 0.1 < missed.mean() < 0.9
    assert np.isinf(samples.z[missed]).all()
    assert np.isfinite(samples.z[~missed]).all()
    assert (samples.alpha == ~missed).all()


def test_positions_stay_in_their_pixel_on_a_wide_film():
    scene = still_life(film={"width": 3000, "height": 2}, spp=256)
    depth = mi.load_dict({"type": "depth"})
    samples = pm.render_samples(scene, integrator=depth, sampling=pm.Sampling(**PRIMARY))
    pixels = np.repeat(np.arange(3000 * 2), 256)
    np.testing.assert_array_equal(samples.pixel(), pixels)


# ---------------------------------------------------------------- what cannot be sampled


def test_an_empty_scene_is_refused():
    scene = mi.load_dict(
        {"type": "scene", "sensor": {"type": "potmesil", "f_number": 2.0}, "i": PATH}
    )
    with pytest.raises(ValueError, match="scene: is empty"):
        pm.render_samples(scene)


def test_a_film_of_one_pixel_is_refused():
    with pytest.raises(ValueError, match="film: its crop window has 1x1 pixels"):
        pm.render_samples(still_life(film={"width": 1, "height": 1}))


def test_a_missing_sensor_and_a_negative_count_are_named():
    scene = still_life()
    with pytest.raises(ValueError, match="sensor=3: must be 0 to 0"):
        pm.render_samples(scene, 3)
    with pytest.raises(ValueError, match="spp=-1"):
        pm.render_samples(scene, spp=-1)
    with pytest.raises(TypeError, match=r"spp=4\.5"):
        pm.render_samples(scene, spp=4.5)
    with pytest.raises(ValueError, match="seed=-1"):
        pm.render_samples(scene, seed=-1)


def test_what_cannot_give_samples_is_named():
    scene = still_life()
    with pytest.raises(TypeError, match=r"ParticleTracerIntegrator.*must be a sampling integrator"):
        pm.render_samples(scene, integrator=mi.load_dict({"type": "ptracer"}))


def test_a_film_of_spectral_bands_is_refused():
    mi.set_variant("llvm_ad_spectral")
    special = mi.load_dict(
        {
            "type": "potmesil",
            "f_number": 2.0,
            "film": {
                "type": "specfilm",
                "band": {"type": "spectrum", "value": [(400, 1.0), (700, 1.0)]},
            },
        }
    )
    with pytest.raises(TypeError, match="film: must be"):
        pm.render_samples(still_life(), special)


def test_infinite_radiance_is_dropped_with_a_warning():
    glow = {"type": "area", "radiance": {"type": "rgb", "value": float("inf")}}
    ball = {"type": "sphere", "center": [0, 0, 2.3], "radius": 0.3, "emitter": glow}
    scene = still_life(spp=4, ball=ball)
    with pytest.warns(RuntimeWarning, match="dropped"):
        samples = pm.render_samples(scene)
    assert np.isfinite(np.array(pm.focus(samples))).all()


def test_hidden_emitters_have_no_depth():
    ball = {"type": "sphere", "center": [0, 0, 2.3], "radius": 0.3, "emitter": {"type": "area"}}
    scene = still_life({**PATH, "hide_emitters": True}, ball=ball)
    samples = pm.render_samples(scene)
    assert set(np.unique(samples.surface)) == {0, 2}
    assert np.isclose(samples.z[samples.surface == 2], 4).all()


def test_the_medium_around_the_camera_is_seen_through():
    fog = {"type": "homogeneous", "albedo": 0.0, "sigma_t": 0.3}
    scene = still_life(
        {"type": "volpath", "max_depth": 4},
        spp=64,
        sensor={"medium": fog, "f_number": 2.0},
    )
    clear = pm.render_samples(still_life({"type": "volpath", "max_depth": 4}, spp=64))
    foggy = pm.render_samples(scene, sampling=EVEN)
    expected = np.array(mi.render(scene))
    np.testing.assert_allclose(pinhole_mean(foggy), expected, atol=1e-5)
    assert foggy.rgb.mean() < 0.5 * clear.rgb.mean()
