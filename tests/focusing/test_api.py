import dataclasses
import gc
import itertools
import weakref

import brute_force
import mitsuba as mi
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import potmesil_mi as pm
from potmesil_mi.focusing.film import FinePicture, reconstruct
from scenes import evenly_spread, overscanned, papers_scene, pinhole_mean, still_life, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

FIGURE_11 = [2000.0, 980.0, 550.0, 290.0]

PRIMARY = {"layers": 1, "overscan": 0}
"""Sampling of the film alone, as in the paper."""

every_method = pytest.mark.parametrize("method", ["paper", "layered", "lightfield"])


def focused(samples, lens=None, *, method, **options):
    """The picture as an array; of equation 20 that of few tables without its own fall-off."""
    if method == "paper":
        options = {"inverse_square": False, "tables": 9, **options}
    return np.array(pm.focus(samples, lens, method=method, **options))


def radius_in_pixels(samples, lens, depth):
    """That of the circle of confusion."""
    pixels_per_mm = samples.camera.focal_length_pixels / lens.film_distance
    return abs(lens.circle_of_confusion(depth)) / 2 * pixels_per_mm


def relative_error(samples, lens, **options):
    """Root of the mean square difference from equation 20 term by term, over that of it."""
    width, height = samples.camera.crop_size
    pixels = np.stack(np.meshgrid(range(0, width, 3), range(0, height, 3)), -1).reshape(-1, 2)
    expected = brute_force.equation_20(
        samples, lens, pixels, inverse_square=options.get("inverse_square", True)
    )
    image = np.array(pm.focus(samples, lens, method="paper", **options), dtype=np.float64)
    difference = image[pixels[:, 1], pixels[:, 0]] - expected
    return np.sqrt(np.mean(difference**2) / np.mean(expected**2))


@pytest.fixture(scope="module")
def papers_samples():
    mi.set_variant("llvm_ad_rgb")
    return pm.render_samples(papers_scene(96), spp=1, sampling=pm.Sampling("uniform", **PRIMARY))


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


def test_equation_20_knows_what_is_sampled_beyond_the_film_but_nothing_hidden():
    sampling = pm.Sampling("uniform", overscan=12)
    samples = pm.render_samples(papers_scene(96), spp=1, sampling=sampling)
    assert samples.window == (-12, -12, 120, 120)
    assert samples.layer.any()
    assert relative_error(samples, samples.lens) < 1e-3
    image, of_visible = (
        np.array(pm.focus(s, method="paper")) for s in (samples, samples.visible())
    )
    np.testing.assert_allclose(image, of_visible, atol=1e-6)


def test_jittered_positions_are_met_by_their_classes():
    samples = pm.render_samples(papers_scene(96), spp=16, sampling=pm.Sampling(**PRIMARY))
    lens = samples.lens.replace(focus_distance=2000, f_number=2)
    assert relative_error(samples, lens, tables=289) < 2e-3


def test_the_inverse_square_can_be_switched_off(papers_samples):
    assert relative_error(papers_samples, papers_samples.lens, inverse_square=False) < 1e-3
    with_it, without = (
        np.array(pm.focus(papers_samples, method="paper", inverse_square=switch))
        for switch in (True, False)
    )
    assert np.abs(with_it - without).max() > 0.01


@every_method
@given(
    f_number=st.floats(0.7, 100),
    focus_distance=st.floats(0.5, 100),
    level=st.floats(1e-3, 1e3),
    inverse_square=st.booleans(),
)
@example(f_number=100.0, focus_distance=2.0, level=1.0, inverse_square=False)
@settings(max_examples=15)
def test_a_uniform_picture_stays_uniform(method, f_number, focus_distance, level, inverse_square):
    for samples in (synthetic(), overscanned(30_000)):
        samples = samples.replace(rgb=np.full_like(samples.rgb, level))
        lens = samples.lens.replace(f_number=f_number, focus_distance=focus_distance)
        options = {"inverse_square": inverse_square} if method == "paper" else {}
        image = focused(samples, lens, method=method, **options)
        np.testing.assert_allclose(image, np.float32(level), rtol=1e-5)


