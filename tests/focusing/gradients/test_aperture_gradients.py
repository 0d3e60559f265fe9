"""Pictures are differentiable in the parameters of an aperture, also behind what hides a part."""

import dataclasses
import functools
import pickle

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing.gradients.opening_of_numbers import OpeningOfNumbers
from potmesil_mi.focusing.gradients.opening_of_picture import OpeningOfPicture
from potmesil_mi.focusing.kernels import KernelFactory
from potmesil_mi.focusing.small_circles import responses_of
from potmesil_mi.optics.convolution import convolve_fully, correlations
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = (40, 32)
PER_SIDE = 3
NEAR, FOCUS, FAR = 1.2, 2.0, 5.0

WEIGHTS = np.random.default_rng(5).normal(size=(32, 40, 3)).astype(np.float32)
"""Of a function of pictures, for gradients in reverse."""


@functools.cache
def bar_before_lights(aperture_radius):
    """A wall with four small lights, beyond the focused plane, and a slanting bar before it."""
    width, height = SIZE
    down, across = np.divmod(np.arange(width * height * PER_SIDE**2), width * PER_SIDE)
    x, y = (across + 0.5) / PER_SIDE, (down + 0.5) / PER_SIDE
    rgb = np.full((len(x), 3), 0.2)
    for place, colour in {
        (8, 8): (6, 3, 1),
        (30, 20): (1, 5, 2),
        (18, 25): (2, 2, 6),
        (22, 12): (5, 5, 5),
    }.items():
        rgb[(np.abs(x - place[0]) < 0.7) & (np.abs(y - place[1]) < 0.7)] = colour
    bar = np.abs(x - 20 + 0.2 * (y - 16)) < 4
    count = np.count_nonzero(bar)
    return synthetic(
        len(x) + count,
        size=SIZE,
        x=np.concatenate([x, x[bar]]),
        y=np.concatenate([y, y[bar]]),
        rgb=np.concatenate([rgb, np.tile([0.5, 0.1, 0.1], (count, 1))]),
        z=np.concatenate([np.full(len(x), FAR), np.full(count, NEAR)]),
        layer=np.concatenate([bar, np.zeros(count)]).astype(np.uint8),
        surface=np.repeat([1, 2], [len(x), count]),
        weight=np.full(len(x) + count, PER_SIDE**-2.0),
        lens=pm.ThinLens(
            50.0,
            aperture_radius=aperture_radius,
            focus_distance=FOCUS,
            millimeters_per_unit=1000.0,
        ),
    )


def with_gradient(values):
    """A Dr.Jit array, or tensor, with gradients enabled."""
    kind = mi.TensorXf if np.ndim(values) == 2 else mi.Float
    array = kind(np.atleast_1d(values).astype(np.float32))
    dr.enable_grad(array)
    return array


def focused(aperture, aperture_radius=0.3, method="layered", **options):
    samples = bar_before_lights(aperture_radius)
    return pm.focus(samples, samples.lens.replace(aperture=aperture), method=method, **options)


def derivative(make, parameter, change=1.0, **options):
    """The picture's derivative along a change, forward; and in reverse that of its weighted sum."""
    array = with_gradient(parameter)
    picture = focused(make(array), **options)
    dr.set_grad(array, type(array)(np.zeros_like(np.array(dr.detach(array))) + np.float32(change)))
    dr.forward_to(picture)
    forward = np.array(dr.grad(picture), dtype=np.float64)
    array = with_gradient(parameter)
    dr.backward(dr.sum(focused(make(array), **options) * mi.TensorXf(WEIGHTS), axis=None))
    return forward, float(np.vdot(np.array(dr.grad(array), dtype=np.float64), change))


def numbers_of(make, parameter, **options):
    """The picture itself, as it is where there are gradients."""
    picture = focused(make(with_gradient(parameter)), **options)
    return np.array(dr.detach(picture), dtype=np.float64)


