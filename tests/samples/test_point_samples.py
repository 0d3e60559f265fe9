"""What samples must be, their layers, merging, crops."""

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.optics.disc import lens_points
from potmesil_mi.samples import counting
from potmesil_mi.samples.columns import COLUMNS, Columns, points_that_see
from potmesil_mi.samples.raster import Window
from scenes import overscanned, papers_scene, pinhole_mean, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")


# ---------------------------------------------------------------- what samples must be


@pytest.mark.parametrize(
    ("field", "bad"),
    [
        ("rgb", np.nan),
        ("rgb", np.inf),
        ("alpha", np.nan),
        ("z", np.nan),
        ("z", -1.0),
        ("x", np.inf),
        ("weight", 0.0),
    ],
)
def test_bad_samples_are_dropped_and_counted(field, bad):
    good = synthetic(100)
    column = getattr(good, field).copy()
    column[[3, 50]] = bad
    with pytest.warns(RuntimeWarning, match="dropped 2 of 100 samples"):
        samples = good.replace(**{field: column})
    assert len(samples) == 98
    np.testing.assert_array_equal(samples.y, np.delete(good.y, [3, 50]))
    assert np.isfinite(np.array(pm.focus(samples))).all()


def test_no_samples_at_all_are_refused():
    with pytest.raises(ValueError, match="no samples"):
        synthetic(0)
    good = synthetic(5)
    with (
        pytest.warns(RuntimeWarning, match="dropped 5 of 5"),
        pytest.raises(ValueError, match="no samples"),
    ):
        good.replace(rgb=np.full((5, 3), np.nan))


def test_columns_of_the_wrong_shape_are_named():
    with pytest.raises(ValueError, match=r"z: has shape \(3,\), must have \(5,\)"):
        synthetic(5, z=np.ones(3))
    with pytest.raises(ValueError, match="rgb: has shape"):
        synthetic(5, rgb=np.ones((5, 4)))


def test_a_sample_on_the_films_last_edge_belongs_to_the_last_pixel():
    samples = synthetic(3, x=[0.0, 19.999, 20.0], y=[0.0, 13.5, 14.0])
    np.testing.assert_array_equal(samples.pixel(), [0, 13 * 20 + 19, 13 * 20 + 19])


def test_the_window_is_the_crop_window_unless_told():
    camera = overscanned(1).camera
    assert synthetic(5, camera=camera).window == (2, 3, 20, 14)
    window = synthetic(5, window=np.array([-3, -2, 26, 18])).window
    assert window == (-3, -2, 26, 18)
    assert all(type(number) is int for number in window)
    assert synthetic(5, window=(-3, -2, 26, 18)).replace(window=None).window == (0, 0, 20, 14)


@pytest.mark.parametrize(
    ("window", "error", "text"),
    [
        ((0, 0, 0, 14), ValueError, r"window\[2\]=0"),
        ((0, 0, 20, -1), ValueError, r"window\[3\]=-1"),
        ((0, -(1 << 25), 20, 14), ValueError, r"window\[1\]="),
        ((0, 0, 20), ValueError, r"window=\(0, 0, 20\): must be left, top, width and height"),
        ((0.0, 0, 20, 14), TypeError, r"window\[0\]=0.0: must be a whole number"),
        ((0, True, 20, 14), TypeError, r"window\[1\]=True"),
        ("crop", TypeError, r"window\[0\]='c'"),
        (20, TypeError, "window=20: must be left"),
    ],
)
def test_a_bad_window_is_named(window, error, text):
    with pytest.raises(error, match=text):
        synthetic(5, window=window)


def test_pixels_are_counted_in_the_window():
    samples = synthetic(
        5, window=(-3, -2, 26, 18), x=[-3, -1e-9, 0, 22.5, 40], y=[-2, -0.5, 0, 15.5, 40]
    )
    np.testing.assert_array_equal(
        samples.pixel(), [0, 26 + 2, 2 * 26 + 3, 17 * 26 + 25, 17 * 26 + 25]
    )


def test_samples_are_described_in_a_line():
    text = repr(synthetic(5))
    assert text.startswith("PointSamples(5 in 20x14 pixels, z = ")
    assert "['one', 'two', 'three']" in text


