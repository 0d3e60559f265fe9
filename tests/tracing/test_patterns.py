"""Where the film is sampled: the patterns on their own, and what they give of a scene."""

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.samples.raster import Window
from potmesil_mi.tracing.buffers import Shown
from potmesil_mi.tracing.patterns import FINE, papers_grid, sampler_cells, subdivided
from scenes import papers_scene, pinhole_mean, still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")

PRIMARY = {"layers": 1, "overscan": 0}
"""Sampling of what the pinhole sees of the film, and no more."""


# ---------------------------------------------------------------- without a scene


def showing(grey, asked=None):
    """Rays that show ``grey(ix, iy)``; in ``asked`` are the points that were asked for."""

    def show(ix, iy):
        if asked is not None:
            asked.extend(zip(ix.tolist(), iy.tolist(), strict=True))
        values = np.broadcast_to(grey(ix, iy), ix.shape).astype(np.float32)
        ones = np.ones(len(ix), dtype=np.float32)
        return Shown(np.repeat(values[:, None], 3, axis=1), ones, ones, ones.astype(np.uint32))

    return show


def rectangles(cells):
    return list(zip(cells.left, cells.top, cells.width, cells.height, strict=True))


def test_the_pixels_of_the_crop_window_come_first_and_each_pixel_once():
    crop, window = Window(3, 2, 4, 3), Window(1, 1, 8, 6)
    inside, beyond = sampler_cells(crop, window)
    np.testing.assert_array_equal((inside.left, inside.top), crop.pixels())
    assert (inside.area == 1).all()
    every = [rectangle[:2] for part in (inside, beyond) for rectangle in rectangles(part)]
    assert sorted(every) == sorted(zip(*window.pixels(), strict=True))
    assert not crop.contains(beyond.left, beyond.top).any()


def test_without_overscan_there_is_one_part_of_pixels():
    crop = Window(3, 2, 4, 3)
    assert len(sampler_cells(crop, crop)) == 1


@pytest.mark.parametrize("window", [Window(-300, 2, 330, 7), Window(-37, -120, 100, 501)])
def test_cells_cover_the_window_once_and_are_small_beside_their_distance(window):
    crop = Window(3, 2, 7, 5)
    covered = np.zeros(window.shape, dtype=int)
    for cells in sampler_cells(crop, window):
        for left, top, width, height in rectangles(cells):
            place = Window(left, top, width, height)
            covered[place.slices_in(window)] += 1
            apart = max(
                crop.left - place.right,
                place.left - crop.right,
                crop.top - place.bottom,
                place.top - crop.bottom,
                0,
            )
            assert max(width, height) <= max(1, apart / FINE)
    assert (covered == 1).all()


def test_the_number_of_cells_hardly_grows_with_overscan():
    crop = Window(0, 0, 256, 256)
    counts = [sum(map(len, sampler_cells(crop, crop.grown(n)))) for n in (32, 256, 2048)]
    assert counts[0] == 320**2
    assert counts[1] < 2 * crop.size
    assert counts[2] < 2.5 * crop.size


def test_the_papers_grid_has_every_half_pixel_once():
    points = papers_grid(Window(5, 6, 3, 2), showing(lambda ix, iy: ix))
    assert len(points.ix) == 7 * 5
    assert set(zip(points.ix, points.iy, strict=True)) == {
        (i, j) for i in range(7) for j in range(5)
    }
    np.testing.assert_array_equal(points.shown.rgb[:, 0], points.ix)
    assert (points.weight == 0.25).all()


@pytest.mark.parametrize("subdivisions", [0, 1, 3])
def test_nothing_is_subdivided_where_all_is_the_same(subdivisions):
    window = Window(-2, 7, 4, 3)
    points = subdivided(window, showing(lambda ix, iy: 0.5), 0.0, subdivisions)
    side = 1 << subdivisions
    assert set(points.ix) == {i * side for i in range(5)}
    assert set(points.iy) == {j * side for j in range(4)}
    assert len(points.ix) == 5 * 4
    # Corners at the border stand for the mirror image beyond it, too.
    np.testing.assert_array_equal(points.weight, np.ones(20))


def test_subdivision_goes_to_the_edge_and_asks_for_no_point_twice():
    asked = []
    edge = showing(lambda ix, iy: ix >= 9, asked)
    points = subdivided(Window(0, 0, 4, 3), edge, 0.1, 2)
    assert len(set(asked)) == len(asked) == len(points.ix)
    assert sorted(asked) == sorted(zip(points.ix.tolist(), points.iy.tolist(), strict=True))
    # Pixels have four steps on a side; the edge lies in the third, between steps 8 and 9.
    assert set(points.ix) == {0, 4, 8, 9, 10, 12, 16}
    np.testing.assert_array_equal(points.shown.rgb[:, 0], points.ix >= 9)


