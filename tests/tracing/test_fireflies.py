"""Fireflies: what is far too bright is told of and limited, but for lamps and the sky."""

import warnings

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.samples.columns import Columns
from potmesil_mi.samples.raster import Window
from potmesil_mi.tracing.fireflies import BRIGHT_DISC, Fireflies
from scenes import pinhole_mean, still_life

BY_CHANCE = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}
CROP = Window(0, 0, 24, 24)
LAMP, WALL, SPP = 1, 2, 4


def small_lamp(radiance=2500.0, radius=0.03):
    """A lamp out of the picture that hardly any path finds by chance."""
    return {
        "type": "sphere",
        "center": [0.6, 0.8, 2.0],
        "radius": radius,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
    }


def even_wall(**bright):
    """Four samples a pixel of a wall of radiance 1, and in the middle a pixel with a brighter one.

    ``bright`` are columns of that one.
    """
    row, column, _ = (index.ravel() for index in np.indices((*CROP.shape, SPP)))
    count = len(row)
    columns = {
        "x": column + 0.5,
        "y": row + 0.5,
        "rgb": np.ones((count, 3)),
        "alpha": np.ones(count),
        "z": np.full(count, 2.0),
        "surface": np.full(count, WALL),
        "weight": np.full(count, 1 / SPP),
    }
    middle = SPP * (12 * CROP.width + 12)
    for name, value in bright.items():
        columns[name][middle] = value
    return Columns(**columns)


def fireflies(clamp=None):
    return Fireflies(np.array([LAMP], np.uint32), clamp)


@pytest.mark.parametrize("at_once", [100, 10_000])
def test_one_sample_that_outshines_a_disc_is_told_of_with_the_remedy(at_once, monkeypatch):
    monkeypatch.setattr("potmesil_mi.samples.columns.AT_ONCE", at_once)
    bright = 1.01 * BRIGHT_DISC * SPP
    with pytest.warns(UserWarning, match=r"radiance: 1 of 2304 samples .*clamp=400 limits"):
        fireflies().warn(even_wall(rgb=[0, bright, 0]), CROP)


@pytest.mark.parametrize(
    "bright",
    [
        {"rgb": [0, 0.99 * BRIGHT_DISC * SPP, 0]},
        {"rgb": 1e6, "surface": LAMP},
        {"rgb": 1e6, "surface": 0, "z": np.inf},
        {"rgb": 1e6, "x": -0.5},
        {"rgb": np.inf},
        {"rgb": [np.inf, -np.inf, 3e38], "weight": 100},
        {"rgb": np.nan},
    ],
    ids=["dimmer", "lamp", "sky", "beside", "infinite", "infinite difference", "no number"],
)
def test_of_what_is_no_firefly_nothing_is_said(bright):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fireflies().warn(even_wall(**bright), CROP)


def test_in_the_dark_a_bright_sample_is_no_firefly_unless_the_picture_knows_it():
    # The left half is black but for one sample, which is dim beside the right half.
    columns = even_wall()
    columns.rgb[columns.x < 12] = 0
    columns.rgb[SPP * (12 * CROP.width + 4)] = 0.9
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fireflies().warn(columns, CROP)


def test_the_clamp_keeps_hue_and_sign_and_leaves_lamps_and_the_sky():
    rgb = np.array([[8, 4, 0], [-8, 2, 0], [1, 2, 3], [8, 8, 8], [8, 8, 8]], np.float32)
    surface = np.array([WALL, WALL, WALL, LAMP, 0], np.uint32)
    z = np.array([1, 1, 1, 1, np.inf], np.float32)
    expected = [[4, 2, 0], [-4, 1, 0], [1, 2, 3], [8, 8, 8], [8, 8, 8]]
    given = rgb.copy()
    np.testing.assert_array_equal(fireflies(4.0).clamped(rgb, surface, z), expected)
    np.testing.assert_array_equal(rgb, given)
    assert fireflies().clamped(rgb, surface, z) is rgb


@pytest.mark.parametrize("at_once", [100, 10_000])
def test_all_samples_are_clamped_in_their_own_memory(at_once, monkeypatch):
    monkeypatch.setattr("potmesil_mi.samples.columns.AT_ONCE", at_once)
    columns = even_wall(rgb=[0, 8, 4])
    rgb, expected = columns.rgb, fireflies(4.0).clamped(columns.rgb, columns.surface, columns.z)
    fireflies(4.0).clamp_all(columns)
    assert columns.rgb is rgb
    np.testing.assert_array_equal(rgb, expected)
    assert rgb.max() == 4


def test_a_lamp_found_by_chance_warns_and_clamped_it_does_not(variant_llvm):
    scene = still_life(BY_CHANCE, spp=16, small=small_lamp())
    with pytest.warns(UserWarning, match="bright discs"):
        samples = pm.render_samples(scene, seed=3)
    clamped = pm.render_samples(scene, seed=3, sampling=pm.Sampling(clamp=2.0))
    assert samples.rgb.max() > 20
    assert clamped.rgb.max() == pytest.approx(2)
    assert pinhole_mean(clamped).mean() < pinhole_mean(samples).mean()


def test_a_lamp_in_the_picture_and_in_a_mirror_is_as_bright_as_it_is(variant_llvm):
    lamp = {**small_lamp(100.0, 0.1), "center": [-0.5, 0.3, 2.0]}
    mirror = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0.8, 0, 3]).rotate([0, 1, 0], 200).scale(0.4),
        "bsdf": {"type": "conductor"},
    }
    scene = still_life(spp=16, sampler="multijitter", lamp_there=lamp, mirror=mirror)
    samples = pm.render_samples(scene, sampling=pm.Sampling(clamp=1.0))
    names = {name: id_ for id_, name in samples.surfaces.items()}
    shows = samples.surface == names["lamp_there"]
    assert samples.rgb[shows].max() == pytest.approx(100)
    assert samples.rgb[~shows].max() <= 1 + 1e-6


@pytest.mark.filterwarnings("ignore:radiance")
def test_fireflies_that_are_clamped_draw_no_further_samples(variant_llvm):
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    scene = still_life(BY_CHANCE, spp=16, small=small_lamp(), sky=sky)
    around = []
    for clamp in (None, 2.0):
        sampling = pm.Sampling(clamp=clamp, layers=1, overscan=0)
        samples = pm.render_samples(scene, seed=3, sampling=sampling)
        if clamp is None:
            row, column = np.divmod(samples.pixel()[samples.rgb.max(axis=1).argmax()], 24)
        apart = np.hypot(samples.x - column - 0.5, samples.y - row - 0.5)
        around.append(np.count_nonzero(apart < 2.5))
    assert around[1] < around[0] / 2


@pytest.mark.parametrize(
    ("clamp", "error"), [(0, ValueError), (-1, ValueError), (np.nan, ValueError), ("4", TypeError)]
)
def test_a_bad_clamp_is_named(clamp, error):
    with pytest.raises(error, match="clamp="):
        pm.Sampling(clamp=clamp)