def rotated(rotation):
    return pm.Polygon(5, rotation=rotation, curvature=0.2)


def curved(curvature):
    return pm.Polygon(5, rotation=17.0, curvature=curvature)


@functools.cache
def heart():
    """The picture of an aperture, with a dark part."""
    down, across = np.indices((12, 12)) - 5.5
    picture = np.clip(1.2 - np.hypot(across - 1, down + 0.5) / 6, 0.05, 1)
    picture[3:6, 2:5] = 0
    return picture


def error_of(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@pytest.mark.parametrize(
    ("make", "parameter", "steps", "method"),
    [
        (rotated, 17.0, (0.25, 0.5), "layered"),
        (curved, 0.3, (0.005, 0.01), "lightfield"),
        # So straight that without gradients each blade is of one piece.
        (curved, 0.02, (0.01,), "layered"),
    ],
)
def test_derivatives_in_numbers_are_central_differences(make, parameter, steps, method):
    forward, reverse = derivative(make, parameter, method=method)
    assert np.abs(forward).max() > 1e-4
    for step in steps:
        ends = [numbers_of(make, parameter + by, method=method) for by in (step, -step)]
        assert error_of(forward, (ends[0] - ends[1]) / (2 * step)) < 0.01
    assert reverse == pytest.approx(np.vdot(forward, WEIGHTS), rel=1e-5, abs=1e-7)


@pytest.mark.parametrize(
    ("aperture_radius", "method"), [(0.02, "layered"), (0.3, "layered"), (0.3, "lightfield")]
)
def test_derivatives_in_a_picture_are_differences(aperture_radius, method):
    change = np.random.default_rng(1).random(heart().shape)
    options = {"method": method, "aperture_radius": aperture_radius}
    forward, reverse = derivative(pm.ImageAperture, heart(), change, **options)
    for step in (0.005, 0.01):
        # What is dark cannot become darker: differences of the second order to one side.
        first, second, third = (
            numbers_of(pm.ImageAperture, heart() + by * step * change, **options)
            for by in (0, 1, 2)
        )
        assert error_of(forward, (4 * second - 3 * first - third) / (2 * step)) < 0.01
    assert reverse == pytest.approx(np.vdot(forward, WEIGHTS), rel=1e-5)


def test_alpha_has_derivatives_too():
    samples = bar_before_lights(0.3)
    alpha = np.where(samples.z > 2, 0.25, 1)
    samples = samples.replace(alpha=alpha)

    def covered(at):
        curvature = with_gradient(at)
        return curvature, pm.focus(samples, psf=curved(curvature), alpha=True)[..., 3]

    curvature, picture = covered(0.3)
    dr.forward(curvature)
    found = np.array(dr.grad(picture), dtype=np.float64)
    ends = [np.array(dr.detach(covered(at)[1]), dtype=np.float64) for at in (0.31, 0.29)]
    assert error_of(found, (ends[0] - ends[1]) / 0.02) < 0.01


def test_a_picture_has_gradients_in_its_circle_only_and_none_along_itself():
    picture = with_gradient(heart())
    dr.backward(dr.sum(focused(pm.ImageAperture(picture)) * mi.TensorXf(WEIGHTS), axis=None))
    gradient = np.array(dr.grad(picture), dtype=np.float64)
    assert gradient[0, 0] == gradient[-1, 0] == 0
    assert gradient[4, 3] != 0
    # A brighter aperture is the same: the exposure stays.
    assert abs(np.vdot(gradient, heart())) < 1e-3 * np.abs(gradient * heart()).sum()


MANY_POINTS = "lightfield:lens_points=1024"
"""The method of pictures in which what lens points see is hardly chance."""


def test_derivatives_with_occlusion_are_those_of_pictures_without_gradients():
    forward, _ = derivative(curved, 0.5, method="lightfield:lens_points=512")
    ends = [np.array(focused(curved(at), method=MANY_POINTS), np.float64) for at in (0.6, 0.4)]
    assert error_of(forward, (ends[0] - ends[1]) / 0.2) < 0.2


def test_gradients_in_an_aperture_take_no_more_of_the_picture_than_those_in_the_lens():
    distance = with_gradient(FOCUS)
    samples = bar_before_lights(0.3)
    for attached, plain in (
        (curved(with_gradient(0.3)), curved(0.3)),
        (pm.ImageAperture(with_gradient(heart())), pm.ImageAperture(heart())),
    ):
        lens = samples.lens.replace(aperture=plain, focus_distance=distance)
        pictures = (
            focused(attached, method="lightfield"),
            pm.focus(samples, lens, method="lightfield"),
        )
        right = np.array(focused(plain, method=MANY_POINTS))
        found, expected = (np.array(dr.detach(picture)) - right for picture in pictures)
        assert np.linalg.norm(found) < 1.05 * np.linalg.norm(expected)


def test_two_parameters_and_the_lens_have_gradients_together():
    rotation, curvature, distance = (with_gradient(of) for of in (17.0, 0.3, FOCUS))
    samples = bar_before_lights(0.3)
    lens = samples.lens.replace(focus_distance=distance)
    picture = pm.focus(samples, lens, psf=pm.Polygon(5, rotation, curvature))
    dr.backward(dr.sum(picture * mi.TensorXf(WEIGHTS), axis=None))
    found = [float(dr.grad(of)[0]) for of in (rotation, curvature)]
    alone = [
        derivative(lambda of: pm.Polygon(5, of, 0.3), 17.0)[1],
        derivative(curved, 0.3)[1],
    ]
    # A polygon whose curvature is fixed has fewer pieces.
    assert found == pytest.approx(alone, rel=0.02)
    assert dr.grad(distance)[0] != 0


# ---------------------------------------------------------------- operators


def opening_of(kind):
    """An opening, and the arrays that have its gradients."""
    if kind == "picture":
        picture = with_gradient(np.random.default_rng(3).random((9, 7)))
        return OpeningOfPicture(pm.ImageAperture(picture)), [picture.array]
    both = with_gradient(17.0), with_gradient(0.3)
    return OpeningOfNumbers(pm.Polygon(5, *both)), list(both)


def numbers_made(opening, what):
    if what == "weights":
        return opening.weights(40)
    if what == "responses":
        return opening.responses(responses_of(opening.psf, 1.25, 2), 1.25)
    lens = pm.ThinLens(50.0, 2.0, squeeze=1.25)
    factory = KernelFactory(lens, opening.psf, 1.0, 8.0, 0.5, -1.0, 1 / 6, (9, 9))
    radii = np.array([0.0, 0.7, 1.2, 3.1, 12.3])
    kernels = [factory.of_radius(radius) for radius in radii]
    assert [kernel.ndim for kernel in kernels] == [1, 1, 1, 2, 2]
    return opening.kernels(factory, radii, kernels).values


@pytest.mark.parametrize("what", ["kernels", "responses", "weights"])
@pytest.mark.parametrize("kind", ["picture", "numbers"])
def test_the_transpose_of_what_an_aperture_makes(kind, what):
    """<A x, y> = <x, A' y>."""
    rng = np.random.default_rng(7)
    opening, arrays = opening_of(kind)
    x = [rng.normal(size=dr.width(of)).astype(np.float32) for of in arrays]
    numbers = numbers_made(opening, what)
    y = rng.normal(size=dr.width(numbers)).astype(np.float32)
    for array, along in zip(arrays, x, strict=True):
        dr.set_grad(array, mi.Float(along))
    dr.forward_to(numbers)
    forward = float(np.vdot(np.array(dr.grad(numbers), dtype=np.float64), y))
    opening, arrays = opening_of(kind)
    dr.backward(dr.dot(numbers_made(opening, what), mi.Float(y)))
    reverse = sum(
        float(np.vdot(np.array(dr.grad(of), dtype=np.float64), along))
        for of, along in zip(arrays, x, strict=True)
    )
    assert forward == pytest.approx(reverse, rel=1e-5)


def test_correlations_are_the_transpose_of_spreading():
    rng = np.random.default_rng(2)
    shapes = [(5, 7), (1, 1), (3, 3)]
    images = [np.zeros((30, 26, 2)) for _ in shapes]
    for image in images:
        image[4:-4, 4:-4] = rng.random((22, 18, 2))
    light = rng.normal(size=(30, 26, 2))
    found = correlations(light, images, shapes)
    for image, kernel in zip(images, found, strict=True):
        x = rng.normal(size=kernel.shape)
        rows, columns = (size // 2 for size in kernel.shape)
        spread = np.stack([convolve_fully(image[..., c], x) for c in range(2)], axis=-1)
        spread = spread[rows : rows + 30, columns : columns + 26]
        assert np.vdot(spread, light) == pytest.approx(np.vdot(x, kernel), rel=1e-10)


# ---------------------------------------------------------------- how a user says it


def test_an_aperture_has_plain_numbers_beside_what_has_gradients():
    curvature = with_gradient(0.25)
    aperture = pm.Polygon(5, curvature=curvature)
    assert aperture == pm.Polygon(5, curvature=0.25)
    assert hash(aperture) == hash(pm.Polygon(5, curvature=0.25))
    assert repr(aperture) == repr(pm.Polygon(5, curvature=0.25))
    assert aperture.describe() == "polygon:blades=5,rotation=0.0,curvature=0.25"
    assert aperture.attached.keys() == {"curvature"}
    assert dataclasses.replace(aperture, blades=7).attached.keys() == {"curvature"}
    assert dataclasses.replace(aperture, curvature=0.25).attached == {}
    assert aperture.without_gradients().attached == {}
    assert pm.Polygon(5, curvature=mi.Float(0.25)).attached == {}
    picture = pm.ImageAperture(with_gradient(heart()))
    assert picture == pm.ImageAperture(heart().astype(np.float32))
    assert picture.attached.keys() == {"transmission_map"}
    assert pickle.loads(pickle.dumps(picture.without_gradients())) == picture


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda of: pm.Polygon(blades=of(6.0)), TypeError, r"blades=\[6\]: must be a whole"),
        (lambda of: pm.Polygon(curvature=of([0.1, 0.2])), ValueError, "curvature=.*one number"),
        (lambda of: pm.Polygon(curvature=of(1.5)), ValueError, "curvature=1.5: must be 0 to 1"),
        (lambda of: pm.Lommel(of(550.0)), NotImplementedError, "wavelengths=.*no derivatives"),
    ],
)
def test_parameters_without_gradients_are_refused_by_name(make, error, message):
    with pytest.raises(error, match=message):
        make(with_gradient)


@dataclasses.dataclass(frozen=True, eq=False)
class Square(pm.Aperture):
    """One of one's own, without a name."""

    half: object

    def corner_area(self, x, y):
        half = float(np.array(dr.detach(self.half))[0])
        return (np.clip(x, -half, half) + half) * (np.clip(y, -half, half) + half)


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (curved, {"method": "paper"}, "method=paper: has no derivatives"),
        (curved, {"filters": ["fade:amount=0.5"]}, "filters.*curvature has gradients"),
        (Square, {}, "psf=.*: half of an aperture"),
    ],
)
def test_what_has_no_derivatives_is_refused(make, options, message):
    with pytest.raises(NotImplementedError, match=message):
        focused(make(with_gradient(0.5)), **options)


def test_vignetting_is_refused():
    samples = bar_before_lights(0.3)
    lens = samples.lens.replace(aperture=curved(with_gradient(0.5)), vignetting=0.3)
    with pytest.raises(NotImplementedError, match=r"vignetting=0\.3: .*curvature has gradients"):
        pm.focus(samples, lens)
