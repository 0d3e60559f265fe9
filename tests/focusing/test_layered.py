"""The methods ``layered`` and ``lightfield``: pictures of what the lens sees."""

import dataclasses
import gc
import math
import weakref

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.evaluation.metrics import psnr
from potmesil_mi.focusing import viewing as viewing_module
from potmesil_mi.focusing.lens_view import LensView
from potmesil_mi.optics.blur import radius_per_vergence
from scenes import LENS, diffuse, overscanned, pinhole_mean, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

METHODS = ["layered", "lightfield"]
NEAR, FAR = 1.0, 4.0
RED, GREEN = np.array([1.0, 0.2, 0.0]), np.array([0.0, 0.6, 0.3])


def picture(samples, **options):
    return np.array(pm.focus(samples, **options), dtype=np.float64)


def with_parallax(samples, scale, focus_distance=2.0):
    """The same samples with a lens whose circles have ``scale`` pixels per unit of vergence."""
    lens = pm.ThinLens(
        50.0,
        aperture_radius=scale / samples.camera.focal_length_pixels,
        focus_distance=focus_distance,
        millimeters_per_unit=1000.0,
    )
    return samples.replace(lens=lens)


def grid(size, subpixels):
    """Regular positions, (N,), in a film."""
    width, height = (subpixels * n for n in size)
    y, x = np.divmod(np.arange(width * height), width)
    return (x + 0.5) / subpixels, (y + 0.5) / subpixels


def planes(*shown, size, subpixels=2):
    """Samples of planes from the nearest to the farthest, each as (mask, depth, colour).

    Masks and colours are functions of x and y. Nothing is missing behind a nearer plane.
    """
    x, y = grid(size, subpixels)
    before = np.zeros(len(x), dtype=np.uint8)
    parts = []
    for mask, depth, colour in shown:
        there = mask(x, y)
        rgb = colour(x, y) if callable(colour) else np.broadcast_to(colour, (len(x), 3))
        surface = np.full(len(x), len(parts) + 1)
        columns = (x, y, np.full(len(x), depth), rgb, before.copy(), surface)
        parts.append([column[there] for column in columns])
        before += there
    names = ("x", "y", "z", "rgb", "layer", "surface")
    columns = dict(zip(names, map(np.concatenate, zip(*parts, strict=True)), strict=True))
    count = len(columns["x"])
    return synthetic(count, size=size, weight=np.full(count, subpixels**-2.0), **columns)


def everywhere(x, y):
    return np.ones(len(x), dtype=bool)


def left_of(edge):
    return lambda x, y: x < edge


def half_plane(size, parallax, focus_distance, near=RED, far=GREEN):
    """A near half plane, left, before a far plane; both known whole."""
    samples = planes(
        (left_of(size[0] / 2), NEAR, near), (everywhere, FAR, far), size=size, subpixels=4
    )
    return with_parallax(samples, parallax / (1 / NEAR - 1 / FAR), focus_distance)


