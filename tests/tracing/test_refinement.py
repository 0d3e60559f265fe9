"""Refinement: further samples go where radiance varies, and no picture is darker for it."""

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.tracing.refinement import (
    MOST_SETS,
    further_sets,
    mean_sharpness,
    pixel_score,
)
from scenes import papers_scene, pinhole_mean, still_life

PATH = {"type": "path", "max_depth": 3}


def counts(samples):
    """How many samples of what the pinhole sees each pixel has, (H, W)."""
    width, height = samples.camera.crop_size
    visible = samples.visible()
    return np.bincount(visible.pixel(), minlength=width * height).reshape(height, width)


# ---------------------------------------------------------------- where they go


@pytest.mark.parametrize("share", [0.1, 0.25, 1.0, 3.0])
@pytest.mark.parametrize("spread", [0.0, 1.0, 4.0])
def test_there_are_as_many_further_sets_as_are_asked_for(share, spread):
    score = np.exp(spread * np.random.default_rng(0).normal(size=(48, 64)))
    sets = further_sets(score, share)
    assert 0.95 * share < sets.mean() <= share
    assert set(np.unique(sets)) <= {0, *(2**n for n in range(5))}
    assert sets.max() <= MOST_SETS


def test_they_go_to_the_pixels_around_which_radiance_varies():
    score = np.full((32, 32), 1e-4)
    score[8:16, 8:16] = 1.0
    sets = further_sets(score, 0.25)
    assert sets[9:15, 9:15].min() >= 2
    assert sets[20:, 20:].max() == 0


def test_a_pixels_own_samples_call_for_nothing():
    # They would count less the more they call for, and the mean picture would be too dark.
    score = np.random.default_rng(1).uniform(1, 2, (16, 16))
    other = score.copy()
    other[7, 5] = 1e6
    assert further_sets(score, 0.5)[7, 5] <= further_sets(other, 0.5)[7, 6]
    alone = np.zeros((16, 16))
    alone[7, 5] = 1.0
    sets = further_sets(alone, 0.25)
    assert sets[7, 5] == 0
    assert sets[6:9, 4:7].sum() == sets.sum() > 0


@pytest.mark.parametrize("score", [np.zeros((4, 5)), np.full((4, 5), np.nan)])
def test_where_nothing_is_known_to_vary_there_are_none(score):
    assert not further_sets(score, 0.5).any()


def test_radiance_that_is_not_finite_calls_for_nothing():
    rgb = np.ones((3, 4, 3), np.float32)
    rgb[1, 2] = np.inf
    rgb[2, :2] = 3
    score = pixel_score(rgb, np.ones((3, 4)))
    assert score[0] == 0
    assert score[2] == pytest.approx(3)
    assert not further_sets(np.array([[0, score[1], 0]]), 1.0).any()


@pytest.mark.parametrize("foci", [(0.7, 3.0), (2.0, 2.0), (1.0, np.inf)])
def test_the_mean_sharpness_is_that_of_the_foci(foci):
    z, scale = np.array([0.5, 1.0, 2.5, np.inf]), 9.0
    vergence = np.linspace(1 / foci[0], 1 / foci[1], 200_001)
    expected = [(1 / (1 + np.pi * (scale * (1 / one - vergence)) ** 2)).mean() for one in z]
    np.testing.assert_allclose(mean_sharpness(z, scale, foci), expected, rtol=1e-3)
    assert (mean_sharpness(z, scale, None) == 1).all()


# ---------------------------------------------------------------- samples


def test_the_even_samples_come_first_and_all_of_a_pixel_count_the_same(variant_llvm):
    scene = still_life(PATH, spp=16)
    refined, even = (
        pm.render_samples(scene, seed=3, sampling=pm.Sampling(refine=share, layers=1, overscan=0))
        for share in (0.5, 0)
    )
    np.testing.assert_array_equal(refined.rgb[: len(even)], even.rgb)
    np.testing.assert_array_equal(refined.x[: len(even)], even.x)
    number = counts(refined)
    assert 1.3 * len(even) < len(refined) <= 1.5 * len(even)
    assert set(np.unique(number // 16 - 1)) <= {0, 1, 2, 4, 8, 16}
    np.testing.assert_allclose(refined.weight, 1 / number.ravel()[refined.pixel()], rtol=1e-6)


def test_the_same_seed_gives_the_same_samples(variant_llvm):
    scene = still_life(PATH, spp=4)
    one, again = (pm.render_samples(scene, seed=2) for _ in range(2))
    np.testing.assert_array_equal(one.x, again.x)
    np.testing.assert_array_equal(one.rgb, again.rgb)


@pytest.mark.filterwarnings("ignore:radiance")
def test_pictures_are_no_darker_on_the_average(variant_llvm):
    # A lamp so small that few paths find it: the brightest pixels are the luckiest ones.
    lamp = {
        "type": "sphere",
        "center": [0.6, 0.8, 2.0],
        "radius": 0.2,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 25.0}},
    }
    integrator = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}
    scene = still_life(integrator, spp=4, sampler="independent", lamp=lamp)
    only = {"layers": 1, "overscan": 0}
    refined, even = [], []
    for seed in range(40):
        for share, means in ((1.0, refined), (0.0, even)):
            sampling = pm.Sampling(refine=share, **only)
            means.append(
                pinhole_mean(pm.render_samples(scene, seed=seed, sampling=sampling)).mean()
            )
    noise = np.hypot(*(np.std(means, ddof=1) / np.sqrt(40) for means in (refined, even)))
    assert 2 * noise < np.mean(even) / 5
    assert abs(np.mean(refined) - np.mean(even)) < 3 * noise


@pytest.mark.parametrize("method", ["layered", "lightfield"])
def test_a_quarter_more_samples_halve_the_error_of_textures_in_focus(variant_llvm, method):
    scene = papers_scene(96)
    lens = scene.sensors()[0].lens().replace(f_number=5.6, focus_distance=550)
    best = np.array(pm.focus(pm.render_samples(scene, spp=256), lens, method=method, squares=2))
    errors = []
    for share in (0, 0.25):
        samples = pm.render_samples(scene, spp=16, seed=1, sampling=pm.Sampling(refine=share))
        picture = np.array(pm.focus(samples, lens, method=method, squares=2))
        errors.append(np.mean((picture - best) ** 2))
    assert errors[1] < errors[0] / 1.6


def test_grids_are_not_refined(variant_llvm):
    scene = still_life(PATH, spp=1)
    for pattern in ("uniform", "adaptive"):
        one, other = (
            pm.render_samples(scene, sampling=pm.Sampling(pattern, refine=share, overscan=0))
            for share in (0, 1.0)
        )
        assert len(one) == len(other)


def test_another_variant_refines_too():
    mi.set_variant("llvm_ad_mono")
    sampling = pm.Sampling(refine=1.0, overscan=0)
    samples = pm.render_samples(still_life(PATH, spp=4), sampling=sampling)
    assert counts(samples).max() > 8


@pytest.mark.parametrize("period", [2, 8, 9, 32])
@pytest.mark.parametrize("down", [True, False])
def test_large_pictures_with_a_period_get_the_share_that_was_asked_for(period, down):
    """Some pixels tell for all: they must not all be of one phase."""
    row, column = np.indices((512, 1024))
    score = np.where((row if down else column) % period == 0, 1e-4, 1.0)
    assert further_sets(score, 0.25).mean() == pytest.approx(0.25, rel=0.05)
