"""Deep EXR files of other programs: transparency, volumes, what a lens sees behind things."""

import numpy as np
import pytest
from picture_files import write_deep

import potmesil_mi as pm

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = (24, 16)
LENS = {"f_number": 0.5, "focus_distance": 2.0, "millimeters_per_unit": 1000.0}
OPTIONS = {"camera": 40.0, "lens": LENS, "depth_kind": "z"}


def everywhere(*samples):
    return [[list(samples) for _ in range(SIZE[0])] for _ in range(SIZE[1])]


def middle(samples, **lens):
    picture = np.array(pm.focus(samples, samples.lens.replace(**lens)))
    return picture[SIZE[1] // 2, SIZE[0] // 2]


@pytest.mark.parametrize("f_number", [0.1, 0.27, 0.5, 1.0, np.inf])
@pytest.mark.parametrize("focus_distance", [2.0, 6.0])
def test_transparent_samples_are_over_those_behind_for_every_lens(
    tmp_path, f_number, focus_distance
):
    """A red glass of alpha 0.25 before a blue wall of 0.5, before nothing."""
    names = ("R", "G", "B", "A", "Z")
    pixels = everywhere((0, 0, 0.4, 0.5, 6.0), (0.2, 0, 0, 0.25, 2.0))
    path = write_deep(tmp_path / "a.exr", pixels, names)
    lens = {**LENS, "f_number": f_number}
    samples = pm.PointSamples.from_image(path, **{**OPTIONS, "lens": lens})
    found = middle(samples, focus_distance=focus_distance)
    np.testing.assert_allclose(found, (0.2, 0, 0.75 * 0.4), atol=0.01)
    lens = samples.lens.replace(focus_distance=focus_distance)
    alpha = np.array(pm.focus(samples, lens, alpha=True))[8, 12, 3]
    assert alpha == pytest.approx(1 - 0.75 * 0.5, abs=0.01)


def test_the_order_of_samples_and_pixels_without_any_do_not_matter(tmp_path):
    names = ("Z", "A", "R", "G", "B")
    pixels = everywhere((6.0, 1.0, 0.1, 0.2, 0.3))
    pixels[0][0] = []
    pixels[5][5] = [(6.0, 1.0, 0.1, 0.2, 0.3), (2.0, 1.0, 0.9, 0.9, 0.9)]
    samples = pm.PointSamples.from_image(write_deep(tmp_path / "a.exr", pixels, names), **OPTIONS)
    sharp = np.array(pm.focus(samples, samples.lens.replace(f_number=np.inf)))
    np.testing.assert_allclose(sharp[0, 0], 0, atol=1e-6)
    np.testing.assert_allclose(sharp[5, 5], 0.9, atol=1e-5)
    np.testing.assert_allclose(sharp[9, 9], (0.1, 0.2, 0.3), atol=1e-5)
    hidden = (samples.layer > 0) & (samples.z == 6)
    np.testing.assert_allclose(samples.weight[hidden], 1)


def test_a_volume_becomes_slices_that_let_through_as_much(tmp_path):
    names = ("R", "G", "B", "A", "Z", "ZBack")
    pixels = everywhere((0.3, 0.3, 0.3, 0.6, 1.0, 3.0), (0, 0.8, 0, 1.0, 6.0, 6.0))
    path = write_deep(tmp_path / "a.exr", pixels, names)
    lens = {**LENS, "f_number": 0.05}
    samples = pm.PointSamples.from_image(path, **{**OPTIONS, "lens": lens})
    visible = samples.layer == 0
    assert len(np.unique(samples.z[visible])) == 5
    for f_number in (np.inf, 1.0, 0.5, 0.2, 0.05):
        lens = {**LENS, "f_number": f_number}
        found = middle(pm.PointSamples.from_image(path, **{**OPTIONS, "lens": lens}))
        np.testing.assert_allclose(found, (0.3, 0.3 + 0.4 * 0.8, 0.3), atol=0.015)


def test_an_overscan_is_left_out_where_it_is(tmp_path):
    """Each pixel has its number as red; the film is the middle of the data window."""
    pixels = [
        [[(100 * row + column, 0, 0, 1, 2.0)] for column in range(SIZE[0])]
        for row in range(SIZE[1])
    ]
    window = {
        "dataWindow": (np.array([-3, -2], np.int32), np.array([20, 13], np.int32)),
        "displayWindow": (np.array([0, 0], np.int32), np.array([9, 7], np.int32)),
    }
    names = ("R", "G", "B", "A", "Z")
    path = write_deep(tmp_path / "a.exr", pixels, names, **window)
    samples = pm.PointSamples.from_image(path, **OPTIONS)
    assert samples.camera.film_size == (10, 8)
    seen = samples.layer == 0
    expected = 100 * (np.floor(samples.y) + 2) + np.floor(samples.x) + 3
    np.testing.assert_allclose(samples.rgb[seen, 0], expected[seen], rtol=1e-6)
    assert len(np.unique(samples.pixel()[seen])) == 80


def test_which_kind_a_deep_depth_is_is_asked_for(tmp_path):
    path = write_deep(tmp_path / "a.exr", everywhere((1, 1, 1, 1, 2.0)), ("R", "G", "B", "A", "Z"))
    with pytest.raises(ValueError, match=r"a\.exr.*no file says.*depth_kind"):
        pm.PointSamples.from_image(path, camera=40.0, lens=LENS)


@pytest.mark.parametrize(
    ("sample", "problem"),
    [((1, 1, 1, 1, -2.0), "Z that is not > 0"), ((np.nan, 1, 1, 1, 2.0), "not finite")],
)
def test_samples_that_make_no_sense_are_an_error_that_names_the_file(tmp_path, sample, problem):
    path = write_deep(tmp_path / "a.exr", everywhere(sample), ("R", "G", "B", "A", "Z"))
    with pytest.raises(ValueError, match=rf"a\.exr.*{problem}"):
        pm.PointSamples.from_image(path, **OPTIONS)
    no_depth = write_deep(tmp_path / "b.exr", everywhere((1, 1)), ("R", "A"))
    with pytest.raises(ValueError, match=r"b\.exr.*no channel Z"):
        pm.PointSamples.from_image(no_depth, **OPTIONS)
