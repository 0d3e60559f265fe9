import math

import pytest

from potmesil_mi._units import Length, f_number_of, in_one_unit, length_text


@pytest.mark.parametrize(
    ("text", "in_meters"),
    [
        ("1.2m", 1.2),
        ("290mm", 0.29),
        ("290 MM", 0.29),
        ("12cm", 0.12),
        ("10in", 0.254),
        ("1.2", 1.2),
        ("1e-3 m", 1e-3),
        (".5m", 0.5),
        ("inf", math.inf),
        ("-1m", -1.0),
    ],
)
def test_a_length_is_in_its_unit_or_else_in_scene_units(text, in_meters):
    assert Length.of(text).in_units(1000) == pytest.approx(in_meters)


@pytest.mark.parametrize("text", ["", "m", "1.2q", "1,2m", "1.2 m m", "f/2", "1.2m3", "0x10"])
def test_what_is_no_length_is_refused(text):
    with pytest.raises(ValueError, match="must be a length"):
        Length.of(text)


@pytest.mark.parametrize("text", ["2.8", "f/2.8", "F/2.8", "f / 2.8"])
def test_an_f_number_is_read_as_photographers_write_it(text):
    assert f_number_of(text) == 2.8


@pytest.mark.parametrize("text", ["", "f", "f2.8", "2.8m", "1/2.8"])
def test_what_is_no_f_number_is_refused(text):
    with pytest.raises(ValueError, match="must be an f-number"):
        f_number_of(text)


def test_a_length_is_told_in_its_unit_where_a_scene_unit_is_one():
    assert length_text(1.25, 1000) == "1.25 m"
    assert length_text(290, 1) == "290 mm"
    assert length_text(3, 25.4) == "3 in"
    assert length_text(2, 50) == "2 (100 mm)"


def test_lengths_of_several_units_are_told_in_one_and_inf_needs_none():
    assert in_one_unit("value", [1.0, 2.0]) == ([1.0, 2.0], None)
    assert in_one_unit("value", ["1", 2.0]) == ([1.0, 2.0], None)
    assert in_one_unit("value", ["29cm", "2m", math.inf]) == ([290.0, 2000.0, math.inf], "mm")
    with pytest.raises(ValueError, match=r"value=.*: must all have a unit, or none"):
        in_one_unit("value", ["29cm", 2.0])
    with pytest.raises(ValueError, match="value='far': must be a length"):
        in_one_unit("value", ["far", 2.0])


@pytest.mark.parametrize("parse", [Length.of, f_number_of])
def test_whoever_writes_a_comma_is_told_how_decimals_and_several_are_written(parse):
    with pytest.raises(ValueError, match="decimals have a point, and several have spaces between"):
        parse("2,8")
