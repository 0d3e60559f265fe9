import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing import visibility as visibility_module
from potmesil_mi.focusing.density import evened
from potmesil_mi.focusing.gathering import gather
from potmesil_mi.focusing.highlight_visibility import Jitter, visibility_of_highlights
from potmesil_mi.focusing.visibility import visibility
from potmesil_mi.optics.disc import lens_points
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = 60, 44
EDGE = 30


def planes(*masks_and_depths, size=SIZE):
    """Samples of planes, each where its mask (x, y) is, from the nearest to the farthest.

    One in each pixel of each plane, in layers as the pinhole sees them.
    """
    x, y = (axis.ravel() + 0.5 for axis in np.meshgrid(np.arange(size[0]), np.arange(size[1])))
    before = np.zeros(len(x), dtype=np.uint8)
    columns = {name: [] for name in ("x", "y", "z", "layer")}
    for mask, z in masks_and_depths:
        there = mask(x, y)
        for name, values in (("x", x), ("y", y), ("z", np.full(len(x), z)), ("layer", before)):
            columns[name].append(values[there])
        before = before + there.astype(np.uint8)
    columns = {name: np.concatenate(values) for name, values in columns.items()}
    count = len(columns["x"])
    return synthetic(count, size=size, weight=np.ones(count), **columns)


def everywhere(x, y):
    return np.ones(len(x), dtype=bool)


def left(x, y):
    return x < EDGE


@pytest.fixture
def half_plane():
    """A near half plane before a far plane, the whole of which is known."""
    return planes((left, 1.0), (everywhere, 4.0))


def analytic(fragments, points, parallax):
    """Whether points see fragments behind the half plane, and how far the edge is from the way."""
    x = fragments.x[:, None] + 0.5 - parallax * points[:, 0]
    y = fragments.y[:, None] + 0.5 - parallax * points[:, 1]
    inside = (x > 1) & (y > 1) & (x < fragments.width - 1) & (y < fragments.height - 1)
    return x > EDGE, np.abs(x - EDGE), inside


# ---------------------------------------------------------------- points on the lens


@pytest.mark.parametrize("count", [8, 32, 128, 512])
def test_points_on_the_lens_are_spread_like_a_disc(count):
    points = lens_points(count)
    assert points.shape == (count, 2)
    assert (np.hypot(*points.T) < 1).all()
    tolerance = 0.02 if count >= 128 else 0.04 if count >= 32 else 0.1
    np.testing.assert_allclose((points**2).mean(axis=0), 0.25, atol=tolerance / 2)
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=2 / count)
    assert (points**2).sum(axis=1).mean() == pytest.approx(0.5)


def test_turned_points_are_spread_like_a_disc_too():
    fragments = gather(planes((everywhere, 2.0)), 1, 1.0)
    points = lens_points(16)
    jitter = Jitter(fragments)
    lane = np.arange(len(fragments) * 16)
    u, v = jitter.moved(
        *(mi.Float(np.tile(column, len(fragments)).astype(np.float32)) for column in points.T),
        mi.UInt32(lane % 16),
        mi.UInt32(lane // 16),
    )
    u, v = np.array(u).reshape(-1, 16), np.array(v).reshape(-1, 16)
    assert np.hypot(u, v).max() <= 1 + 1e-6
    np.testing.assert_allclose([np.mean(u**2), np.mean(v**2)], 0.25, atol=0.005)
    np.testing.assert_allclose([np.mean(u), np.mean(v)], 0, atol=0.005)
    assert len(np.unique(u[:, 0])) > 0.9 * len(fragments), "each fragment has its own"


# ---------------------------------------------------------------- what points see


def test_veils_let_through_their_parts_one_after_the_other_and_nothing_past_their_edges():
    """Two veils, the nearer in the left half: of each what the pinhole sees, and what it hides."""
    x, y = (axis.ravel() + 0.5 for axis in np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])))
    before = np.where(left(x, y), 0.4, 1.0)
    parts = [(1.0, 1 - before, 0), (2.0, 0.5 * before, 0), (2.0, 0.5 * (1 - before), 1)]
    parts += [(4.0, 0.5 * before, 0), (4.0, 1 - 0.5 * before, 1)]
    columns = [
        (x[w > 0], y[w > 0], np.full((w > 0).sum(), z), w[w > 0], np.full((w > 0).sum(), layer))
        for z, w, layer in parts
    ]
    x, y, z, weight, layer = (np.concatenate(column) for column in zip(*columns, strict=True))
    samples = synthetic(len(x), size=SIZE, x=x, y=y, z=z, weight=weight, layer=layer)
    scale = 8.0
    fragments, points = gather(samples, 1, scale), lens_points(32)
    coverable, seen = visibility(fragments, scale, points)
    behind = fragments.chosen(coverable)
    for z, veils in ((2.0, [1.0]), (4.0, [1.0, 2.0])):
        these = np.isclose(behind.vergence, 1 / z)
        parallaxes = [scale * (1 / veil - 1 / z) for veil in veils]
        sees, from_edge, inside = analytic(behind, points, parallaxes[0])
        for parallax in parallaxes[1:]:
            inside &= analytic(behind, points, parallax)[2]
        expected = np.where(sees, 1, 0.4) * (0.5 if z == 4 else 1)
        clear = these[:, None] & inside & (from_edge > 1)
        assert clear.sum() > 1000
        np.testing.assert_allclose(seen[clear] / 255, expected[clear], atol=3e-3)


