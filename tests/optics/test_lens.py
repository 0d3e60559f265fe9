"""The lens law, the depth of field and the circle of confusion: equations 1-8 of the paper."""

import json
import math
import re

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from potmesil_mi import Disc, ThinLens

FOCAL_LENGTHS = st.floats(5, 400)
F_NUMBERS = st.floats(0.7, 64)
DEPTHS = st.floats(450, 1e6)
"""Distances in millimetres, all beyond the longest focal length."""

BOTH_FILMS = pytest.mark.parametrize("film", ["focal", "focused"])

# ---------------------------------------------------------------- Table 1

TABLE_1 = [
    # f-number, focused distance, far limit, near limit, depth of field; millimetres
    (5.6, 2000, 2511, 1662, 849),
    (5.6, 980, 1089, 891, 198),
    (5.6, 550, 583, 521, 62),
    (5.6, 290, 299, 282, 17),
    (11, 2000, 3333, 1429, 1904),
    (11, 980, 1219, 819, 400),
    (11, 550, 618, 495, 123),
    (11, 290, 308, 274, 34),
    (22, 2000, 10000, 1111, 8889),
    (22, 980, 1612, 704, 908),
    (22, 550, 705, 451, 254),
    (22, 290, 328, 260, 68),
]


@pytest.mark.parametrize(("f_number", "focused", "far", "near", "depth"), TABLE_1)
def test_table_1_is_reproduced_to_the_printed_integer(f_number, focused, far, near, depth):
    limits = ThinLens(55, f_number, focused).depth_of_field()
    assert (round(limits.far), round(limits.near)) == (far, near)
    assert round(limits.far) - round(limits.near) == depth  # as the paper's authors subtracted
    assert limits.depth == limits.far - limits.near


@pytest.mark.parametrize(("f_number", "diameter"), [(5.6, 9.82), (11, 5.00), (22, 2.50)])
def test_table_1_lens_diameters(f_number, diameter):
    assert round(ThinLens(55, f_number).lens_diameter, 2) == diameter


# ---------------------------------------------------------------- equations 1-7


@given(FOCAL_LENGTHS, DEPTHS, DEPTHS)
def test_equations_1_and_7_the_lens_law(focal_length, focused, depth):
    lens = ThinLens(focal_length, 4, focused)
    image = lens.image_distance()
    assert 1 / focused + 1 / image == pytest.approx(1 / focal_length, rel=1e-12)
    assert image == pytest.approx(focal_length * focused / (focused - focal_length), rel=1e-9)
    assert lens.image_distance(depth) == pytest.approx(
        focal_length * depth / (depth - focal_length), rel=1e-9
    )


def test_image_distance_inside_at_and_far_beyond_the_focal_length():
    lens = ThinLens(50, 4, 1000)
    assert lens.image_distance(25) == pytest.approx(-50)  # virtual, on the object's side
    assert lens.image_distance(50) == math.inf
    assert lens.image_distance(math.inf) == 50
    assert ThinLens(50, 4).image_distance() == 50  # focused at infinity


@given(FOCAL_LENGTHS, F_NUMBERS, DEPTHS, st.sampled_from([1e-3, 3e-4]))
def test_equations_2_to_4_limits_by_a_patch_of_one_mil(focal_length, n, focused, acuity):
    share = acuity * n * focused / focal_length  # nU/(1000F)
    assume(abs(share - 1) > 1e-3)
    limits = ThinLens(focal_length, n, focused).depth_of_field(acuity)
    assert limits.near == pytest.approx(focused / (1 + share), rel=1e-9)
    assert limits.far == pytest.approx(focused / (1 - share) if share < 1 else math.inf, rel=1e-9)


@given(FOCAL_LENGTHS, F_NUMBERS, DEPTHS)
def test_equations_5_and_6_limits_by_the_hyperfocal_distance(focal_length, n, focused):
    lens = ThinLens(focal_length, n, focused)
    hyperfocal = 1000 * focal_length / n
    assume(abs(focused / hyperfocal - 1) > 1e-3)
    assert lens.hyperfocal_distance() == pytest.approx(hyperfocal, rel=1e-12)
    near, far = lens.depth_of_field()
    assert near == pytest.approx(hyperfocal * focused / (hyperfocal + focused), rel=1e-9)
    if focused < hyperfocal:
        assert far == pytest.approx(hyperfocal * focused / (hyperfocal - focused), rel=1e-9)
    else:
        assert far == math.inf


