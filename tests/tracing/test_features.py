"""Albedo and normal of samples."""

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.samples.columns import COLUMNS
from scenes import diffuse, still_life

BALL, WALL = (0.8, 0.3, 0.1), (0.2, 0.4, 0.7)
FEATURES = pm.Sampling(features=True)


def of_surface(samples, name):
    number = next(number for number, other in samples.surfaces.items() if other == name)
    return samples.surface == number


def test_samples_keep_albedo_and_normal_of_what_they_show(variant_llvm):
    samples = pm.render_samples(still_life(), sampling=FEATURES)
    ball, wall = of_surface(samples, "ball"), of_surface(samples, "wall")
    np.testing.assert_allclose(samples.albedo[ball], np.tile(BALL, (ball.sum(), 1)), rtol=1e-6)
    np.testing.assert_allclose(samples.albedo[wall], np.tile(WALL, (wall.sum(), 1)), rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(samples.normal[ball], axis=1), 1, atol=1e-5)
    assert np.ptp(samples.normal[ball], axis=0).min() > 0.5
    np.testing.assert_allclose(np.abs(samples.normal[wall]), [[0, 0, 1]] * wall.sum(), atol=1e-6)
    nothing = samples.surface == 0
    assert nothing.any()
    assert not samples.albedo[nothing].any()
    assert not samples.normal[nothing].any()


def test_hidden_samples_have_features_of_their_own(variant_llvm):
    samples = pm.render_samples(still_life(), sampling=FEATURES)
    hidden = of_surface(samples, "wall") & (samples.layer > 0)
    assert hidden.any()
    np.testing.assert_allclose(samples.albedo[hidden], np.tile(WALL, (hidden.sum(), 1)), rtol=1e-6)


@pytest.mark.parametrize("pattern", ["sampler", "uniform", "adaptive"])
def test_features_change_nothing_else(variant_llvm, pattern):
    scene = still_life()
    plain = pm.render_samples(scene, sampling=pm.Sampling(pattern))
    kept = pm.render_samples(scene, sampling=pm.Sampling(pattern, features=True))
    assert plain.albedo is None
    assert plain.normal is None
    for column in COLUMNS:
        if column.name not in ("albedo", "normal"):
            first, second = (getattr(samples, column.name) for samples in (plain, kept))
            np.testing.assert_array_equal(first, second)


def test_what_a_mirror_shows_has_its_own_features(variant_llvm):
    facing = mi.ScalarTransform4f().translate([0, 0, 1.5]).rotate([0, 1, 0], 180).scale(5)
    scene = still_life(
        mirror={"type": "rectangle", "to_world": facing, "bsdf": {"type": "conductor"}},
        behind={
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, -2]).scale(20),
            "bsdf": diffuse(0.3, 0.5, 0.2),
        },
    )
    shown = pm.render_samples(scene, sampling=pm.Sampling(features=True, layers=1, overscan=0))
    assert of_surface(shown, "behind").all()
    np.testing.assert_allclose(shown.albedo, [(0.3, 0.5, 0.2)] * len(shown), rtol=1e-6)
    flat = pm.Sampling(features=True, layers=1, overscan=0, virtual_depth=False)
    np.testing.assert_array_equal(pm.render_samples(scene, sampling=flat).albedo, 1)


def test_lamps_have_no_features_and_metal_has_the_albedo_of_white(variant_llvm):
    across = mi.ScalarTransform4f().translate([0, 0, 3]).rotate([0, 1, 0], 180).scale([0.5, 3, 1])
    scene = still_life(
        panel={
            "type": "rectangle",
            "to_world": across,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5.0}},
        },
        ball={
            "type": "sphere",
            "center": [0, 0, 2.3],
            "radius": 0.3,
            "bsdf": {"type": "roughconductor", "alpha": 0.5},
        },
    )
    samples = pm.render_samples(scene, sampling=FEATURES)
    panel, ball = of_surface(samples, "panel"), of_surface(samples, "ball")
    assert panel.any()
    assert not samples.normal[panel & (samples.layer == 0)].any()
    np.testing.assert_array_equal(samples.albedo[ball], 1)
    assert samples.normal[ball].any(axis=1).all()


def test_what_veils_show_themselves_has_no_features_and_what_is_behind_them_does(variant_llvm):
    pane = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, 3]).rotate([0, 1, 0], 180).scale(5),
        "bsdf": {"type": "mask", "opacity": 0.4, "bsdf": diffuse(0.5, 0.5, 0.5)},
    }
    samples = pm.render_samples(still_life(pane=pane), sampling=FEATURES)
    veil, wall = of_surface(samples, "pane"), of_surface(samples, "wall")
    assert veil.any()
    assert not samples.normal[veil & (samples.layer == 0)].any()
    np.testing.assert_allclose(samples.albedo[wall], np.tile(WALL, (wall.sum(), 1)), rtol=1e-6)


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"])
def test_features_are_colours_in_variants_that_count_in_others(variant):
    mi.set_variant(variant)
    samples = pm.render_samples(still_life(), sampling=FEATURES)
    ball = of_surface(samples, "ball")
    assert np.ptp(samples.albedo[ball], axis=0).max() < 1e-5
    red, _, blue = samples.albedo[ball].mean(axis=0)
    assert red == blue if variant == "llvm_ad_mono" else red > 4 * blue