@pytest.mark.parametrize("parallax", [2.0, 5.0, 11.0])
def test_behind_a_half_plane_points_see_what_geometry_lets_them(half_plane, parallax):
    scale = parallax / (1 - 1 / 4)
    fragments = gather(half_plane, 1, scale)
    points = lens_points(64)
    coverable, seen = visibility(fragments, scale, points)
    behind = fragments.chosen(coverable)
    np.testing.assert_allclose(behind.vergence, 1 / 4)
    expected, from_edge, inside = analytic(behind, points, parallax)
    clear = inside & (from_edge > 1)
    np.testing.assert_array_equal(seen[clear], np.where(expected, 255, 0)[clear])
    # On the whole the edge is where it should be, to a small part of a square.
    shift = (seen[inside] / 255 - expected[inside]).sum() / (from_edge[inside] < 0.5).sum()
    assert abs(shift) < 0.2
    # What is too far from the edge to be covered is not asked for.
    assert not coverable[
        (fragments.vergence < 0.5) & (fragments.x > EDGE + 1.5 * parallax + 4)
    ].any()


def slanted(stretch, direction, per_side, seed=0):
    """A slanted plane before a far one, ``per_side``² samples a pixel, and its parallax scale.

    Along ``direction`` its parallax grows by ``stretch`` pixels a pixel.
    """
    rng = np.random.default_rng(seed)
    width, height = SIZE
    y, x = np.mgrid[: height * per_side, : width * per_side]
    x, y = ((axis + rng.uniform(0, 1, axis.shape)).ravel() / per_side for axis in (x, y))
    along = direction[0] * x + direction[1] * y
    span = along.max() - along.min()
    vergence = 0.25 + 0.75 * (along - along.min()) / span
    count = len(x)
    samples = synthetic(
        2 * count,
        size=SIZE,
        x=np.tile(np.minimum(x, width - 1e-4), 2),
        y=np.tile(np.minimum(y, height - 1e-4), 2),
        z=np.concatenate([1 / vergence, np.full(count, 8.0)]),
        weight=np.full(2 * count, per_side**-2.0),
        layer=np.repeat([0, 1], count),
    )
    return samples, stretch * span / 0.75