def test_focused_at_the_hyperfocal_distance_all_from_half_of_it_is_sharp():
    hyperfocal = ThinLens(50, 8).hyperfocal_distance()
    near, far = ThinLens(50, 8, hyperfocal).depth_of_field()
    assert hyperfocal == 6250
    assert near == pytest.approx(hyperfocal / 2, rel=1e-12)
    assert far == math.inf


def test_focused_at_infinity_the_near_limit_is_the_hyperfocal_distance():
    near, far = ThinLens(50, 8).depth_of_field()
    assert near == pytest.approx(6250, rel=1e-12)
    assert far == math.inf


# ---------------------------------------------------------------- equation 8


@given(FOCAL_LENGTHS, F_NUMBERS, DEPTHS, DEPTHS)
def test_equation_8_as_printed_for_points_beyond_the_focal_length(focal_length, n, focused, depth):
    def image(distance):
        return focal_length * distance / (distance - focal_length)

    printed = abs(image(focused) - image(depth)) * focal_length / (n * image(depth))
    circle = ThinLens(focal_length, n, focused).circle_of_confusion(depth)
    # What is printed subtracts image distances that are nearly equal, so it loses digits.
    assert abs(circle) == pytest.approx(printed, rel=1e-9, abs=1e-12 * focal_length**2)


@given(FOCAL_LENGTHS, F_NUMBERS, DEPTHS, DEPTHS)
def test_circle_is_positive_before_and_negative_beyond_the_focused_plane(f, n, focused, depth):
    assume(abs(depth / focused - 1) > 1e-9)
    circle = ThinLens(f, n, focused).circle_of_confusion(depth)
    assert math.copysign(1, circle) == (1 if depth < focused else -1)


@given(FOCAL_LENGTHS, F_NUMBERS, DEPTHS)
def test_circle_vanishes_on_the_focused_plane(focal_length, n, focused):
    assert ThinLens(focal_length, n, focused).circle_of_confusion(focused) == 0


@given(FOCAL_LENGTHS, F_NUMBERS, DEPTHS)
def test_limiting_circle_of_infinite_depth(focal_length, n, focused):
    circle = ThinLens(focal_length, n, focused).circle_of_confusion(math.inf)
    assert circle == pytest.approx(-(focal_length**2) / (n * (focused - focal_length)), rel=1e-9)


@pytest.mark.parametrize(("depth", "circle"), [(1000, 0.625), (50, 12.5), (10, 62.5)])
def test_circle_of_a_lens_focused_at_infinity(depth, circle):
    """C = D F / P: the film is at F, and a cone of the lens's diameter leaves the point."""
    assert ThinLens(50, 4).circle_of_confusion(depth) == pytest.approx(circle, rel=1e-12)
    assert ThinLens(50, 4).circle_of_confusion(math.inf) == 0


def test_circle_is_affine_in_the_vergence_also_inside_the_focal_length():
    """Equation 8 as printed is 0/0 at P = F; the form that is used passes through it."""
    lens = ThinLens(50, 2, 400)
    vergence = np.array([1 / 800, 1 / 400, 1 / 60, 1 / 50, 1 / 40, 1 / 5])
    slope = np.diff(lens.circle_of_confusion(1 / vergence)) / np.diff(vergence)
    np.testing.assert_allclose(slope, 25 * (50 * 400 / 350), rtol=1e-12)
    assert lens.circle_of_confusion(0) == math.inf