def part_of_disc(t):
    """Area of the unit disc left of t, as a share of it."""
    t = np.clip(t, -1, 1)
    return (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi + 0.5


# ---------------------------------------------------------------- light


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("f_number", [0.1, 1.0, 30.0])
def test_a_uniform_picture_stays_uniform_whatever_the_depths(method, f_number):
    samples = synthetic(20 * 14 * 16)
    samples = samples.replace(rgb=np.full_like(samples.rgb, 0.7))
    lens = samples.lens.replace(f_number=f_number)
    np.testing.assert_allclose(picture(samples, lens=lens, method=method), 0.7, atol=1e-4)


@pytest.mark.parametrize("depth", [NEAR, 8.0])
@pytest.mark.parametrize("at", [(120, 120), (123, 121), (126, 127)])
def test_a_disc_of_a_dim_point_is_where_the_point_is_however_coarse_its_squares(depth, at):
    size, radius = (240, 240), 64.0

    def lit(x, y):
        point = (np.floor(x) == at[0]) & (np.floor(y) == at[1])
        return (1 + 5 * point)[:, None] * np.ones(3)

    samples = planes((everywhere, depth, lit), size=size, subpixels=1)
    samples = with_parallax(samples, radius / abs(1 / depth - 1 / 2))
    disc = picture(samples)[..., 1] - 1
    inner = np.hypot(*(np.indices(disc.shape) - np.array(at[::-1])[:, None, None])) < radius + 12
    y, x = (np.average(axis[inner], weights=disc[inner]) for axis in np.indices(disc.shape))
    np.testing.assert_allclose([x, y], at, atol=0.3)
    assert disc[inner].sum() == pytest.approx(5, rel=0.02)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("depth", [NEAR, 8.0])
@pytest.mark.parametrize(
    ("radius", "size"), [(1.7, 21), (3.3, 31), (10.0, 51), (45.0, 191), (130.0, 531)]
)
def test_a_point_becomes_a_disc_of_the_right_radius_and_light(method, depth, radius, size):
    if radius > 100 and depth == NEAR:
        return
    middle = size // 2

    def lit(x, y):
        at_middle = (np.floor(x) == middle) & (np.floor(y) == middle)
        return at_middle[:, None] * np.array([100.0, 50.0, 0])

    subpixels = 2 if radius < 100 else 1
    options = {"squares": 1} if subpixels == 1 else {}
    samples = planes((everywhere, depth, lit), size=(size, size), subpixels=subpixels)
    samples = with_parallax(samples, radius / abs(1 / depth - 1 / 2))
    image = picture(samples, method=method, **options)
    light = image.sum(axis=(0, 1))
    np.testing.assert_allclose(light, [100, 50, 0], rtol=1e-3, atol=1e-3)
    y, x = np.mgrid[:size, :size] - middle
    red = image[..., 0] / light[0]
    # Large circles are spread on coarser squares.
    coarser = 2 ** max(0, math.floor(math.log2(radius / pm.Disc.finest)))
    assert abs((red * x).sum()) < 0.02 + (coarser - 1) / 2
    assert abs((red * y).sum()) < 0.02 + (coarser - 1) / 2
    # The mean square of distances in a disc, in the pixel that is spread, and in those in which it
    # lands: tables leave out one of the two.
    spread = (red * (x**2 + y**2)).sum()
    assert spread == pytest.approx(radius**2 / 2 + 1 / 4, rel=0.03, abs=0.15)
    # Between circles that have a table, their radii a factor of sqrt(2) apart, light is shared.
    distance = np.hypot(x, y)
    assert red[distance > math.sqrt(2) * radius + 2 + coarser].max() < 1e-4 / radius**2
    inner = red[distance < 0.7 * radius - 1.5]
    np.testing.assert_allclose(inner * math.pi * radius**2, 1, atol=0.2)


@pytest.mark.parametrize("squares", [1, 3])
@pytest.mark.parametrize("lens", [{"f_number": np.inf}, {"aperture_radius": 0.0}])
def test_a_closed_aperture_gives_what_the_pinhole_sees(squares, lens):
    samples = half_plane((21, 14), 6.0, focus_distance=FAR)  # the edge is within a pixel
    image = picture(samples, lens=samples.lens.replace(**lens), squares=squares)
    np.testing.assert_allclose(image, pinhole_mean(samples), atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_in_focus_a_flat_picture_is_that_of_the_pinhole(method):
    samples = planes((everywhere, 2.0, lambda x, y: np.stack([x, y, x * y], 1)), size=(20, 14))
    image = picture(with_parallax(samples, 40.0), method=method)
    np.testing.assert_allclose(image, pinhole_mean(samples), rtol=1e-5)


# ---------------------------------------------------------------- what hides what


@pytest.mark.parametrize(("method", "tolerance"), [("layered", 0.075), ("lightfield", 0.03)])
@pytest.mark.parametrize("radius", [3.0, 8.0, 20.0])
def test_the_blurred_edge_of_something_near_is_a_part_of_a_disc(method, tolerance, radius):
    width, height = 4 * int(radius) + 20, 2 * int(radius) + 8
    samples = half_plane((width, height), radius, focus_distance=FAR)
    image = picture(samples, method=method)
    x = np.arange(width) + 0.5 - width / 2
    near = 1 - part_of_disc(x / radius)[:, None]
    expected = near * RED + (1 - near) * GREEN
    inner = slice(int(radius), width - int(radius))
    rows = slice(int(radius), height - int(radius))
    difference = (image - expected)[rows, inner]
    assert np.abs(difference).max() < tolerance
    assert np.abs(difference).mean() < tolerance / 4
    assert np.abs(difference.mean(axis=(0, 1))).max() < 0.01


@pytest.mark.parametrize("method", METHODS)
def test_what_is_in_focus_and_near_gets_no_light_from_behind(method):
    def stripes(x, y):
        return 1 + 99 * (np.floor(y / 3) % 2)[:, None] * np.ones(3)

    samples = half_plane((60, 40), 9.0, focus_distance=NEAR, near=np.full(3, 0.1), far=stripes)
    image = picture(samples, method=method)[10:-10, 10:-10]
    np.testing.assert_allclose(image[:, :20], 0.1, atol=2e-3)
    # Up to the edge the far plane is as bright as far away from it: a mean of the stripes.
    np.testing.assert_allclose(image[:, 20:], 50.5, rtol=0.2)


@pytest.mark.parametrize("method", METHODS)
def test_what_is_far_and_in_focus_is_sharp_beside_something_blurred(method):
    def checks(x, y):
        return ((np.floor(x / 4) + np.floor(y / 4)) % 2)[:, None] * np.ones(3)

    samples = half_plane((72, 40), 6.0, focus_distance=FAR, far=checks)
    image = picture(samples, method=method)
    sharp = pinhole_mean(samples)
    beyond = slice(36 + 8, 72)
    np.testing.assert_allclose(image[:, beyond], sharp[:, beyond], atol=0.01)
    covered = slice(8, 36 - 8)
    np.testing.assert_allclose(image[8:-8, covered], np.broadcast_to(RED, (24, 20, 3)), atol=0.01)


@pytest.mark.parametrize("method", METHODS)
def test_a_hidden_light_that_no_point_of_the_lens_sees_changes_nothing(method):
    def lit(x, y):
        return (np.abs(x - 30) < 1) & (np.abs(y - 22) < 1)

    samples = planes(
        (everywhere, NEAR, np.full(3, 0.5)), (lit, FAR, np.full(3, 1e3)), size=(60, 44)
    )
    image = picture(with_parallax(samples, 10.0, NEAR), method=method)
    np.testing.assert_allclose(image, 0.5, atol=1e-3)


@pytest.mark.parametrize(
    "method",
    [
        "layered",
        "lightfield",
    ],
)
def test_an_opaque_plane_that_is_sampled_at_random_lets_no_light_through(method):
    plane = (everywhere, 1 / 0.6, np.zeros(3))
    samples = planes(plane, (everywhere, FAR, np.ones(3)), size=(64, 48), subpixels=4)
    jitter = np.random.default_rng(0).uniform(0, 1, (2, len(samples)))
    samples = samples.replace(x=np.floor(samples.x) + jitter[0], y=np.floor(samples.y) + jitter[1])
    image = picture(with_parallax(samples, 20.0, 1 / 0.6), method=method)
    assert image[12:-12, 12:-12].mean() < 0.01


def seen_through_planes(shown, size, circles, lens_points=3000, subpixels=3):
    """The picture of planes ray by ray, each as (mask, colour), from the nearest.

    ``circles`` are the signed radii of the planes' circles of confusion in pixels.
    """
    x, y = grid(size, subpixels)
    k = np.arange(lens_points) + 0.5
    radius, angle = np.sqrt(k / lens_points), k * 2.399963
    total = np.zeros((len(x), 3))
    for u, v in zip(radius * np.cos(angle), radius * np.sin(angle), strict=True):
        free = np.ones(len(x), dtype=bool)
        for (mask, colour), circle in zip(shown, circles, strict=True):
            px, py = x - circle * u, y - circle * v
            hit = free & mask(px, py)
            total[hit] += colour(px[hit], py[hit])
            free &= ~hit
    shape = size[1], subpixels, size[0], subpixels, 3
    return (total / lens_points).reshape(shape).mean(axis=(1, 3))


@pytest.mark.parametrize("focus_distance", [1.0, 1.7, 4.0])
def test_three_planes_look_as_if_traced_ray_by_ray(focus_distance):
    size = 44, 32

    def disc(x, y):
        return np.hypot(x - 17, y - 14) < 7

    def bar(x, y):
        return np.abs(x + 0.4 * y - 32) < 4

    def colour(a, b, c):
        return lambda x, y: (
            0.5 + 0.4 * np.stack([np.sin(a * x), np.cos(b * y), np.sin(c * (x + y))], axis=1)
        )

    colours = colour(0.3, 0.2, 0.1), colour(0.9, 0.5, 0.4), colour(0.5, 1.1, 0.7)
    masks, depths = (disc, bar, everywhere), (1.0, 1.7, 4.0)
    scale = 7.0
    samples = planes(*zip(masks, depths, colours, strict=True), size=size, subpixels=4)
    samples = with_parallax(samples, scale, focus_distance)
    circles = [scale * (1 / z - 1 / focus_distance) for z in depths]
    shown = list(zip(masks, colours, strict=True))
    expected = seen_through_planes(shown, size, circles, lens_points=400)
    # Nothing is known beyond the film.
    inner = slice(6, -6), slice(6, -6)
    for method, least in (("layered", 40.0), ("lightfield", 41.5)):
        image = picture(samples, method=method)
        assert psnr(image[inner], expected[inner]) > least, method


# ---------------------------------------------------------------- windows


@pytest.mark.parametrize("method", METHODS)
def test_a_crop_window_with_overscan_is_a_part_of_the_whole_picture(method):
    whole = with_parallax(
        planes(
            (lambda x, y: np.hypot(x - 20, y - 16) < 8, NEAR, RED),
            (everywhere, FAR, lambda x, y: np.stack([x, y, x + y], 1) / 60),
            size=(48, 32),
        ),
        6.0,
    )
    left, top, width, height = 15, 9, 16, 12
    camera = dataclasses.replace(whole.camera, crop_offset=(left, top), crop_size=(width, height))
    assert camera.focal_length_pixels == whole.camera.focal_length_pixels
    crop = whole.replace(camera=camera, window=(0, 0, 48, 32))
    image = picture(crop, method=method)
    assert image.shape == (height, width, 3)
    expected = picture(whole, method=method)[top : top + height, left : left + width]
    np.testing.assert_allclose(image, expected, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_light_from_beyond_the_window_is_added(method):
    samples = planes((everywhere, 8.0, lambda x, y: (x < 10)[:, None] * np.ones(3)), size=(40, 12))
    samples = with_parallax(samples, 5.0 / (1 / 2 - 1 / 8))
    camera = dataclasses.replace(samples.camera, crop_offset=(10, 0), crop_size=(30, 12))
    image = picture(samples.replace(camera=camera, window=(0, 0, 40, 12)), method=method)[6, :, 0]
    x = np.arange(30) + 0.5
    np.testing.assert_allclose(image, 1 - part_of_disc(x / 5), atol=0.03)


# ---------------------------------------------------------------- what is kept


@pytest.mark.parametrize("method", METHODS)
def test_refocusing_finds_visibility_only_once(method, monkeypatch):
    calls = {"gathered": 0, "seen": 0}
    gather, see = viewing_module.gather_with_known, LensView.of.__func__

    def counting_gather(*arguments, **options):
        calls["gathered"] += 1
        return gather(*arguments, **options)

    def counting_see(cls, *arguments, **options):
        calls["seen"] += 1
        return see(cls, *arguments, **options)

    monkeypatch.setattr(viewing_module, "gather_with_known", counting_gather)
    monkeypatch.setattr(LensView, "of", classmethod(counting_see))
    samples = with_parallax(overscanned(), 8.0)
    images = [
        picture(samples, lens=samples.lens.replace(focus_distance=u), method=method)
        for u in (1.0, 2.0, 4.0, 1.0)
    ]
    assert calls == {"gathered": 1, "seen": 1}
    np.testing.assert_allclose(images[0], images[3], atol=1e-6)
    assert np.abs(images[0] - images[2]).max() > 0.01
    # Another aperture has to look anew.
    picture(samples, lens=samples.lens.replace(aperture_radius=0.5), method=method)
    assert calls["seen"] == 2


@pytest.mark.parametrize("method", METHODS)
def test_what_was_kept_of_one_question_does_not_answer_another(method):
    def fresh(**options):
        return picture(with_parallax(overscanned(), 8.0), method=method, **options)

    samples = with_parallax(overscanned(), 8.0)
    narrow = samples.lens.replace(aperture_radius=samples.lens.aperture_radius / 3)
    questions = [
        {},
        {"lens": narrow},
        {"alpha": True},
        {"squares": 3},
        {"lens_points": 9},
        {"lens": narrow, "lens_points": 9},
        {},
    ]
    for question in questions:
        image = picture(samples, method=method, **question)
        # Threads add up light in any order, and so round it otherwise.
        np.testing.assert_allclose(image, fresh(**question), atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_samples_that_are_no_longer_needed_are_released(method):
    samples = with_parallax(overscanned(), 8.0)
    picture(samples, method=method)
    reference = weakref.ref(samples)
    del samples
    gc.collect()
    assert reference() is None


# ---------------------------------------------------------------- options


@pytest.mark.parametrize("method", METHODS)
def test_alpha_is_the_coverage_through_the_lens(method):
    samples = half_plane((40, 24), 6.0, focus_distance=FAR)
    samples = samples.replace(alpha=(samples.z == NEAR).astype(np.float32))
    image = picture(samples, alpha=True, method=method)
    assert image.shape == (24, 40, 4)
    np.testing.assert_allclose(image[..., :3], picture(samples, method=method), atol=1e-5)
    # What is red is near, and what is near has an alpha of 1.
    np.testing.assert_allclose(image[..., 3], image[..., 0], atol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_more_lens_points_come_closer_to_the_part_of_a_disc(method):
    samples = half_plane((44, 24), 8.0, focus_distance=FAR, near=np.ones(3), far=np.zeros(3))
    expected = 1 - part_of_disc((np.arange(44) - 21.5) / 8)
    errors = [
        np.abs(picture(samples, method=method, lens_points=n)[12, 8:-8, 0] - expected[8:-8]).mean()
        for n in (4, 256)
    ]
    assert errors[1] < 0.01
    assert errors[0] > 3 * errors[1]


@pytest.mark.parametrize("squares", [1, 2, 4])
@pytest.mark.parametrize("method", METHODS)
def test_any_division_into_squares_shows_the_same(method, squares):
    samples = half_plane((40, 24), 6.0, focus_distance=FAR)
    expected = 1 - part_of_disc((np.arange(40) - 19.5) / 6)
    image = picture(samples, method=method, squares=squares)[12, 6:-6, 0]
    np.testing.assert_allclose(image, expected[6:-6], atol=0.075)


@pytest.mark.parametrize("method", METHODS)
def test_a_lens_in_other_units_forms_the_same_picture(method):
    samples = overscanned()
    metres = samples.lens.replace(f_number=1.0, focus_distance=1.2)
    millimetres = pm.ThinLens(metres.focal_length, 1.0, 1200.0)
    np.testing.assert_allclose(
        picture(samples, lens=millimetres, method=method),
        picture(samples, lens=metres, method=method),
        atol=1e-5,
    )


@pytest.mark.parametrize("method", METHODS)
def test_merged_samples_give_nearly_the_same_picture(method):
    samples = half_plane((40, 24), 6.0, focus_distance=FAR)
    merged = samples.merge()
    assert len(merged) < len(samples) / 2
    difference = picture(merged, method=method) - picture(samples, method=method)
    assert np.abs(difference).max() < 0.01


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("z", [3.0, np.inf])
def test_one_sample_or_one_depth_is_enough(method, z):
    few = synthetic(1, z=np.full(1, z), x=np.full(1, 4.3), y=np.full(1, 4.3))
    image = picture(few, method=method, alpha=True)
    assert np.isfinite(image).all()
    assert image[4, 4, 3] >= 0.25
    np.testing.assert_allclose(image[4, 4, :3] / image[4, 4, 3], few.rgb[0], rtol=1e-4)
    assert np.count_nonzero(image[..., 3]) < 30


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"lens_points": 0}, ValueError, "lens_points=0"),
        ({"lens_points": 4097}, ValueError, "lens_points=4097"),
        ({"lens_points": 2.5}, TypeError, r"lens_points=2\.5"),
        ({"squares": 17}, ValueError, "squares=17"),
        ({"method": "lightfeld"}, ValueError, "method='lightfeld'.*lightfield"),
    ],
)
def test_a_bad_option_is_named(options, error, text):
    with pytest.raises(error, match=text):
        pm.focus(synthetic(), **options)


# ---------------------------------------------------------------- against Mitsuba's lens


@pytest.fixture(scope="module")
def ball_and_wall():
    """A ball before a wall: the scene, and its samples."""
    mi.set_variant("llvm_ad_rgb")
    checks = {
        "type": "checkerboard",
        "color0": {"type": "rgb", "value": [0.1, 0.2, 0.5]},
        "color1": {"type": "rgb", "value": [0.9, 0.6, 0.2]},
        "to_uv": mi.ScalarTransform4f().scale([9, 9, 1]),
    }
    wall = mi.ScalarTransform4f().translate([0, 0, 4]).rotate([0, 1, 0], 180).scale(5)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "potmesil",
                **LENS,
                "film": {
                    "type": "hdrfilm",
                    "width": 48,
                    "height": 32,
                    "pixel_format": "rgb",
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "multijitter", "sample_count": 64},
            },
            "sky": {"type": "constant", "radiance": 0.5},
            "ball": {
                "type": "sphere",
                "center": [0, 0, 2.3],
                "radius": 0.3,
                "bsdf": diffuse(0.8, 0.3, 0.1),
            },
            "wall": {
                "type": "rectangle",
                "to_world": wall,
                "emitter": {"type": "area", "radiance": checks},
                "bsdf": diffuse(0, 0, 0),
            },
        }
    )
    return scene, pm.render_samples(scene, sampling=pm.Sampling(min_f_number=0.2))


@pytest.mark.parametrize(
    ("focus_distance", "least"),
    [(2.0, {"layered": 40.0, "lightfield": 42.5}), (4.0, {"layered": 44.5, "lightfield": 46.0})],
)
def test_pictures_come_closer_to_mitsubas_lens_than_the_papers(
    ball_and_wall, focus_distance, least
):
    scene, samples = ball_and_wall
    lens = samples.lens.replace(f_number=0.2, focus_distance=focus_distance)
    assert 6 < radius_per_vergence(lens, samples.camera) < 8
    sensor = mi.load_dict(
        {
            **lens.to_thinlens(),
            "film": scene.sensors()[0].film(),
            "sampler": {"type": "independent", "sample_count": 1024},
        }
    )
    reference = np.array(mi.render(scene, sensor=sensor, seed=1))
    found = {method: psnr(pm.focus(samples, lens, method=method), reference) for method in METHODS}
    pinhole = pm.render_samples(scene, sampling=pm.Sampling(overscan=0, layers=1))
    papers = max(
        psnr(pm.focus(pinhole, lens, method="paper", inverse_square=switch), reference)
        for switch in (True, False)
    )
    for method in METHODS:
        assert found[method] > max(papers, least[method])
