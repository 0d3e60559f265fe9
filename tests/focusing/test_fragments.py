import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing import locating
from potmesil_mi.focusing.fragments import BIN_RADIUS, MAX_BINS, SHARE
from potmesil_mi.focusing.gathering import gather
from scenes import overscanned, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")


def light(samples, subpixels=1):
    """R, G, B, share and alpha of all samples, in subpixels."""
    columns = np.concatenate(
        [samples.rgb, np.ones((len(samples), 1)), samples.alpha[:, None]], axis=1
    )
    return (samples.weight[:, None].astype(np.float64) * columns).sum(axis=0) * subpixels**2


def mean_vergence(samples):
    return np.average(1 / samples.z.astype(np.float64), weights=samples.weight)


def total(fragments):
    return fragments.values.astype(np.float64).sum(axis=0)


def every_kind():
    """Samples of which subpixels are flat, of several depths, and hidden."""
    samples = overscanned(20_000)
    flat = samples.x < samples.window[0] + 12
    return samples.replace(z=np.where(flat, 2.0, samples.z))


@pytest.mark.parametrize("subpixels", [1, 2, 3])
@pytest.mark.parametrize("scale", [0.01, 3.0, 1e4])
def test_gathering_samples_keeps_their_light_and_mean_depth(subpixels, scale):
    samples = every_kind()
    fragments = gather(samples, subpixels, scale, alpha=True)
    np.testing.assert_allclose(total(fragments), light(samples, subpixels), rtol=1e-5)
    share = fragments.values[:, SHARE].astype(np.float64)
    mean = np.average(fragments.vergence, weights=share)
    assert mean == pytest.approx(mean_vergence(samples), rel=1e-5)
    assert (fragments.width, fragments.height) == (30 * subpixels, 24 * subpixels)
    assert 0 <= fragments.x.min() <= fragments.x.max() < fragments.width
    assert 0 <= fragments.y.min() <= fragments.y.max() < fragments.height


def test_every_subpixel_keeps_its_own_light():
    samples = every_kind()
    fragments = gather(samples, 1, 3.0)
    size = fragments.width * fragments.height
    place = fragments.y.astype(np.int64) * fragments.width + fragments.x
    for i in range(3):
        expected = np.bincount(samples.pixel(), samples.weight * samples.rgb[:, i], size)
        np.testing.assert_allclose(
            np.bincount(place, fragments.values[:, i], size), expected, rtol=1e-5
        )


