"""Codes of depth buffers, packed depth, and what a code is worth."""

import math

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.optics import depth_buffer as b
from potmesil_mi.optics.blur import Blur
from potmesil_mi.optics.depth import camera_of

FIRST = ("red", "alpha")

# ---------------------------------------------------------------- codes


@pytest.mark.parametrize("bits", b.BITS)
def test_codes_return_from_their_stored_depths(bits):
    largest = 2**bits - 1
    codes = np.unique(np.linspace(0, largest, 1001).astype(np.uint32))
    stored = b.stored_from_code(codes, bits)
    assert stored[0] == 0
    assert stored[-1] == 1
    np.testing.assert_array_equal(b.code_from_stored(stored, bits), codes)


@pytest.mark.parametrize("bits", b.BITS)
def test_stored_depth_is_off_by_at_most_half_a_code(bits):
    stored = np.linspace(0, 1, 1013)
    error = b.stored_from_code(b.code_from_stored(stored, bits), bits) - stored
    assert abs(error).max() <= 0.5 / (2**bits - 1) + 1e-16


def test_codes_have_the_type_of_the_buffer():
    assert b.code_from_stored(np.ones((2, 3)), 16).dtype == np.uint16
    assert b.code_from_stored(np.ones((2, 3)), 24).dtype == np.uint32
    assert b.code_from_stored(np.ones((2, 3)), 24).shape == (2, 3)
    assert b.code_from_stored(1.0, 32) == 4294967295
    assert isinstance(b.code_from_stored(0.5), int)


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("bits", b.BITS)
def test_drjit_arrays_have_the_codes_that_numpy_arrays_have(bits):
    stored = np.linspace(0, 1, 1013)
    codes = b.code_from_stored(stored, bits)
    got = b.code_from_stored(mi.Float64(stored), bits)
    assert type(got) is mi.UInt32
    np.testing.assert_array_equal(got, codes)
    np.testing.assert_allclose(
        b.stored_from_code(mi.UInt32(codes), bits), b.stored_from_code(codes, bits), 1e-15
    )
    tensor = b.code_from_stored(mi.TensorXf64(stored[:-1].reshape(4, 253)), bits)
    np.testing.assert_array_equal(np.array(tensor), codes[:-1].reshape(4, 253))


# ---------------------------------------------------------------- packed depth


def shader_of_r167(stored):
    """packDepthToRGBA as bytes, with the shader's own operations in double precision."""
    if stored >= 1:
        return [255] * 4
    rest, whole = math.modf(stored * 256**3)
    blue, whole = math.modf(whole / 256)
    green, whole = math.modf(whole / 256)
    return [round(255 * v) for v in (whole / 255, green * 256 / 255, blue * 256 / 255, rest)]


def shader_until_r166(stored):
    red, green, blue = (math.fmod(stored * 256**k, 1) for k in (3, 2, 1))
    rgba = (red, green - red / 256, blue - green / 256, stored - blue / 256)
    return [min(round(255 * v * 256 / 255), 255) for v in rgba]


@pytest.mark.parametrize("stored", [0.0, 1e-9, 0.25, 1 / 3, 0.7, 0.999, 1 - 2**-24, 1.0])
def test_packed_depth_is_that_of_three_js(stored):
    assert b.rgba_from_stored(stored).tolist() == shader_of_r167(stored)
    if stored < 1:
        ours, theirs = b.rgba_from_stored(stored, first="alpha"), shader_until_r166(stored)
        assert ours[1:].tolist() == theirs[1:]
        assert abs(int(ours[0]) - theirs[0]) <= 1  # The lowest byte is rounded down here.


def test_unpacked_depth_is_that_of_three_js():
    rgba = np.random.default_rng(1).integers(0, 256, (50, 4), np.uint8)
    down, share = 255 / 256, rgba / 255
    newer = share @ [down, down / 256, down / 256**2, 1 / 256**3]
    older = share @ [down / 256**3, down / 256**2, down / 256, down]
    np.testing.assert_allclose(b.stored_from_rgba(rgba), newer, atol=1e-15)
    np.testing.assert_allclose(b.stored_from_rgba(rgba, first="alpha"), older, atol=1e-15)


@pytest.mark.parametrize("first", FIRST)
def test_stored_depth_returns_from_a_picture_to_its_lowest_byte(first):
    stored = np.linspace(0, 1, 1200).reshape(3, 400)
    rgba = b.rgba_from_stored(stored, first=first)
    assert rgba.shape == (3, 400, 4)
    assert rgba.dtype == np.uint8
    error = b.stored_from_rgba(rgba, first=first) - stored
    assert abs(error).max() <= (0.5 / 255 if first == "red" else 1 / 256) / 2**24