@BOTH_FILMS
def test_circle_is_what_the_equivalent_thin_lens_blurs(film):
    """A thin lens blurs by R |1/P - 1/U| on a plane at distance 1; the film is at distance d."""
    lens = ThinLens(50, 2.8, 1.2, film=film, millimeters_per_unit=1000)
    depth = np.array([0.03, 0.5, 1.1, 1.3, 9, np.inf])
    thin = lens.to_thinlens()
    film_distance = 36 / (2 * math.tan(math.radians(thin["fov"]) / 2))
    blur = 2 * thin["aperture_radius"] * np.abs(1 / depth - 1 / thin["focus_distance"])
    np.testing.assert_allclose(
        np.abs(lens.circle_of_confusion(depth)), blur * film_distance, rtol=1e-12
    )


# ---------------------------------------------------------------- kinds of numbers

DISTANCES = np.array([20.0, 50.0, 300.0, 999.0, 1000.0, 1001.0, 1e5, np.inf])
RESULTS = {
    "circle_of_confusion": lambda lens, depth: lens.circle_of_confusion(depth),
    "image_distance": lambda lens, depth: lens.image_distance(depth + 30),
    "near": lambda lens, depth: lens.replace(focus_distance=depth + 60).depth_of_field().near,
    "far": lambda lens, depth: lens.replace(focus_distance=depth + 60).depth_of_field().far,
    "f_number": lambda lens, depth: (
        lens.replace(aperture_radius=0.1, focus_distance=depth + 60).f_number
    ),
}


@pytest.mark.parametrize("focused", [1000.0, math.inf])
@pytest.mark.parametrize("result", RESULTS.values(), ids=RESULTS)
def test_floats_numpy_and_drjit_arrays_give_equal_values(result, focused, variant_llvm):
    lens = ThinLens(50.0, 4.0, focused)
    one_by_one = np.array([result(lens, float(distance)) for distance in DISTANCES])
    assert isinstance(result(lens, 300.0), float)
    np.testing.assert_allclose(result(lens, DISTANCES), one_by_one, rtol=1e-14)

    for kind, tolerance in ((mi.Float64, 1e-13), (mi.Float, 2e-6)):
        array = result(lens, kind(DISTANCES))
        assert isinstance(array, kind)
        # The circle near the focused plane is a small difference: judged by the largest one.
        atol = tolerance * np.abs(one_by_one[np.isfinite(one_by_one)]).max()
        np.testing.assert_allclose(np.array(array), one_by_one, rtol=tolerance, atol=atol)


def test_all_parameters_may_be_arrays(variant_llvm):
    values = {
        "focal_length": [35, 50, 85],
        "f_number": [2, 4, 8],
        "focus_distance": [500, 1000, np.inf],
    }
    depth = np.array([300, 2000, 700.0])
    expected = [
        ThinLens(*(float(v[i]) for v in values.values())).circle_of_confusion(float(depth[i]))
        for i in range(3)
    ]
    for kind in (np.array, mi.Float64):
        lens = ThinLens(**{name: kind(np.array(v, float)) for name, v in values.items()})
        circle = np.array(lens.circle_of_confusion(kind(depth)))
        np.testing.assert_allclose(circle, expected, rtol=1e-12)


POINT = {"focal_length": 50.0, "focus_distance": 1000.0, "depth": 700.0}


@BOTH_FILMS
@pytest.mark.parametrize("aperture", [{"f_number": 4.0}, {"aperture_radius": 6.0}], ids="_".join)
@pytest.mark.parametrize("name", ["focal_length", "focus_distance", "depth", "aperture"])
def test_derivative_of_the_circle_agrees_with_central_differences(
    name, aperture, film, variant_llvm
):
    values = POINT | aperture
    name = next(iter(aperture)) if name == "aperture" else name

    def circle(value):
        changed = values | {name: value}
        depth = changed.pop("depth")
        return ThinLens(**changed, film=film).circle_of_confusion(depth)

    parameter = mi.Float64(values[name])
    dr.enable_grad(parameter)
    dr.backward(circle(parameter))

    step = 1e-4 * values[name]
    difference = (circle(values[name] + step) - circle(values[name] - step)) / (2 * step)
    assert abs(difference) > 1e-6
    assert dr.grad(parameter)[0] == pytest.approx(difference, rel=1e-6)


