"""The film: what is in focus is filtered by the film's filter, each sample where it is."""

import pickle

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing.film import TabulatedFilter
from potmesil_mi.focusing.moments import legendre, orders, responses
from scenes import evenly_spread, overscanned, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

FILTERS = ["box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos"]
METHODS = ["layered", "lightfield"]
SIZE = (24, 16)


def noisy_edges(seed, per_pixel=16):
    """Slanted edges at one depth, with the noise of shading, at random places."""
    rng = np.random.default_rng(seed)
    pixel = np.repeat(np.arange(SIZE[0] * SIZE[1]), per_pixel)
    x, y = (n + rng.uniform(0, 1, len(pixel)) for n in (pixel % SIZE[0], pixel // SIZE[0]))
    bright = np.where((0.4 * x + y) % 7 < 3, 0.9, 0.1)
    return synthetic(
        len(x),
        size=SIZE,
        x=x,
        y=y,
        z=np.full(len(x), 2.0),
        rgb=bright[:, None] * rng.uniform(0.7, 1.3, (len(x), 3)),
        alpha=bright > 0.5,
        weight=np.full(len(x), 1 / per_pixel),
    )


def on_film(samples, rfilter, values):
    """What Mitsuba's film makes of the samples: each counts as the filter says, (H, W, C)."""
    width, height = SIZE
    total = np.zeros((width * height, values.shape[1] + 1))
    reach = int(np.ceil(rfilter.radius())) + 1
    for dx in range(-reach, reach + 1):
        for dy in range(-reach, reach + 1):
            column, row = np.floor(samples.x).astype(int) + dx, np.floor(samples.y).astype(int) + dy
            there = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            counts = np.prod(
                [
                    np.array(rfilter.eval(mi.Float(at - middle - 0.5)))
                    for at, middle in ((samples.x, column), (samples.y, row))
                ],
                axis=0,
            )
            light = counts[:, None] * np.column_stack([values, np.ones(len(values))])
            np.add.at(total, (row * width + column)[there], light[there])
    return (total[:, :-1] / total[:, -1:]).reshape(height, width, -1)


def mean_square(a, b):
    return np.mean((np.asarray(a) - np.asarray(b)) ** 2)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", FILTERS)
def test_a_picture_in_focus_is_that_of_mitsubas_film(method, name):
    rfilter = mi.load_dict({"type": name})
    samples, others = noisy_edges(0), noisy_edges(1)
    values = np.column_stack([samples.rgb, samples.alpha])
    expected = on_film(samples, rfilter, values)
    again = on_film(others, rfilter, np.column_stack([others.rgb, others.alpha]))
    image = np.array(pm.focus(samples, method=method, rfilter=rfilter, alpha=True))
    # The difference is far below the noise of the samples.
    assert mean_square(image, expected) < mean_square(again, expected) / 2 / 20
    if name == "box":
        np.testing.assert_allclose(image, expected, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", FILTERS)
def test_a_uniform_picture_stays_uniform_through_every_filter(method, name):
    samples = overscanned(20_000)
    samples = samples.replace(rgb=np.full_like(samples.rgb, 0.5))
    lens = samples.lens.replace(f_number=1.0)
    image = np.array(pm.focus(samples, lens, method=method, rfilter=mi.load_dict({"type": name})))
    np.testing.assert_allclose(image, 0.5, rtol=1e-4)


def test_what_is_blurred_behind_what_is_sharp_gets_the_places_that_it_leaves():
    # A sharp half plane before a blurred wall: the wall has the places that the edge leaves.
    rng = np.random.default_rng(2)
    count = 64 * SIZE[0] * SIZE[1]
    x, y = rng.uniform(0, SIZE[0], count), rng.uniform(0, SIZE[1], count)
    near = x < 11.4
    lens = pm.ThinLens(50.0, aperture_radius=0.1, focus_distance=1.0, millimeters_per_unit=1000.0)
    samples = synthetic(
        count + near.sum(),
        size=SIZE,
        x=np.concatenate([x, x[near]]),
        y=np.concatenate([y, y[near]]),
        z=np.concatenate([np.where(near, 1.0, 4.0), np.full(near.sum(), 4.0)]),
        rgb=np.concatenate([np.where(near, 1.0, 0.0), np.zeros(near.sum())])[:, None] * np.ones(3),
        layer=np.repeat([0, 1], [count, near.sum()]),
        weight=np.full(count + near.sum(), 1 / 64),
        lens=lens,
    )
    rfilter = mi.load_dict({"type": "gaussian"})
    across = np.linspace(-2, 2, 4001)
    response = np.array(rfilter.eval(mi.Float(across)))
    covered = np.cumsum(response) / response.sum()
    expected = np.interp(11.4 - (np.arange(8, 15) + 0.5), across, covered)
    image = np.array(pm.focus(samples, rfilter=rfilter))[4:-4, 8:15, 0].mean(axis=0)
    np.testing.assert_allclose(image, expected, atol=0.02)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["tent", "gaussian"])
def test_what_is_beside_something_very_bright_is_not_black_for_a_filter(method, name):
    rng = np.random.default_rng(4)
    pixel = np.repeat(np.arange(SIZE[0] * SIZE[1]), 4)
    x, y = (n + rng.uniform(0, 1, len(pixel)) for n in (pixel % SIZE[0], pixel // SIZE[0]))
    lamp = (np.floor(0.7 * x) % 5 == 0) & (np.floor(0.7 * y) % 5 == 0)
    samples = synthetic(
        len(x),
        size=SIZE,
        x=x,
        y=y,
        z=np.full(len(x), 2.0),
        rgb=np.where(lamp, 1000.0, 1.0)[:, None] * np.ones(3),
        weight=np.full(len(x), 1 / 4),
    )
    image = np.array(pm.focus(samples, method=method, rfilter=mi.load_dict({"type": name})))
    assert image.min() > 0.4


# ---------------------------------------------------------------- moments


def test_orders_are_those_of_polynomials_up_to_a_degree():
    assert orders(0) == []
    assert orders(1) == [(1, 0), (0, 1)]
    assert orders(2) == [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]


@pytest.mark.parametrize("degree", [1, 2])
def test_responses_that_are_polynomials_are_met(degree):
    def response(x):
        return 0.3 - 0.5 * x + (0.8 * x**2 if degree == 2 else 0)

    middles = np.array([-0.75, -0.25, 0.25])
    found = responses(response, middles, 0.5, degree)
    at = np.linspace(-1, 1, 9)
    for n, middle in enumerate(middles):
        fitted = sum(found[k, n] * legendre(k, at) for k in range(degree + 1))
        np.testing.assert_allclose(fitted, response(middle + at / 4), rtol=1e-12)


# ---------------------------------------------------------------- ends of bright things


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["box", "gaussian"])
@pytest.mark.parametrize("radius", [0.3, 0.6, 1.0, 2.0])
def test_a_bright_light_out_of_focus_ends_where_its_circles_end(method, name, radius):
    # A lamp a thousand times as bright as the wall beside it; its end is within a pixel.
    size, end, per_side = (48, 24), 24.25, 8
    x, y = (
        (axis.ravel() + 0.5) / per_side
        for axis in np.meshgrid(np.arange(size[0] * per_side), np.arange(size[1] * per_side))
    )
    lamp = (x > 20) & (x < end) & (np.abs(y - 12) < 6)
    samples = synthetic(
        len(x),
        size=size,
        x=x,
        y=y,
        z=np.full(len(x), 2.0),
        rgb=np.where(lamp, 20.0, 0.02)[:, None] * np.ones(3),
        weight=np.full(len(x), per_side**-2.0),
    )
    lens = pm.ThinLens(
        50.0,
        aperture_radius=4 * radius / samples.camera.focal_length_pixels,
        focus_distance=4.0,
        millimeters_per_unit=1000.0,
    )
    rfilter = mi.load_dict({"type": name})
    image = np.array(pm.focus(samples, lens, method=method, rfilter=rfilter))[12, 22:29, 0]
    # The light along a row is the lamp's, spread by a disc as a row sees it, then by the filter.
    step = 1 / 64
    at = np.arange(-4, 4, step) + step / 2
    disc = np.sqrt(np.maximum(radius**2 - at**2, 0))
    along = np.arange(12, 38, step) + step / 2
    light = np.where((along > 20) & (along < end), 20.0, 0.02)
    for spread in (disc, np.array(rfilter.eval(mi.Float(at)))):
        light = np.convolve(light, spread / spread.sum(), mode="same")
    expected = np.interp(np.arange(22, 29) + 0.5, along, light)
    # To 3 % of the lamp, and beyond its light it is not seen at all.
    np.testing.assert_allclose(image, expected, atol=0.6)
    beyond = np.arange(22, 29) > end + radius + rfilter.radius()
    np.testing.assert_allclose(image[beyond], 0.02, atol=0.01)


@pytest.mark.parametrize("kind", FILTERS)
def test_a_filter_as_a_table_forms_the_same_picture(kind):
    rfilter = mi.load_dict({"type": kind})
    table = pickle.loads(pickle.dumps(TabulatedFilter.of(rfilter)))
    samples = evenly_spread((12, 8), 2)
    found, expected = (np.array(pm.focus(samples, rfilter=of)) for of in (table, rfilter))
    np.testing.assert_allclose(found, expected, rtol=2e-6, atol=2e-7)