def test_the_first_channel_has_the_highest_bits():
    assert b.rgba_from_stored(0.5).tolist() == [128, 0, 0, 0]
    assert b.rgba_from_stored(0.5, first="alpha").tolist() == [0, 0, 0, 128]
    assert b.rgba_from_stored(1.0, first="alpha").tolist() == [255] * 4


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("first", FIRST)
def test_drjit_arrays_are_packed_as_numpy_arrays_are(first):
    stored = np.linspace(0, 1, 1013)
    rgba = b.rgba_from_stored(stored, first=first)
    channels = b.rgba_from_stored(mi.Float64(stored), first=first)
    np.testing.assert_array_equal(np.stack(channels, axis=-1), rgba)
    np.testing.assert_array_equal(
        b.stored_from_rgba(channels, first=first), b.stored_from_rgba(rgba, first=first)
    )


# ---------------------------------------------------------------- the buffer

BUFFERS = [
    b.DepthBuffer(0.5, 10.0, bits=16),
    b.DepthBuffer(0.5, 10.0),
    b.DepthBuffer(0.5, 10.0, bits=32, reverse=True),
    b.DepthBuffer(0.5, bits=24, clip="direct3d"),
    b.DepthBuffer(0.5, 10.0, bits=32, floating=True),
    b.DepthBuffer(0.5, bits=32, floating=True, clip="direct3d", reverse=True),
]


@pytest.mark.parametrize("buffer", BUFFERS, ids=str)
def test_depth_returns_from_the_buffer_to_half_a_step(buffer):
    z = np.geomspace(0.5, 10, 1001)
    error = abs(buffer.depth_from_code(buffer.code_from_depth(z)) - z)
    # Half a step of a float may be half of its larger neighbour's.
    slack = 2 if buffer.floating else 1
    assert np.all(error <= slack * buffer.depth_step(z) / 2 * (1 + 1e-4) + 1e-14)


@pytest.mark.parametrize("buffer", BUFFERS, ids=str)
def test_codes_sort_depths(buffer):
    codes = buffer.code_from_depth(np.geomspace(0.5, 10, 1001)).astype(np.float64)
    steps = np.diff(codes)
    assert np.all(steps < 0 if buffer.reverse else steps > 0)


def test_a_step_is_the_interval_of_depths_that_a_code_stands_for():
    buffer = b.DepthBuffer(0.5, 10.0, bits=16)
    codes = np.array([100, 30000, 65000])
    z = buffer.depth_from_code(codes)
    ends = [
        0.5 / (1 - (codes + half) / 65535 * (1 - 0.5 / 10)) for half in (-0.5, 0.5)
    ]  # of the interval that is rounded to the code
    np.testing.assert_allclose(buffer.depth_step(z), ends[1] - ends[0], rtol=1e-10)


def test_a_nearer_near_plane_has_longer_steps_far_away():
    """Jünemann, "The graphics pipeline (1)": n as large as possible."""
    z = 8.0
    steps = [b.DepthBuffer(near, 10.0, bits=24).depth_step(z) for near in (1, 0.5, 0.25)]
    expected = [z**2 * (1 / near - 1 / 10) / (2**24 - 1) for near in (1, 0.5, 0.25)]
    np.testing.assert_allclose(steps, expected, rtol=1e-9)


def test_a_step_that_reaches_infinity_is_infinite():
    buffer = b.DepthBuffer(0.01, bits=16)
    last = 0.01 * 65535
    assert buffer.depth_step(0.49 * last) < last
    assert buffer.depth_step(2.01 * last) == math.inf
    assert buffer.depth_step(math.inf) == math.inf


def test_reversed_z_gives_a_float_buffer_a_step_in_proportion_to_depth():
    z = np.geomspace(1, 1e6, 7)
    buffer = b.DepthBuffer(0.1, bits=32, floating=True, clip="direct3d", reverse=True)
    assert np.all(buffer.depth_step(z) / z <= 2**-23)
    assert np.all(buffer.depth_step(z) / z >= 2**-24)
    forward = b.DepthBuffer(0.1, bits=32, floating=True, clip="direct3d")
    np.testing.assert_allclose(forward.vergence_step(z), 10 * 2.0**-24, rtol=1e-12)


def test_reversed_z_gains_nothing_where_ndc_depth_is_minus_1_to_1():
    buffer = b.DepthBuffer(0.1, bits=32, floating=True, reverse=True)
    assert buffer.vergence_step(1e6) == pytest.approx(10 * 2.0**-25, rel=1e-12)


def test_a_code_is_worth_the_same_blur_at_all_depths():
    camera = camera_of(40, (1920, 1080))
    lens = pm.ThinLens.of_field_of_view(
        40, f_number=1.4, focus_distance=5, millimeters_per_unit=1e3
    )
    buffer = b.DepthBuffer(0.01, 1000.0, bits=16)
    step = buffer.radius_step(3.0, lens, camera)
    blur = Blur.of(lens, camera)
    codes = np.array([64000, 65000, 65500])
    radii = blur.radius(1 / buffer.depth_from_code(np.stack([codes, codes + 1])))
    np.testing.assert_allclose(radii[0] - radii[1], step, rtol=1e-9)
    nearer = b.DepthBuffer(0.001, 1000.0, bits=16)
    assert nearer.radius_step(3.0, lens, camera) / step == pytest.approx(10, rel=1e-3)