@pytest.mark.parametrize("lattice", [0, 4])
@pytest.mark.parametrize("every", [1, 2, 9])
def test_gathering_some_of_the_samples_is_as_if_there_were_no_others(monkeypatch, every, lattice):
    samples = every_kind()
    if lattice:
        x, y = (np.floor(of * lattice) / lattice for of in (samples.x, samples.y))
        samples = samples.replace(x=x, y=y, lattice=lattice)
    bins = locating.Bins.of(samples.z, 3.0)
    # Parts that are meant as a whole, mostly, in a few places and not at all.
    which = np.arange(len(samples)) % every != every // 2
    which[: len(samples) // 3] ^= True
    which[-3000:] = False
    monkeypatch.setattr(locating, "GATHERED_AT_ONCE", 2000)
    some = gather(samples, 2, 3.0, alpha=True, bins=bins, which=which)
    alone = gather(samples.chosen(which), 2, 3.0, alpha=True, bins=bins)
    for name in ("x", "y", "bin"):
        np.testing.assert_array_equal(getattr(some, name), getattr(alone, name))
    for name in ("vergence", "values", "gap_in_front"):
        np.testing.assert_allclose(getattr(some, name), getattr(alone, name), rtol=1e-4, atol=1e-7)


def test_gathering_in_parts_gives_the_same(monkeypatch):
    samples = every_kind()
    at_once = gather(samples, 1, 3.0, alpha=True)
    monkeypatch.setattr(locating, "GATHERED_AT_ONCE", 1234)
    in_parts = gather(samples, 1, 3.0, alpha=True)
    for name in ("x", "y", "bin"):
        np.testing.assert_array_equal(getattr(in_parts, name), getattr(at_once, name))
    for name in ("vergence", "values", "gap_in_front"):
        np.testing.assert_allclose(getattr(in_parts, name), getattr(at_once, name), rtol=1e-5)


def test_a_subpixel_of_one_depth_is_one_fragment():
    samples = synthetic(5000, z=np.full(5000, 3.0))
    fragments = gather(samples, 1, 3.0)
    assert len(fragments) == 20 * 14
    np.testing.assert_allclose(fragments.vergence, 1 / 3, rtol=1e-6)
    assert not fragments.gap_in_front.any()


def test_depths_are_gathered_within_a_quarter_of_a_subpixel_of_their_circle():
    samples = every_kind()
    scale = 20.0
    fragments = gather(samples, 1, scale)
    assert fragments.bin_width * scale == pytest.approx(BIN_RADIUS)
    place = fragments.y.astype(np.int64) * fragments.width + fragments.x
    by_place = {p: fragments.vergence[place == p] for p in np.unique(place)}
    nearest = [
        np.abs(by_place[p] - 1 / z).min() * scale
        for p, z in zip(samples.pixel()[::37], samples.z[::37], strict=True)
    ]
    assert max(nearest) <= 2 * BIN_RADIUS  # flat subpixels are of two bins
    assert len(fragments) < len(samples)


def test_of_depths_very_many_circles_apart_bins_are_bounded():
    samples = synthetic(3000, z=np.geomspace(0.01, 1e4, 3000))
    fragments = gather(samples, 1, 1e5)
    assert fragments.bin.max() <= MAX_BINS
    np.testing.assert_allclose(total(fragments), light(samples)[:4], rtol=1e-5)


def test_what_is_infinitely_far_has_no_vergence():
    samples = synthetic(500, z=np.full(500, np.inf))
    fragments = gather(samples, 1, 3.0)
    assert not fragments.vergence.any()
    z = np.where(np.arange(500) % 2, np.inf, 1.0)
    both = synthetic(500, z=z, weight=np.full(500, 0.5))
    fragments = gather(both, 1, 3.0)
    assert (fragments.vergence.min(), fragments.vergence.max()) == (0, 1)


def test_fragments_are_in_order_of_depth_and_then_of_place():
    fragments = gather(every_kind(), 2, 3.0)
    key = (fragments.bin.astype(np.int64) * fragments.height + fragments.y) * fragments.width
    assert (np.diff(key + fragments.x) >= 0).all()
    middle = fragments.vergence_min + (fragments.bin + 0.5) * fragments.bin_width
    assert np.abs(fragments.vergence - middle).max() <= fragments.bin_width


def test_between_gives_the_fragments_of_some_bins():
    fragments = gather(every_kind(), 1, 3.0)
    for first, end in ((0, 3), (2, 5), (4, MAX_BINS + 1), (3, 3)):
        part = np.zeros(len(fragments), dtype=bool)
        part[fragments.between(first, end)] = True
        np.testing.assert_array_equal(part, (fragments.bin >= first) & (fragments.bin < end))
        assert part.any() == (end > first)


# ---------------------------------------------------------------- hidden samples


def test_a_hidden_sample_knows_how_far_the_first_surface_of_its_subpixel_is_before_it():
    # Two samples a pixel, one behind the other: at 1 and at 4.
    x, y = (axis.ravel() + 0.5 for axis in np.meshgrid(np.arange(20), np.arange(14)))
    samples = synthetic(
        560,
        x=np.tile(x, 2),
        y=np.tile(y, 2),
        z=np.repeat([1.0, 4.0], 280),
        layer=np.repeat([0, 1], 280),
    )
    fragments = gather(samples, 1, 10.0)
    assert len(fragments) == 560
    hidden = fragments.gap_in_front > 0
    np.testing.assert_allclose(fragments.vergence, np.where(hidden, 0.25, 1.0), rtol=1e-6)
    np.testing.assert_allclose(fragments.gap_in_front[hidden], 0.75, atol=fragments.bin_width)


def test_hidden_samples_stay_apart_from_visible_ones_of_the_same_depth():
    samples = synthetic(4000, z=np.full(4000, 2.0), layer=np.arange(4000) % 2)
    fragments = gather(samples, 1, 3.0)
    assert (fragments.gap_in_front > 0).sum() == 280
    shown = samples.layer == 0
    expected = samples.weight[shown].sum()
    assert fragments.values[fragments.gap_in_front == 0, SHARE].sum() == pytest.approx(
        expected, rel=1e-5
    )


# ---------------------------------------------------------------- samples on a lattice


def on_lattice(sampling):
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "potmesil",
                "f_number": 2.0,
                "film": {"type": "hdrfilm", "width": 12, "height": 9},
            },
            "ball": {"type": "sphere", "center": [0, 0, 3], "radius": 0.4},
            "sky": {"type": "constant"},
        }
    )
    return pm.render_samples(scene, spp=1, sampling=sampling)


