import dataclasses
import itertools

import brute_force
import mitsuba as mi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import potmesil_mi as pm
from potmesil_mi.focus import reconstruct
from scenes import papers_scene, pinhole_mean, still_life, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

FIGURE_11 = [2000.0, 980.0, 550.0, 290.0]


def relative_error(samples, lens, **options):
    """Root of the mean square difference from equation 20 term by term, over that of it."""
    width, height = samples.camera.crop_size
    pixels = np.stack(np.meshgrid(range(0, width, 3), range(0, height, 3)), -1).reshape(-1, 2)
    expected = brute_force.equation_20(
        samples, lens, pixels, inverse_square=options.get("inverse_square", True)
    )
    image = np.array(pm.focus(samples, lens, **options), dtype=np.float64)
    difference = image[pixels[:, 1], pixels[:, 0]] - expected
    return np.sqrt(np.mean(difference**2) / np.mean(expected**2))


@pytest.fixture(scope="module")
def papers_samples():
    mi.set_variant("llvm_ad_rgb")
    return pm.render_samples(papers_scene(96), spp=1, sampling=pm.Sampling("uniform"))


@pytest.mark.parametrize("focus_distance", FIGURE_11)
def test_73_tables_agree_with_equation_20_on_the_papers_scene_to_a_thousandth(
    papers_samples, focus_distance
):
    lens = papers_samples.lens.replace(focus_distance=focus_distance)
    assert relative_error(papers_samples, lens) < 1e-3


def test_more_tables_come_closer_to_equation_20(papers_samples):
    lens = papers_samples.lens.replace(focus_distance=980)
    errors = [relative_error(papers_samples, lens, tables=n) for n in (19, 37, 73, 145)]
    assert all(more < 0.6 * fewer for fewer, more in itertools.pairwise(errors))


def test_jittered_positions_are_met_by_their_classes():
    samples = pm.render_samples(papers_scene(96), spp=16)
    lens = samples.lens.replace(focus_distance=2000, f_number=2)
    assert relative_error(samples, lens, tables=289) < 2e-3


def test_the_inverse_square_can_be_switched_off(papers_samples):
    assert relative_error(papers_samples, papers_samples.lens, inverse_square=False) < 1e-3
    with_it, without = (
        np.array(pm.focus(papers_samples, inverse_square=switch)) for switch in (True, False)
    )
    assert np.abs(with_it - without).max() > 0.01


@given(
    f_number=st.floats(0.7, 100),
    focus_distance=st.floats(0.5, 100),
    level=st.floats(1e-3, 1e3),
    inverse_square=st.booleans(),
)
@settings(max_examples=15)
def test_a_uniform_picture_stays_uniform(f_number, focus_distance, level, inverse_square):
    samples = synthetic()
    samples = samples.replace(rgb=np.full_like(samples.rgb, level))
    lens = samples.lens.replace(f_number=f_number, focus_distance=focus_distance)
    image = np.array(pm.focus(samples, lens, inverse_square=inverse_square, tables=9))
    np.testing.assert_allclose(image, np.float32(level), rtol=1e-5)


def test_a_bright_lamp_leaves_no_trace_beyond_its_circle():
    samples = synthetic(20_000, size=(64, 48))
    rgb = np.full_like(samples.rgb, 0.5)
    rgb[(abs(samples.x - 20) < 0.5) & (abs(samples.y - 20) < 0.5)] = 1e5
    samples = samples.replace(rgb=rgb, z=np.full(len(rgb), 4.0))
    lens = samples.lens.replace(f_number=5.6)
    image = np.array(pm.focus(samples, lens))
    pixels_per_mm = samples.camera.focal_length_pixels / lens.film_distance
    radius = abs(lens.circle_of_confusion(4.0)) / 2 * pixels_per_mm
    y, x = np.mgrid[:48, :64] + 0.5
    beyond = np.hypot(x - 20, y - 20) > radius + 2
    assert beyond.mean() > 0.5
    np.testing.assert_allclose(image[beyond], 0.5, atol=1e-3)
    assert image.min() >= 0.5


@pytest.mark.parametrize("sampler", ["independent", "multijitter"])
def test_a_closed_aperture_gives_the_pinhole_picture(sampler):
    scene = still_life(spp=16, sampler=sampler)
    path = mi.load_dict({"type": "path", "max_depth": 3})
    pinhole = np.array(mi.render(scene, integrator=path, seed=7))
    samples = pm.render_samples(scene, integrator=path, seed=7)
    for f_number in (1e6, float("inf")):
        lens = samples.lens.replace(f_number=f_number)
        image = np.array(pm.focus(samples, lens, inverse_square=False))
        np.testing.assert_allclose(image, pinhole, atol=1e-4)