# ---------------------------------------------------------------- layers


def test_samples_are_visible_unless_told():
    samples = synthetic(5)
    assert samples.layer.dtype == np.uint8
    np.testing.assert_array_equal(samples.layer, 0)
    assert samples.visible() is samples


def test_what_is_visible_is_layer_0():
    samples = overscanned(300)
    visible = samples.visible()
    first = samples.layer == 0
    assert 0 < len(visible) == first.sum() < 300
    assert visible.window == samples.window
    np.testing.assert_array_equal(visible.rgb, samples.rgb[first])
    np.testing.assert_array_equal(visible.layer, 0)


def test_layers_follow_their_samples():
    samples = overscanned(300)
    assert samples.replace(lens=samples.lens.replace(f_number=8.0)).layer is samples.layer
    rgb = samples.rgb.copy()
    rgb[[3, 50]] = np.nan
    with pytest.warns(RuntimeWarning, match="dropped 2 of 300"):
        fewer = samples.replace(rgb=rgb)
    np.testing.assert_array_equal(fewer.layer, np.delete(samples.layer, [3, 50]))
    with pytest.raises(ValueError, match=r"layer: has shape \(300,\), must have \(5,\)"):
        synthetic(5, layer=samples.layer)


# ---------------------------------------------------------------- merging


def test_merging_keeps_the_light_of_every_pixel():
    samples = synthetic(20_000)
    merged = samples.merge(tolerance=3.0)
    assert len(merged) < len(samples) / 2
    np.testing.assert_allclose(pinhole_mean(merged), pinhole_mean(samples), atol=1e-5)
    assert merged.weight.sum() == pytest.approx(samples.weight.sum(), rel=1e-5)


def test_merging_joins_only_what_the_rule_allows():
    here = {"x": [1.1, 1.2, 1.7, 1.1], "y": [1.1] * 4, "z": [2.0, 2.0001, 2.0, 2.0]}
    surface = [1, 1, 1, 2]
    samples = synthetic(4, **here, surface=surface, weight=[1, 3, 1, 1])
    merged = samples.merge()
    assert len(merged) == 3
    joined = merged.weight == 4
    assert merged.x[joined] == pytest.approx(1.175)
    assert 1 / merged.z[joined] == pytest.approx((1 / 2.0 + 3 / 2.0001) / 4)
    np.testing.assert_allclose(
        merged.rgb[joined][0], (samples.rgb[0] + 3 * samples.rgb[1]) / 4, rtol=1e-6
    )


def test_merging_keeps_layers_apart():
    here = {"x": [-0.9] * 4, "y": [1.1] * 4, "z": [2.0] * 4, "surface": [1] * 4}
    samples = synthetic(4, **here, layer=[0, 1, 2, 1], weight=[1, 1, 1, 3], window=(-2, 0, 22, 14))
    merged = samples.merge()
    np.testing.assert_array_equal(np.sort(merged.layer), [0, 1, 2])
    assert merged.weight[merged.layer == 1] == 4
    np.testing.assert_allclose(
        merged.rgb[merged.layer == 1][0], (samples.rgb[1] + 3 * samples.rgb[3]) / 4, rtol=1e-6
    )
    assert merged.window == samples.window


def test_merging_keeps_the_light_of_every_layer_and_pixel_of_the_window():
    samples = overscanned(30_000).replace(alpha=np.ones(30_000))
    merged = samples.merge(tolerance=3.0)
    assert len(merged) < 0.8 * len(samples)
    for layer in range(3):
        one, other = (
            s.replace(layer=np.where(s.layer == layer, 0, 1)).visible() for s in (samples, merged)
        )
        np.testing.assert_allclose(
            pinhole_mean(other, whole=True), pinhole_mean(one, whole=True), atol=1e-5
        )
        assert other.weight.sum() == pytest.approx(one.weight.sum(), rel=1e-5)


