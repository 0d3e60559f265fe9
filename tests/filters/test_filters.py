import dataclasses
import math
from typing import ClassVar

import mitsuba as mi
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.special import j0, j1

import potmesil_mi as pm
from potmesil_mi import cli
from potmesil_mi.focusing import session
from scenes import SCENES, still_life, synthetic

LENS = pm.ThinLens(50.0, 8.0, frame_width=36.0)
FIGURE = ["render", str(SCENES / "figure11.xml"), "-D", "res=24", "-D", "spp=4"]


class Hexagon:
    """A hexagonal aperture with a corner at the top, its edges as soft as an element."""

    def __repr__(self):  # Part of the names of tests, which are the same in every process.
        return f"{type(self).__name__}()"

    def transmission(self, size):
        at = (2 * np.arange(size, dtype=np.float32) + 1) / size - 1
        inside = np.ones((size, size), dtype=np.float32)
        for angle in np.radians([0, 60, 120]):
            distance = np.abs(math.cos(angle) * at[None, :] + math.sin(angle) * at[:, None])
            beyond = (math.cos(math.pi / 6) - distance) * size / 2
            inside = np.minimum(inside, np.clip(beyond + 0.5, 0, 1))
        return inside


class Box(Hexagon):
    def transmission(self, size):
        return np.ones((size, size))


FILTERS = [
    pm.Star(),
    pm.Star(points=5, length=0.7, threshold=0, rotation=20, strength=1),
    pm.Diffraction(samples=2),
    pm.Diffraction(scale=30, aperture=Hexagon(), threshold=1, samples=3),
    pm.Defocus(0.03),
    pm.Fade(0.3, (0.2, 0.4, 0.6)),
]
CONVOLUTIONS = FILTERS[:5]


def lamps(*places, size=(60, 80), light=(200.0, 150.0, 80.0), channels=3):
    picture = np.zeros((*size, channels))
    for row, column in places:
        picture[row, column, :3] = light
    return picture


def applied(picture, *filters, lens=LENS):
    return pm.apply_filters(picture, filters, lens)


def at(kernel, radius, angle):
    """A kernel's (middle channel's) values, ``angle`` in radians anticlockwise from the top."""
    middle = np.array(kernel.shape[:2]) // 2
    row, column = middle[0] - radius * np.cos(angle), middle[1] - radius * np.sin(angle)
    values = kernel if kernel.ndim == 2 else kernel[..., 1]
    return map_coordinates(values, [row, column], order=3)


def around(kernel, radii, count=720):
    """Mean of a kernel over ``radii``, at angles anticlockwise from the top."""
    angle = np.arange(count) * 2 * math.pi / count
    return at(kernel, radii[:, None], angle).mean(axis=0)


def peaks(values, least):
    """Angles in degrees of maxima above ``least`` of the highest value."""
    smooth = sum((7 - abs(k)) * np.roll(values, k) for k in range(-6, 7))
    top = (smooth >= np.roll(smooth, 1)) & (smooth > np.roll(smooth, -1))
    found = np.flatnonzero(top & (smooth > least * smooth.max()))
    return found * 360 / len(values)


