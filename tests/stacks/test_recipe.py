"""Recipes of data sets: what chance chooses is the same for a seed, and errors name the key."""

import math

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.stacks.draws import Draw
from potmesil_mi.stacks.recipe import Recipe

RECIPE = {
    "seed": 7,
    "scenes": [{"path": "a.xml", "define": {"res": 24}}, {"path": "b.xml", "sensors": [1, 0]}],
    "cameras": {"count": 2, "pan": {"uniform": [-5, 5]}, "move": [{"uniform": [0, 1]}, 0, 0]},
    "lens": {"count": 2, "focal_length": {"choice": [35, 85]}},
    "apertures": {"count": 3, "f_number": {"log_uniform": [1.4, 16]}},
    "foci": {"count": 4, "distance": {"reciprocal_uniform": [0.5, math.inf]}},
}


def test_there_is_each_scene_from_each_camera_through_each_lens_and_aperture():
    views = Recipe.from_dict(RECIPE).views()
    assert [(one.name, one.sensor, one.camera) for one in views] == [
        ("a", 0, 0), ("a", 0, 1), ("b", 1, 0), ("b", 1, 1), ("b", 0, 0), ("b", 0, 1),
    ]  # fmt: skip
    stacks = [stack for view in views for stack in view.stacks]
    assert [stack.number for stack in stacks] == list(range(6 * 2 * 3))
    lens = pm.ThinLens(50.0, 2.0, millimeters_per_unit=1000.0)
    lenses = views[1].lenses(lens)
    assert len(lenses) == 2 * 3 * 4
    assert {one.focal_length for one in lenses} <= {35, 85}
    assert all(1.4 <= one.f_number <= 16 for one in lenses)
    assert all(one.focus_distance >= 0.5 for one in lenses)
    assert len({view.seed for view in views}) == 6
    assert len({view.turn["pan"] for view in views}) == 6


def test_what_chance_chooses_does_not_depend_on_what_else_there_is():
    views = Recipe.from_dict(RECIPE).views()
    more = Recipe.from_dict(
        {
            **RECIPE,
            "scenes": [{"path": "c.xml"}, *RECIPE["scenes"]],
            "cameras": {**RECIPE["cameras"], "count": 3},
            "foci": {**RECIPE["foci"], "count": 9},
        }
    ).views()
    found = {(one.name, one.sensor, one.camera): one for one in more}
    for view in views:
        same = found[view.name, view.sensor, view.camera]
        assert (same.seed, same.turn, same.move) == (view.seed, view.turn, view.move)
        for stack, other in zip(view.stacks, same.stacks, strict=True):
            assert other.changes == stack.changes
            assert other.foci.distances[:4] == stack.foci.distances
    assert Recipe.from_dict({**RECIPE, "seed": 8}).views()[0].seed != views[0].seed


def test_lengths_may_have_units():
    """The scene says what its unit is, or its sensor does."""
    recipe = {
        **RECIPE,
        "scenes": [{"path": "a.xml", "units": "cm"}],
        "cameras": {"move": ["1in", {"uniform": ["-5mm", "1cm"]}, 0]},
        "lens": {"focal_length": {"uniform": ["3.5cm", "85mm"]}},
        "apertures": {"f_number": "f/2.8"},
        "foci": {"count": 9, "distance": {"reciprocal_uniform": ["50cm", "2m"]}},
    }
    (view,) = Recipe.from_dict(recipe).views()
    assert view.units == "cm"
    assert view.move[0] == "1in"
    lenses = view.lenses(pm.ThinLens(50.0, 2.0, 100, millimeters_per_unit=10))
    assert all(50 <= one.focus_distance <= 200 for one in lenses)
    assert len({one.focus_distance for one in lenses}) == 9
    assert all(35 <= one.focal_length <= 85 and one.f_number == 2.8 for one in lenses)
    in_scene_units = {**recipe, "foci": {"count": 9, "distance": {"reciprocal_uniform": [50, 200]}}}
    (same,) = Recipe.from_dict(in_scene_units).views()
    found = same.lenses(pm.ThinLens(50.0, 2.0, 100, millimeters_per_unit=10))
    assert [one.focus_distance for one in found] == pytest.approx(
        [one.focus_distance for one in lenses]
    )


