"""Floats, NumPy and Dr.Jit arrays of any batch shape give the same, and Dr.Jit's gradients hold."""

import math
import subprocess
import sys

import drjit as dr
import numpy as np
import pytest

from potmesil_mi.optics import camera as cam
from potmesil_mi.optics.camera import vectors

SHAPE = (2, 3)
RANDOM = np.random.default_rng(2)


def point(low=(-3, -2, -9), high=(3, 2, -1)):
    return RANDOM.uniform(low, high, (*SHAPE, len(low)))


def number(low, high):
    return RANDOM.uniform(low, high, SHAPE)


VIEW = (number(40, 80), number(0.8, 2), number(0.1, 1), number(10, 20))
WINDOW = (number(-2, -1), number(1, 2), number(-2, -1), number(1, 2), number(0.5, 1), number(5, 9))
GAZE, UP = point(), point((-0.3, 1, -0.3), (0.3, 2, 0.3))
EYE, FAR_POINT = point((-1, -1, 5), (1, 1, 9)), point((-1, -1, -30), (1, 1, -20))
ANGLES = (number(-50, 50), number(-50, 50), number(-50, 50))
PLANE = (point((-1, 1, -1), (1, 2, 1)), point((-1, -9, -1), (1, -5, 1)))
TRIANGLE = (point(), point(), point((-3, -2, -30), (3, 2, 5)))


def clipped(a, b, c, *view):
    """Only the first vertices: the others repeat them."""
    matrix = cam.Frustum(*view).clip_from_camera()
    faces = cam.clip_faces([cam.multiply(matrix, cam.homogeneous(p)) for p in (a, b, c)])
    return (*faces.vertices, faces.count)


def projected(a, eye, gaze, up, *view):
    basis = cam.basis_from_gaze(gaze, up)
    return cam.project_vertices(
        a,
        np.eye(4),
        cam.camera_from_world(basis, eye),
        cam.Frustum(*view).clip_from_camera(),
        640,
        480,
        behind="nan",
    )


def flat(ball):
    return (ball.inside, ball.outside, *ball.cuts, *ball.distances)