def within(kernel, radius):
    """Share of each channel within ``radius`` pixels of the middle."""
    down, across = (np.arange(n) - n // 2 for n in kernel.shape[:2])
    return kernel[np.hypot(down[:, None], across) <= radius].sum(axis=0)


# ---------------------------------------------------------------- all of them


@pytest.mark.parametrize("one", FILTERS, ids=str)
@pytest.mark.parametrize("channels", [3, 4])
def test_the_picture_given_stays_as_it_is(one, channels):
    picture = lamps((30, 40), (2, 77), channels=channels) + 0.25
    before = picture.copy()
    direct = one(picture, LENS, 80 / 36)
    np.testing.assert_array_equal(picture, before)
    assert not np.shares_memory(direct, picture)
    result = applied(picture, one)
    np.testing.assert_array_equal(picture, before)
    assert result.shape == picture.shape
    assert result.dtype == np.float32
    np.testing.assert_allclose(result, direct, rtol=1e-6)


@pytest.mark.parametrize("one", CONVOLUTIONS, ids=str)
def test_a_uniform_picture_stays_uniform_up_to_its_borders(one):
    picture = np.full((50, 70, 4), [3.0, 2.0, 0.5, 1.0])
    np.testing.assert_allclose(applied(picture, one), picture, rtol=1e-5)


@pytest.mark.parametrize("one", CONVOLUTIONS, ids=str)
def test_light_far_from_the_border_is_conserved(one):
    picture = lamps((75, 100), (80, 93), size=(151, 201)) + 0.1
    small = {"scale": 2.0} if isinstance(one, pm.Diffraction) else {}
    small |= {"length": 0.2} if isinstance(one, pm.Star) else {}
    result = applied(picture, type(one)(**{**vars(one), **small}))
    total = picture.sum(axis=(0, 1))
    np.testing.assert_allclose(result.sum(axis=(0, 1), dtype=float), total, rtol=2e-4)
    assert np.abs(result - picture).max() > 1


@pytest.mark.parametrize("one", FILTERS, ids=str)
def test_no_light_is_negative_beside_very_bright_lamps(one):
    picture = lamps((30, 40), (0, 0), light=(1e7, 1e5, 0))
    assert applied(picture, one).min() >= 0


@pytest.mark.parametrize("one", CONVOLUTIONS, ids=str)
def test_values_that_are_not_finite_do_not_spread(one):
    picture = lamps((30, 40))
    picture[3, 4] = np.nan
    picture[50, 60, 1] = np.inf
    result = applied(picture, one)
    picture[~np.isfinite(picture)] = 0
    np.testing.assert_array_equal(result, applied(picture, one))


@pytest.mark.parametrize("one", [*CONVOLUTIONS, pm.Fade(0.0)], ids=str)
def test_a_black_picture_stays_black(one):
    assert (applied(np.zeros((9, 13, 3)), one) == 0).all()


@pytest.mark.parametrize("one", [FILTERS[0], FILTERS[3]], ids=str)
def test_a_picture_of_nothing_bright_is_not_changed(one):
    picture = np.random.default_rng(1).uniform(0, 1, (20, 30, 3)).astype(np.float32)
    np.testing.assert_array_equal(applied(picture, one), picture)


@pytest.mark.parametrize("one", [FILTERS[0], *FILTERS[3:]], ids=str)
def test_a_crop_of_the_film_has_effects_of_the_same_size(one):
    picture = lamps((32, 40), size=(64, 80), light=(400.0, 300.0, 200.0))
    whole = pm.apply_filters(picture, [one], LENS, 80 / 36)[26:39, 34:47]
    part = pm.apply_filters(picture[20:45, 28:53], [one], LENS, 80 / 36)[6:19, 6:19]
    # What is beyond the crop is spread within it: only shapes can be compared.
    np.testing.assert_allclose(part / part.sum(), whole / whole.sum(), rtol=0.2, atol=1e-4)


def test_filters_are_applied_in_their_order():
    picture = lamps((30, 40))
    star, fade = pm.Star(threshold=50), pm.Fade(0.9)
    first = applied(picture, star, fade)
    np.testing.assert_allclose(first, applied(applied(picture, star), fade), rtol=1e-6)
    other = applied(picture, fade, star)
    assert np.count_nonzero(other) < np.count_nonzero(first), "what has faded is not spread"


def test_a_filter_of_ones_own_has_a_text():
    @dataclasses.dataclass(frozen=True)
    class Negative(pm.Filter):
        most: float = 1.0
        name: ClassVar[str] = "negative"

        def __call__(self, picture, lens, pixels_per_mm):
            return self.most - picture

    try:
        assert pm.parse_filter("negative:most=2") == Negative(2)
        np.testing.assert_array_equal(applied(lamps((3, 3)), "negative:most=2"), 2 - lamps((3, 3)))
    finally:
        del pm.Filter._registered["negative"]


def test_any_function_can_be_a_filter():
    picture = np.full((4, 6, 3), 0.25)
    seen = []

    def double(image, lens, pixels_per_mm):
        seen.append((lens, pixels_per_mm))
        return 2 * image

    np.testing.assert_allclose(applied(picture, double, "fade:amount=0.5"), 0.25)
    assert seen == [(LENS, 6 / 36)]
    with pytest.raises(ValueError, match=r"shape \(4, 6\), must be \(4, 6, 3\)"):
        applied(picture, lambda image, *_: image[..., 0])


# ---------------------------------------------------------------- star


@pytest.mark.parametrize("points", [2, 3, 4, 5, 6, 8])
def test_a_star_has_its_points_at_equal_angles_from_the_top(points):
    kernel = pm.Star(points, length=0.2, rotation=10).kernel(500, (999, 999))
    angles = peaks(around(kernel, np.arange(20, 80)), 0.5)
    expected = (10 + 360 / points * np.arange(points)) % 360
    np.testing.assert_allclose(angles, np.sort(expected), atol=1)


@pytest.mark.parametrize("rotation", [0, 7, 33, 45])
def test_stars_rays_have_neither_dots_nor_stairs(rotation):
    kernel = pm.Star(1, length=0.4, rotation=rotation).kernel(500, (999, 999))
    middle = len(kernel) // 2
    angle, up = math.radians(rotation), np.arange(10, 120)
    rows = kernel[middle - up]
    light = rows.sum(axis=1)
    even = light / (1 - up / (200 * math.cos(angle))) ** 2
    np.testing.assert_allclose(even, even.mean(), rtol=0.01)
    place = (rows * (np.arange(len(kernel)) - middle)).sum(axis=1) / light
    np.testing.assert_allclose(place, -up * math.tan(angle), atol=0.05)


def test_a_star_is_of_the_same_size_on_a_larger_film():
    star = pm.Star(points=6, length=0.2, threshold=0, strength=1, width=0.02)
    small, large = (star.kernel(n, (2 * n, 2 * n)) for n in (200, 400))
    # Four pixels of the one are one of the other.
    radii = np.arange(10, 35)
    profile = around(large, 2 * radii) * 4
    np.testing.assert_allclose(profile, around(small, radii), atol=5e-3 * profile.max())


def test_a_star_takes_its_light_from_above_the_threshold_and_keeps_the_hue():
    picture = lamps((30, 40), light=(11.0, 5.5, 2.2), size=(61, 81))
    result = applied(picture, pm.Star(threshold=1, strength=0.5, length=0.2))
    # Ten elevenths of the lamp are above the threshold, half of them are moved.
    np.testing.assert_allclose(result.sum(axis=(0, 1)), picture.sum(axis=(0, 1)), rtol=1e-5)
    rays = result.sum(axis=(0, 1)) - result[30, 40]
    np.testing.assert_allclose(rays / rays[0], [1, 0.5, 0.2], rtol=1e-4)
    kernel = pm.Star(length=0.2).kernel(81, (61, 81))
    expected = picture[30, 40] * (1 - 5 / 11 * (1 - kernel.max()))
    np.testing.assert_allclose(result[30, 40], expected, rtol=1e-4)


# ---------------------------------------------------------------- diffraction


@pytest.mark.parametrize(("f_number", "pixels_per_mm", "scale"), [(8, 1e4, 1), (4, 100, 200)])
def test_the_first_dark_ring_of_a_disc_has_the_airy_radius(f_number, pixels_per_mm, scale):
    lens = LENS.replace(f_number=f_number)
    blur = pm.Diffraction(scale, bandwidth=0, wavelengths=(650, 550, 450))
    kernel = blur.kernel(lens, pixels_per_mm, (120, 120))
    for channel, wavelength in enumerate((650, 550, 450)):
        airy = 1.2197 * wavelength * 1e-6 * f_number * pixels_per_mm * scale
        profile = kernel[119, 119:, channel]
        near = round(0.7 * airy)
        dark = near + np.argmin(profile[near : round(1.3 * airy)])
        assert dark == pytest.approx(airy, abs=1)
        assert profile[dark] < 1e-3 * profile[0]


def test_the_light_of_a_disc_is_spread_as_far_as_theory_says():
    # In most pixels of this frame the pattern is continued, far beyond the transform.
    kernel = pm.Diffraction(bandwidth=0, wavelengths=(550,) * 3).kernel(LENS, 100, (400, 400))
    radii = np.array([5, 10, 20, 40, 80, 160, 320])
    shares = np.array([within(kernel, radius)[1] for radius in radii])
    v = np.pi * radii / (0.55e-3 * 8 * 100)
    expected = 1 - j0(v) ** 2 - j1(v) ** 2
    np.testing.assert_allclose(np.diff(shares), np.diff(expected), rtol=0.1)
    assert shares[0] == pytest.approx(expected[0], abs=0.03)


@pytest.mark.parametrize("scale", [1, 20])
def test_a_hexagon_has_six_spikes_across_its_sides(scale):
    kernel = pm.Diffraction(scale, aperture=Hexagon()).kernel(LENS, 20, (200, 200))
    angles = peaks(around(kernel, np.arange(40, 180)), 0.3)
    np.testing.assert_allclose(angles, [30, 90, 150, 210, 270, 330], atol=1)
    np.testing.assert_allclose(kernel, kernel[::-1, ::-1], atol=1e-9)


def test_the_aperture_is_the_lenss_own_by_default():
    lens = LENS.replace(aperture=pm.Polygon(blades=6, rotation=10))
    kernel = pm.Diffraction(20).kernel(lens, 20, (200, 200))
    angles = peaks(around(kernel, np.arange(40, 180)), 0.3)
    np.testing.assert_allclose(angles, 10 + np.array([30, 90, 150, 210, 270, 330]), atol=1)


def test_an_anamorphic_lens_spreads_light_sideways():
    plain, tall = (
        pm.Diffraction(100, aperture=Box(), bandwidth=0).kernel(
            LENS.replace(squeeze=squeeze), 20, (150, 150)
        )[..., 1]
        for squeeze in (1, 2)
    )
    np.testing.assert_allclose(tall.sum(axis=1), plain.sum(axis=1), rtol=0.05, atol=1e-4)
    wide, narrow = tall.sum(axis=0)[149:], plain.sum(axis=0)[149:]
    assert wide[0] == pytest.approx(narrow[0] / 2, rel=0.05)
    np.testing.assert_allclose(wide[20:60:2], narrow[10:30] / 2, rtol=0.3, atol=1e-3)


def test_the_pattern_grows_with_the_wavelength():
    red, blue = pm.Diffraction(2, aperture=Hexagon()), pm.Diffraction(1, aperture=Hexagon())
    twice = pm.Diffraction(
        1, aperture=Hexagon(), wavelengths=(1220.0, 1100.0, 930.0), bandwidth=160
    )
    assert blue != red
    np.testing.assert_array_equal(
        red.kernel(LENS, 2000, (60, 60)), twice.kernel(LENS, 2000, (60, 60))
    )
    kernel = pm.Diffraction().kernel(LENS, 2000, (150, 150))
    radii = [next(r for r in range(150) if within(kernel, r)[c] > 0.83) for c in range(3)]
    assert radii[0] / radii[2] == pytest.approx(610 / 465, rel=0.1)
    assert radii[0] > radii[1] > radii[2]


def test_a_band_of_wavelengths_makes_streaks_of_dots():
    def unevenness(**options):
        blur = pm.Diffraction(100, aperture=Hexagon(), **options)
        radii = np.arange(40, 180)
        spike = at(blur.kernel(LENS, 20, (200, 200)), radii, math.pi / 2) * radii**2
        return spike.std() / spike.mean()

    assert unevenness() < 0.3 * unevenness(bandwidth=0)


def test_patterns_are_integrated_over_pixels():
    blur = pm.Diffraction(5, aperture=Hexagon(), samples=3)
    fine, coarse = blur.kernel(LENS, 60, (122, 122)), blur.kernel(LENS, 20, (41, 41))
    summed = fine.reshape(81, 3, 81, 3, 3).sum(axis=(1, 3))
    np.testing.assert_allclose(summed, coarse, rtol=0.3, atol=1e-5)
    np.testing.assert_allclose(summed[40, 40], coarse[40, 40], rtol=0.01)


def test_a_closed_aperture_is_refused():
    with pytest.raises(ValueError, match=r"f_number=inf.*closed"):
        applied(lamps((3, 3)), pm.Diffraction(), lens=LENS.replace(f_number=math.inf))


class _Wrong:
    def __init__(self, value):
        self.value = value

    def transmission(self, size):
        return self.value(size)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (lambda n: np.zeros((n, n)), "let light through"),
        (lambda n: np.full((n, n), np.nan), "finite"),
        (lambda n: np.ones((n, 3)), "must be"),
    ],
)
def test_an_aperture_that_cannot_be_one_is_refused(value, text):
    with pytest.raises(ValueError, match=f"aperture.*{text}"):
        applied(lamps((3, 3)), pm.Diffraction(aperture=_Wrong(value)))