def test_merging_by_a_finer_step_changes_the_picture_less():
    samples = pm.render_samples(papers_scene(64), spp=64, sampling=pm.Sampling(refine=0))
    # Nothing is nearly in focus: small circles show where in its quarter of a pixel light was.
    lens = samples.lens.replace(f_number=0.7, focus_distance=200)
    # What is merged no longer tells that the samples were many, for which layered looks closer.
    method = pm.Layered(lens_points=32, squares=1)
    image = np.array(pm.focus(samples, lens, method=method))
    errors, counts = [], []
    for tolerance in (4.0, 0.1):
        merged = samples.merge(lens, tolerance)
        counts.append(len(merged))
        of_merged = np.array(pm.focus(merged, lens, method=method))
        errors.append(np.sqrt(np.mean((of_merged - image) ** 2)))
    assert counts[0] < counts[1] < len(samples) / 4
    assert errors[1] < 2e-4
    assert errors[1] < errors[0] / 2


def test_samples_on_a_lattice_are_not_merged():
    samples = synthetic(50, lattice=2)
    assert samples.merge() is samples


def test_a_bad_tolerance_is_named():
    for tolerance in (0, -1, np.inf, np.nan):
        with pytest.raises(ValueError, match=f"tolerance={tolerance}"):
            synthetic(5).merge(tolerance=tolerance)
    with pytest.raises(ValueError, match="lattice=-1"):
        synthetic(5, lattice=-1)


# ---------------------------------------------------------------- columns


def test_bytes_of_samples_are_counted():
    assert synthetic(100).nbytes == 100 * (8 * 4 + 4 + 1)


def test_columns_are_taken_as_they_are_and_joined_in_order():
    rng = np.random.default_rng(4)
    samples = synthetic(100).replace(
        through=rng.random(100),
        visibility=rng.integers(0, 2**64, 100, np.uint64),
        visibility_radius=(0.1, 0.1),
        albedo=rng.random((100, 3)),
        normal=rng.random((100, 3)) / 2,
        time=rng.random(100),
        motion=rng.random((100, 3)),
    )
    columns = {f.name: getattr(samples, f.name) for f in COLUMNS}
    whole = Columns(**columns)
    assert whole.rgb is samples.rgb
    first, second = (whole.chosen(slice(*ends)) for ends in ((0, 30), (30, 100)))
    joined = Columns.joined([first, second])
    for field in COLUMNS:
        np.testing.assert_array_equal(getattr(joined, field.name), columns[field.name])
        assert getattr(joined, field.name).dtype == field.metadata["dtype"]


def test_columns_that_some_parts_do_without_are_zeros_there():
    plain = synthetic(5)
    seen = plain.replace(through=np.full(5, 2.0))
    joined = Columns.joined([Columns(**own(seen)), Columns(**own(plain))])
    np.testing.assert_array_equal(joined.through, [2.0] * 5 + [0.0] * 5)
    assert joined.visibility is None


def own(samples):
    """The columns of samples, by their names."""
    return {f.name: getattr(samples, f.name) for f in COLUMNS}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"visibility": np.ones(5, np.uint64)}, "visibility_radius=None: must be the half-widths"),
        ({"visibility_radius": (1.0, 1.0)}, r"visibility_radius=\(1.0, 1.0\): must be .* None"),
        (
            {"visibility": np.ones(5, np.uint64), "visibility_radius": (1.0, 0.0)},
            r"visibility_radius=\(1.0, 0.0\): must be two numbers > 0",
        ),
        (
            {"visibility": np.ones(5, np.uint64), "visibility_radius": 0.5},
            "visibility_radius=0.5: must be two numbers > 0",
        ),
        ({"through": np.ones(4)}, r"through: has shape \(4,\), must have \(5,\)"),
    ],
)
def test_what_is_said_of_windows_fits_together(fields, message):
    with pytest.raises(ValueError, match=message):
        synthetic(5).replace(**fields)


@pytest.mark.parametrize("through", [np.nan, np.inf, -1.0])
def test_samples_that_are_seen_through_nothing_possible_are_dropped(through):
    depths = np.array([0.0, 1.0, through, 1.0, 0.0])
    with pytest.warns(RuntimeWarning, match="dropped 1 of 5 .* through not finite or < 0"):
        samples = synthetic(5).replace(through=depths)
    np.testing.assert_array_equal(samples.through, [0, 1, 1, 0])