CASES = {
    "convert_axes": (cam.convert_axes, GAZE),
    "basis_from_gaze": (cam.basis_from_gaze, GAZE, UP),
    "look_at": (cam.look_at, EYE, GAZE, UP),
    "orientation": (cam.orientation, *ANGLES),
    "angles_of": (lambda *a: cam.angles_of(cam.orientation(*a)), *ANGLES),
    "camera_from_world": (
        lambda g, u, e: cam.camera_from_world(cam.basis_from_gaze(g, u), e),
        GAZE,
        UP,
        EYE,
    ),
    "rigid_inverse": (lambda *a: cam.rigid_inverse(cam.look_at(*a)), EYE, GAZE, UP),
    "dolly": (lambda d, *a: cam.dolly(cam.look_at(*a), d), number(-3, 3), EYE, GAZE, UP),
    "image_from_camera": (cam.image_from_camera, GAZE, number(1, 2)),
    "orthographic_image": (cam.orthographic_image, GAZE, number(1, 2)),
    "vanishing_point": (cam.vanishing_point, GAZE, number(1, 2)),
    "pseudodepth": (cam.pseudodepth, number(-9, -1), *WINDOW[-2:]),
    "pseudodepth_coefficients": (cam.pseudodepth_coefficients, *WINDOW[-2:]),
    "homogeneous_perspective": (cam.homogeneous_perspective, number(1, 2)),
    "perspective_clip_from_camera": (cam.perspective_clip_from_camera, *WINDOW),
    "orthographic_clip_from_camera": (cam.orthographic_clip_from_camera, *WINDOW),
    "perspective_divide": (cam.perspective_divide, point((-1, -1, -1, 1), (1, 1, 1, 2))),
    "image_from_world_matrix": (cam.image_from_world_matrix, *ANGLES, EYE, number(1, 2)),
    "image_from_world": (
        lambda p, *a: cam.image_from_world(p, cam.image_from_world_matrix(*a), "nan"),
        point((-1, -1, 20), (1, 1, 30)),
        *ANGLES,
        EYE,
        number(1, 2),
    ),
    "plane_projection": (cam.plane_projection, GAZE, number(1, 2)),
    "plane_projection of lines": (cam.plane_projection, point((1, 1), (2, 2)), number(1, 2)),
    "projection_onto_plane": (
        lambda n, p, c: cam.projection_onto_plane(cam.plane_through(p, n), c),
        *PLANE,
        EYE,
    ),
    "parallel_projection_onto_plane": (
        lambda n, p, c: cam.parallel_projection_onto_plane(cam.plane_through(p, n), c),
        *PLANE,
        EYE,
    ),
    "Frustum": (
        lambda *v: (
            *cam.Frustum(*v).size_at(3),
            cam.Frustum(*v).far_width,
            cam.Frustum(*v).near_height,
            cam.Frustum(*v).x_fov,
            cam.Frustum(*v).focal_length(36),
            cam.Frustum(*v).clip_from_camera("mitsuba"),
            *cam.Frustum(*v).corners(),
            *cam.Frustum(*v).planes(),
            cam.Frustum(*v).zoom(2).y_fov,
        ),
        *VIEW,
    ),
    "Frustum.from_x_fov": (lambda *v: cam.Frustum.from_x_fov(*v).y_fov, *VIEW),
    "Frustum.from_far_plane": (
        lambda f, n: cam.Frustum.from_far_plane(9, 6, n, f).y_fov,
        VIEW[3],
        VIEW[2],
    ),
    "Frustum.contains": (lambda p, *v: cam.Frustum(*v).contains(p), 3 * GAZE, *VIEW),
    "Frustum.ball": (lambda p, r, *v: flat(cam.Frustum(*v).ball(p, r)), GAZE, number(0, 3), *VIEW),
    "Frustum.bounce": (
        lambda p, d, r, *v: cam.Frustum(*v).bounce(p, d, r),
        GAZE,
        UP,
        number(0, 0.3),
        *VIEW,
    ),
    "dolly_zoom": (
        lambda z, d, *v: cam.dolly_zoom(cam.Frustum(*v), np.eye(4), z, d)[0].y_fov,
        number(5, 9),
        number(1, 4),
        *VIEW,
    ),
    "outside_planes": (cam.outside_planes, point((-1, -1, -1, -1), (1, 1, 1, 1))),
    "inside_clip": (cam.inside_clip, point((-1, -1, -1, 0), (1, 1, 1, 2))),
    "clip_faces": (clipped, *TRIANGLE, *VIEW),
    "pixel_from_ndc": (cam.pixel_from_ndc, GAZE, number(100, 200), number(100, 200)),
    "ndc_from_pixel": (cam.ndc_from_pixel, GAZE[..., :2], number(100, 200), number(100, 200)),
    "project_vertices": (projected, FAR_POINT, EYE, -EYE, UP, *VIEW),
}


def results(case, *arguments):
    found = CASES[case][0](*arguments)
    return found if isinstance(found, tuple) else (found,)


@pytest.mark.parametrize("case", CASES)
def test_a_batch_of_numpy_is_its_parts_one_by_one(case):
    """The parts are floats and tuples of floats."""
    arguments = CASES[case][1:]
    batch = results(case, *arguments)
    for index in np.ndindex(SHAPE):
        parts = [argument[index].tolist() for argument in arguments]
        parts = [tuple(part) if isinstance(part, list) else part for part in parts]
        for whole, part in zip(batch, results(case, *parts), strict=True):
            whole = np.broadcast_to(whole, SHAPE + np.shape(part))
            np.testing.assert_allclose(whole[index], part, rtol=1e-12, atol=1e-12)