# ---------------------------------------------------------------- defocus, fade


def test_defocus_makes_discs_of_its_radius():
    result = applied(lamps((60, 80), size=(121, 161), light=(9, 9, 9)), pm.Defocus(0.1))[..., 0]
    lit = result > result.max() / 2
    assert lit.sum() == pytest.approx(math.pi * 16.1**2, rel=0.02)
    assert result.max() == pytest.approx(9 / (math.pi * 16.1**2), rel=1e-4)


def test_defocus_blurs_alpha_with_the_colours():
    picture = np.zeros((40, 60, 4))
    picture[:, 30:] = 1
    result = applied(picture, pm.Defocus(0.1))
    np.testing.assert_allclose(result[..., 3], result[..., 0], atol=1e-6)
    assert ((result[..., 3] > 0.1) & (result[..., 3] < 0.9)).any()


@pytest.mark.parametrize("one", [FILTERS[0], FILTERS[2], FILTERS[5]], ids=str)
def test_the_others_leave_alpha_alone(one):
    picture = lamps((30, 40), channels=4)
    picture[..., 3] = np.random.default_rng(2).uniform(0, 1, picture.shape[:2])
    np.testing.assert_allclose(applied(picture, one)[..., 3], picture[..., 3], rtol=1e-6)


def test_defocus_of_no_radius_changes_nothing():
    picture = np.random.default_rng(1).uniform(0, 1, (20, 30, 3))
    np.testing.assert_allclose(applied(picture, pm.Defocus(0)), picture, atol=1e-6)