def test_what_was_never_drawn_has_the_code_of_the_far_plane():
    for buffer, code in ((b.DepthBuffer(1, 9), 2**24 - 1), (b.DepthBuffer(1, 9, reverse=True), 0)):
        assert buffer.code_from_depth(math.inf) == code
        assert buffer.depth_from_code(code) == pytest.approx(9, rel=1e-12)
    assert b.DepthBuffer(1).depth_from_code(2**24 - 1) == math.inf


def test_a_floating_buffer_keeps_small_stored_depths():
    buffer = b.DepthBuffer(0.1, bits=32, floating=True, clip="direct3d", reverse=True)
    code = buffer.code_from_depth(1e12)
    assert code.dtype == np.float32
    assert buffer.depth_from_code(code) == pytest.approx(1e12, rel=1e-7)


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("buffer", BUFFERS, ids=str)
def test_drjit_arrays_are_kept_as_numpy_arrays_are(buffer):
    z = np.geomspace(0.5, 10, 101)
    codes = buffer.code_from_depth(z)
    drjit = buffer.code_from_depth(mi.Float64(z))
    np.testing.assert_array_equal(drjit, codes)
    np.testing.assert_allclose(buffer.depth_from_code(drjit), buffer.depth_from_code(codes), 1e-12)
    np.testing.assert_allclose(buffer.depth_step(mi.Float64(z)), buffer.depth_step(z), 1e-12)


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("buffer", [BUFFERS[0], BUFFERS[5]], ids=str)
def test_gradients_of_steps_are_those_of_finite_differences(buffer):
    import drjit as dr

    z = np.array([0.7, 3.1, 9.3])
    variable = mi.Float64(z)
    dr.enable_grad(variable)
    dr.backward(dr.sum(buffer.depth_step(variable)))
    step = 1e-6
    expected = (buffer.depth_step(z + step) - buffer.depth_step(z - step)) / (2 * step)
    np.testing.assert_allclose(variable.grad, expected, rtol=1e-6)


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: b.DepthBuffer(0, 3), "near=0: must be > 0"),
        (lambda: b.DepthBuffer(3, 1), "far=1: must be > near=3"),
        (lambda: b.DepthBuffer(1, 3, bits=20), "bits=20: must be 16, 24, 32"),
        (lambda: b.DepthBuffer(1, 3, floating=True), "bits=24: must be 32 where floating=True"),
        (lambda: b.DepthBuffer(1, 3, clip="gl"), "clip='gl': must be one of opengl, direct3d"),
        (lambda: b.DepthBuffer(1, 3).code_from_depth(0.5), "depth=0.5: must be in near=1 to far=3"),
        (lambda: b.DepthBuffer(1, 3).code_from_depth(4), "depth=4: must be in near=1 to far=3"),
        (lambda: b.DepthBuffer(1, 3).depth_step(-1), "depth=-1: must be > 0"),
        (lambda: BUFFERS[4].depth_from_code(1.5), "code=1.5: must be 0 to 1"),
        (lambda: b.code_from_stored(1.1), "stored=1.1: must be 0 to 1"),
        (lambda: b.code_from_stored(0.5, bits=8), "bits=8: must be 16, 24, 32"),
        (lambda: b.stored_from_code(65536, 16), "code=65536: must be 0 to 65535"),
        (lambda: b.stored_from_code(-1, 16), "code=-1: must be 0 to 65535"),
        (lambda: b.rgba_from_stored(-0.1), "stored=-0.1: must be 0 to 1"),
        (lambda: b.rgba_from_stored(0.1, first="blue"), "first='blue': must be one of red, alpha"),
        (lambda: b.stored_from_rgba([0, 0, 0]), "rgba: has 3 channels, must have 4"),
        (lambda: b.stored_from_rgba([0, 0, 0, 256]), "rgba=256: must be 0 to 255"),
    ],
)
def test_errors_name_the_parameter_its_value_and_what_is_allowed(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: b.stored_from_code(0.5), "code: must be whole numbers, 0 to 16777215"),
        (lambda: b.stored_from_rgba(np.ones((2, 4))), "rgba: must be whole numbers, 0 to 255"),
        (lambda: b.DepthBuffer(1, 3, reverse=1), "reverse=1: must be True or False"),
        (lambda: b.DepthBuffer("1", 3), "near='1': must be a number"),
    ],
)
def test_errors_of_type_name_the_parameter(call, message):
    with pytest.raises(TypeError, match=message):
        call()