def test_points_of_the_lens_are_those_of_a_round_aperture_as_the_picture_has_them():
    samples = synthetic(5).replace(visibility=np.ones(5, np.uint64), visibility_radius=(0.5, 0.25))
    points = samples.visibility_points
    np.testing.assert_allclose(points[0], -lens_points(64)[0] * (0.5, 0.25))
    assert (points**2 / np.array([0.25, 0.0625])).sum(axis=1).max() < 1
    with pytest.raises(ValueError, match="have no visibility"):
        synthetic(5).visibility_points  # noqa: B018


def test_an_unknown_field_is_refused():
    with pytest.raises(TypeError, match="colour"):
        synthetic(5).replace(colour=1)


# ---------------------------------------------------------------- crops


def two_planes(count=30_000, *, size=(64, 48), margin=12, **fields):
    """A plane at 2 and one at 5 units, each with hidden parts, everywhere in the window.

    Wherever one crops, the nearest and the farthest depth are the same.
    """
    rng = np.random.default_rng(3)
    width, height = size
    window = Window(0, 0, width, height).grown(margin)
    near = rng.integers(0, 2, count).astype(bool)
    return synthetic(
        count,
        size=size,
        window=window,
        x=rng.uniform(window.left, window.right, count),
        y=rng.uniform(window.top, window.bottom, count),
        z=np.where(near, 2.0, 5.0),
        surface=np.where(near, 1, 2),
        layer=np.where(near, 0, rng.integers(0, 2, count)),
        lens=pm.ThinLens(50.0, 0.15, 3.0, millimeters_per_unit=1000.0),
        **fields,
    )


@pytest.mark.parametrize(
    "window", [(20, 14, 16, 12), (0, 0, 9, 48), (40, 30, 24, 18), (0, 0, 64, 48)]
)
@pytest.mark.parametrize("squares", [1, 2])
@pytest.mark.parametrize("method", ["layered", "lightfield"])
def test_a_crop_with_a_halo_is_focused_like_the_whole(window, squares, method):
    """The circles' radii are 2.5 and 2 pixels; the halo is farther than light and shadow reach.

    The same light is added up in the same order, but the transforms and sums of single precision
    are of other lengths. In a picture with values up to 1 that made 4e-7; 2e-6 is 17 units in
    the last place.
    """
    samples, window = two_planes(), Window(*window)
    options = {"method": method, "squares": squares}
    whole = np.array(pm.focus(samples, **options))[window.slices_in(samples.crop_window)]
    crop = samples.crop(window, halo=12)
    assert crop.crop_window == window
    assert crop.window == window.grown(12).intersection(samples.window)
    part = np.array(pm.focus(crop, **options))
    assert part.shape == whole.shape
    np.testing.assert_allclose(part, whole, rtol=0, atol=2e-6)
    assert len(crop) < len(samples) or window == samples.crop_window


def test_without_a_halo_what_is_outside_is_not_missed_in_focus():
    """Through a pinhole the crop alone is the picture of the crop.

    A pixel without samples shows its neighbours, which may be outside. Threads add the same light
    up in a changing order: 4 units in the last place of 1.
    """
    samples, window = two_planes(), Window(10, 8, 20, 16)
    pinhole = samples.lens.replace(f_number=np.inf)
    whole = np.array(pm.focus(samples, pinhole))[window.slices_in(samples.crop_window)]
    crop = samples.crop(window)
    part = np.array(pm.focus(crop, pinhole))
    seen = crop.visible()
    sampled = np.bincount(window.pixel_of(seen.x, seen.y), minlength=window.size) > 0
    sampled = sampled.reshape(window.shape)
    assert sampled.mean() > 0.9
    rounding = 4 * np.finfo(np.float32).eps
    np.testing.assert_allclose(part[sampled], whole[sampled], rtol=0, atol=rounding)


