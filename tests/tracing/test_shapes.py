"""Surface ids, and what instances are made of."""

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.tracing.shapes import bsdf_flags, registry_index, surface_ids
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


@pytest.mark.parametrize(("bsdf", "flag"), [("diffuse", False), ("conductor", True)])
def test_an_instance_is_as_specular_as_what_it_is_made_of(bsdf, flag):
    scene = still_life(
        group={"type": "shapegroup", "a": {"type": "sphere", "bsdf": {"type": bsdf}}},
        ball={"type": "instance", "shapegroup": {"type": "ref", "id": "group"}},
    )
    deltas = bsdf_flags(scene) & int(mi.BSDFFlags.DeltaReflection)
    assert deltas.any() == flag