@every_method
@pytest.mark.parametrize("f_number", [5.6, 0.5])
def test_a_bright_lamp_leaves_no_trace_beyond_its_circle(method, f_number):
    samples = evenly_spread((64, 48))
    rgb = np.full_like(samples.rgb, 0.5)
    rgb[(abs(samples.x - 20) < 0.5) & (abs(samples.y - 20) < 0.5)] = 1e5
    samples = samples.replace(rgb=rgb, z=np.full(len(rgb), 4.0))
    lens = samples.lens.replace(f_number=f_number)
    image = focused(samples, lens, method=method)
    # From the middle of the lamp to the far corner of a pixel are 1.5 pixels. The new methods
    # know the place of a sample only to a square, here of a whole pixel.
    margin = 2 if method == "paper" else 3
    y, x = np.mgrid[:48, :64] + 0.5
    beyond = np.hypot(x - 20, y - 20) > radius_in_pixels(samples, lens, 4.0) + margin
    assert beyond.mean() > 0.5
    # The new methods transform in single precision: 3e-8 of the lamp may get anywhere.
    tolerance = 1e-3 if method == "paper" else 3e-8 * 1e5
    np.testing.assert_allclose(image[beyond], 0.5, atol=tolerance)
    assert image.min() >= (0.5 if method == "paper" else 0.5 - tolerance)


@every_method
@pytest.mark.parametrize("f_number", [1e6, float("inf")])
@pytest.mark.parametrize("sampler", ["independent", "multijitter"])
def test_a_closed_aperture_gives_the_pinhole_picture(sampler, f_number, method):
    scene = still_life(spp=16, sampler=sampler)
    path = mi.load_dict({"type": "path", "max_depth": 3})
    pinhole = np.array(mi.render(scene, integrator=path, seed=7))
    even = pm.Sampling(refine=0)
    samples = pm.render_samples(scene, integrator=path, seed=7, sampling=even)
    image = focused(samples, samples.lens.replace(f_number=f_number), method=method)
    np.testing.assert_allclose(image, pinhole, atol=1e-4)


@every_method
def test_with_everything_in_focus_the_picture_is_the_pinholes(method):
    samples = synthetic(30_000, z=np.full(30_000, 2.0))
    lens = samples.lens.replace(f_number=1.4, focus_distance=2.0)
    image = focused(samples, lens, method=method)
    np.testing.assert_allclose(image, pinhole_mean(samples), atol=1e-4)


@every_method
def test_everything_at_infinity_is_finite_and_has_the_limiting_circle(method):
    samples = synthetic(z=np.full(2000, np.inf))
    infinity = samples.lens.replace(focus_distance=np.inf)
    np.testing.assert_allclose(
        focused(samples, infinity, method=method), pinhole_mean(samples), atol=1e-4
    )
    far = samples.replace(z=np.full(2000, 1e7))
    np.testing.assert_allclose(
        focused(samples, method=method), focused(far, method=method), atol=1e-4
    )


@every_method
def test_the_picture_scales_with_the_light(method):
    samples = synthetic()
    image = focused(samples, method=method)
    brighter = focused(samples.replace(rgb=8 * samples.rgb), method=method)
    np.testing.assert_allclose(brighter, 8 * image, rtol=1e-4)


@every_method
def test_circles_larger_than_the_film_are_averaged(method):
    y, x = (np.mgrid[0 : 14 * 4, 0 : 20 * 4].reshape(2, -1) + 0.5) / 4
    count = len(x)
    samples = synthetic(count, x=x, y=y, z=np.full(count, 5.0), weight=np.full(count, 1 / 16))
    lens = samples.lens.replace(f_number=0.01, focus_distance=1.0)
    image = focused(samples, lens, method=method)
    mean = samples.rgb.mean(axis=0)
    np.testing.assert_allclose(image, np.broadcast_to(mean, image.shape), atol=1e-3)


@every_method
def test_samples_that_nobody_holds_are_given_up_at_once(method):
    gc.collect()
    gc.disable()
    try:
        samples = pm.render_samples(papers_scene(16), spp=4)
        for aperture in (pm.Disc(), pm.Lommel()):
            focused(samples, samples.lens.replace(aperture=aperture), method=method)
        kept = weakref.ref(samples)
        del samples
        assert kept() is None
    finally:
        gc.enable()