def test_derivative_by_depth_in_closed_form(variant_llvm):
    depth = mi.Float64([200, 1000, 1500])
    dr.enable_grad(depth)
    dr.backward(ThinLens(50, 4, 1000).circle_of_confusion(depth))
    expected = -12.5 * (50 * 1000 / 950) / np.array([200, 1000, 1500.0]) ** 2
    np.testing.assert_allclose(np.array(dr.grad(depth)), expected, rtol=1e-12)


# ---------------------------------------------------------------- apertures and film positions


def test_to_thinlens_with_the_film_at_the_focal_length():
    """The paper's film: fov = 2 atan(W / 2F), R = V_u / 2n."""
    thin = ThinLens(50, 4, 1000).to_thinlens()
    assert thin == {
        "type": "thinlens",
        "fov": pytest.approx(math.degrees(2 * math.atan(36 / 100)), rel=1e-12),
        "fov_axis": "x",
        "aperture_radius": pytest.approx(50 * 1000 / 950 / 8, rel=1e-12),
        "focus_distance": 1000,
    }


def test_to_thinlens_with_the_film_at_the_focused_image():
    """A real camera, which breathes: fov = 2 atan(W / 2V_u), R = F / 2n."""
    image = 50 * 1000 / 950
    thin = ThinLens(50, 4, 1000, frame_width=24, film="focused").to_thinlens()
    assert thin == {
        "type": "thinlens",
        "fov": pytest.approx(math.degrees(2 * math.atan(24 / (2 * image))), rel=1e-12),
        "fov_axis": "x",
        "aperture_radius": pytest.approx(50 / 8, rel=1e-12),
        "focus_distance": 1000,
    }


def test_to_thinlens_is_in_scene_units():
    in_mm = ThinLens(50, 4, 1000).to_thinlens()
    in_m = ThinLens(50, 4, 1, millimeters_per_unit=1000).to_thinlens()
    assert in_m["aperture_radius"] == pytest.approx(in_mm["aperture_radius"] / 1000, rel=1e-12)
    assert in_m["focus_distance"] == 1
    assert in_m["fov"] == pytest.approx(in_mm["fov"], rel=1e-12)


def test_to_thinlens_stands_in_for_infinity_with_a_finite_distance():
    thin = ThinLens(50, 4).to_thinlens()
    assert thin["aperture_radius"] == 6.25
    assert thin["focus_distance"] == 6.25e9


def test_to_thinlens_is_json_ready_for_arrays_of_one(variant_llvm):
    lens = ThinLens(mi.Float64(50), np.array([4.0]), mi.Float64(1000))
    assert json.loads(json.dumps(lens.to_thinlens())) == ThinLens(50, 4, 1000).to_thinlens()


@pytest.mark.parametrize("aperture", [{"f_number": math.inf}, {"aperture_radius": 0}], ids="_".join)
def test_a_pinhole_has_no_blur_and_is_a_perspective_sensor(aperture):
    lens = ThinLens(50, focus_distance=1000, **aperture)
    assert (lens.f_number, lens.aperture_radius, lens.lens_diameter) == (math.inf, 0, 0)
    assert lens.circle_of_confusion(300) == 0
    assert lens.to_thinlens() == {"type": "perspective", "fov": lens.fov, "fov_axis": "x"}
    assert lens.depth_of_field() == (0, math.inf)


@BOTH_FILMS
@given(FOCAL_LENGTHS, F_NUMBERS, DEPTHS, st.sampled_from([1.0, 10.0, 1000.0]))
def test_f_number_and_aperture_radius_describe_one_lens(film, focal_length, n, focused, unit):
    options = {"film": film, "millimeters_per_unit": unit}
    by_number = ThinLens(focal_length, n, focused / unit, **options)
    by_radius = ThinLens(
        focal_length,
        focus_distance=focused / unit,
        aperture_radius=by_number.aperture_radius,
        **options,
    )
    assert by_radius.f_number == pytest.approx(n, rel=1e-12)
    circles = [
        lens.circle_of_confusion(np.array([0.5, 2, np.inf]) * focused / unit)
        for lens in (by_number, by_radius)
    ]
    np.testing.assert_allclose(circles[1], circles[0], rtol=1e-9)