@pytest.mark.parametrize("pattern", ["uniform", "adaptive"])
def test_a_crop_of_samples_on_a_lattice_has_the_corners_of_its_pixels(pattern):
    samples = pm.render_samples(papers_scene(32), spp=1, sampling=pm.Sampling(pattern))
    window = Window(8, 8, 12, 10)
    pinhole = samples.lens.replace(f_number=np.inf)
    crop = samples.crop(window)
    for edge, at in ((window.left, crop.x), (window.right, crop.x), (window.bottom, crop.y)):
        assert (at == edge).any()
    whole = np.array(pm.focus(samples, pinhole))[window.slices_in(samples.crop_window)]
    np.testing.assert_allclose(np.array(pm.focus(crop, pinhole)), whole, rtol=0, atol=1e-6)


def test_a_crop_has_the_samples_of_its_pixels_and_of_the_halo():
    samples = overscanned(5000)
    window = Window(2, 3, 20, 14)
    assert samples.crop_window == window
    same = samples.crop(window, halo=5)
    assert same.window == samples.window
    np.testing.assert_array_equal(same.x, samples.x)
    inner = samples.crop(Window(4, 6, 3, 2), halo=1)
    assert inner.window == (3, 5, 5, 4)
    assert inner.window.contains(inner.x, inner.y).all()
    assert (
        len(inner) == samples.window.intersection(inner.window).contains(samples.x, samples.y).sum()
    )
    assert inner.surfaces is samples.surfaces
    assert inner.lens is samples.lens


def test_tiles_together_are_the_pinhole_picture():
    samples = overscanned(20_000)
    picture = np.full((*samples.crop_window.shape, 3), np.nan)
    for tile in samples.crop_window.tiles(6):
        picture[tile.slices_in(samples.crop_window)] = pinhole_mean(samples.crop(tile))
    np.testing.assert_array_equal(picture, pinhole_mean(samples))


@pytest.mark.parametrize(
    ("window", "halo", "error", "text"),
    [
        ((0, 3, 20, 14), 0, ValueError, r"window=\(0, 3, 20, 14\): must lie in the crop window"),
        ((2, 3, 20, 15), 0, ValueError, "must lie in the crop window"),
        ((2, 3, 0, 15), 0, ValueError, r"window\[2\]=0"),
        ((2, 3, 2.5, 15), 0, TypeError, r"window\[2\]=2.5"),
        ((2, 3, 4, 4), -1, ValueError, "halo=-1"),
        ((2, 3, 4, 4), 1.0, TypeError, "halo=1.0"),
    ],
)
def test_a_bad_crop_is_named(window, halo, error, text):
    with pytest.raises(error, match=text):
        overscanned(500).crop(window, halo)


def test_a_crop_without_samples_is_refused():
    with pytest.raises(ValueError, match=r"window=\(0, 0, 2, 2\), halo=0: there are no samples"):
        synthetic(2, x=[9.5, 9.5], y=[9.5, 9.5]).crop(Window(0, 0, 2, 2))


@pytest.mark.parametrize("enough", [100, 10**6])
def test_shares_of_a_ray_are_one_of_the_samples_a_pixel(monkeypatch, enough):
    monkeypatch.setattr(counting, "ENOUGH_TO_COUNT", enough)
    samples = synthetic(20 * 14 * 5)
    pixel = np.repeat(np.arange(20 * 14), 5)
    rng = np.random.default_rng(0)
    x, y = (of + rng.uniform(0.1, 0.9, len(pixel)) for of in (pixel % 20, pixel // 20))
    once = samples.replace(x=x, y=y, layer=np.zeros(len(x), np.uint8), weight=np.full(len(x), 0.2))
    assert once.spp == 5
    # All have two shares.
    part = rng.uniform(0.1, 0.9, len(x))
    twice = {name: np.repeat(getattr(once, name), 2, axis=0) for name in ("x", "y", "rgb", "z")}
    twice |= {name: np.repeat(getattr(once, name), 2) for name in ("alpha", "surface", "layer")}
    both = once.replace(**twice, weight=0.2 * np.stack([part, 1 - part], axis=1).ravel())
    assert both.spp == 5


def test_as_many_lens_points_see_a_sample_as_bits_are_set():
    visibility = np.array([0, 1, 2**63, 2**64 - 1, 2**64 - 2, 0b1011 << 30], np.uint64)
    np.testing.assert_array_equal(points_that_see(visibility), [0, 1, 1, 64, 63, 3])
    assert len(points_that_see(visibility[:0])) == 0