def test_with_everything_in_focus_the_picture_is_the_pinholes():
    samples = synthetic(30_000, z=np.full(30_000, 2.0))
    image = np.array(pm.focus(samples, samples.lens.replace(f_number=1.4, focus_distance=2.0)))
    np.testing.assert_allclose(image, pinhole_mean(samples), atol=1e-4)


def test_everything_at_infinity_is_finite_and_has_the_limiting_circle():
    samples = synthetic(z=np.full(2000, np.inf))
    infinity = samples.lens.replace(focus_distance=np.inf)
    np.testing.assert_allclose(
        np.array(pm.focus(samples, infinity)), pinhole_mean(samples), atol=1e-4
    )
    far = samples.replace(z=np.full(2000, 1e7))
    np.testing.assert_allclose(np.array(pm.focus(samples)), np.array(pm.focus(far)), atol=1e-4)


def test_the_picture_scales_with_the_light():
    samples = synthetic()
    image = np.array(pm.focus(samples))
    brighter = np.array(pm.focus(samples.replace(rgb=8 * samples.rgb)))
    np.testing.assert_allclose(brighter, 8 * image, rtol=1e-4)


def test_circles_larger_than_the_film_are_averaged():
    samples = synthetic(z=np.full(2000, 5.0))
    lens = samples.lens.replace(f_number=0.01, focus_distance=1.0)
    image = np.array(pm.focus(samples, lens))
    mean = np.average(samples.rgb, axis=0, weights=samples.weight)
    np.testing.assert_allclose(image, np.broadcast_to(mean, image.shape), atol=1e-3)


def test_where_no_light_arrives_the_picture_is_black():
    samples = synthetic(x=np.full(2000, 3.3), y=np.full(2000, 3.3))
    image = np.array(pm.focus(samples, samples.lens.replace(f_number=1e6), alpha=True))
    assert image[3, 3, 3] == 1
    assert np.count_nonzero(image.any(axis=-1)) == 1


def test_alpha_is_the_coverage_through_the_lens():
    samples = synthetic(20_000)
    samples = samples.replace(alpha=samples.x < 10, z=np.full(len(samples), 2.0))
    alpha = np.array(pm.focus(samples, alpha=True))[..., 3]
    np.testing.assert_allclose(alpha[:, :10], 1, atol=1e-5)
    np.testing.assert_allclose(alpha[:, 10:], 0, atol=1e-5)


def test_a_point_spread_function_is_asked_for_its_tables():
    class Shifted:
        """All the light in the square to the right."""

        def table(self, lens, depth, squares_per_mm, offset=(0.0, 0.0), largest=None):
            table = np.zeros((*np.shape(offset)[:-1], 3, 3))
            table[..., 1, 2] = 1
            return table

    samples = synthetic(30_000)
    image = np.array(pm.focus(samples, psf=Shifted(), squares=1, inverse_square=False))
    np.testing.assert_allclose(image[:, 1:], pinhole_mean(samples)[:, :-1], atol=1e-4)


def test_many_tables_at_once_are_those_asked_for_one_by_one():
    lens = pm.ThinLens(50.0, 2.0, 100.0)
    offsets = np.random.default_rng(1).uniform(0, 1, (2, 5, 2))
    together = pm.Disc().table(lens, 120.0, 2.0, offsets)
    for i, j in np.ndindex(2, 5):
        np.testing.assert_array_equal(
            together[i, j], pm.Disc().table(lens, 120.0, 2.0, offsets[i, j])
        )


def test_a_lens_of_drjit_arrays_is_taken_for_its_values():
    samples = synthetic()
    drjit_lens = samples.lens.replace(f_number=mi.Float(4), focus_distance=mi.Float(3))
    plain_lens = samples.lens.replace(f_number=4.0, focus_distance=3.0)
    np.testing.assert_allclose(
        np.array(pm.focus(samples, drjit_lens)), np.array(pm.focus(samples, plain_lens)), atol=1e-6
    )


def test_dividing_pixels_into_squares_adds_no_noise_to_a_blur():
    edge = synthetic(8 * 40 * 30, size=(40, 30), z=np.full(8 * 40 * 30, 5.0))
    edge = edge.replace(rgb=np.repeat((edge.x > 20)[:, None], 3, axis=1))
    lens = edge.lens.replace(f_number=0.25)
    whole, divided = (
        np.array(pm.focus(edge, lens, inverse_square=False, squares=n)) for n in (1, 2)
    )
    # Along a straight edge all that differs from row to row is noise.
    noise, noise_divided = (image[5:-5, 10:30].std(axis=0).mean() for image in (whole, divided))
    assert 0 < noise_divided < 1.05 * noise


