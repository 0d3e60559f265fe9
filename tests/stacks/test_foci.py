"""Which lenses a stack has: distances at equal steps, apertures, tables of lenses."""

import math

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.stacks.foci import Foci, read_table

THIN = pm.ThinLens(50.0, 2.0, 2.0, millimeters_per_unit=1000.0)
TELECENTRIC = pm.TelecentricLens(2.0, 2.0)


def focused(lenses):
    return [lens.focus_distance for lens in lenses]


def test_circles_of_confusion_grow_by_equal_steps_from_near_to_far():
    lenses = Foci(near=0.5, far=math.inf, count=5).lenses(THIN.replace(film="focused"))
    assert focused(lenses)[0] == 0.5
    assert focused(lenses)[-1] == math.inf
    steps = np.diff(1 / np.array(focused(lenses)))
    np.testing.assert_allclose(steps, -0.5)
    radii = np.array([lens.aperture_radius for lens in lenses])
    shifts = radii[0] * (1 / 3.0 - 1 / np.array(focused(lenses)))
    np.testing.assert_allclose(np.diff(shifts), np.diff(shifts)[0])


def test_depths_of_a_telecentric_lens_go_by_equal_steps():
    lenses = Foci(near=-1.0, far=3.0, count=5).lenses(TELECENTRIC)
    assert focused(lenses) == [-1, 0, 1, 2, 3]


def test_all_distances_are_focused_on_with_each_aperture():
    lenses = Foci([1.0, math.inf], f_numbers=[2.8, 5.6]).lenses(THIN)
    assert [(one.f_number, one.focus_distance) for one in lenses] == [
        (2.8, 1.0), (2.8, math.inf), (5.6, 1.0), (5.6, math.inf),
    ]  # fmt: skip
    assert len(Foci([1.0, math.inf], f_numbers=[2.8, 5.6])) == 4
    assert focused(Foci(f_numbers=[4.0]).lenses(THIN)) == [2.0]


def test_a_table_has_lenses_and_what_others_have_in_place_of_the_lens_at_hand():
    other = THIN.replace(focal_length=85.0)
    foci = Foci(table=[other, {"f_number": 8.0, "focus_distance": 3.0}])
    assert foci.lenses(THIN) == [other, THIN.replace(f_number=8.0, focus_distance=3.0)]
    assert foci.first_lens() == {"focus_distance": 2.0, "f_number": 2.0}
    wider = Foci(table=[{"half_angle": 1.0}, {"half_angle": 3.0}])
    assert wider.first_lens() == {"half_angle": 3.0}  # for which samples are taken


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "distances: must be given"),
        ({"distances": []}, r"distances=\[\]: must be one at least"),
        ({"distances": 1.0}, "distances=1.0: must be several"),
        ({"distances": [1.0], "near": 1.0}, "near=1.0: must not be given with distances"),
        ({"near": 1.0, "far": 2.0}, "count: must be given with near, far"),
        ({"near": 1.0, "far": 1.0, "count": 3}, "far=1.0: must be > near=1.0"),
        ({"near": 1.0, "far": 2.0, "count": 1}, "count=1: must be 2 to"),
        ({"distances": [1.0, "x"]}, r"distances\[1\]='x': must be a length"),
        ({"distances": [1.0], "f_numbers": [-1]}, r"f_numbers\[0\]=-1: must be > 0"),
        ({"table": [{}], "count": 3}, "count=3: must not be given with lenses="),
        ({"table": [3]}, r"lenses\[0\]=3: must be a lens"),
    ],
)
def test_what_does_not_go_together_is_named(given, message):
    with pytest.raises((ValueError, TypeError), match=message):
        Foci(**given)


def test_a_lens_that_there_cannot_be_is_told_with_its_place():
    with pytest.raises(ValueError, match=r"distances\[1\]: focus_distance=0.01"):
        Foci([1.0, 0.01]).lenses(THIN)
    with pytest.raises(ValueError, match="f_numbers: must be None for a TelecentricLens"):
        Foci([1.0], f_numbers=[2.0]).lenses(TELECENTRIC)
    with pytest.raises(ValueError, match=r"near: focus_distance=-1\.0: must be"):
        Foci(near=-1.0, far=2.0, count=3).lenses(THIN)
    with pytest.raises(TypeError, match=r"lenses\[0\]: width: not a parameter"):
        Foci(table=[{"width": 1}]).lenses(THIN)