@pytest.mark.parametrize(
    ("kind", "ends", "of"),
    [
        ("uniform", (-2.0, 6.0), lambda x: x),
        ("log_uniform", (1.4, 16.0), np.log),
        ("reciprocal_uniform", (0.5, math.inf), lambda x: 1 / x),
    ],
)
def test_draws_are_even_in_what_they_say(kind, ends, of):
    draw = Draw.of("x", {kind: list(ends)})
    drawn = np.array([draw.at(1, f"{i}") for i in range(4000)])
    assert ((drawn >= ends[0]) & (drawn <= ends[1])).all()
    low, high = sorted(of(np.array(ends)))
    even = (of(drawn) - low) / (high - low)
    counts, _ = np.histogram(even, 8, (0, 1))
    assert np.abs(counts - 500).max() < 5 * math.sqrt(500)


def test_each_choice_is_about_as_frequent_and_what_is_no_table_is_always_chosen():
    draw = Draw.of("x", {"choice": ["disc", "polygon"]})
    share = np.mean([draw.at(1, f"{i}") == "disc" for i in range(1000)])
    assert abs(share - 0.5) < 0.08
    assert Draw.of("x", 3).at(1, "any") == 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenes": []}, "scenes=.*must be tables"),
        ({"scenes": [{}]}, r"scenes\[0\]: path=None: must be given"),
        ({"scenes": [{"path": "a.xml"}] * 2}, r"scenes\[1\]: name='a': must be another"),
        ({"scenes": [{"path": "a.xml", "name": "../a"}]}, r"scenes\[0\]: name='../a'"),
        ({"scenes": [{"path": "a.xml", "sensors": []}]}, r"scenes\[0\]: sensors="),
        ({"speed": 1}, "speed: unknown, must be one of seed"),
        ({"seed": -1}, "seed=-1: must be 0 to"),
        ({"layout": "nyu"}, "layout='nyu': must be one of plain, fod500"),
        ({"endings": [".gif"]}, r"endings\[0\]='.gif'"),
        ({"bit_depth": "9"}, "bit_depth='9'"),
        ({"quality": 90}, "quality=90: must be left out, for it is of JPEG"),
        ({"layout": "fod500", "endings": [".png"]}, "endings=.*must be left out for layout"),
        ({"maps": ["depht"]}, r"maps\[0\]='depht'"),
        ({"lens": 3}, "lens=3: must be a table"),
        ({"lens": {"f_stop": 2}}, r"\[lens\].f_stop: unknown, must be one of focal_length"),
        ({"lens": {"count": 0}}, r"\[lens\].count=0: must be 1 to"),
        ({"lens": {"focal_length": -1}}, r"\[lens\].focal_length=-1: must be"),
        ({"apertures": {"f_number": {"uniform": [-1, 2]}}}, r"\[apertures\].f_number=-1"),
        ({"apertures": {"f_number": {"even": [1, 2]}}}, r"\[apertures\].f_number=.*log_uniform"),
        ({"apertures": {"f_number": {"log_uniform": [0, 2]}}}, r"f_number.log_uniform\[0\]=0"),
        ({"apertures": {"f_number": {"uniform": [3, 2]}}}, r"f_number.uniform=\[3, 2\]"),
        ({"apertures": {"f_number": True}}, r"\[apertures\].f_number=True: must be"),
        ({"cameras": {"pan": "left"}}, r"\[cameras\].pan='left': must be numbers"),
        ({"cameras": {"roll": 1}}, r"\[cameras\].roll: unknown"),
        ({"cameras": {"move": [1]}}, r"\[cameras\].move=\[1\]: must be three"),
        ({"foci": {"near": 1}}, r"\[foci\].far: must be given"),
        ({"foci": {"distance": 1, "near": 1}}, r"\[foci\].distance: must not be given"),
        ({"foci": {"distance": "far"}}, r"\[foci\].distance='far': must be a length"),
        ({"foci": {"distance": {"uniform": ["3cm", 4]}}}, r"uniform=.*must all have a unit"),
        ({"scenes": [{"path": "a.xml", "units": "km"}]}, r"units='km': must be one of m,"),
        ({"cameras": {"move": ["left", 0, 0]}}, r"move\[0\]='left': must be a length"),
        ({"foci": {}}, r"\[foci\].distances: must be given"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_recipe_is_named_by_its_key(changes, message):
    with pytest.raises((ValueError, TypeError), match=message):
        Recipe.from_dict({**RECIPE, **changes})
