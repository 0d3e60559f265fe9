"""Shapes of a scene that are moved and put back."""

import mitsuba as mi
import numpy as np
import pytest

from potmesil_mi.tracing.posing import PosedShapes

pytestmark = pytest.mark.usefixtures("variant_llvm")


def scene(moved=None, matrix=None):
    """A ball, a cube (a mesh), an instance and a lamp; one of them ``moved`` from the start."""

    def at(name, *steps):
        transform = mi.ScalarTransform4f()
        for step in steps:
            transform = transform @ step
        if name == moved:
            transform = mi.ScalarTransform4f(matrix) @ transform
        return transform

    shift, size = mi.ScalarTransform4f().translate, mi.ScalarTransform4f().scale
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": mi.ScalarTransform4f().look_at([0, 1, 8], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 32, "height": 24},
                "sampler": {"type": "independent", "sample_count": 4},
            },
            "group": {"type": "shapegroup", "inner": {"type": "cube"}},
            "ball": {"type": "sphere", "to_world": at("ball", shift([-2, 0, 0]))},
            "box": {"type": "cube", "to_world": at("box", shift([0, 1, 0]), size(0.5))},
            "twin": {
                "type": "instance",
                "to_world": at("twin", shift([2, 0, 0]), size(0.6)),
                "group": {"type": "ref", "id": "group"},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": at(
                    "lamp", shift([0, 5, 0]), mi.ScalarTransform4f().rotate([1, 0, 0], 90)
                ),
                "emitter": {"type": "area"},
            },
        },
        optimize=False,
    )


def picture(of):
    return np.array(mi.render(of, seed=1))


@pytest.mark.parametrize("name", ["ball", "box", "twin", "lamp"])
def test_a_shape_that_is_moved_is_where_the_scene_would_have_it(name):
    turn = mi.ScalarTransform4f().translate([0.3, -0.5, 0.4]) @ mi.ScalarTransform4f().rotate(
        [1, 2, 0.5], 40
    )
    matrix = np.array(turn.matrix)
    posed = scene()
    still = picture(posed)
    shapes = PosedShapes(posed, [name])
    shapes.place({name: matrix})
    np.testing.assert_allclose(picture(posed), picture(scene(name, matrix)), atol=2e-3)
    assert np.abs(picture(posed) - still).max() > 0.01
    shapes.place({})
    np.testing.assert_allclose(picture(posed), still, atol=1e-6)


def test_the_middle_of_a_shape_is_where_the_scene_has_it():
    posed = scene()
    shapes = PosedShapes(posed, ["ball", "box"])
    shapes.place({"box": np.diag([3.0, 3, 3, 1])})
    np.testing.assert_allclose(shapes.centres["ball"], [-2, 0, 0], atol=1e-6)
    np.testing.assert_allclose(shapes.centres["box"], [0, 1, 0], atol=1e-6)


def test_shapes_that_cannot_be_moved_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"shapes.cone: must be the id of one shape.*ball, box"):
        PosedShapes(scene(), ["ball", "cone"])
    with pytest.raises(ValueError, match=r"shapes.inner: must be the id of one shape"):
        PosedShapes(scene(), ["inner"])
    points = tmp_path / "hair.txt"
    points.write_text("0 0 0 .1\n1 0 0 .1\n1 1 0 .1")
    curve = (
        f'<shape type="linearcurve" id="hair"><string name="filename" value="{points}"/></shape>'
    )
    unnamed = '<shape type="sphere"/><shape type="disk" id="coin"/>'
    hair = mi.load_string(f'<scene version="3.0.0">{unnamed}{curve}</scene>', optimize=False)
    with pytest.raises(ValueError, match=r"shapes.hair: is a LinearCurve, which Mitsuba lets"):
        PosedShapes(hair, ["hair"])