@every_method
def test_where_no_light_arrives_the_picture_is_black(method):
    # Of such weights sums are exact in any order.
    samples = synthetic(x=np.full(2000, 3.3), y=np.full(2000, 3.3), weight=np.full(2000, 2.0**-13))
    lens = samples.lens.replace(f_number=1e6)
    image = focused(samples, lens, method=method, alpha=True)
    assert image[3, 3, 3] == pytest.approx(1, abs=0 if method == "paper" else 1e-6)
    mean = np.average(samples.rgb, axis=0, weights=samples.weight)
    np.testing.assert_allclose(image[3, 3, :3], mean, rtol=1e-4)
    # Where there is no sample the nearest one is shown, up to a pixel away.
    lit = image.any(axis=-1)
    around = np.zeros_like(lit)
    around[2:5, 2:5] = method != "paper"
    around[3, 3] = True
    np.testing.assert_array_equal(lit, around)


@every_method
def test_alpha_is_the_coverage_through_the_lens(method):
    samples = synthetic(20_000)
    samples = samples.replace(alpha=samples.x < 10, z=np.full(len(samples), 2.0))
    alpha = focused(samples, method=method, alpha=True)[..., 3]
    np.testing.assert_allclose(alpha[:, :10], 1, atol=1e-5)
    np.testing.assert_allclose(alpha[:, 10:], 0, atol=1e-5)


class Shifted:
    """All the light ``squares`` squares to the right, at every size of them."""

    def __init__(self, squares, pixels_per_mm):
        self.mm = squares / pixels_per_mm

    def table(self, lens, depth, pixels_per_mm, offset=(0.0, 0.0), largest=None):
        reach = round(self.mm * pixels_per_mm)
        table = np.zeros((*np.shape(offset)[:-1], 2 * reach + 1, 2 * reach + 1))
        table[..., reach, 2 * reach] = 1
        return table


@every_method
def test_a_point_spread_function_is_asked_for_its_tables(method):
    samples = synthetic(30_000, size=(30, 20), z=np.full(30_000, 4.0))
    # Well out of focus: the new methods take what is within half a pixel of it for sharp.
    lens = samples.lens.replace(f_number=0.06)
    assert 3 < radius_in_pixels(samples, lens, 4.0) < 6
    psf = Shifted(3, samples.camera.focal_length_pixels / lens.film_distance)
    image = focused(samples, lens, method=method, psf=psf, squares=1)
    np.testing.assert_allclose(image[:, 3:], pinhole_mean(samples)[:, :-3], atol=1e-4)


def test_many_tables_at_once_are_those_asked_for_one_by_one():
    lens = pm.ThinLens(50.0, 2.0, 100.0)
    offsets = np.random.default_rng(1).uniform(0, 1, (2, 5, 2))
    together = pm.Disc().table(lens, 120.0, 2.0, offsets)
    for i, j in np.ndindex(2, 5):
        np.testing.assert_array_equal(
            together[i, j], pm.Disc().table(lens, 120.0, 2.0, offsets[i, j])
        )


@every_method
def test_a_lens_of_drjit_arrays_is_taken_for_its_values(method):
    samples = synthetic()
    drjit_lens = samples.lens.replace(f_number=mi.Float(4), focus_distance=mi.Float(3))
    plain_lens = samples.lens.replace(f_number=4.0, focus_distance=3.0)
    np.testing.assert_allclose(
        focused(samples, drjit_lens, method=method),
        focused(samples, plain_lens, method=method),
        atol=1e-6,
    )


@every_method
def test_dividing_pixels_into_squares_adds_no_noise_to_a_blur(method):
    edge = synthetic(8 * 40 * 30, size=(40, 30), z=np.full(8 * 40 * 30, 5.0))
    # Off the raster: squares that end at the edge would tell it without noise.
    edge = edge.replace(rgb=np.repeat((edge.x > 20.3)[:, None], 3, axis=1))
    lens = edge.lens.replace(f_number=0.25)
    whole, divided = (focused(edge, lens, method=method, squares=n) for n in (1, 2))
    # Along a straight edge all that differs from row to row is noise.
    noise, noise_divided = (image[5:-5, 10:30].std(axis=0).mean() for image in (whole, divided))
    assert 0 < noise_divided < 1.05 * noise