def as_drjit(array, single):
    """An array (2, 3, ...) as Dr.Jit's, flat."""
    import drjit.llvm.ad as jit

    suffix = "" if single else "64"
    columns = array.reshape(6, *array.shape[2:])
    if columns.ndim == 1:
        return getattr(jit, f"Float{suffix}")(columns)
    kind = getattr(jit, f"Array{columns.shape[1]}f{suffix}")
    return kind(*columns.T)


def as_numpy(value):
    """Dr.Jit's numbers, points, matrices and rows of 4x3 ones, the batch first."""
    if isinstance(value, tuple):
        return np.stack([as_numpy(part) for part in value], axis=-2)
    array = np.asarray(value)
    return np.moveaxis(array, -1, 0) if array.ndim else array


@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
@pytest.mark.parametrize("case", CASES)
def test_drjit_gives_what_numpy_gives(case, single, variant_llvm):
    arguments = CASES[case][1:]
    expected = results(case, *arguments)
    found = CASES[case][0](*(as_drjit(argument, single) for argument in arguments))
    dr.eval(found)  # at once, so that what results share is compiled once
    rows = case == "image_from_world_matrix"
    found = found if isinstance(found, tuple) and not rows else (found,)
    tolerance = 2e-4 if single else 1e-12
    for ours, theirs in zip(found, expected, strict=True):
        ours = as_numpy(ours)
        theirs = np.broadcast_to(theirs, SHAPE + np.shape(theirs)[2:]).reshape(6, *ours.shape[1:])
        if single and theirs.dtype.kind in "bi":
            continue  # A point on the edge may fall on either side.
        np.testing.assert_allclose(ours, theirs, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("case", CASES)
def test_single_precision_stays_single_beside_floats_and_numpy(case, variant_llvm):
    """One Dr.Jit argument is enough; the others are host numbers."""
    arguments = CASES[case][1:]
    chosen = [argument[0, 0].tolist() for argument in arguments]
    chosen[0] = as_drjit(arguments[0], single=True)
    found = CASES[case][0](*chosen)
    assert vectors.leaf_of(found) is dr.llvm.ad.Float or case in ("Frustum.contains", "inside_clip")


def test_shapes_broadcast():
    points = RANDOM.uniform(-1, 1, (5, 1, 3))
    moved = cam.transform_points(cam.look_at(EYE.reshape(6, 3), (0, 0, 0), (0, 1, 0)), points)
    assert moved.shape == (5, 6, 3)
    assert cam.Frustum([40, 50], 1, [[0.1], [0.2], [0.3]], 10).clip_from_camera().shape == (
        3,
        2,
        4,
        4,
    )


def test_single_precision_of_numpy_is_kept():
    points = np.zeros((2, 3), np.float32) - np.float32(1)
    assert cam.image_from_camera(points, 2.0).dtype == np.float64  # the focal length is a double
    assert cam.convert_axes(points).dtype == np.float32
    assert cam.convert_axes([1, 2, 3]).dtype == np.float64


def test_mitsubas_types_are_taken(variant_llvm):
    import mitsuba as mi

    matrix = mi.Transform4f().look_at([1, 2, 3], [0, 0, 0], [0, 1, 0]).matrix
    moved = cam.transform_points(matrix, mi.Point3f(1, 2, 3))
    assert type(moved) is dr.llvm.ad.Array3f
    scalar = mi.ScalarTransform4f().look_at([1, 2, 3], [0, 0, 0], [0, 1, 0]).matrix
    assert isinstance(cam.transform_points(scalar, mi.ScalarPoint3f(1, 2, 3)), np.ndarray)


# ---------------------------------------------------------------- what is no point or matrix


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: cam.convert_axes([1, 2]), ValueError, "^points=.*: has 2 components; must have 3"),
        (lambda: cam.convert_axes(3.0), TypeError, r"^points=3.0: must be a point or vector"),
        (lambda: cam.convert_axes(["a"] * 3), TypeError, r"^points\[0\]=.*: must be a number"),
        (lambda: cam.multiply(5, (1, 2, 3, 4)), TypeError, "^matrix=5: must be a matrix"),
        (
            lambda: cam.multiply(np.eye(4), (1, 2, 3)),
            ValueError,
            "^matrix: has 4 columns; must have 3, as vectors has",
        ),
        (
            lambda: cam.compose(np.eye(3), np.eye(4)),
            ValueError,
            r"^matrices\[0\]: has 3 columns; must have 4, as matrices\[1\] has",
        ),
        (lambda: cam.Frustum("a", 1, 1, 2), TypeError, "^y_fov='a': must be a number"),
    ],
)
def test_what_is_no_point_matrix_or_number_is_named(call, error, text):
    with pytest.raises(error, match=text):
        call()


