"""Small circles: what is nearly in focus is spread by where in its subpixels its light is."""

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.evaluation.metrics import psnr
from potmesil_mi.focusing.small_circles import BESIDE, LEVELS, STEP, responses_of
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = (24, 20)
FINE = 16
"""Subpixels on a side of a pixel of what pictures are compared with."""

FOCUS = 2.0

ONE_SQUARE = "layered:squares=1"


def tiles(x, y):
    """Slanting tiles about a pixel wide, of three colours: edges that pixels do not show."""
    u, v = 0.93 * x + 0.37 * y, 0.97 * y - 0.41 * x
    waves = np.sin(3.1 * u) * np.sin(2.3 * v), np.sin(2.9 * v), np.sin(4.7 * u)
    return 0.5 + 0.4 * np.sign(np.stack(waves, axis=-1))


def samples_of(colours, radius, depth, subpixels=16, size=SIZE, seed=None, **lens):
    """Samples of a plane at a depth with circles of a radius in pixels, even or random in them."""
    width, height = size
    count = width * height * subpixels**2
    y, x = np.divmod(np.arange(count), width * subpixels)
    nudge = 0.5 if seed is None else np.random.default_rng(seed).random((2, count))
    x, y = (np.stack([x, y]) + nudge) / subpixels
    samples = synthetic(
        count,
        size=size,
        x=x,
        y=y,
        z=np.full(count, depth),
        rgb=colours(x, y),
        weight=np.full(count, subpixels**-2.0),
        layer=np.zeros(count, np.uint8),
        surface=np.ones(count, np.uint32),
    )
    scale = radius / abs(1 / depth - 1 / FOCUS)
    return samples.replace(
        lens=pm.ThinLens(
            50.0,
            aperture_radius=scale / samples.camera.focal_length_pixels,
            focus_distance=FOCUS,
            millimeters_per_unit=1000.0,
            **lens,
        )
    )


