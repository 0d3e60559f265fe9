import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing import fragments as elements_module
from potmesil_mi.focusing.fragments import BIN, MOST_BINS, SHARE, Elements
from scenes import overscanned, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")


def light(samples, per_pixel=1):
    """R, G, B, share and alpha of all samples, in squares."""
    columns = np.concatenate(
        [samples.rgb, np.ones((len(samples), 1)), samples.alpha[:, None]], axis=1
    )
    return (samples.weight[:, None].astype(np.float64) * columns).sum(axis=0) * per_pixel**2


def mean_vergence(samples):
    return np.average(1 / samples.z.astype(np.float64), weights=samples.weight)


def total(elements):
    return elements.values.astype(np.float64).sum(axis=0)


def every_kind():
    """Samples of which squares are flat, of several depths, and hidden."""
    samples = overscanned(20_000)
    flat = samples.x < samples.window[0] + 12
    return samples.replace(z=np.where(flat, 2.0, samples.z))


@pytest.mark.parametrize("per_pixel", [1, 2, 3])
@pytest.mark.parametrize("scale", [0.01, 3.0, 1e4])
def test_gathering_samples_keeps_their_light_and_mean_depth(per_pixel, scale):
    samples = every_kind()
    elements = Elements.of(samples, per_pixel, scale, alpha=True)
    np.testing.assert_allclose(total(elements), light(samples, per_pixel), rtol=1e-5)
    share = elements.values[:, SHARE].astype(np.float64)
    mean = np.average(elements.vergence, weights=share)
    assert mean == pytest.approx(mean_vergence(samples), rel=1e-5)
    assert (elements.width, elements.height) == (30 * per_pixel, 24 * per_pixel)
    assert 0 <= elements.x.min() <= elements.x.max() < elements.width
    assert 0 <= elements.y.min() <= elements.y.max() < elements.height


def test_every_square_keeps_its_own_light():
    samples = every_kind()
    elements = Elements.of(samples, 1, 3.0)
    size = elements.width * elements.height
    place = elements.y.astype(np.int64) * elements.width + elements.x
    for i in range(3):
        expected = np.bincount(samples.pixel(), samples.weight * samples.rgb[:, i], size)
        np.testing.assert_allclose(
            np.bincount(place, elements.values[:, i], size), expected, rtol=1e-5
        )


def test_gathering_in_parts_gives_the_same(monkeypatch):
    samples = every_kind()
    at_once = Elements.of(samples, 1, 3.0, alpha=True)
    monkeypatch.setattr(elements_module, "AT_ONCE", 1234)
    in_parts = Elements.of(samples, 1, 3.0, alpha=True)
    for name in ("x", "y", "bin"):
        np.testing.assert_array_equal(getattr(in_parts, name), getattr(at_once, name))
    for name in ("vergence", "values", "front"):
        np.testing.assert_allclose(getattr(in_parts, name), getattr(at_once, name), rtol=1e-5)


def test_a_square_of_one_depth_is_one_element():
    samples = synthetic(5000, z=np.full(5000, 3.0))
    elements = Elements.of(samples, 1, 3.0)
    assert len(elements) == 20 * 14
    np.testing.assert_allclose(elements.vergence, 1 / 3, rtol=1e-6)
    assert not elements.front.any()


def test_depths_are_gathered_within_a_quarter_of_a_square_of_their_circle():
    samples = every_kind()
    scale = 20.0
    elements = Elements.of(samples, 1, scale)
    assert elements.step * scale == pytest.approx(BIN)
    place = elements.y.astype(np.int64) * elements.width + elements.x
    by_place = {p: elements.vergence[place == p] for p in np.unique(place)}
    nearest = [
        np.abs(by_place[p] - 1 / z).min() * scale
        for p, z in zip(samples.pixel()[::37], samples.z[::37], strict=True)
    ]
    assert max(nearest) <= 2 * BIN  # flat squares are of two bins
    assert len(elements) < len(samples)


def test_of_depths_very_many_circles_apart_bins_are_bounded():
    samples = synthetic(3000, z=np.geomspace(0.01, 1e4, 3000))
    elements = Elements.of(samples, 1, 1e5)
    assert elements.bin.max() <= MOST_BINS
    np.testing.assert_allclose(total(elements), light(samples)[:4], rtol=1e-5)


def test_what_is_infinitely_far_has_no_vergence():
    samples = synthetic(500, z=np.full(500, np.inf))
    elements = Elements.of(samples, 1, 3.0)
    assert not elements.vergence.any()
    both = synthetic(500, z=np.where(np.arange(500) % 2, np.inf, 1.0))
    elements = Elements.of(both, 1, 3.0)
    assert (elements.vergence.min(), elements.vergence.max()) == (0, 1)


def test_elements_are_in_order_of_depth_and_then_of_place():
    elements = Elements.of(every_kind(), 2, 3.0)
    key = (elements.bin.astype(np.int64) * elements.height + elements.y) * elements.width
    assert (np.diff(key + elements.x) >= 0).all()
    middle = elements.least + (elements.bin + 0.5) * elements.step
    assert np.abs(elements.vergence - middle).max() <= elements.step


