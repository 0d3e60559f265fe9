"""Density: what chance does to samples changes neither what is covered nor how bright it is."""

import functools

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing.density import BORROWED_DENSITY, evened
from potmesil_mi.focusing.fragments import SHARE
from potmesil_mi.focusing.gathering import gather
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = (24, 16)
NEAR, FAR = 1.0, 4.0
PERIOD, BAR = 6, 2


def bars(per_pixel, *, at_random=True, seed=3):
    """Bars before a wall, both known whole, of ``per_pixel`` samples in every pixel."""
    rng = np.random.default_rng(seed)
    width, height = SIZE
    per_side = round(per_pixel**0.5)
    places = np.arange(width * height * per_pixel)
    pixel, number = np.divmod(places, per_pixel)
    if at_random:
        within = rng.uniform(0, 1, (2, len(places)))
    else:
        within = (np.array([number % per_side, number // per_side]) + 0.5) / per_side
    x, y = pixel % width + within[0], pixel // width + within[1]
    near = x % PERIOD < BAR
    z = np.concatenate([np.where(near, NEAR, FAR), np.full(near.sum(), FAR)])
    return synthetic(
        len(z),
        size=(width, height),
        x=np.concatenate([x, x[near]]),
        y=np.concatenate([y, y[near]]),
        z=z,
        rgb=np.ones((len(z), 3)),
        layer=np.concatenate([np.zeros(len(x)), np.ones(near.sum())]),
        surface=np.where(z == NEAR, 1, 2),
        weight=np.full(len(z), 1 / per_pixel),
    )


def by_subpixel(fragments, column, which):
    size = fragments.width * fragments.height
    return np.bincount(fragments.subpixel[which], column[which], size)


# ---------------------------------------------------------------- fragments


def test_even_samples_stay_as_they_are():
    fragments = gather(bars(16, at_random=False), 2, 8.0)
    even = evened(fragments, 2)
    assert even.fragments is fragments
    assert even.density is None
    assert even.moments is None


@pytest.mark.parametrize("subpixels", [2, 3, 4])
def test_what_the_pinhole_sees_of_every_subpixel_has_its_whole_area(subpixels):
    fragments = gather(bars(16), subpixels, 8.0)
    even, density, *_ = evened(fragments, subpixels)
    first = even.gap_in_front == 0
    np.testing.assert_allclose(by_subpixel(even, even.values[:, SHARE], first), 1, rtol=1e-5)
    first = fragments.gap_in_front == 0
    share = by_subpixel(fragments, fragments.values[:, SHARE], first).reshape(density.shape)
    np.testing.assert_allclose(density, np.where(share > 0, share, BORROWED_DENSITY), rtol=1e-5)


def test_colours_and_the_share_of_what_is_hidden_go_with_the_area():
    fragments = gather(bars(16), 2, 8.0)
    even, density, *_ = evened(fragments, 2)
    of = {(x, y, b): v for x, y, b, v in zip(even.x, even.y, even.bin, even.values, strict=True)}
    hidden = 0
    for x, y, bin_, gap, values in zip(
        fragments.x,
        fragments.y,
        fragments.bin,
        fragments.gap_in_front,
        fragments.values,
        strict=True,
    ):
        if (fragments.x == x)[(fragments.y == y) & (fragments.bin == bin_)].sum() > 1:
            continue
        np.testing.assert_allclose(of[x, y, bin_] * density[y, x], values, rtol=1e-5)
        hidden += gap > 0
    assert hidden > 100


def test_a_subpixel_without_a_sample_shows_all_that_the_nearest_one_shows():
    samples = bars(16, at_random=False)
    left_out = (np.floor(samples.x) == 7) & (np.floor(samples.y) == 5)
    whole = gather(samples, 1, 8.0)
    even, density, *_ = evened(gather(samples.chosen(~left_out), 1, 8.0), 1)
    assert density[5, 7] == np.float32(BORROWED_DENSITY)
    there = even.chosen((even.x == 7) & (even.y == 5))
    beside = [
        whole.chosen((whole.x == x) & (whole.y == y)) for x, y in ((6, 5), (8, 5), (7, 4), (7, 6))
    ]
    assert any(
        len(other) == len(there) and np.array_equal(other.values, there.values) for other in beside
    )
    assert len(there) == 2
    assert (np.diff(even.bin.astype(np.int64) * 24 * 16 + even.subpixel) >= 0).all()


@pytest.mark.parametrize("cell", [3, 8])
def test_a_sample_that_stands_for_many_pixels_is_shown_in_all_of_them(cell):
    x, y = (axis.ravel() for axis in np.mgrid[0:24:cell, 0:24:cell] + cell / 2)
    samples = synthetic(len(x), size=(24, 24), x=x, y=y, weight=np.full(len(x), float(cell**2)))
    found = evened(gather(samples, 2, 1.0), 2)
    assert len(found.fragments) == 48**2
    np.testing.assert_allclose(found.fragments.values[:, SHARE], 1, atol=1e-6)


def test_a_hole_that_is_wider_than_samples_lie_apart_stays_a_hole():
    samples = bars(16, at_random=False)
    samples = samples.chosen((samples.x < 4) | (samples.x > 10))
    even, density, *_ = evened(gather(samples, 1, 8.0), 1)
    borrowed = [BORROWED_DENSITY]
    expected = [1] * 4 + borrowed + [0] * 4 + borrowed + [1] * 14
    np.testing.assert_allclose(density[8], expected, rtol=1e-5)
    assert not np.isin(even.x, [5, 6, 7, 8]).any()


# ---------------------------------------------------------------- pictures


@pytest.mark.parametrize("method", ["layered", "lightfield"])
@pytest.mark.parametrize("squares", [1, 2, 4])
@pytest.mark.parametrize("per_pixel", [4, 16, 64])
def test_samples_at_random_make_nothing_darker_or_brighter(method, squares, per_pixel):
    samples = bars(per_pixel)
    for bright, expected in ((FAR, 1 - BAR / PERIOD), (NEAR, BAR / PERIOD)):
        shown = samples.replace(rgb=np.repeat((samples.z == bright)[:, None], 3, axis=1) * 1.0)
        for focused in (NEAR, FAR):
            lens = pm.ThinLens(
                50.0,
                aperture_radius=4 / (0.75 * samples.camera.focal_length_pixels),
                focus_distance=focused,
                millimeters_per_unit=1000.0,
            )
            image = np.array(pm.focus(shown, lens, method=method, squares=squares))
            # Of whole periods, away from the ends of the film.
            mean = image[2:-2, PERIOD:-PERIOD].mean()
            assert mean == pytest.approx(expected, abs=0.01), (bright, focused)


def dark_balls_before_a_bright_wall(sampler, focused):
    transform = mi.ScalarTransform4f()
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "thinlens",
                "fov": 40,
                "aperture_radius": 0.08,
                "focus_distance": focused,
                "film": {
                    "type": "hdrfilm",
                    "width": 32,
                    "height": 32,
                    "pixel_format": "luminance",
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": sampler, "sample_count": 16},
            },
            "wall": {
                "type": "rectangle",
                "to_world": transform.translate([0, 0, FAR]).rotate([0, 1, 0], 180).scale(4),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
            **{
                f"ball_{i}": {
                    "type": "sphere",
                    "center": [(i % 4 - 1.5) / 6, (i // 4 - 1.5) / 6, NEAR],
                    "radius": 0.05,
                    "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
                }
                for i in range(16)
            },
        }
    )


@functools.cache
def ray_traced_mean(focused):
    """Of so many rays that it is the same with every sampler."""
    scene = dark_balls_before_a_bright_wall("independent", focused)
    return np.array(mi.render(scene, spp=512)).mean()


@pytest.mark.parametrize("sampler", ["independent", "stratified", "multijitter", "ldsampler"])
@pytest.mark.parametrize("focused", [NEAR, FAR])
def test_with_every_sampler_the_picture_is_as_bright_as_a_ray_traced_one(sampler, focused):
    scene = dark_balls_before_a_bright_wall(sampler, focused)
    samples = pm.render_samples(scene, spp=16)
    for method, squares in (("layered", None), ("layered", 4), ("lightfield", None)):
        image = np.array(pm.focus(samples, method=method, squares=squares))
        traced = pytest.approx(ray_traced_mean(focused), abs=0.008)
        assert image.mean() == traced, (method, squares)
