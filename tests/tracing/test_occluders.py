"""Near things of every kind cover what their outline covers, whether or not they are closed.

A black thing stands at depth 1 before a white wall in focus at depth 4; the aperture's radius is
0.08. The cone from the lens to the wall's middle has radius 0.06 at depth 1: a ball of half that
radius covers a quarter of it. A strand of half-width a covers 2/pi (asin(s) + s sqrt(1 - s^2)) of
it, where s = a / 0.06.
"""

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm

pytestmark = pytest.mark.usefixtures("variant_llvm")

BLACK = {"type": "diffuse", "id": "black", "reflectance": {"type": "rgb", "value": 0}}
OF_BLACK = {"type": "ref", "id": "black"}
RADIUS = 0.03
STRAND = 0.015
BY_STRAND = 2 / np.pi * (np.arcsin(0.25) + 0.25 * np.sqrt(1 - 0.25**2))
COLUMNS, ROWS = 24, 12


def place():
    return mi.ScalarTransform4f().translate([0, 0, 1]).scale(RADIUS)


def ball_mesh(hole):
    """A ball of triangles; the hole, two of them, is at its bottom, where the pinhole sees none."""
    down, around = np.meshgrid(np.linspace(0, np.pi, ROWS + 1), np.arange(COLUMNS), indexing="ij")
    around = around * (2 * np.pi / COLUMNS)
    axes = np.sin(down) * np.cos(around), np.cos(down), np.sin(down) * np.sin(around)
    corners = np.stack(axes, axis=-1).reshape(-1, 3)
    number = np.arange((ROWS + 1) * COLUMNS).reshape(ROWS + 1, COLUMNS)
    right = np.roll(number, -1, axis=1)
    upper = np.stack([number[:-1], right[:-1], number[1:]], axis=-1)[1:]
    lower = np.stack([right[:-1], right[1:], number[1:]], axis=-1)[:-1]
    faces = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    return mesh_of(corners * RADIUS + [0, 0, 1], faces[:-2] if hole else faces)


def mesh_of(corners, faces):
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(BLACK)
    mesh = mi.Mesh("mesh", len(corners), len(faces), props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = corners.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def sphere(_):
    ball = {"type": "sphere", "center": [0, 0, 1], "radius": RADIUS, "bsdf": OF_BLACK}
    return {"thing": ball}, 0.75


def instance(_):
    group = {"type": "shapegroup", "part": {"type": "sphere", "bsdf": OF_BLACK}}
    thing = {"type": "instance", "to_world": place(), "shapes": {"type": "ref", "id": "group"}}
    return {"group": group, "thing": thing}, 0.75


def mesh_with_a_hole(_):
    return {"thing": ball_mesh(hole=True)}, 0.75


def merged_meshes(folder):
    """Mitsuba makes one mesh of a ball and a distant triangle of the same material."""
    shapes = {}
    far = mesh_of(np.array([[3, 3, 3.9], [3.1, 3, 3.9], [3, 3.1, 3.9]]), np.array([[0, 1, 2]]))
    for name, mesh in (("thing", ball_mesh(hole=False)), ("far", far)):
        mesh.write_ply(str(folder / f"{name}.ply"))
        shapes[name] = {"type": "ply", "filename": str(folder / f"{name}.ply"), "bsdf": OF_BLACK}
    return shapes, 0.75


def distance_grid(_):
    axis = np.linspace(-1.2, 1.2, 24)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    distance = (np.sqrt(x**2 + y**2 + z**2) - 1) / 2.4
    grid = mi.TensorXf(distance[..., None].astype(np.float32))
    to_world = place() @ mi.ScalarTransform4f().translate([-1.2] * 3).scale(2.4)
    return {
        "thing": {"type": "sdfgrid", "grid": grid, "to_world": to_world, "bsdf": OF_BLACK}
    }, 0.75


def curve(folder):
    points = "".join(f"0 {y:g} 1 {STRAND}\n" for y in np.linspace(-0.3, 0.3, 6))
    (folder / "strand.txt").write_text(points)
    thing = {"type": "linearcurve", "filename": str(folder / "strand.txt"), "bsdf": OF_BLACK}
    return {"thing": thing}, 1 - BY_STRAND


@pytest.mark.parametrize(
    "kind", [sphere, instance, mesh_with_a_hole, merged_meshes, distance_grid, curve]
)
def test_a_near_thing_covers_its_part_of_the_lens(kind, tmp_path):
    shapes, expected = kind(tmp_path)
    wall = mi.ScalarTransform4f().translate([0, 0, 4]).rotate([0, 1, 0], 180).scale(4)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "material": BLACK,
            "sensor": {
                "type": "thinlens",
                "fov": 10,
                "aperture_radius": 0.08,
                "focus_distance": 4.0,
                "film": {
                    "type": "hdrfilm",
                    "width": 65,
                    "height": 65,
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "multijitter", "sample_count": 16},
            },
            "wall": {
                "type": "rectangle",
                "to_world": wall,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
            **shapes,
        }
    )
    picture = np.array(pm.focus(pm.render_samples(scene)))
    assert picture[32, 32] == pytest.approx(expected, abs=0.015)
    # Where the lens sees nothing of the thing the wall is white.
    assert picture[0, 0] == pytest.approx(1, abs=1e-3)
