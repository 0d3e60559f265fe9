"""The pinhole is at the origin and looks along +z, towards mirrors and glass."""

import mitsuba as mi
import numpy as np

from potmesil_mi.tracing.onward import alphas_of
from potmesil_mi.tracing.virtual_depth import trace_visible

MIRROR = {"type": "twosided", "bsdf": {"type": "conductor"}}
WALL = {"type": "twosided", "bsdf": {"type": "diffuse"}}
BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}

N = 1.5
"""Index of refraction of glass."""

GLASS = {"type": "dielectric", "int_ior": N, "ext_ior": 1.0}


def plane(z, facing=-1, turn=0, x=0, size=20, bsdf=WALL):
    """A square at (x, 0, z), turned by degrees about the y axis."""
    place = mi.ScalarTransform4f().translate([x, 0, z]).rotate([0, 1, 0], turn)
    place = place.rotate([0, 1, 0], 180 if facing < 0 else 0).scale(size)
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


def ball(z, radius, bsdf=MIRROR):
    return {"type": "sphere", "center": [0, 0, z], "radius": radius, "bsdf": bsdf}


def cube(z, half, bsdf=GLASS, size=20):
    """A plate from z - half to z + half."""
    place = mi.ScalarTransform4f().translate([0, 0, z]).scale([size, size, half])
    return {"type": "cube", "to_world": place, "bsdf": bsdf}


def lamp(z, radiance=1.0, facing=-1, **more):
    """A square that shines and reflects nothing."""
    light = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    return {**plane(z, facing, bsdf=BLACK, **more), "emitter": light}


def before_lens(*, size, spp, radius, focus, integrator="path", max_depth=6, **shapes):
    """A thin lens in the place of the pinhole, with ``size`` pixels to 40 degrees."""
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": integrator, "max_depth": max_depth},
            "sensor": {
                "type": "thinlens",
                "fov": 40,
                "aperture_radius": radius,
                "focus_distance": focus,
                "film": {
                    "type": "hdrfilm",
                    "width": size,
                    "height": size,
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "multijitter", "sample_count": spp},
            },
            **shapes,
        }
    )


def fan():
    """Directions up to 30 degrees off the axis."""
    tangents = np.linspace(-0.6, 0.6, 5)
    x, y = (v.ravel() for v in np.meshgrid(tangents, tangents))
    return np.stack([x, y, np.ones_like(x)])


def mesh(z, normals, texcoords, n=65, bsdf=MIRROR):
    """A square of two units with the given normals, of n x n vertices."""
    u, v = (w.ravel() for w in np.meshgrid(*2 * [np.linspace(-1, 1, n)]))
    first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [[first, first + n, first + 1], [first + 1, first + n, first + n + 1]], axis=1
    )
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    result = mi.Mesh("mesh", n * n, faces.shape[1], props, True, texcoords)
    parameters = mi.traverse(result)
    height, normals = normals(u, v)
    points = np.stack([u, v, z + height], axis=-1)
    parameters["vertex_positions"] = mi.Float(points.ravel().astype("f"))
    parameters["vertex_normals"] = mi.Float(normals.ravel().astype("f"))
    parameters["faces"] = mi.UInt32(faces.T.ravel().astype(np.uint32))
    if texcoords:
        parameters["vertex_texcoords"] = mi.Float((np.stack([u, v], -1) * 3).ravel().astype("f"))
    parameters.update()
    return result


def bulge(u, v):
    """Heights and normals of a mesh that bulges towards the pinhole, of radius 4."""
    w = np.sqrt(4**2 - u**2 - v**2)
    return 4 - w, np.stack([u, v, -w], axis=-1) / 4


def loaded(**shapes):
    return mi.load_dict({"type": "scene", **shapes}, optimize=False)


def visible_in(scene, directions=(0, 0, 1), near=0.01, axis=(0, 0, 1), **options):
    """The primary rays of each direction, and what they show."""
    d = mi.Vector3f(np.reshape(directions, (3, -1)).astype(np.float32))
    ray = mi.Ray3f(mi.Point3f(near * d), mi.Vector3f(d / mi.Float(np.linalg.norm(d, axis=0))))
    hit = scene.ray_intersect(ray)
    return ray, trace_visible(scene, [0, 0, 0], ray, hit, axis, alphas=alphas_of(scene), **options)


def looked_at(directions=(0, 0, 1), near=0.01, axis=(0, 0, 1), bounces=16, **shapes):
    """Depths, names of what is seen and whether it is an image, of each direction."""
    scene = loaded(**shapes)
    _, visible = visible_in(scene, directions, near, axis, bounces=bounces)
    depth, last = visible.depth, visible.hit
    names = np.full(len(depth), "", dtype=object)
    for shape in scene.shapes():
        names[np.array(last.is_valid() & (last.shape == mi.ShapePtr(shape)))] = shape.id()
    return np.array(depth), names, np.broadcast_to(np.array(visible.through_window), len(depth))