def test_fade_mixes_the_picture_with_the_colour():
    picture = np.random.default_rng(1).uniform(0, 2, (5, 7, 3))
    np.testing.assert_allclose(applied(picture, pm.Fade(0)), picture, rtol=1e-6)
    color = (0.5, 0.25, 1.0)
    half = applied(picture, pm.Fade(0.5, color))
    np.testing.assert_allclose(half, picture / 2 + np.array(color) / 2, rtol=1e-6)
    np.testing.assert_allclose(applied(picture, pm.Fade(1, color))[2, 3], color, rtol=1e-6)


def test_fade_leaves_what_is_transparent_transparent():
    picture = np.full((5, 7, 4), 0.5)
    picture[0] = 0
    faded = applied(picture, pm.Fade(1.0, (1, 1, 1)))
    assert (faded[0] == 0).all()
    np.testing.assert_allclose(faded[1:], 0.5)


# ---------------------------------------------------------------- texts


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("star", pm.Star()),
        ("star:points=6,length=0.1,threshold=2", pm.Star(6, 0.1, 2)),
        (" star : rotation = 15 , strength=1 ", pm.Star(rotation=15, strength=1)),
        ("diffraction:wavelengths=600/500/400", pm.Diffraction(wavelengths=(600, 500, 400))),
        ("diffraction:scale=20,samples=3", pm.Diffraction(20, samples=3)),
        ("defocus:radius=1e-2", pm.Defocus(0.01)),
        ("fade:amount=0.5,color=1/0.9/0.8", pm.Fade(0.5, (1, 0.9, 0.8))),
    ],
)  # fmt: skip
def test_texts_are_filters(text, expected):
    assert pm.parse_filter(text) == expected
    assert pm.parse_filter(str(expected)) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("strar", "filter='strar'.*star, diffraction, defocus, fade"),
        ("", "filter=''.*star, diffraction"),
        ("star:lenght=3", "lenght.*star.*points, length, threshold, rotation, strength, width"),
        ("diffraction:aperture=3", "aperture: not a parameter"),
        ("star:points", "filter='star:points'.*parameter=value"),
        ("star:points=4,points=5", "filter='star:points=4,points=5'"),
        ("star:points=6.5", r"points=6\.5.*whole number from 1 to 64"),
        ("star:points=0", "points=0.*1 to 64"),
        ("star:length=long", "length='long'.*number"),
        ("star:length=-1", r"length=-1.*0 to 2"),
        ("star:threshold=nan", "threshold=nan"),
        ("star:strength=2", "strength=2.*0 to 1"),
        ("diffraction:scale=0", "scale=0.*0.01 to 1000"),
        ("diffraction:wavelengths=500", "wavelengths=500.*three"),
        ("diffraction:wavelengths=500/400", "wavelengths=.*three"),
        ("diffraction:wavelengths=1/2/3", "wavelengths=.*100 to 10000"),
        ("diffraction:bandwidth=1000", "bandwidth=1000.*less than twice"),
        ("diffraction:samples=0", "samples=0"),
        ("defocus", "needs radius"),
        ("defocus:radius=2", "radius=2.*0 to 1"),
        ("fade", "needs amount"),
        ("fade:amount=1.5", "amount=1.5.*0 to 1"),
        ("fade:amount=1,color=1/-1/1", "color=-1"),
    ],
)
def test_what_is_wrong_with_a_text_is_named(text, message):
    with pytest.raises((ValueError, TypeError), match=message):
        pm.parse_filter(text)