def test_drjit_values_of_another_kind_are_named(variant_llvm):
    from drjit.llvm.ad import Array2f, Array3f, Float, TensorXf

    with pytest.raises(TypeError, match=r"^points: must be a vector such as Array3f and not Float"):
        cam.convert_axes(Float(1, 2, 3))
    with pytest.raises(TypeError, match=r"^points: must be a vector .* and not TensorXf"):
        cam.convert_axes(TensorXf([1, 2, 3], (1, 3)))
    with pytest.raises(ValueError, match=r"^points=.*: has 2 components"):
        cam.convert_axes(Array2f(1, 2))
    with pytest.raises(TypeError, match=r"^matrix: must be a matrix such as Matrix4f and not"):
        cam.multiply(Array3f(1), Array3f(1))
    with pytest.raises(TypeError, match=r"^focal_length: must be a Float and not a Array3f"):
        cam.image_from_camera((1, 2, -3), Array3f(1))
    with pytest.raises(TypeError, match=r"^focal_length: has shape \(2, 2\); beside arrays of Dr"):
        cam.image_from_camera(Array3f(1, 2, -3), np.ones((2, 2)))


def test_bad_drjit_values_are_refused_by_name(variant_llvm):
    from drjit.llvm.ad import Array3f, Float

    with pytest.raises(ValueError, match=r"^y_fov=180.0: must be > 0 and < 180 degrees"):
        cam.Frustum(Float(30, 180), 1, 1, 2)
    with pytest.raises(ValueError, match=r"^up=\(0.0, 0.0, 1.0\): must be another direction"):
        cam.basis_from_gaze(Array3f(0, 0, [1, -1]), Array3f([1, 0], 0, 1))
    with pytest.raises(ValueError, match=r"^points=\(1.0, 2.0, 3.0\): must be in front of"):
        cam.image_from_camera(Array3f(1, 2, [-3, 3]), 1)


def test_symbolic_loops_of_drjit_project_points(variant_llvm):
    """Nothing can be refused there; what has no image is NaN."""
    from drjit.llvm.ad import Array3f, Float, UInt32

    points = Array3f(1, 2, [-1, 4])

    def step(i, x):
        return i + 1, x + cam.image_from_camera(points - Array3f(0, 0, Float(i)), 2.0).x

    _, found = dr.while_loop((UInt32(0), Float(0)), lambda i, x: i < 3, step, mode="symbolic")
    np.testing.assert_allclose(found[0], 2 * (1 + 1 / 2 + 1 / 3), rtol=1e-6)
    assert math.isnan(found[1])


# ---------------------------------------------------------------- gradients


def pixels_of(eye, target, up, fov, near, zoom, path):
    """A number that depends on all of the way from an object to pixels."""
    view, matrix = cam.dolly_zoom(
        cam.Frustum(fov, 1.5, near, 20.0), cam.look_at(eye, target, up), 6.0, path
    )
    steps = cam.project_vertices(
        [(0.5, 0.2, 0.1), (-0.4, 1, 0.3)][0],
        np.eye(4),
        cam.rigid_inverse(matrix),
        view.zoom(zoom).clip_from_camera(),
        640,
        480,
    )
    x, y = vectors.components("pixels", steps.pixels)
    return x * 0.7 - y + 50 * vectors.components("ndc", steps.ndc)[2]