@pytest.mark.parametrize("subpixels", [1, 2, 3])
@pytest.mark.parametrize("margin", [0, 2])
def test_samples_on_edges_are_shared_by_the_subpixels_beside_them(margin, subpixels):
    samples = on_lattice(pm.Sampling("uniform", layers=1, overscan=margin))
    fragments = gather(samples, subpixels, 1.0)
    place = fragments.y.astype(np.int64) * fragments.width + fragments.x
    share = np.bincount(place, fragments.values[:, SHARE], fragments.width * fragments.height)
    pixels = share.reshape(-1, subpixels, samples.window[2], subpixels).sum(axis=(1, 3))
    np.testing.assert_allclose(pixels / subpixels**2, 1, rtol=1e-5)


@pytest.mark.parametrize("subpixels", [1, 3])
def test_of_samples_where_the_picture_is_divided_none_is_lost(subpixels):
    sampling = pm.Sampling("adaptive", layers=1, overscan=0, threshold=0.0)
    samples = on_lattice(sampling)
    assert len(np.unique(samples.weight)) > 4
    fragments = gather(samples, subpixels, 1.0)
    assert total(fragments)[SHARE] == pytest.approx(12 * 9 * subpixels**2, rel=1e-5)


def test_a_sample_on_a_corner_gives_a_quarter_to_each_subpixel():
    samples = synthetic(
        2, x=np.array([3.0, 0.0]), y=np.array([5.0, 0.0]), weight=np.ones(2), z=np.full(2, 2.0)
    ).replace(lattice=1)
    fragments = gather(samples, 1, 1.0)
    found = dict(
        zip(
            zip(fragments.x.tolist(), fragments.y.tolist(), strict=True),
            fragments.values[:, SHARE].tolist(),
            strict=True,
        )
    )
    assert found == dict.fromkeys(((2, 4), (3, 4), (2, 5), (3, 5), (0, 0)), 0.25)


# ---------------------------------------------------------------- coarser subpixels


@pytest.mark.parametrize("factor", [2, 4, 8])
def test_coarser_subpixels_have_the_same_light_and_mean_depth(factor):
    fine = gather(every_kind(), 1, 3.0, alpha=True)
    coarse, index = fine.coarser(factor)
    assert (coarse.width, coarse.height) == (-(-30 // factor), -(-24 // factor))
    np.testing.assert_allclose(total(coarse) * factor**2, total(fine), rtol=1e-5)
    means = [
        np.average(e.vergence.astype(np.float64), weights=e.values[:, SHARE])
        for e in (fine, coarse)
    ]
    assert means[0] == pytest.approx(means[1], rel=1e-5)
    assert coarse.bin_width == fine.bin_width * factor
    assert len(coarse) < len(fine)
    # Each went to the square and the depth in which it lies.
    np.testing.assert_array_equal(coarse.x[index], fine.x // factor)
    np.testing.assert_array_equal(coarse.y[index], fine.y // factor)
    np.testing.assert_array_equal(coarse.bin[index], fine.bin // factor)


def test_a_uniform_picture_is_as_dense_on_coarser_subpixels():
    x, y = (axis.ravel() + 0.5 for axis in np.meshgrid(np.arange(20), np.arange(14)))
    samples = synthetic(280, x=x, y=y, z=np.full(280, 2.0), weight=np.ones(280))
    coarse, _ = gather(samples, 1, 3.0).coarser(2)
    np.testing.assert_allclose(coarse.values[:, SHARE], 1, rtol=1e-6)