def test_the_given_one_of_f_number_and_radius_stays_as_the_lens_is_focused():
    by_number = ThinLens(50, 4, 1000)
    radius = by_number.aperture_radius
    by_radius = ThinLens(50, focus_distance=1000, aperture_radius=radius)
    by_number, by_radius = (lens.replace(focus_distance=200) for lens in (by_number, by_radius))
    assert by_number.f_number == 4
    assert by_number.aperture_radius == pytest.approx(50 * 200 / 150 / 8, rel=1e-12)
    assert by_radius.aperture_radius == radius
    assert by_radius.f_number == pytest.approx(4 * (200 / 150) / (1000 / 950), rel=1e-12)


def test_replace_exchanges_f_number_and_radius_and_keeps_the_rest():
    lens = ThinLens(50, 4, 1, frame_width=24, millimeters_per_unit=1000, film="focused")
    exchanged = lens.replace(aperture_radius=0.002)
    assert "f_number" not in exchanged.parameters()
    assert exchanged.aperture_radius == 0.002
    assert exchanged.f_number == pytest.approx(12.5, rel=1e-12)
    back = exchanged.replace(f_number=4)
    assert back.parameters() == lens.parameters()
    assert lens.f_number == 4  # the first lens is as it was


def test_parameters_build_an_equal_lens():
    lens = ThinLens(50, 4, 1, frame_width=24, millimeters_per_unit=1000, film="focused")
    assert ThinLens(**lens.parameters()) == lens
    assert lens.replace() == lens
    assert lens.replace(f_number=4.1) != lens
    assert lens.replace(aperture_radius=lens.aperture_radius) != lens
    assert lens != "ThinLens"
    assert eval(repr(lens), {"ThinLens": ThinLens, "Disc": Disc}) == lens


def test_files_of_before_say_image_distance_for_film():
    lens = ThinLens(50, 4, 1000, film="focused")
    values = lens.to_dict()
    values["image_distance"] = values.pop("film")
    assert ThinLens.from_dict(values) == lens == ThinLens.from_dict(lens.to_dict())


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"focal": 3}, TypeError, "^focal: not a parameter of ThinLens, which has aperture, "),
        ({"f_number": [4, 5]}, TypeError, r"^f_number=\[4, 5\]: must be a number"),
        ({"squeeze": True}, TypeError, "^squeeze=True: must be a number"),
        ({"film": "far"}, ValueError, "^film='far': must be one of focal, focused"),
        ({"film": ["focal"]}, TypeError, "^film=.*must be one of focal, focused"),
        ({"aperture": 3}, TypeError, "^aperture=3: "),
        ({"aperture_radius": 1.0}, ValueError, "^f_number=.*, aperture_radius=1.0: exactly one"),
    ],
)
def test_what_a_file_says_of_a_lens_is_checked(changes, error, message):
    values = ThinLens(50, 4, 1000).to_dict()
    with pytest.raises(error, match=message):
        ThinLens.from_dict({**values, **changes})
    del values["focal_length"]
    with pytest.raises(TypeError, match=r"^focal_length: must be given"):
        ThinLens.from_dict(values)


@BOTH_FILMS
def test_a_scene_in_metres_gives_the_same_optics(film):
    in_mm = ThinLens(50, 4, 1000, film=film)
    in_m = ThinLens(50, 4, 1, millimeters_per_unit=1000, film=film)
    depth = np.array([30, 400, 1000, 5000, np.inf])
    np.testing.assert_allclose(
        in_m.circle_of_confusion(depth / 1000), in_mm.circle_of_confusion(depth), rtol=1e-12
    )
    np.testing.assert_allclose(
        in_m.image_distance(depth / 1000), in_mm.image_distance(depth), rtol=1e-12
    )
    np.testing.assert_allclose(
        np.array(in_m.depth_of_field()) * 1000, in_mm.depth_of_field(), rtol=1e-12
    )
    assert in_m.hyperfocal_distance() * 1000 == pytest.approx(in_mm.hyperfocal_distance())
    assert in_m.fov == pytest.approx(in_mm.fov, rel=1e-12)
    assert in_m.lens_diameter == in_mm.lens_diameter