@every_method
def test_a_lens_in_millimetres_focuses_a_scene_in_metres(method):
    samples = synthetic()
    metres = samples.lens.replace(f_number=4.0, focus_distance=1.2)
    millimetres = pm.ThinLens(metres.focal_length, 4.0, 1200.0)
    np.testing.assert_allclose(
        focused(samples, millimetres, method=method),
        focused(samples, metres, method=method),
        atol=1e-6,
    )


@every_method
def test_a_crop_window_is_focused_like_the_whole_in_focus(method):
    samples = synthetic(30_000, size=(24, 16), z=np.full(30_000, 2.0))
    whole = focused(samples, method=method)
    inside = (samples.x > 5) & (samples.x < 14) & (samples.y > 3) & (samples.y < 11)
    camera = dataclasses.replace(samples.camera, crop_offset=(5, 3), crop_size=(9, 8))
    fields = {
        name: getattr(samples, name)[inside]
        for name in ("x", "y", "rgb", "alpha", "z", "surface", "weight", "layer")
    }
    part = focused(samples.replace(**fields, camera=camera, window=(5, 3, 9, 8)), method=method)
    assert part.shape == (8, 9, 3)
    np.testing.assert_allclose(part, whole[3:11, 5:14], atol=1e-5)


@every_method
@pytest.mark.parametrize("f_number", [2.0, 0.5, 0.1])
def test_a_crop_window_with_samples_all_around_equals_the_whole(method, f_number):
    samples = synthetic(30_000, size=(24, 16))
    lens = samples.lens.replace(f_number=f_number)
    whole = focused(samples, lens, method=method)
    camera = dataclasses.replace(samples.camera, crop_offset=(5, 3), crop_size=(9, 8))
    part = focused(samples.replace(camera=camera, window=(0, 0, 24, 16)), lens, method=method)
    np.testing.assert_allclose(part, whole[3:11, 5:14], atol=1e-5)


@every_method
def test_a_smooth_filter_is_honoured(method):
    scene = still_life(spp=256, film={"rfilter": {"type": "gaussian", "stddev": 0.7}})
    path = mi.load_dict({"type": "path", "max_depth": 3})
    expected = np.array(mi.render(scene, integrator=path))
    samples = pm.render_samples(scene, integrator=path)
    sharp = samples.lens.replace(f_number=1e6)
    error = {}
    for name, rfilter in (("box", None), ("gaussian", scene.sensors()[0].film().rfilter())):
        image = focused(samples, sharp, method=method, squares=4, rfilter=rfilter)
        error[name] = np.abs(image - expected).max()
    assert error["gaussian"] < 0.02
    assert error["box"] > 3 * error["gaussian"]


def test_reconstruction_weights_squares_by_their_samples():
    fine = np.array([[1.0, 2.0], [3.0, 4.0]])[..., None]
    for weights, expected in (
        (np.ones((2, 2)), 2.5),
        (np.array([[3.0, 1.0], [0, 0]]), 1.25),
        (np.zeros((2, 2)), 0),
    ):
        assert reconstruct(FinePicture(fine, weights), 2)[0, 0, 0] == pytest.approx(expected)


@every_method
def test_a_pixel_without_samples_shows_the_light_that_reaches_it(method):
    samples = synthetic(9, x=np.full(9, 4.5), y=np.full(9, 4.5), z=np.full(9, 5.0))
    lens = samples.lens.replace(f_number=0.05)
    image = focused(samples, lens, method=method, alpha=True)
    mean = np.average(samples.rgb, axis=0, weights=samples.weight)
    # The rim of the circle gets so little that the new methods' single precision shows.
    tolerance = 1e-5 if method == "paper" else 1e-3
    lit = image[..., 3] > 0
    assert lit.sum() > 20
    np.testing.assert_allclose(image[lit][:, 3], 1, rtol=tolerance)
    expected = np.broadcast_to(mean, (lit.sum(), 3))
    np.testing.assert_allclose(image[lit][:, :3], expected, rtol=tolerance)
    assert (image[~lit] == 0).all()


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"method": "layred"}, ValueError, "method='layred'.*layered, lightfield, paper"),
        ({"lens_points": 0}, ValueError, "lens_points=0.*1 to"),
        ({"lens_points": 5000}, ValueError, "lens_points=5000"),
        ({"lens_points": 2.5}, TypeError, r"lens_points=2\.5"),
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