@pytest.mark.parametrize(
    ("filters", "message"),
    [
        ("star", r"filters='star'.*list"),
        (pm.Star(), "filters=Star.*list"),
        ([3], "filters: 3 must be a filter"),
        ([pm.Star], "filters:.*must be a filter"),
    ],
)
def test_what_is_no_list_of_filters_is_refused(filters, message):
    with pytest.raises(TypeError, match=message):
        pm.apply_filters(np.zeros((3, 3, 3)), filters, LENS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((3, 3)), [], LENS), r"picture=.*: has shape \(3, 3\)"),
        ((np.zeros((3, 3, 2)), [], LENS), r"picture=.*: has shape \(3, 3, 2\)"),
        ((np.zeros((3, 3, 3)), [], None), "lens=None.*ThinLens"),
        ((np.zeros((3, 3, 3)), [], LENS, -1), "pixels_per_mm=-1"),
    ],
)
def test_what_cannot_be_filtered_is_named(arguments, message):
    with pytest.raises((ValueError, TypeError), match=message):
        pm.apply_filters(*arguments)


def test_parameters_that_are_no_numbers_are_refused():
    with pytest.raises(TypeError, match=r"aperture=6.*transmission"):
        pm.Diffraction(aperture=6)
    with pytest.raises(TypeError, match=r"color=0.*three"):
        pm.Fade(0.5, 0)
    with pytest.raises(TypeError, match="points=True"):
        pm.Star(points=True)