def area_of_clipped(x, fov):
    """The area in pixels of a triangle that is cut by the frustum."""
    matrix = cam.Frustum(fov, 1.5, 0.5, 20.0).clip_from_camera()
    triangle = [(x, 0.5, -3.0), (-9.0, 1.0, -2.0), (0.5, -4.0, x)]
    face = [cam.multiply(matrix, cam.homogeneous(corner)) for corner in triangle]
    pixels = [
        vectors.components("p", cam.pixel_from_ndc(cam.perspective_divide(v), 640, 480))
        for v in cam.clip_faces(face).vertices
    ]
    total = 0.0
    for (x0, y0), (x1, y1) in zip(pixels, pixels[1:] + pixels[:1], strict=True):
        total = total + (x0 * y1 - x1 * y0) / 2
    return total


def angles_and_bounce(pan, tilt, swing, radius):
    basis = cam.orientation(pan, tilt, swing, axes="opengl")
    angles = cam.angles_of(cam.compose(basis, basis), "opengl")
    center, velocity = cam.Frustum(60, 1.5, 0.5, 20.0).bounce(
        [pan * 0.1, tilt * 0.1, swing * 0 - 3.0], (1.0, 2.0, 0.5), radius
    )
    ball = [*vectors.components("c", center), *vectors.components("v", velocity)]
    return sum(angles, 0.0) + sum((i + 1) * part for i, part in enumerate(ball))


@pytest.mark.parametrize(
    ("function", "at"),
    [
        (
            lambda x, y, z, *a: pixels_of((x, y, z), (0.1, 0, 0), (0.1, 1, 0.2), *a),
            (1.0, 2.0, 7.0, 50.0, 0.7, 1.3, 1.5),
        ),
        (area_of_clipped, (1.5, 70.0)),
        (angles_and_bounce, (10.0, 15.0, 20.0, 0.3)),
    ],
    ids=["pixels", "clipping", "angles and bounce"],
)
def test_gradients_are_those_of_finite_differences(function, at, variant_llvm):
    from drjit.llvm.ad import Float64

    inputs = [Float64(value) for value in at]
    for x in inputs:
        dr.enable_grad(x)
    dr.backward(function(*inputs))
    for i, x in enumerate(inputs):
        step = 1e-6 * max(1.0, abs(at[i]))
        ends = [
            function(*(v + sign * step * (i == j) for j, v in enumerate(at))) for sign in (1, -1)
        ]
        difference = (ends[0] - ends[1]) / (2 * step)
        assert abs(difference) > 1e-3
        assert dr.grad(x)[0] == pytest.approx(difference, rel=1e-6)


def test_a_point_behind_the_camera_leaves_the_gradients_of_others_alone(variant_llvm):
    from drjit.llvm.ad import Array3f, Float

    x = Float(1.0)
    dr.enable_grad(x)
    image = cam.image_from_camera(Array3f(x, 1, [-2, 0]), 1, behind="nan")
    dr.backward(dr.select(dr.isnan(image.x), 0, image.x))
    assert dr.grad(x)[0] == pytest.approx(0.5)


# ---------------------------------------------------------------- what is imported


def test_neither_mitsuba_nor_drjit_nor_llvm_is_needed_for_numpy():
    program = """
import sys
import numpy as np
from potmesil_mi.optics import camera as cam
view = cam.Frustum(60.0, 1.5, 1.0, 10.0)
matrix = cam.compose(view.clip_from_camera(), cam.rigid_inverse(cam.look_at((5, 0, 0), (0, 0, 0))))
clip = cam.multiply(matrix, cam.homogeneous(np.zeros((2, 3, 3))))
cam.pixel_from_ndc(cam.perspective_divide(clip), 64, 48)
cam.clip_faces(np.ones((5, 3, 4)))
camera = cam.Camera.looking_at((0, 0, 5), (0, 0, 0), film_size=(4, 4), x_fov=40)
camera.pixel_from_world(np.zeros((4, 3)))
loaded = [name for name in ("mitsuba", "drjit") if name in sys.modules]
assert not loaded, loaded
"""
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