@pytest.mark.parametrize("direction", [(0, 1), (1, 0), (0.7, 0.7), (0.3, -0.95)])
@pytest.mark.parametrize("stretch", [0.05, 0.1, 0.2])
@pytest.mark.parametrize(("per_side", "subpixels"), [(4, 1), (4, 2), (2, 1)])
def test_nothing_shines_through_a_slanted_plane(direction, stretch, per_side, subpixels):
    samples, scale = slanted(stretch, direction, per_side)
    fragments = gather(samples, subpixels, scale * subpixels)
    coverable, seen = visibility(fragments, scale * subpixels, lens_points(32))
    behind = fragments.chosen(coverable)
    margin = subpixels * min(math.ceil(scale), min(SIZE) // 2 - 2)
    inside = behind.vergence < 0.13
    inside &= (behind.x >= margin) & (behind.x < behind.width - margin)
    inside &= (behind.y >= margin) & (behind.y < behind.height - margin)
    assert inside.any()
    assert seen[inside].mean() / 255 < 1e-3
    assert seen[inside].mean(axis=1).max() / 255 < 0.05


def test_where_chance_puts_no_sample_in_a_square_nothing_shines_through():
    rng = np.random.default_rng(1)
    count = 4 * SIZE[0] * SIZE[1]
    samples = synthetic(
        2 * count,
        size=SIZE,
        x=np.tile(rng.uniform(0, SIZE[0], count), 2),
        y=np.tile(rng.uniform(0, SIZE[1], count), 2),
        z=np.repeat([1.0, 8.0], count),
        weight=np.full(2 * count, 0.25),
        layer=np.repeat([0, 1], count),
    )
    scale = 6.0 * 8 / 7
    # A third of the squares is empty.
    fragments = evened(gather(samples, 2, 2 * scale), 2).fragments
    coverable, seen = visibility(fragments, 2 * scale, lens_points(32))
    behind = fragments.chosen(coverable)
    inside = (behind.vergence < 0.5) & (np.abs(behind.x - SIZE[0]) < SIZE[0] - 16)
    inside &= np.abs(behind.y - SIZE[1]) < SIZE[1] - 16
    assert inside.any()
    assert not seen[inside].any()


def test_nothing_hides_what_is_nearest(half_plane):
    fragments = gather(half_plane, 1, 10.0)
    coverable, _ = visibility(fragments, 10.0, lens_points(16))
    assert not coverable[fragments.vergence > 0.5].any()


def test_the_order_of_the_lens_points_is_that_of_the_columns(half_plane):
    fragments = gather(half_plane, 1, 10.0)
    points = lens_points(16)
    coverable, seen = visibility(fragments, 10.0, points)
    order = np.random.default_rng(0).permutation(16)
    again = visibility(fragments, 10.0, points[order])
    np.testing.assert_array_equal(again[0], coverable)
    np.testing.assert_array_equal(again[1], seen[:, order])


def test_few_points_at_a_time_see_the_same(half_plane, monkeypatch):
    fragments = gather(half_plane, 1, 10.0)
    points = lens_points(16)
    _, seen = visibility(fragments, 10.0, points)
    monkeypatch.setattr(visibility_module, "MAX_COVERED", 3 * 80 * 60)
    np.testing.assert_array_equal(visibility(fragments, 10.0, points)[1], seen)


def test_a_flat_picture_covers_nothing_of_itself():
    fragments = gather(planes((everywhere, 2.0)), 1, 100.0)
    coverable, seen = visibility(fragments, 100.0, lens_points(16))
    assert not coverable.any()
    assert seen.shape == (0, 16)


@pytest.mark.parametrize(("slope", "least"), [(0.2, 1.0), (1 / 3, 0.95)])
def test_a_slanted_surface_does_not_cover_itself(slope, least):
    flat = planes((everywhere, 2.0))
    # From pixel to pixel the circle's radius changes by so much.
    vergence = 0.25 + slope * flat.x / 40
    fragments = gather(flat.replace(z=1 / vergence), 1, 40.0)
    coverable, seen = visibility(fragments, 40.0, lens_points(32))
    share = np.ones((len(fragments), 32))
    share[coverable] = seen / 255
    assert share.mean() >= least


def test_half_transparent_edges_let_half_through():
    mask = planes((left, 1.0), (everywhere, 4.0))
    near = mask.z == 1
    both = near | (mask.layer > 0)
    half = mask.replace(weight=np.where(both, 0.5, 1.0), layer=np.zeros(len(mask)))
    fragments = gather(half, 1, 10.0)
    coverable, seen = visibility(fragments, 10.0, lens_points(64))
    values = seen[fragments.chosen(coverable).x > 8]
    # A point's ways are a square apart, or two ways meet in one.
    assert np.isin(values, (0, 127, 128, 255)).all()
    assert np.isin(values, (127, 128)).mean() > 0.3


def test_a_third_plane_is_covered_by_both_before_it():
    def right(x, y):
        return x > EDGE

    samples = planes((left, 1.0), (right, 2.0), (everywhere, 4.0))
    scale = 12.0
    fragments = gather(samples, 1, scale)
    points = lens_points(64)
    coverable, seen = visibility(fragments, scale, points)
    behind = fragments.chosen(coverable)
    far = behind.vergence < 0.3
    # Between the nearer ones a gap opens to the points on one side.
    x = behind.x[far][:, None] + 0.5
    past_first = x - scale * 0.75 * points[:, 0]
    past_second = x - scale * 0.25 * points[:, 0]
    free = (past_first > EDGE) & (past_second < EDGE)
    sure = (np.abs(past_first - EDGE) > 1) & (np.abs(past_second - EDGE) > 1)
    inner = (np.abs(behind.x[far] - EDGE) < 12) & (np.abs(behind.y[far] - 22) < 10)
    sure &= inner[:, None]
    assert free[sure].sum() > 100
    np.testing.assert_array_equal(seen[far][sure], np.where(free, 255, 0)[sure])


def test_what_is_close_behind_the_first_surface_is_seen_from_nowhere():
    close = 1 / (1 / 2 - 0.3 * 1 / 10)
    samples = planes((left, 2.0), (everywhere, close))
    fragments = gather(samples, 1, 10.0)
    coverable, seen = visibility(fragments, 10.0, lens_points(16))
    hidden = fragments.gap_in_front[coverable] > 0
    assert hidden.sum() == EDGE * SIZE[1]
    assert not seen[hidden].any()


# ---------------------------------------------------------------- ways followed one by one


def as_they_are(self, u, v, point, fragment):
    return u, v


@pytest.mark.parametrize("parallax", [3.0, 11.0])
def test_both_ways_to_find_visibility_agree(half_plane, parallax, monkeypatch):
    monkeypatch.setattr(Jitter, "moved", as_they_are)
    scale = parallax / (1 - 1 / 4)
    fragments = gather(half_plane, 1, scale)
    points = lens_points(64)
    coverable, seen = visibility(fragments, scale, points)
    highlights = fragments.chosen(coverable)
    also = visibility_of_highlights(fragments, highlights, scale, points)
    assert also.shape == seen.shape
    expected, from_edge, inside = analytic(highlights, points, parallax)
    clear = inside & (from_edge > 1.5)
    np.testing.assert_array_equal(also[clear], np.where(expected, 255, 0)[clear])
    assert np.mean(also[inside] != seen[inside]) < 0.04
    assert abs(also[inside].mean() - seen[inside].mean()) < 3


def test_few_fragments_are_seen_as_by_points_of_their_own(half_plane):
    scale, parallax = 40 / 3, 10.0
    fragments = gather(half_plane, 1, scale)
    highlights = fragments.chosen((fragments.vergence < 0.5) & (np.abs(fragments.x - EDGE) < 12))
    seen = visibility_of_highlights(fragments, highlights, scale, lens_points(256))
    # The part of the lens that sees past the edge: that of a disc beyond a chord.
    t = np.clip((highlights.x + 0.5 - EDGE) / parallax, -1, 1)
    expected = (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi + 0.5
    inner = (highlights.y > 12) & (highlights.y < SIZE[1] - 12)
    difference = seen.mean(axis=1)[inner] / 255 - expected[inner]
    assert np.abs(difference).max() < 0.05
    assert np.abs(difference).mean() < 0.02


def test_of_no_fragments_nothing_is_asked(half_plane):
    fragments = gather(half_plane, 1, 10.0)
    none = fragments.chosen(np.zeros(len(fragments), dtype=bool))
    assert visibility_of_highlights(fragments, none, 10.0, lens_points(16)).shape == (0, 16)


def test_the_pinhole_of_a_closed_lens_sees_what_the_samples_show():
    samples = planes((left, 1.0), (everywhere, 4.0))
    colours = np.where(samples.z[:, None] == 1, [1.0, 0, 0], [0, 1.0, 0])
    image = np.array(pm.focus(samples.replace(rgb=colours), samples.lens.replace(f_number=np.inf)))
    np.testing.assert_array_equal(image[:, :EDGE], np.broadcast_to([1, 0, 0], (44, EDGE, 3)))
    np.testing.assert_array_equal(image[:, EDGE:], np.broadcast_to([0, 1, 0], (44, 60 - EDGE, 3)))


def test_covered_subpixels_are_not_copied_at_every_step():
    """Dr.Jit copies an array to which something still refers before it is added to."""
    steps = [(lambda x, y, end=EDGE - n: x < end, 1 + 0.1 * n) for n in range(20)]
    fragments = gather(planes(*steps, (everywhere, 4.0)), 1, 20.0)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        visibility(fragments, 20.0, lens_points(16))
        kernels = dr.kernel_history()
    copied = [each["size"] for each in kernels if each["type"] == dr.KernelType.Memcpy]
    assert sum(each["type"] == dr.KernelType.JIT for each in kernels) > 20
    assert sum(copied) < 16 * fragments.width * fragments.height


def test_what_leaves_a_bounded_frame_is_seen_and_covers_nothing(monkeypatch):
    """Of the fragments in the frame, all see the same as in one that is large enough."""
    fragments = gather(planes((lambda x, y: x < EDGE, 0.1), (everywhere, 4.0)), 1, 20.0)
    points = lens_points(16)
    coverable, wide = visibility(fragments, 20.0, points)
    size = max(fragments.width, fragments.height)
    monkeypatch.setattr("potmesil_mi.focusing.visibility.MAX_COVERED", size**2)
    bounded_too, narrow = visibility(fragments, 20.0, points)
    np.testing.assert_array_equal(bounded_too, coverable)
    assert 0 < narrow.mean() < 255
    np.testing.assert_array_equal(narrow, wide)