# ---------------------------------------------------------------- where they are used


TEXTS = ["star:points=6,length=0.3,threshold=0.2", "defocus:radius=0.05", "fade:amount=0.25"]


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("alpha", [False, True])
def test_focus_applies_filters_to_the_finished_picture(alpha):
    samples = synthetic()
    lens = samples.lens.replace(focal_length=85.0, f_number=4)
    plain = np.array(pm.focus(samples, lens, alpha=alpha))
    filters = [pm.Star(4, 0.4, 0.5), pm.Diffraction(300, samples=2), *TEXTS]
    image = np.array(pm.focus(samples, lens, alpha=alpha, filters=filters))
    # The field of view stays the samples': their whole film is the frame.
    pixels_per_mm = samples.camera.focal_length_pixels / lens.film_distance
    frame = lens.replace(frame_width=20 / pixels_per_mm)
    expected = pm.apply_filters(plain, filters, frame, pixels_per_mm)
    np.testing.assert_allclose(image, expected, rtol=1e-4, atol=1e-5)
    assert np.abs(image - plain).max() > 0.05


@pytest.mark.usefixtures("variant_llvm")
def test_focus_refuses_a_wrong_filter_before_it_starts(monkeypatch):
    monkeypatch.setattr(session, "Exposure", lambda *_, **__: pytest.fail("started"))
    with pytest.raises(ValueError, match="filter='sepia'"):
        pm.focus(synthetic(), filters=["sepia"])
    with pytest.raises(TypeError, match="filters='star'"):
        pm.focus(synthetic(), filters="star")


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("pixel_format", ["rgb", "rgba", "luminance"])
def test_the_integrator_applies_filters_in_the_order_of_their_names(pixel_format):
    # Named so that neither the order in the scene nor that of letters is right.
    names = {"filter_10": TEXTS[2], "filter": TEXTS[0], "filter_2": TEXTS[1]}
    focus = {"type": "focus", "nested": {"type": "path", "max_depth": 3}}
    scene = still_life({**focus, **names}, film={"pixel_format": pixel_format})
    assert [str(one) for one in scene.integrator().filters] == TEXTS
    assert TEXTS[1] in str(scene.integrator())
    image = np.array(mi.render(scene, seed=2))
    samples = pm.render_samples(scene, seed=2)
    expected = np.array(pm.focus(samples, filters=TEXTS, alpha=pixel_format == "rgba"))
    if pixel_format == "luminance":
        expected = (expected @ [0.212671, 0.715160, 0.072169])[..., None]
    np.testing.assert_allclose(image, expected, atol=1e-4)


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize(
    ("value", "text"),
    [("sepia", "filter='sepia'"), ("star:points=0", "points=0"), (3, "filter_2=3")],
)
def test_a_wrong_filter_is_named_when_the_scene_is_loaded(value, text):
    focus = {"type": "focus", "nested": {"type": "path"}}
    with pytest.raises((ValueError, TypeError, RuntimeError), match=text):
        mi.load_dict({**focus, "filter_2": value})