def test_a_lens_in_millimetres_focuses_a_scene_in_metres():
    samples = synthetic()
    metres = samples.lens.replace(f_number=4.0, focus_distance=1.2)
    millimetres = pm.ThinLens(metres.focal_length, 4.0, 1200.0)
    np.testing.assert_allclose(
        np.array(pm.focus(samples, millimetres)), np.array(pm.focus(samples, metres)), atol=1e-6
    )


def test_a_crop_window_is_focused_like_the_whole_in_focus():
    crop = {"crop_offset_x": 5, "crop_offset_y": 3, "crop_width": 9, "crop_height": 8}
    samples = synthetic(30_000, size=(24, 16), z=np.full(30_000, 2.0))
    whole = np.array(pm.focus(samples))
    inside = (samples.x > 5) & (samples.x < 14) & (samples.y > 3) & (samples.y < 11)
    camera = dataclasses.replace(samples.camera, crop_offset=(5, 3), crop_size=(9, 8))
    fields = {
        name: getattr(samples, name)[inside]
        for name in ("x", "y", "rgb", "alpha", "z", "surface", "weight")
    }
    part = np.array(pm.focus(samples.replace(**fields, camera=camera)))
    assert crop["crop_width"] == part.shape[1]
    np.testing.assert_allclose(part, whole[3:11, 5:14], atol=1e-5)


def test_a_smooth_filter_is_honoured():
    scene = still_life(spp=256, film={"rfilter": {"type": "gaussian", "stddev": 0.7}})
    path = mi.load_dict({"type": "path", "max_depth": 3})
    expected = np.array(mi.render(scene, integrator=path))
    samples = pm.render_samples(scene, integrator=path)
    sharp = samples.lens.replace(f_number=1e6)
    error = {}
    for name, rfilter in (("box", None), ("gaussian", scene.sensors()[0].film().rfilter())):
        image = pm.focus(samples, sharp, inverse_square=False, squares=4, rfilter=rfilter)
        error[name] = np.abs(np.array(image) - expected).max()
    assert error["gaussian"] < 0.02
    assert error["box"] > 3 * error["gaussian"]


def test_reconstruction_weights_squares_by_their_samples():
    fine = np.array([[1.0, 2.0], [3.0, 4.0]])[..., None]
    assert reconstruct(fine, np.ones((2, 2)), 2)[0, 0, 0] == pytest.approx(2.5)
    assert reconstruct(fine, np.array([[3.0, 1.0], [0, 0]]), 2)[0, 0, 0] == pytest.approx(1.25)
    assert reconstruct(fine, np.zeros((2, 2)), 2)[0, 0, 0] == 0


def test_a_pixel_without_samples_shows_the_light_that_reaches_it():
    samples = synthetic(9, x=np.full(9, 4.5), y=np.full(9, 4.5), z=np.full(9, 5.0))
    lens = samples.lens.replace(f_number=0.05)
    image = np.array(pm.focus(samples, lens, alpha=True))
    mean = np.average(samples.rgb, axis=0, weights=samples.weight)
    assert (image[..., 3] == 1).sum() > 20
    lit = image[..., 3] > 0
    np.testing.assert_allclose(image[lit][:, :3], np.broadcast_to(mean, (lit.sum(), 3)), rtol=1e-5)
    assert (image[~lit] == 0).all()


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"method": "layred"}, ValueError, "method='layred'.*paper"),
        ({"tables": 1}, ValueError, "tables=1.*2 to"),
        ({"tables": 7.5}, TypeError, "tables=7.5"),
        ({"squares": 0}, ValueError, "squares=0"),
        ({"inverse_square": 1}, TypeError, "inverse_square=1"),
        ({"lens": 550}, TypeError, "lens=550.*ThinLens"),
        ({"psf": 3}, TypeError, "psf=3.*Disc"),
    ],
)
def test_a_bad_option_is_named(options, error, text):
    with pytest.raises(error, match=text):
        pm.focus(synthetic(), **options)


def test_scalar_variants_are_told_what_to_do():
    samples = synthetic()
    mi.set_variant("scalar_rgb")
    with pytest.raises(RuntimeError, match=r"focus: needs a vectorised variant.*llvm_ad_rgb"):
        pm.focus(samples)