@pytest.mark.parametrize("threshold", [0.0, 0.05, 0.4])
@pytest.mark.parametrize("subdivisions", [0, 1, 2, 3])
def test_weights_add_up_to_the_area_within_the_border(threshold, subdivisions):
    window, lattice = Window(0, 0, 5, 4), 1 << subdivisions
    wavy = showing(lambda ix, iy: 0.5 + 0.5 * np.sin(ix / lattice * 2) * np.cos(iy / lattice))
    points = subdivided(window, wavy, threshold, subdivisions)
    on_border = np.isin(points.ix, (0, 5 * lattice)).astype(int)
    on_border += np.isin(points.iy, (0, 4 * lattice))
    assert (points.weight / 2**on_border).sum() == pytest.approx(window.size, rel=1e-12)


def test_light_brighter_than_white_and_not_a_number_is_not_subdivided():
    for grey in (lambda ix, iy: 1 + ix, lambda ix, iy: np.nan, lambda ix, iy: -1.0 - iy):
        points = subdivided(Window(0, 0, 4, 3), showing(grey), 0.0, 2)
        assert len(points.ix) == 5 * 4


# ---------------------------------------------------------------- of a scene


@pytest.mark.parametrize("margin", [0, 3])
def test_the_papers_grid_has_corners_edges_and_centres(margin):
    sampling = pm.Sampling("uniform", layers=1, overscan=margin)
    samples = pm.render_samples(still_life(spp=1), sampling=sampling)
    columns, rows = 2 * (24 + 2 * margin) + 1, 2 * (16 + 2 * margin) + 1
    assert len(samples) == columns * rows
    assert set(np.unique(samples.x)) == set(np.arange(columns) / 2 - margin)
    assert set(np.unique(samples.y)) == set(np.arange(rows) / 2 - margin)
    assert (samples.weight == 0.25).all()


def test_many_paths_at_a_point_of_the_grid_are_averaged():
    scene = still_life(lamp={"type": "constant"})
    grid = pm.Sampling("uniform", **PRIMARY)
    spread = [pm.render_samples(scene, spp=spp, sampling=grid).rgb[:, 0].std() for spp in (1, 256)]
    few, many = (pm.render_samples(scene, spp=spp, sampling=grid) for spp in (1, 256))
    assert len(few) == len(many)
    np.testing.assert_array_equal(few.z, many.z)
    assert spread[1] < spread[0]


def test_adaptive_subdivision_goes_where_intensities_differ():
    scene = papers_scene(48, spp=1)
    sampling = pm.Sampling("adaptive", subdivisions=2, **PRIMARY)
    samples = pm.render_samples(scene, sampling=sampling)
    corners, all_points = 49 * 49, (4 * 48 + 1) ** 2
    assert corners < len(samples) < all_points / 3
    level = np.where((samples.x % 1 == 0) & (samples.y % 1 == 0), 0, 1)
    on_background = samples.surface == 1
    assert level[~on_background].mean() > level[on_background].mean()
    assert len(np.unique(np.stack([samples.x, samples.y]), axis=1).T) == len(samples)


@pytest.mark.parametrize(("threshold", "lattice"), [(0.0, 4), (2.0, 1)])
def test_the_threshold_decides_on_subdivision(threshold, lattice):
    scene = still_life(spp=4, lamp={"type": "constant"}, integrator={"type": "direct"})
    sampling = pm.Sampling("adaptive", threshold=threshold, subdivisions=2, **PRIMARY)
    samples = pm.render_samples(scene, sampling=sampling)
    if threshold > 1:
        assert len(samples) == 25 * 17
    else:
        assert len(samples) > 25 * 17 * lattice


@pytest.mark.parametrize("margin", [0, 5])
def test_adaptive_weights_add_up_to_the_film(margin):
    sampling = pm.Sampling("adaptive", layers=1, overscan=margin)
    samples = pm.render_samples(papers_scene(32, spp=1), sampling=sampling)
    border_x = np.isin(samples.x, (-margin, 32 + margin))
    border_y = np.isin(samples.y, (-margin, 32 + margin))
    inside = samples.weight / (1 + border_x) / (1 + border_y)
    assert inside.sum() == pytest.approx((32 + 2 * margin) ** 2, rel=1e-5)


@pytest.mark.parametrize("method", ["paper", "layered", "lightfield"])
def test_adaptive_pictures_come_close_to_many_samples_with_few(method):
    scene = papers_scene(48, spp=256)
    reference = pinhole_mean(pm.render_samples(scene, sampling=pm.Sampling(**PRIMARY)))
    options = {"inverse_square": False} if method == "paper" else {}
    errors = []
    for subdivisions in (0, 3):
        sampling = pm.Sampling("adaptive", threshold=0.02, subdivisions=subdivisions)
        samples = pm.render_samples(scene, spp=1, sampling=sampling)
        pinhole = samples.lens.replace(f_number=np.inf)
        image = np.array(pm.focus(samples, pinhole, method=method, **options))
        errors.append(np.sqrt(np.mean((image - reference) ** 2)))
    assert errors[1] < errors[0] / 1.5