def test_between_gives_the_elements_of_some_bins():
    elements = Elements.of(every_kind(), 1, 3.0)
    for first, end in ((0, 3), (2, 5), (4, MOST_BINS + 1), (3, 3)):
        part = np.zeros(len(elements), dtype=bool)
        part[elements.between(first, end)] = True
        np.testing.assert_array_equal(part, (elements.bin >= first) & (elements.bin < end))
        assert part.any() == (end > first)


# ---------------------------------------------------------------- hidden samples


def test_a_hidden_sample_knows_how_far_the_first_surface_of_its_square_is_before_it():
    # Two samples a pixel, one behind the other: at 1 and at 4.
    x, y = (axis.ravel() + 0.5 for axis in np.meshgrid(np.arange(20), np.arange(14)))
    samples = synthetic(
        560,
        x=np.tile(x, 2),
        y=np.tile(y, 2),
        z=np.repeat([1.0, 4.0], 280),
        layer=np.repeat([0, 1], 280),
    )
    elements = Elements.of(samples, 1, 10.0)
    assert len(elements) == 560
    hidden = elements.front > 0
    np.testing.assert_allclose(elements.vergence, np.where(hidden, 0.25, 1.0), rtol=1e-6)
    np.testing.assert_allclose(elements.front[hidden], 0.75, atol=elements.step)


def test_hidden_samples_stay_apart_from_visible_ones_of_the_same_depth():
    samples = synthetic(4000, z=np.full(4000, 2.0), layer=np.arange(4000) % 2)
    elements = Elements.of(samples, 1, 3.0)
    assert (elements.front > 0).sum() == 280
    shown = samples.layer == 0
    expected = samples.weight[shown].sum()
    assert elements.values[elements.front == 0, SHARE].sum() == pytest.approx(expected, rel=1e-5)


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


@pytest.mark.parametrize("per_pixel", [1, 2, 3])
@pytest.mark.parametrize("margin", [0, 2])
def test_samples_on_edges_are_shared_by_the_squares_beside_them(margin, per_pixel):
    samples = on_lattice(pm.Sampling("uniform", layers=1, overscan=margin))
    elements = Elements.of(samples, per_pixel, 1.0)
    place = elements.y.astype(np.int64) * elements.width + elements.x
    share = np.bincount(place, elements.values[:, SHARE], elements.width * elements.height)
    pixels = share.reshape(-1, per_pixel, samples.window[2], per_pixel).sum(axis=(1, 3))
    np.testing.assert_allclose(pixels / per_pixel**2, 1, rtol=1e-5)


@pytest.mark.parametrize("per_pixel", [1, 3])
def test_of_samples_where_the_picture_is_divided_none_is_lost(per_pixel):
    sampling = pm.Sampling("adaptive", layers=1, overscan=0, threshold=0.0)
    samples = on_lattice(sampling)
    assert len(np.unique(samples.weight)) > 4
    elements = Elements.of(samples, per_pixel, 1.0)
    assert total(elements)[SHARE] == pytest.approx(12 * 9 * per_pixel**2, rel=1e-5)


def test_a_sample_on_a_corner_gives_a_quarter_to_each_square():
    samples = synthetic(
        2, x=np.array([3.0, 0.0]), y=np.array([5.0, 0.0]), weight=np.ones(2), z=np.full(2, 2.0)
    ).replace(lattice=1)
    elements = Elements.of(samples, 1, 1.0)
    found = dict(
        zip(
            zip(elements.x.tolist(), elements.y.tolist(), strict=True),
            elements.values[:, SHARE].tolist(),
            strict=True,
        )
    )
    assert found == dict.fromkeys(((2, 4), (3, 4), (2, 5), (3, 5), (0, 0)), 0.25)


# ---------------------------------------------------------------- coarser squares


@pytest.mark.parametrize("factor", [2, 4, 8])
def test_coarser_squares_have_the_same_light_and_mean_depth(factor):
    fine = Elements.of(every_kind(), 1, 3.0, alpha=True)
    coarse, index = fine.coarser(factor)
    assert (coarse.width, coarse.height) == (-(-30 // factor), -(-24 // factor))
    np.testing.assert_allclose(total(coarse) * factor**2, total(fine), rtol=1e-5)
    means = [
        np.average(e.vergence.astype(np.float64), weights=e.values[:, SHARE])
        for e in (fine, coarse)
    ]
    assert means[0] == pytest.approx(means[1], rel=1e-5)
    assert coarse.step == fine.step * factor
    assert len(coarse) < len(fine)
    # Each went to the square and the depth in which it lies.
    np.testing.assert_array_equal(coarse.x[index], fine.x // factor)
    np.testing.assert_array_equal(coarse.y[index], fine.y // factor)
    np.testing.assert_array_equal(coarse.bin[index], fine.bin // factor)


def test_a_uniform_picture_is_as_dense_on_coarser_squares():
    x, y = (axis.ravel() + 0.5 for axis in np.meshgrid(np.arange(20), np.arange(14)))
    samples = synthetic(280, x=x, y=y, z=np.full(280, 2.0), weight=np.ones(280))
    coarse, _ = Elements.of(samples, 1, 3.0).coarser(2)
    np.testing.assert_allclose(coarse.values[:, SHARE], 1, rtol=1e-6)
