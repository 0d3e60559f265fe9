"""Surface ids, and which shapes enclose a volume."""

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.tracing.shapes import closed_shapes, is_closed_mesh, registry_index, surface_ids
from scenes import papers_scene, still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")


def test_surface_ids_are_stable_from_load_to_load():
    first, second = (pm.render_samples(papers_scene(16, spp=1)).replace() for _ in range(2))
    assert first.surfaces == {1: "background", 2: "cube", 3: "sphere"}
    assert second.surfaces == first.surfaces
    np.testing.assert_array_equal(first.surface, second.surface)


def test_shapes_without_names_are_told_apart_by_their_place():
    text = """<scene version="3.0.0"><integrator type="depth"/>
        <sensor type="potmesil"><float name="f_number" value="2"/></sensor>
        <shape type="sphere"><point name="center" x="{}" y="0" z="9"/></shape>
        <shape type="sphere"><point name="center" x="{}" y="0" z="9"/></shape></scene>"""
    columns = [
        pm.render_samples(mi.load_string(text.format(*x)), spp=1) for x in ((-2, 2), (2, -2))
    ]
    assert columns[0].surfaces == {1: "Sphere_1", 2: "Sphere_2"}
    np.testing.assert_array_equal(columns[0].surface, columns[1].surface)


def test_an_instance_is_one_surface():
    scene = still_life(
        spp=4,
        group={"type": "shapegroup", "a": {"type": "sphere", "radius": 0.2}},
        ball={
            "type": "instance",
            "to_world": mi.ScalarTransform4f().translate([0, 0, 2]),
            "shapegroup": {"type": "ref", "id": "group"},
        },
    )
    samples = pm.render_samples(scene)
    seen = {samples.surfaces[i] for i in np.unique(samples.surface[samples.surface > 0])}
    assert seen == {"ball", "wall"}


def test_ids_are_found_at_what_a_ray_hits():
    scene = still_life()
    ids, names = surface_ids(scene)
    assert names == {1: "ball", 2: "wall"}
    hit = scene.ray_intersect(mi.Ray3f([[0, 0.7], [0, 0], [0, 0]], [0, 0, 1]))
    assert [names[int(np.array(ids)[i])] for i in np.array(registry_index(hit))] == ["ball", "wall"]


# ---------------------------------------------------------------- closed shapes


def strip_of(faces):
    """A tetrahedron's mesh, of which some faces may be left out."""
    mesh = mi.Mesh("tetrahedron", 4, len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1]
    parameters["faces"] = np.array(faces, dtype=np.uint32).ravel()
    parameters.update()
    return mesh


TETRAHEDRON = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]


@pytest.mark.parametrize(
    ("shape", "closed"),
    [
        ({"type": "sphere"}, True),
        ({"type": "cylinder"}, True),
        ({"type": "cube"}, True),
        ({"type": "rectangle"}, False),
        ({"type": "disk"}, False),
        (TETRAHEDRON, True),
        (TETRAHEDRON[:3], False),
        ([*TETRAHEDRON[:3], [0, 2, 3]], False),
    ],
    ids=["sphere", "cylinder", "cube", "rectangle", "disk", "mesh", "open", "twisted"],
)
def test_closed_shapes_are_told_from_open_ones_and_their_inside_from_the_outside(shape, closed):
    shape = shape if isinstance(shape, dict) else strip_of(shape)
    scene = mi.load_dict({"type": "scene", "thing": shape, "other": {"type": "rectangle"}})
    ids, surfaces = surface_ids(scene)
    table = dict(zip(np.array(ids).tolist(), np.array(closed_shapes(scene)).tolist(), strict=True))
    found = {surfaces[i]: value for i, value in table.items() if i > 0}
    assert [value for name, value in found.items() if name != "other"] == [closed]
    assert found["other"] == 0


@pytest.mark.parametrize(
    ("faces", "closed"),
    [(TETRAHEDRON, True), (TETRAHEDRON[:3], False), ([*TETRAHEDRON[:3], [0, 2, 3]], False)],
    ids=["closed", "open", "twisted"],
)
def test_vertices_at_one_place_count_as_one(faces, closed):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
    faces = np.array(faces)
    assert is_closed_mesh(corners, faces) is closed
    # Every face with vertices of its own, as a mesh with one normal for each face has them.
    own = np.arange(faces.size).reshape(-1, 3)
    assert is_closed_mesh(corners[faces.ravel()], own) is closed


def test_faces_without_an_extent_do_not_open_a_mesh():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
    assert is_closed_mesh(corners, np.array([*TETRAHEDRON, [2, 2, 2]]))