def spread_exactly(colours, radius, aperture, squeeze=1.0, size=SIZE):
    """Pixels of a plane seen through an aperture: of each point of the film and of the lens."""
    width, height = size
    reach = int(np.ceil(abs(radius) * FINE)) + 1
    y, x = np.mgrid[-reach : height * FINE + reach, -reach : width * FINE + reach]
    # Beyond the film there is what is at its edge: there pictures are not compared.
    light = colours((x + 0.5) / FINE, (y + 0.5) / FINE)
    kernel = aperture.circle_kernel(radius * FINE, squeeze, (0.5, 0.5))
    down, across = (n // 2 for n in kernel.shape)
    total = np.zeros((height * FINE, width * FINE, 3))
    for (j, i), share in np.ndenumerate(kernel):
        top, left = reach - (j - down), reach - (i - across)
        total += share * light[top : top + height * FINE, left : left + width * FINE]
    return total.reshape(height, FINE, width, FINE, 3).mean(axis=(1, 3))


def inner(image, margin=3):
    return np.asarray(image, dtype=np.float64)[margin:-margin, margin:-margin]


@pytest.mark.parametrize("aperture", [pm.Disc(), pm.Polygon(3), pm.Polygon(6)])
@pytest.mark.parametrize("degree", [1, 2])
def test_no_light_is_made_and_even_light_leaves_to_all_sides_as_the_aperture_lets_it(
    aperture, degree
):
    responses = responses_of(aperture, 1.0, degree)
    assert responses.shape == (2 * LEVELS + 1, 2, degree + 1, len(BESIDE))
    assert np.abs(responses[LEVELS]).max() < 1e-6
    even = responses[:, :, 0]
    assert even.min() >= 0
    assert even.sum(axis=-1).max() < 1
    # The mean of even light moves as the middle of the aperture does, while none goes farther than
    # the subpixels that are known. Circles smaller than a cell are in the middle.
    radius = np.arange(-LEVELS, LEVELS + 1) * STEP
    kernel = aperture.circle_kernel(64.0, 1.0, (0.5, 0.5))
    places = np.arange(len(kernel)) - len(kernel) // 2
    close = (np.abs(radius) < 1.4) & (np.abs(radius) > 1 / 16)
    for axis in (0, 1):
        middle = kernel.sum(axis=axis) @ places / 64
        np.testing.assert_allclose(
            (even[:, axis] @ np.array(BESIDE))[close], (middle * radius)[close], atol=4e-3
        )


@pytest.mark.parametrize("depth", [1.5, 3.0])
@pytest.mark.parametrize(
    ("squares", "radius", "least"), [(1, 0.3, 46), (1, 0.6, 42), (1, 0.9, 36), (2, 0.3, 43)]
)
def test_detail_finer_than_a_pixel_is_spread_as_the_lens_spreads_it(squares, radius, least, depth):
    samples = samples_of(tiles, radius, depth)
    expected = inner(spread_exactly(tiles, radius, pm.Disc()))
    image = pm.focus(samples, method=f"layered:squares={squares}")
    # Without detail it would be 7 to 15 dB less, but 5 for two squares.
    assert psnr(inner(image), expected) > least


@pytest.mark.parametrize("depth", [1.5, 3.0])
def test_an_aperture_that_is_not_symmetric_is_upside_down_on_one_side_of_the_focus(depth):
    half = np.hypot(*np.mgrid[-1:1:32j, -1:1:32j]) < 1
    half[:, :16] = False
    aperture, radius = pm.ImageAperture(half.astype(float)), 0.7
    samples = samples_of(tiles, radius, depth)
    signed = radius if depth < FOCUS else -radius
    right, wrong = (inner(spread_exactly(tiles, of, aperture)) for of in (signed, -signed))
    image = inner(pm.focus(samples, psf=aperture, method=ONE_SQUARE))
    assert psnr(image, right) > 34
    assert psnr(image, right) > psnr(image, wrong) + 6


def test_a_squeezed_lens_spreads_less_across_than_down():
    samples = samples_of(tiles, 0.8, 1.5, squeeze=2.0)
    image = inner(pm.focus(samples, method=ONE_SQUARE))
    assert psnr(image, inner(spread_exactly(tiles, 0.8, pm.Disc(), squeeze=2.0))) > 36
    assert psnr(image, inner(spread_exactly(tiles, 0.8, pm.Disc()))) < 32


@pytest.mark.parametrize("squares", [1, 2])
def test_chance_in_where_samples_are_adds_no_noise_to_what_is_even(squares):
    samples = samples_of(lambda x, y: np.full((len(x), 3), 0.6), 0.8, 1.5, subpixels=3, seed=3)
    rng = np.random.default_rng(4)
    samples = samples.replace(x=rng.permutation(samples.x))
    image = inner(pm.focus(samples, method=f"layered:squares={squares}"))
    np.testing.assert_allclose(image, 0.6, atol=1e-5)


@pytest.mark.parametrize("squares", [1, 2])
@pytest.mark.parametrize("radius", [0.05, 0.2, 0.5, 0.9])
def test_where_light_is_in_corners_no_pixel_is_less_than_nothing(squares, radius):
    """No polynomial of so low a degree tells that: here and there it is negative."""

    def lit(x, y):
        there = (x % 1 > 0.8) & (y % 1 > 0.8) & ((x // 1 + y // 1) % 3 == 0)
        there &= (x > 3) & (x < SIZE[0] - 3) & (y > 3) & (y < SIZE[1] - 3)
        return np.where(there[:, None], 1, 1e-4) * np.ones(3)

    for depth in (1.5, 3.0):
        samples = samples_of(lit, radius, depth)
        image = np.asarray(pm.focus(samples, method=f"layered:squares={squares}"))
        assert image.min() > 0
        mean = (samples.weight[:, None] * samples.rgb).sum() / image.size
        assert image.mean() == pytest.approx(mean, rel=5e-3)


@pytest.mark.parametrize("alpha", [False, True])
def test_light_and_alpha_are_kept(alpha):
    def spot(x, y):
        return np.where((np.hypot(x - 12.2, y - 10.3) < 3)[:, None], tiles(x, y), 0.3)

    samples = samples_of(spot, 0.9, 1.5)
    samples = samples.replace(alpha=samples.rgb[:, 0])
    image = np.asarray(pm.focus(samples, alpha=alpha, method=ONE_SQUARE), dtype=np.float64)
    expected = (samples.weight[:, None] * (samples.rgb - 0.3)).sum(axis=0)
    np.testing.assert_allclose((image[..., :3] - 0.3).sum(axis=(0, 1)), expected, rtol=1e-4)
    if alpha:
        np.testing.assert_allclose(image[..., 3], image[..., 0], atol=1e-5)


def test_what_covers_a_part_of_a_pixel_covers_as_much_beside_it_as_its_place_tells():
    """An edge in focus before a far plane: coverage has detail, too."""
    edge, radius = 12.25, 0.7
    near = samples_of(lambda x, y: np.ones((len(x), 3)), radius, 1.5)
    far = near.replace(z=near.z * 4, rgb=near.rgb * 0.1, surface=near.surface + 1)
    far = far.replace(layer=(far.x < edge).astype(np.uint8))
    samples = near.chosen(near.x < edge)
    columns = ("x", "y", "z", "rgb", "layer", "surface", "weight", "alpha")
    samples = synthetic(
        len(samples) + len(far),
        size=SIZE,
        **{k: np.concatenate([getattr(samples, k), getattr(far, k)]) for k in columns},
    ).replace(lens=near.lens)
    covered = spread_exactly(lambda x, y: (x < edge)[..., None] * np.ones(3), radius, pm.Disc())
    image = np.asarray(pm.focus(samples, method=ONE_SQUARE))
    np.testing.assert_allclose(image[5:-5, 10:15], (0.1 + 0.9 * covered)[5:-5, 10:15], atol=0.03)


@pytest.mark.parametrize("squares", [1, 2])
@pytest.mark.parametrize("name", ["gaussian", "tent", "mitchell"])
def test_before_other_filters_light_stays_where_it_is(name, squares):
    """They ask for the places of light themselves, which are to be counted once."""

    def spot(x, y):
        return np.where((np.hypot(x - 12.86, y - 10.3) < 0.12)[:, None], 1.5, 0.3) * np.ones(3)

    samples = samples_of(spot, 0.4, 1.5)
    rfilter = mi.load_dict({"type": name})
    method = f"layered:squares={squares}"
    image = np.asarray(pm.focus(samples, method=method, rfilter=rfilter))[..., 0] - 0.3
    near = np.s_[6:15, 8:18]
    y, x = (axis[near] + 0.5 for axis in np.indices(image.shape))
    middle = [np.average(of, weights=image[near]) for of in (x, y)]
    np.testing.assert_allclose(middle, [12.86, 10.3], atol=0.05)