@pytest.mark.usefixtures("variant_llvm")
def test_xml_and_the_command_line_agree_with_python(tmp_path):
    filters = [argument for text in TEXTS for argument in ("--filter", text)]
    kept, xml = tmp_path / "samples.exr", tmp_path / "figure.xml"
    rendered, focused, read = (tmp_path / name for name in ("a.exr", "b.exr", "c.exr"))
    assert cli.main([*FIGURE, *filters, "-o", str(rendered), "--samples", str(kept)]) == 0
    assert cli.main(["focus", str(kept), *filters, "-o", str(focused)]) == 0
    strings = "".join(f'<string name="filter_{i}" value="{text}"/>' for i, text in enumerate(TEXTS))
    figure = (SCENES / "figure11.xml").read_text()
    opening = '<integrator type="focus">'
    assert figure.count(opening) == 1
    figure = figure.replace(opening, opening + strings)
    xml.write_text(figure)
    (tmp_path / "fragments").symlink_to(SCENES / "fragments")
    (tmp_path / "textures").symlink_to(SCENES / "textures")
    small = ["-D", "res=24", "-D", "spp=4"]
    assert cli.main(["render", str(xml), *small, "-o", str(read)]) == 0
    expected = np.array(pm.focus(pm.PointSamples.load(kept), filters=TEXTS))
    plain = np.array(pm.focus(pm.PointSamples.load(kept)))
    assert np.abs(expected - plain).max() > 0.05
    for path in (rendered, focused, read):
        np.testing.assert_allclose(np.array(mi.Bitmap(str(path))), expected, atol=1e-4)
    # Those of the command line take the place of the scene's.
    assert cli.main(["render", str(xml), *small, "--filter", "fade:amount=1", "-o", str(read)]) == 0
    assert (np.array(mi.Bitmap(str(read))) == 0).all()


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("command", ["render", "focus"])
def test_the_command_line_finds_a_wrong_filter_before_it_renders(
    tmp_path, monkeypatch, capsys, command
):
    started = "potmesil_mi.tracing.hidden_surface.render_samples"
    monkeypatch.setattr(started, lambda *_, **__: pytest.fail("rendering started"))
    arguments = FIGURE if command == "render" else ["focus", "nothing.exr"]
    out = ["-o", str(tmp_path / "a.png")]
    assert cli.main([*arguments, *out, "--filter", "star:pionts=3"]) == 1
    assert "pionts: not a parameter of the filter star" in capsys.readouterr().err
