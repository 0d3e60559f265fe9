"""Shapes that are moved from where a scene has them."""

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.motion.shape_move import ShapeMove


def moved(values, frame, point, centre=(0, 0, 0)):
    matrix = ShapeMove.from_dict(values).at(frame, np.array(centre, float))
    return (matrix @ [*point, 1])[:3]


def test_a_shape_that_is_told_nothing_stays():
    np.testing.assert_array_equal(ShapeMove().at(3, np.ones(3)), np.eye(4))


def test_a_shape_is_shifted():
    move = {"translate": [[0, [0, 0, 0]], [4, [4, 8, -4], "hold"]]}
    np.testing.assert_allclose(moved(move, 1, (1, 1, 1)), [2, 3, 0])


def test_a_shape_turns_about_its_middle_against_the_clock_as_seen_from_the_end_of_the_axis():
    turn = {"angle": [[0, 0], [2, 180]], "axis": [0, 0, 5]}
    np.testing.assert_allclose(moved(turn, 1, (1, 0, 0)), [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(moved(turn, 1, (3, 1, 7), (2, 1, 0)), [2, 2, 7], atol=1e-12)
    np.testing.assert_allclose(moved({"angle": 90}, 0, (0, 0, 1)), [1, 0, 0], atol=1e-12)


def test_sizes_and_turns_leave_the_pivot_and_come_before_the_shift():
    move = {"scale": 2, "angle": 90, "axis": [0, 0, 1], "pivot": [1, 0, 0], "translate": [0, 0, 9]}
    np.testing.assert_allclose(moved(move, 0, (1, 0, 0), (7, 7, 7)), [1, 0, 9], atol=1e-12)
    np.testing.assert_allclose(moved(move, 0, (2, 0, 0), (7, 7, 7)), [1, 2, 9], atol=1e-12)


@pytest.mark.parametrize(
    ("move", "message"),
    [
        ({"ball": 3}, "shapes.ball: 3: must be a table"),
        ({"ball": {"speed": 3}}, "shapes.ball: speed: unknown, must be one of translate"),
        ({"ball": {"translate": 3}}, "shapes.ball: translate: 3: must be three numbers"),
        ({"ball": {"axis": [0, 1, 0]}}, "shapes.ball: axis: must be given with angle"),
        ({"ball": {"scale": [[0, 1], [1, 0]]}}, "shapes.ball: scale=0: must be > 0"),
        ({"ball": {"angle": "fast"}}, "shapes.ball: angle: 'fast': must be a number"),
    ],
)
def test_what_is_wrong_in_a_shape_move_is_named(move, message):
    with pytest.raises((ValueError, TypeError), match=message):
        pm.Animation.from_dict({"frames": 2, "shapes": move})


def test_an_axis_of_no_length_is_named_with_frame_and_shape():
    turn = {"angle": 3, "axis": [[0, [1, 0, 0]], [1, [0, 0, 0]]]}
    animation = pm.Animation.from_dict({"frames": 2, "shapes": {"ball": turn}})
    centres = {"ball": np.zeros(3)}
    assert animation.transforms_at(centres, 0)["ball"].shape == (4, 4)
    with pytest.raises(ValueError, match=r"frame 1: shapes.ball: axis=\[0.0, 0.0, 0.0\]"):
        animation.transforms_at(centres, 1)