def test_tables_are_read_from_csv_and_toml(tmp_path):
    rows = [{"focus_distance": 0.8, "f_number": 2.8}, {"focus_distance": math.inf, "film": "focal"}]
    csv, toml = tmp_path / "lenses.csv", tmp_path / "lenses.toml"
    csv.write_text("focus_distance, f_number,film\n0.8,2.8,\n\ninf,,focal\n", encoding="utf-8")
    toml.write_text(
        "[[lenses]]\nfocus_distance = 0.8\nf_number = 2.8\n"
        "[[lenses]]\nfocus_distance = inf\nfilm = 'focal'\n",
        encoding="utf-8",
    )
    assert read_table(csv) == read_table(toml) == rows


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "f_number\nwide\n", "a.csv: line 2: f_number='wide': must be an f-number"),
        ("a.csv", "f_number\n1,2\n", "a.csv: line 2: has 2 fields, must have 1"),
        ("a.csv", "", "a.csv: must have names of parameters"),
        ("a.toml", "lens = 3", "a.toml: lens: unknown"),
        ("a.toml", "lenses = 3", "a.toml: lenses=3: must be tables"),
        ("a.txt", "", "must end in one of .csv, .toml"),
    ],
)
def test_what_is_wrong_in_a_table_is_told_with_the_file(tmp_path, name, text, message):
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises((ValueError, TypeError), match=message):
        read_table(tmp_path / name)


def test_texts_with_units_are_distances_of_the_lens_whose_scene_unit_it_knows():
    foci = Foci(["29cm", 2.0, "inf"], f_numbers=["f/2.8", 4])
    assert focused(foci.lenses(THIN)) == pytest.approx([0.29, 2.0, math.inf] * 2)
    assert [lens.f_number for lens in foci.lenses(THIN)] == [2.8] * 3 + [4] * 3
    in_centimetres = THIN.replace(focus_distance=200, millimeters_per_unit=10)
    ends = Foci(near="50cm", far=200, count=2)
    assert focused(ends.lenses(in_centimetres)) == pytest.approx([50, 200])
    assert focused(Foci(near="0.5m", far="20in", count=2).lenses(in_centimetres)) == pytest.approx(
        [50, 50.8]
    )


def test_the_farther_end_is_looked_at_when_the_unit_is_known():
    with pytest.raises(ValueError, match=r"far='20cm': must be > near='0.5m'"):
        Foci(near="0.5m", far="20cm", count=3)
    mixed = Foci(near="50cm", far=2, count=2)
    assert focused(mixed.lenses(THIN)) == [0.5, 2]
    with pytest.raises(ValueError, match=r"far=2: must be > near=50"):
        mixed.lenses(THIN.replace(focus_distance=200, millimeters_per_unit=10))


def test_a_telecentric_lens_has_no_unit_to_know():
    assert focused(Foci(["3"]).lenses(TELECENTRIC)) == [3]
    with pytest.raises(ValueError, match=r"distances\[0\]='3cm': must have no unit"):
        Foci(["3cm"]).lenses(TELECENTRIC)


def test_a_table_may_have_units(tmp_path):
    (tmp_path / "a.csv").write_text("focus_distance,f_number,focal_length\n29cm,f/2.8,5cm\n")
    (tmp_path / "a.toml").write_text('[[lenses]]\nfocus_distance = "29cm"\nf_number = "f/2.8"\n')
    for name in ("a.csv", "a.toml"):
        (lens,) = Foci(table=read_table(tmp_path / name)).lenses(THIN)
        assert (lens.focus_distance, lens.f_number) == (pytest.approx(0.29), 2.8)
        assert lens.focal_length == 50


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("distance,f_number\n1,2\n", "line 1: distance: unknown, must be one of f_number"),
        ("1,2\n3,4\n", "line 1: 1: unknown, must be one of"),
        ("focus_distance;f_number\n1;2\n", "line 1: .*must be names with commas between"),
    ],
)
def test_a_first_line_that_names_no_parameters_is_told(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_table(tmp_path / "a.csv")