# ---------------------------------------------------------------- fields of view


@BOTH_FILMS
@pytest.mark.parametrize("focused", [0.3, math.inf])
@pytest.mark.parametrize("given_one", [{}, {"frame_width": 24}, {"focal_length": 85}], ids=str)
@pytest.mark.parametrize("fov", [2.0, 40.0, 120.0])
def test_of_field_of_view_covers_that_field(fov, given_one, focused, film):
    lens = ThinLens.of_field_of_view(
        fov,
        **given_one,
        f_number=4,
        focus_distance=focused * 4,
        millimeters_per_unit=1000,
        film=film,
    )
    assert lens.fov == pytest.approx(fov, rel=1e-12)
    kept = given_one or {"frame_width": 36}
    for name, value in kept.items():
        assert getattr(lens, name) == value
    assert (lens.f_number, lens.focus_distance) == (4, focused * 4)


def test_a_normal_lens_has_the_field_of_view_that_photographers_know():
    assert ThinLens(50, 4).fov == pytest.approx(39.6, abs=0.01)  # across 36 mm


# ---------------------------------------------------------------- what is refused

REFUSED = {
    "f_number_0": ({"f_number": 0}, "f_number=0: "),
    "f_number_negative": ({"f_number": -1.5}, "f_number=-1.5: "),
    "f_number_nan": ({"f_number": math.nan}, "f_number=nan: "),
    "focal_length_0": ({"focal_length": 0}, "focal_length=0: "),
    "focal_length_negative": ({"focal_length": -5}, "focal_length=-5: "),
    "focal_length_inf": ({"focal_length": math.inf}, "focal_length=inf: "),
    "focus_inside": ({"focus_distance": 49}, "focus_distance=49: "),
    "focus_at_focal_length": ({"focus_distance": 50.0}, "focus_distance=50.0: "),
    "focus_negative": ({"focus_distance": -100}, "focus_distance=-100: "),
    "focus_nan": ({"focus_distance": math.nan}, "focus_distance=nan: "),
    "focus_in_metres": (
        {"focus_distance": 0.05, "millimeters_per_unit": 1000},
        "focus_distance=0.05: must be beyond the focal length of 50 mm",
    ),
    "both_apertures": (
        {"aperture_radius": 2.5},
        "f_number=4, aperture_radius=2.5: exactly one",
    ),
    "no_aperture": ({"f_number": None}, "f_number=None, aperture_radius=None: exactly one"),
    "radius_negative": ({"f_number": None, "aperture_radius": -0.1}, "aperture_radius=-0.1: "),
    "radius_inf": ({"f_number": None, "aperture_radius": math.inf}, "aperture_radius=inf: "),
    "frame_width_0": ({"frame_width": 0}, "frame_width=0: "),
    "unit_negative": ({"millimeters_per_unit": -1}, "millimeters_per_unit=-1: "),
    "film": ({"film": "far"}, "film='far': .*focal, focused"),
    "film_number": ({"film": 50}, "film=50: "),
    "one_of_many": ({"f_number": np.array([4.0, -7.0])}, "f_number=-7.0: "),
    "one_focus_of_many": ({"focus_distance": np.array([900.0, 3.0])}, "focus_distance=3.0: "),
}


@pytest.mark.parametrize(("parameters", "text"), REFUSED.values(), ids=REFUSED)
def test_bad_values_are_refused_by_name_and_value(parameters, text):
    good = {"focal_length": 50, "f_number": 4, "focus_distance": 1000}
    with pytest.raises((ValueError, TypeError), match="^" + text):
        ThinLens(**(good | parameters))


@pytest.mark.parametrize("name", ["focal_length", "f_number", "focus_distance", "frame_width"])
@pytest.mark.parametrize("value", [b"50", True, [None]], ids=str)
def test_what_is_no_number_is_refused(name, value):
    good = {"focal_length": 50, "f_number": 4, "focus_distance": 1000}
    with pytest.raises(TypeError, match=re.escape(f"{name}={value!r}: must be a number")):
        ThinLens(**(good | {name: value}))


