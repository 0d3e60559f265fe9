"""Pictures through a telecentric lens of samples that have no scene."""

import math

import numpy as np
import pytest

import potmesil_mi as pm

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = 48
METHODS = pytest.mark.parametrize("method", ["layered", "lightfield", "paper"])


def plane(depth, lens, rgb, per_side=2, **columns):
    """Samples of a plane, of an orthographic camera 4 scene units wide."""
    at = (np.arange(SIZE * per_side) + 0.5) / per_side
    x, y = (axis.ravel() for axis in np.meshgrid(at, at))
    camera = pm.Camera(
        film_size=(SIZE, SIZE),
        crop_offset=(0, 0),
        crop_size=(SIZE, SIZE),
        x_fov=0.0,
        to_world=tuple(map(tuple, np.eye(4).tolist())),
        projection="orthographic",
        film_width=4.0,
    )
    given = {
        "x": x,
        "y": y,
        "rgb": np.stack([rgb(x, y)] * 3, axis=1),
        "alpha": np.ones_like(x),
        "z": np.broadcast_to(depth, x.shape),
        "surface": np.ones(len(x)),
        "weight": np.full(len(x), 1 / per_side**2),
    }
    return pm.PointSamples(**{**given, **columns}, camera=camera, lens=lens)


def pixel(x, y):
    middle = SIZE // 2
    return (np.floor(x) == middle) & (np.floor(y) == middle)


@METHODS
@pytest.mark.parametrize("depth", [3.0, 7.0])
def test_a_point_becomes_a_disc_of_the_cones_radius(method, depth):
    samples = plane(depth, pm.TelecentricLens(12.0, 5.0), pixel)
    picture = np.array(pm.focus(samples, method=method))[..., 0]
    radius = math.tan(math.radians(12)) * 2 * SIZE / 4
    assert picture.sum() == pytest.approx(1, abs=1e-3)
    y, x = np.mgrid[:SIZE, :SIZE] - SIZE // 2
    # A disc's variance along an axis is r^2/4; a pixel adds 1/12, once or twice.
    variance = (picture * (x**2 + y**2)).sum() / 2
    assert radius**2 / 4 < variance < radius**2 / 4 + 0.25
    reached = np.hypot(x, y)[picture > 0.2 * picture.max()].max()
    assert abs(reached - radius) < 1


@METHODS
def test_a_uniform_picture_stays_uniform(method):
    lens = pm.TelecentricLens(8.0, 3.0)
    random = np.random.default_rng(0)
    depth = random.uniform(1, 5, (2 * SIZE) ** 2)
    depth[::7] = np.inf
    samples = plane(depth, lens, lambda x, _: np.full(x.shape, 0.4))
    picture = np.array(pm.focus(samples, method=method))
    np.testing.assert_allclose(picture, 0.4, atol=1e-5)


@METHODS
def test_the_blur_is_the_same_all_over_the_picture_and_for_depths_moved_together(method):
    def dots(x, y):
        return pixel(x, y) | pixel(x - 12, y + 11)

    lens = pm.TelecentricLens(6.0, 5.0)
    picture = np.array(pm.focus(plane(4.0, lens, dots), method=method))[..., 0]
    middle = SIZE // 2
    box = picture[middle - 5 : middle + 6, middle - 5 : middle + 6]
    other = picture[middle - 16 : middle - 5, middle + 7 : middle + 18]
    # Dots are highlights, whose lens points are turned anew for each: 2% of their peak.
    tolerance = 1e-6 if method == "paper" else 0.02 * picture.max()
    np.testing.assert_allclose(box, other, atol=tolerance)
    moved = plane(104.0, lens.replace(focus_distance=105.0), dots)
    np.testing.assert_allclose(
        np.array(pm.focus(moved, method=method))[..., 0], picture, atol=max(tolerance, 1e-4)
    )


def test_the_paper_has_no_fall_off():
    random = np.random.default_rng(1)
    depth = random.uniform(1, 5, (2 * SIZE) ** 2)
    samples = plane(depth, pm.TelecentricLens(4.0, 3.0), lambda x, _: random.uniform(size=len(x)))
    with_it, without = (
        np.array(pm.focus(samples, method=pm.Equation20(inverse_square=each)))
        for each in (True, False)
    )
    # Threads add the same light up in a changing order.
    np.testing.assert_allclose(with_it, without, rtol=0, atol=2e-6)


def test_a_session_finds_out_once_and_gives_it_up():
    random = np.random.default_rng(2)
    depth = random.uniform(1, 5, (2 * SIZE) ** 2)
    samples = plane(depth, pm.TelecentricLens(4.0, 3.0), lambda x, _: random.uniform(size=len(x)))
    session = pm.FocusSession(samples)
    first = np.array(session.focus())
    kept = session.nbytes
    assert kept > 0
    other = np.array(session.focus(samples.lens.replace(focus_distance=2.0)))
    assert session.nbytes < 2 * kept
    assert np.abs(other - first).max() > 0.01
    np.testing.assert_allclose(np.array(session.focus()), first, atol=1e-6)
    np.testing.assert_allclose(np.array(pm.focus(samples)), first, atol=1e-6)
    session.clear()
    assert session.nbytes == 0


def test_what_needs_a_focal_length_is_refused_by_name():
    samples = plane(4.0, pm.TelecentricLens(4.0, 3.0), pixel)
    with pytest.raises(ValueError, match="filters: diffraction"):
        pm.focus(samples, filters=["diffraction"])
    with pytest.raises(ValueError, match=r"psf=.*must not diffract"):
        pm.focus(samples, psf=pm.Lommel())
    with pytest.raises(ValueError, match="lens=ThinLens: must be a TelecentricLens"):
        pm.focus(samples, pm.ThinLens(50.0, 2.0, 2000.0))
    pm.focus(samples, filters=["fade:amount=0.3"])


def test_samples_are_saved_and_loaded_with_their_lens(tmp_path):
    lens = pm.TelecentricLens(4.0, 3.0, "polygon:blades=6", 1.25)
    random = np.random.default_rng(3)
    depth = random.uniform(1, 5, (2 * SIZE) ** 2)
    depth[:9] = np.inf
    samples = plane(depth, lens, lambda x, _: random.uniform(size=len(x)))
    samples.save(tmp_path / "samples.exr")
    loaded = pm.PointSamples.load(tmp_path / "samples.exr")
    assert loaded.lens == lens
    assert loaded.camera == samples.camera
    np.testing.assert_allclose(np.array(pm.focus(loaded)), np.array(pm.focus(samples)), atol=1e-5)


def test_merged_samples_make_nearly_the_same_picture():
    random = np.random.default_rng(4)
    count = (8 * SIZE) ** 2
    depth = np.where(np.arange(count) % 11 == 0, np.inf, random.uniform(2.9, 3.1, count))
    samples = plane(
        depth, pm.TelecentricLens(4.0, 2.0), lambda x, _: random.uniform(size=len(x)), per_side=8
    )
    merged = samples.merge()
    assert len(merged) < len(samples) / 3
    assert merged.weight.sum() == pytest.approx(samples.weight.sum(), rel=1e-5)
    # What is merged no longer tells that the samples were many, for which layered looks closer.
    of_both = (np.array(pm.focus(each, squares=1)) for each in (merged, samples))
    assert np.sqrt(np.mean(np.subtract(*of_both) ** 2)) < 0.005