def test_lengths_may_be_texts_with_units():
    lens = ThinLens("5cm", "f/2.8", "1.2m", frame_width="1in", millimeters_per_unit=1000)
    assert lens == ThinLens(50, 2.8, 1.2, frame_width=25.4, millimeters_per_unit=1000)
    assert lens.replace(focus_distance="290mm").focus_distance == pytest.approx(0.29)
    assert lens.replace(aperture_radius="5mm").aperture_radius == pytest.approx(0.005)
    assert lens.replace(focus_distance="2").focus_distance == 2  # of scene units
    wide = ThinLens.of_field_of_view(
        60, frame_width="3.6cm", f_number="f/4", focus_distance="50cm", millimeters_per_unit=10
    )
    assert (wide.frame_width, wide.f_number, wide.focus_distance) == (36, 4, 50)


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"focus_distance": "far"}, "focus_distance='far': must be a length, such as 1.2, 1.2m or"),
        ({"focal_length": "50 km"}, "focal_length='50 km': must be a length"),
        ({"f_number": "wide"}, "f_number='wide': must be an f-number, such as 2.8 or f/2.8"),
        ({"focus_distance": "-1m"}, "focus_distance=-1000.0: must be > 0 scene units"),
    ],
)
def test_texts_that_say_no_length_are_refused_by_name(parameters, text):
    good = {"focal_length": 50, "f_number": 4, "focus_distance": 1000}
    with pytest.raises(ValueError, match="^" + re.escape(text)):
        ThinLens(**(good | parameters))


def test_bad_drjit_values_are_refused(variant_llvm):
    with pytest.raises(ValueError, match=r"^f_number=-1\.0: "):
        ThinLens(50, mi.Float([4, -1]), 1000)
    with pytest.raises(ValueError, match=r"^depth=-2\.0: "):
        ThinLens(50, 4, 1000).circle_of_confusion(mi.Float([2, -2]))


@pytest.mark.parametrize("depth", [-1.0, math.nan, -math.inf])
def test_negative_depths_are_refused(depth):
    with pytest.raises(ValueError, match=f"^depth={depth}: "):
        ThinLens(50, 4, 1000).circle_of_confusion(depth)


def test_a_bad_focus_among_lenses_of_many_focal_lengths_is_named():
    with pytest.raises(ValueError, match=r"^focus_distance=60\.0: "):
        ThinLens(np.array([[35.0], [85.0]]), 4, np.array([60.0, 900.0, 1000.0]))


def test_replace_refuses_unknown_names_and_bad_values():
    lens = ThinLens(50, 4, 1000)
    with pytest.raises(TypeError, match=r"^blades: not a parameter of ThinLens.*f_number"):
        lens.replace(blades=3)
    with pytest.raises(ValueError, match=r"^focus_distance=20: "):
        lens.replace(focus_distance=20)
    with pytest.raises(ValueError, match="f_number=4, aperture_radius=2: exactly one"):
        lens.replace(f_number=4, aperture_radius=2)


@pytest.mark.parametrize("fov", [0, 180, -40, math.nan])
def test_impossible_fields_of_view_are_refused(fov):
    with pytest.raises(ValueError, match=f"^fov={fov}: "):
        ThinLens.of_field_of_view(fov, f_number=4)


def test_a_field_of_view_beside_both_that_it_follows_from_is_refused():
    """As in the sensor; one of the three would otherwise be ignored."""
    with pytest.raises(ValueError, match=r"focal_length=50, frame_width=24: must not both.* fov"):
        ThinLens.of_field_of_view(40, focal_length=50, frame_width=24, f_number=4)


def test_lenses_are_unhashable_as_they_may_hold_arrays():
    with pytest.raises(TypeError, match="unhashable"):
        hash(ThinLens(50, 4))


@pytest.mark.parametrize("acuity", [0.0, -1e-3, math.inf])
def test_a_bad_acuity_is_refused_by_name_and_value(acuity):
    with pytest.raises(ValueError, match=rf"acuity={acuity}"):
        ThinLens(50.0, 2.0, 2000.0).depth_of_field(acuity)
