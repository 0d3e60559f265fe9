"""Every exercise of both lecture texts with a definite answer, and the claims a reader can check.

The texts are *Camera Models* (CM, chapter 5) and K. Jünemann, *Camera models and the view pipeline*
(J, chapter 9). Docstrings say which exercise, or which sentence.
"""

import dataclasses
import math

import numpy as np
import pytest

from potmesil_mi import ThinLens
from potmesil_mi.optics import camera as cam

EXACT = 1e-12
RANDOM = np.random.default_rng(9)


def applied(matrix, points):
    return cam.perspective_divide(cam.multiply(matrix, cam.homogeneous(points)))


def in_front(count):
    """Camera points between the depths 1 and 9."""
    return np.stack([*RANDOM.uniform(-3, 3, (2, count)), -RANDOM.uniform(1, 9, count)], axis=-1)


def rotated(axis, degrees, shift=(0, 0, 0)):
    """A 4x4: a turn about a coordinate axis, then a shift."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(4)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    matrix[:3, 3] = shift
    return matrix


# ---------------------------------------------------------------- Camera Models


def test_cm_equation_1_the_image_is_where_the_ray_meets_the_plane():
    """CM 5.3: x* = f (p_x/p_z, p_y/p_z, 1) for f < 0; also as M_p and by a plane."""
    points, f = in_front(20), -2.5
    expected = f * points / points[:, 2:]
    np.testing.assert_allclose(cam.image_from_camera(points, 2.5), expected[:, :2], atol=EXACT)
    np.testing.assert_allclose(
        applied(cam.homogeneous_perspective(2.5), points), expected, atol=EXACT
    )
    np.testing.assert_allclose(
        applied(cam.plane_projection((0, 0, 1), 2.5), points), expected, atol=EXACT
    )


def test_cm_5_3_distant_objects_appear_smaller():
    sizes = cam.image_from_camera([(0, 6, -6 / 0.5), (0, 6, -24)], 1)[:, 1]
    np.testing.assert_allclose(sizes, [0.5, 0.25], atol=EXACT)


def test_cm_5_3_a_line_in_space_is_a_line_in_the_image():
    """CM 5.3, note: perspective projection preserves linearity."""
    start, end = in_front(2)
    points = start + np.linspace(0, 1, 11)[:, None] * (end - start)
    x = cam.image_from_camera(points, 1)
    chord, rest = x[-1] - x[0], x - x[0]
    np.testing.assert_allclose(chord[0] * rest[:, 1] - chord[1] * rest[:, 0], 0, atol=EXACT)


def test_cm_5_3_exercise_parallel_lines_stay_parallel_where_they_are_parallel_to_the_image():
    """CM 5.3, exercise: all others meet, in the image of their direction."""
    starts, far = in_front(6), 1e9

    def image_directions(direction):
        lines = starts[:, None] + np.array([0.0, 0.5])[:, None] * np.asarray(direction)
        images = cam.image_from_camera(lines, 2)
        way = images[:, 1] - images[:, 0]
        return way / np.linalg.norm(way, axis=-1, keepdims=True)

    parallel = image_directions((1, 2, 0))
    np.testing.assert_allclose(parallel, np.array([[1, 2]] * 6) / math.sqrt(5), atol=EXACT)
    with pytest.raises(ValueError, match=r"^directions=.*: must be not parallel to the image"):
        cam.vanishing_point((1, 2, 0), 2)

    assert np.ptp(image_directions((1, 2, -4)), axis=0).max() > 0.1
    met = cam.image_from_camera(starts + far * np.array([1, 2, -4]), 2)
    np.testing.assert_allclose(met, np.broadcast_to([0.5, 1.0], (6, 2)), atol=1e-8)
    np.testing.assert_allclose(cam.vanishing_point((1, 2, -4), 2), [0.5, 1.0], atol=EXACT)
    np.testing.assert_allclose(cam.vanishing_point((-1, -2, 4), 2), [0.5, 1.0], atol=EXACT)


def test_cm_5_4_far_away_perspective_becomes_orthographic():
    """CM 5.4 and J: parallel projection is perspective projection with the camera at infinity."""
    points, errors = in_front(20), []
    for distance in (1e3, 1e6):
        image = cam.image_from_camera(points - [0, 0, distance], 0.7 * distance)
        errors.append(np.abs(image - cam.orthographic_image(points, 0.7)).max())
    assert errors[0] < 0.05
    assert errors[1] == pytest.approx(errors[0] / 1000, rel=0.02)


def test_cm_equations_2_and_3_u_is_perpendicular_to_up():
    """CM 5.5: "in fact it is easy to show that u must also be perpendicular to t"."""
    gaze, up = RANDOM.normal(0, 1, (2, 30, 3))
    u, v, w = np.moveaxis(cam.basis_from_gaze(gaze, up), -1, 0)
    np.testing.assert_allclose(np.sum(u * up, -1), 0, atol=EXACT)
    np.testing.assert_allclose(np.cross(u, v), w, atol=EXACT)
    np.testing.assert_allclose(w, -gaze / np.linalg.norm(gaze, axis=-1)[:, None], atol=EXACT)


@pytest.mark.parametrize(
    ("camera", "parts"),
    [((0, 0, 0), (0, 0)), ((0, 0, -3), (0, -3)), ((0, 1, 0), (1, 0)), ((0, 1, -3), (1, -3))],
)
def test_cm_5_5_table_of_camera_and_world_coordinates(camera, parts):
    """CM 5.5: (0, 0, 0) is e, (0, 0, f) e + f w, (0, 1, 0) e + v, (0, 1, f) e + v + f w."""
    eye, basis = np.array([4.0, 5, 6]), cam.basis_from_gaze((1, 2, 3), (0, 1, 0.5))
    expected = eye + parts[0] * basis[:, 1] + parts[1] * basis[:, 2]
    found = cam.transform_points(cam.world_from_camera(basis, eye), camera)
    np.testing.assert_allclose(found, expected, atol=EXACT)


def test_cm_equations_4_to_7_and_their_inverse():
    """CM 5.5: M_cw^T M_cw = E, M_wc = M_cw^T ("why?"), p_c = M_wc p_w - d with d = M_cw^T e."""
    eye, basis = np.array([4.0, 5, 6]), cam.basis_from_gaze((1, 2, 3), (0, 1, 0.5))
    np.testing.assert_allclose(basis.T @ basis, np.eye(3), atol=EXACT)
    points = RANDOM.normal(0, 5, (20, 3))
    there = cam.camera_from_world(basis, eye)
    np.testing.assert_allclose(
        cam.transform_points(there, points), points @ basis - basis.T @ eye, atol=EXACT
    )
    turn, shift = np.eye(4), np.eye(4)
    turn[:3, :3], shift[:3, 3] = basis.T, -eye
    np.testing.assert_allclose(there, turn @ shift, atol=EXACT)


def test_cm_5_6_try_multiplying_this_out():
    """CM 5.6: M_p p = (p_x, p_y, p_z, p_z/f)."""
    product = cam.multiply(cam.homogeneous_perspective(2), (3, 5, -8, 1))
    np.testing.assert_allclose(product, [3, 5, -8, 4], atol=EXACT)


@pytest.mark.parametrize(("near", "far"), [(1, 3), (2, 10), (0.5, 10), (1e-2, 1e4)])
def test_cm_5_7_pseudodepth_is_minus_1_and_1_and_grows_with_the_distance(near, far):
    a, b = cam.pseudodepth_coefficients(near, far)
    f, big_f = -near, -far
    assert a == pytest.approx(-(1 / f) * (f + big_f) / (f - big_f), rel=EXACT)
    assert b == pytest.approx(2 * big_f / (f - big_f), rel=EXACT)
    z = np.linspace(-near, -far, 101)
    depth = f / z * (a * z + b)
    np.testing.assert_allclose(cam.pseudodepth(z, near, far), depth, atol=1e-10)
    np.testing.assert_allclose(depth[[0, -1]], [-1, 1], atol=1e-10)
    assert (np.diff(cam.pseudodepth(z, near, far)) > 0).all()


def test_cm_5_8_a_triangle_from_object_space_to_the_image_plane():
    """CM 5.8: the five steps, written out."""
    triangle = np.array([(0.0, 0, 0), (1, 0, 0), (0, 2, 0.5)])
    world_from_object = rotated(1, 30, (0.5, -0.25, -5))
    basis, eye = cam.basis_from_gaze((0.1, -0.2, -1)), np.array([0.25, 0.5, 1])
    near, far, f = 1.5, 20, -1.5
    a, b = cam.pseudodepth_coefficients(near, far)
    world = triangle @ world_from_object[:3, :3].T + world_from_object[:3, 3]
    p = (world - eye) @ basis
    expected = f * np.stack([p[:, 0], p[:, 1], a * p[:, 2] + b], -1) / p[:, 2:]

    steps = cam.project_vertices(
        triangle,
        world_from_object,
        cam.camera_from_world(basis, eye),
        cam.pseudodepth_perspective(near, far),
        640,
        480,
    )
    np.testing.assert_allclose(steps.world, world, atol=EXACT)
    np.testing.assert_allclose(steps.camera, p, atol=EXACT)
    np.testing.assert_allclose(steps.clip[:, 3], p[:, 2] / f, atol=EXACT)
    np.testing.assert_allclose(steps.ndc, expected, atol=EXACT)


def test_cm_equation_8_is_the_lens_law():
    lens = ThinLens(50, 4, 2000)
    assert 1 / lens.image_distance(2000) + 1 / 2000 == pytest.approx(1 / 50, rel=EXACT)


# ---------------------------------------------------------------- Jünemann: the frustum


def test_j_parallel_projection_keeps_sizes_and_parallel_lines():
    """J, Parallel Projections: properties; along the normal of any plane."""
    plane = cam.plane_through((0, 1, 0), (1, 2, -2))
    matrix = cam.parallel_projection_onto_plane(plane, (1, 2, -2))
    near, way = in_front(2)
    shadow = cam.transform_points(matrix, np.stack([near, near + way]))
    moved = cam.transform_points(matrix, np.stack([near, near + way]) + 7 * np.array([1, 2, -2]))
    np.testing.assert_allclose(moved, shadow, atol=EXACT)
    other = cam.transform_points(matrix, np.stack([near + 3, near + 3 + way]))
    np.testing.assert_allclose(other[1] - other[0], shadow[1] - shadow[0], atol=EXACT)


def test_j_frustum_relations():
    """J, Parameters of the view frustum: aspect and tangents, of both planes."""
    view = cam.Frustum(60, 16 / 9, 1, 1000)
    assert view.near_width / view.near_height == pytest.approx(16 / 9, rel=EXACT)
    assert view.far_width / view.far_height == pytest.approx(16 / 9, rel=EXACT)
    for width, height, distance in (
        (view.near_width, view.near_height, 1),
        (view.far_width, view.far_height, 1000),
    ):
        assert width / (2 * distance) == pytest.approx(
            math.tan(math.radians(view.x_fov) / 2), rel=EXACT
        )
        assert height / (2 * distance) == pytest.approx(math.tan(math.radians(30)), rel=EXACT)


def test_j_zooming_and_dollying():
    """J: a larger θ makes objects smaller; moving away, too, and shows what was behind."""
    point = np.array([0.5, 0.25, -4.0])
    wide, narrow = cam.Frustum(60, 1, 1, 9), cam.Frustum(30, 1, 1, 9)
    assert applied(narrow.clip_from_camera(), point)[0] > applied(wide.clip_from_camera(), point)[0]
    behind = (0, 0, 2)
    back = cam.rigid_inverse(cam.dolly(np.eye(4), -5))
    assert not wide.contains(behind)
    assert wide.contains(cam.transform_points(back, behind))
    assert (
        applied(wide.clip_from_camera() @ back, point)[0]
        < applied(wide.clip_from_camera(), point)[0]
    )


def test_j_exercise_1_size_of_the_frustum_at_the_ball():
    """J, exercise 1: h_c = 2 z_c tan(θ_y/2), w_c = a h_c."""
    width, height = cam.Frustum(90, 2, 2, 10).size_at(5)
    assert (width, height) == pytest.approx((20, 10), rel=EXACT)


def test_j_exercise_1_the_ball_is_reflected_and_stays_inside_with_its_speed():
    view, radius = cam.Frustum(50, 1.5, 1, 8), 0.3
    center, velocity = np.array([0.1, -0.05, -4.0]), np.array([0.11, 0.07, -0.13])
    speed, turned = np.linalg.norm(velocity), 0
    for _ in range(3000):
        before = velocity
        center, velocity = view.bounce(center + velocity, velocity, radius)
        turned += not np.array_equal(before, velocity)
        assert np.linalg.norm(velocity) == pytest.approx(speed, rel=1e-10)
        assert min(view.distances(center)) >= radius - 1e-9
    assert turned > 100


def test_j_exercise_1_a_ball_that_hits_a_wall_straight_comes_straight_back():
    view = cam.Frustum(90, 2, 2, 10)
    center, velocity = view.bounce((0, 0, -9.5), (0, 0, -1), 1)
    np.testing.assert_allclose(center, [0, 0, -9], atol=EXACT)
    np.testing.assert_allclose(velocity, [0, 0, 1], atol=EXACT)
    inwards = -np.array([0, 1, 1]) / math.sqrt(2)  # from the top, at 45°
    touching = np.array([0, 5, -5]) + 0.5 * inwards
    center, velocity = view.bounce(touching, -2 * inwards, 1)
    np.testing.assert_allclose(center, np.array([0, 5, -5]) + inwards, atol=EXACT)
    np.testing.assert_allclose(velocity, 2 * inwards, atol=EXACT)


def test_j_exercise_2_the_camera_matrix_at_5_0_0_looking_at_the_origin():
    expected = [[0, 0, 1, 5], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]
    np.testing.assert_allclose(cam.look_at((5, 0, 0), (0, 0, 0)), expected, atol=EXACT)


def test_j_object3d_look_at_places_the_point_on_the_positive_z_axis():
    matrix = cam.look_at((5, 0, 0), (0, 0, 0), axes="mitsuba")
    seen = cam.transform_points(cam.rigid_inverse(matrix), (0, 0, 0))
    np.testing.assert_allclose(seen, [0, 0, 5], atol=EXACT)


def test_j_example_sun_earth_and_moon_are_looked_at():
    """J: from the middle of the earth at the sun, the moon, and a fixed point of the earth.

    The lecture's chapter 8 has the hierarchy: the earth's place turns about the sun, the moon about
    the earth, and the earth about itself. Each is on the negative z-axis at its distance.
    """
    earth = rotated(1, 40) @ rotated(1, 0, (10, 0, 0))
    moon = earth @ rotated(1, 100) @ rotated(1, 0, (2, 0, 0))
    spin = earth @ rotated(2, 23) @ rotated(1, 200)
    eye = earth[:3, 3]
    fixed = cam.transform_points(spin, (1, 0, 0))
    for target, distance in ((np.zeros(3), 10), (moon[:3, 3], 2), (fixed, 1)):
        seen = cam.transform_points(cam.rigid_inverse(cam.look_at(eye, target)), target)
        np.testing.assert_allclose(seen, [0, 0, -distance], atol=EXACT)
    with pytest.raises(ValueError, match=r"^target="):  # From the sun's middle there is no sun.
        cam.look_at((0, 0, 0), (0, 0, 0))


@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)])
def test_j_exercise_3_the_snake_sees_the_way_it_goes(direction):
    head, above = np.array([3.0, 0, -2]), np.array([0, 1.5, 0])
    matrix = cam.world_from_camera(cam.basis_from_gaze(direction), head + above)
    ahead = cam.transform_points(cam.rigid_inverse(matrix), head + above + 4 * np.array(direction))
    np.testing.assert_allclose(ahead, [0, 0, -4], atol=EXACT)
    np.testing.assert_allclose(matrix[:3, 1], [0, 1, 0], atol=EXACT)


def test_j_a_resized_screen_changes_the_aspect():
    """J, react to screen resizing: camera.aspect = w/h."""
    view = dataclasses.replace(cam.Frustum(60, 1, 1, 10), aspect=1280 / 720)
    assert view.clip_from_camera()[0, 0] == pytest.approx(math.sqrt(3) * 720 / 1280, rel=EXACT)


# ---------------------------------------------------------------- Jünemann: projection as a matrix


def test_j_projection_on_a_plane_and_the_matrix_that_does_it():
    """J: p' = -d/(p·n) p, by Q_{n,d} = [d E, 0; -n^T, 0] and perspective division."""
    n, d, points = np.array([2.0, -1, 2]) / 3, 4.0, in_front(20)
    points = points[points @ n < 0]
    matrix = cam.plane_projection(n, d)
    np.testing.assert_allclose(matrix[:3, :3], d * np.eye(3), atol=EXACT)
    np.testing.assert_allclose(matrix[3], [*-n, 0], atol=EXACT)
    np.testing.assert_array_equal(matrix[:, 3], 0)
    projected = applied(matrix, points)
    np.testing.assert_allclose(projected, -d / (points @ n)[:, None] * points, atol=EXACT)
    np.testing.assert_allclose(projected @ n + d, 0, atol=EXACT)


def test_j_any_multiple_of_the_matrix_does_the_job():
    matrix, points = cam.plane_projection((0, 0, 1), 2), in_front(5)
    np.testing.assert_allclose(applied(7 * matrix, points), applied(matrix, points), atol=EXACT)


def test_j_projecting_twice_is_projecting_once():
    """J, remark: Q·Q = d Q."""
    matrix = cam.plane_projection((1, -2, 0.5), 3)
    np.testing.assert_allclose(matrix @ matrix, 3 * matrix, atol=EXACT)


def test_j_exercise_4_projection_in_the_plane_on_the_line_through_1_0_and_0_minus_1():
    """J, exercise 4: P = (1, 0) stays, Q = (2, -2) becomes (1/2, -1/2), R = (1, 1) has no image.

    The line is x - y = 1: R looks along it. Its homogeneous image has w = 0, a point at infinity.
    """
    d = 1 / math.sqrt(2)
    matrix = cam.plane_projection((-1, 1), d)
    np.testing.assert_allclose(matrix, d * np.array([[1, 0, 0], [0, 1, 0], [1, -1, 0]]), atol=EXACT)
    points = np.array([(1.0, 0), (2, -2), (1, 1)])
    clip = cam.multiply(matrix, cam.homogeneous(points))
    np.testing.assert_allclose(cam.perspective_divide(clip[0]), [1, 0], atol=EXACT)
    np.testing.assert_allclose(cam.perspective_divide(clip[1]), [0.5, -0.5], atol=EXACT)
    assert clip[2, 2] == pytest.approx(0, abs=EXACT)
    with pytest.raises(ValueError, match=r"^clip=\(.*\): must be in front of the camera"):
        cam.perspective_divide(np.round(clip[2], 12))


def test_j_projection_onto_the_near_plane():
    """J: (x, y, z) becomes (-n x/z, -n y/z, -n)."""
    points, n = in_front(10), 0.75
    matrix = cam.plane_projection((0, 0, 1), n)
    expected = [[n, 0, 0, 0], [0, n, 0, 0], [0, 0, n, 0], [0, 0, -1, 0]]
    np.testing.assert_allclose(matrix, expected, atol=EXACT)
    np.testing.assert_allclose(applied(matrix, points), -n * points / points[:, 2:], atol=EXACT)


def test_j_example_a_shadow_cast_by_a_point_light():
    """J, self-made shadows: a light above a floor, in the world."""
    light, floor = np.array([1.0, 4, 2]), cam.plane_through((0, 0, 0), (0, 1, 0))
    things = RANDOM.uniform([-2, 0.5, -2], [2, 3, 2], (20, 3))
    shadow = applied(cam.projection_onto_plane(floor, light), things)
    np.testing.assert_allclose(shadow[:, 1], 0, atol=EXACT)
    off_line = np.cross(shadow - light, things - light)
    np.testing.assert_allclose(off_line, 0, atol=1e-11)
    np.testing.assert_allclose(
        applied(cam.projection_onto_plane(floor, light), (0, 1, 0)), [-1 / 3, 0, -2 / 3], atol=EXACT
    )


# ---------------------------------------------------------------- Jünemann: NDC


def test_j_the_near_plane_is_rescaled_to_2_by_2():
    """J, NDC: diag(2/w_n, 2/h_n, 1, 1) times the projection onto the near plane."""
    view = cam.Frustum(70, 1.6, 0.5, 20)
    n = view.near
    scale = np.diag([2 / view.near_width, 2 / view.near_height, 1, 1])
    product = scale @ cam.plane_projection((0, 0, 1), n)
    rows = [0, 1, 3]  # The third is where depth comes in.
    np.testing.assert_allclose(view.clip_from_camera()[rows], product[rows], atol=EXACT)


def test_j_the_naive_map_bends_straight_lines_and_ndc_does_not():
    """J, NDC: "(x, y, z) -> (.., .., z) does not map straight lines to straight lines"; g does."""
    start, end = np.array([-1.0, 0.2, -2]), np.array([2.0, 0.5, -8])
    line = start + np.linspace(0, 1, 9)[:, None] * (end - start)
    view = cam.Frustum(60, 1, 1, 10)
    ndc = applied(view.clip_from_camera(), line)
    naive = np.concatenate([ndc[:, :2], line[:, 2:]], axis=-1)

    def bend(points):
        return np.linalg.norm(np.cross(points - points[0], points[-1] - points[0]), axis=-1).max()

    assert bend(naive) > 0.1
    assert bend(ndc) < EXACT


def test_j_exercise_5_1_g_is_minus_1_at_the_near_and_1_at_the_far_plane():
    for n, f in ((1, 3), (2, 10), (0.1, 1000)):
        assert cam.pseudodepth(-n, n, f) == pytest.approx(-1, abs=EXACT)
        assert cam.pseudodepth(-f, n, f) == pytest.approx(1, abs=EXACT)


def test_j_exercise_5_2_g_drawn_for_f_3_and_n_1():
    """J, exercise 5.2: g(z) = 2 + 3/z on [-3, -1]."""
    z = np.array([-3, -2.5, -2, -1.5, -1.25, -1])
    np.testing.assert_allclose(cam.pseudodepth(z, 1, 3), [1, 0.8, 0.5, 0, -0.4, -1], atol=EXACT)


def test_j_exercise_6_1_the_matrix_of_perspective_camera_90_2_2_10():
    expected = [[0.5, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1.5, -5], [0, 0, -1, 0]]
    np.testing.assert_allclose(cam.Frustum(90, 2, 2, 10).clip_from_camera(), expected, atol=EXACT)


def test_j_exercise_6_2_corners_of_the_frustum_become_corners_of_the_cube():
    """J, exercise 6.2: A becomes A' and B becomes B'.

    The figure is not in our copy of the text. Whichever corners A and B are, they are among these:
    half of the near plane is 4 by 2 at z = -2, and half of the far plane 20 by 10 at z = -10.
    """
    view = cam.Frustum(90, 2, 2, 10)
    corners = np.stack(view.corners())
    np.testing.assert_allclose(corners[2], [4, 2, -2], atol=EXACT)
    np.testing.assert_allclose(corners[6], [20, 10, -10], atol=EXACT)
    square = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    cube = [(*xy, z) for z in (-1, 1) for xy in square]
    np.testing.assert_allclose(applied(view.clip_from_camera(), corners), cube, atol=EXACT)


def test_j_ndc_written_out():
    """J: x_ndc = -2 n x_c/(w_n z_c), y_ndc alike, z_ndc = (f + n)/(f - n) + 2 n f/((f - n) z_c)."""
    view, points = cam.Frustum(70, 1.6, 0.5, 20), in_front(20)
    x, y, z = points.T
    expected = [
        -2 * 0.5 * x / (view.near_width * z),
        -2 * 0.5 * y / (view.near_height * z),
        20.5 / 19.5 + 20 / 19.5 / z,
    ]
    np.testing.assert_allclose(
        applied(view.clip_from_camera(), points), np.transpose(expected), atol=EXACT
    )


# ---------------------------------------------------------------- Jünemann: the graphics pipeline


def test_j_steps_1_to_3_are_one_matrix_multiplication():
    vertices, object_matrix = in_front(4), rotated(0, 20, (0.1, 0.2, -6))
    view, there = (
        cam.Frustum(70, 1.6, 0.5, 20),
        cam.rigid_inverse(cam.look_at((1, 1, 1), (0, 0, -9))),
    )
    steps = cam.project_vertices(
        vertices, object_matrix, there, view.clip_from_camera(), 640, 400, behind="nan"
    )
    matrix = cam.compose(view.clip_from_camera(), there, object_matrix)
    np.testing.assert_allclose(
        cam.multiply(matrix, cam.homogeneous(vertices)), steps.clip, atol=EXACT
    )


def test_j_a_vertex_is_outside_where_a_coordinate_exceeds_w():
    """J, homogeneous clip space: \\|x\\| > w or \\|y\\| > w or \\|z\\| > w, without a division."""
    view = cam.Frustum(70, 1.6, 0.5, 20)
    points = RANDOM.uniform([-15, -15, -30], [15, 15, 10], (2000, 3))
    clip = cam.multiply(view.clip_from_camera(), cam.homogeneous(points))
    inside = cam.inside_clip(clip)
    assert 100 < inside.sum() < 1900
    np.testing.assert_array_equal(inside, view.contains(points))
    np.testing.assert_array_equal(inside, ~np.any(cam.outside_planes(clip), axis=0))


def test_j_the_smaller_n_the_worse_the_depth_resolution_far_away():
    """J, plot of z_ndc for f = 10 and n = 0.5 or 1: what is left of [-1, 1] for depths beyond 5."""
    left = [1 - cam.pseudodepth(-5, n, 10) for n in (0.5, 1)]
    np.testing.assert_allclose(left, [2 * 0.5 / 9.5, 2 / 9], atol=EXACT)


def test_j_step_5_the_viewport_transform():
    """J: x_s = w_s/2 x + w_s/2, y_s = -h_s/2 y + h_s/2."""
    ndc = [(-1, 1, 0), (1, -1, 0), (0, 0, 0.3), (0.5, 0.5, 1)]
    pixels = cam.pixel_from_ndc(ndc, 640, 480)
    np.testing.assert_allclose(pixels, [(0, 0), (640, 480), (320, 240), (480, 120)], atol=EXACT)
    np.testing.assert_allclose(
        cam.ndc_from_pixel(pixels, 640, 480), np.array(ndc)[:, :2], atol=EXACT
    )


# ---------------------------------------------------------------- both, and the paper


def test_both_texts_write_one_map():
    """Q_ndc = diag(2/w_n, 2/h_n, 1, 1) n M_p, with n = -f and f = -F."""
    view = cam.Frustum(70, 1.6, 0.5, 20)
    scale = np.diag([2 / view.near_width, 2 / view.near_height, 1, 1])
    np.testing.assert_allclose(
        scale @ (0.5 * cam.pseudodepth_perspective(0.5, 20)), view.clip_from_camera(), atol=EXACT
    )


def test_paper_2_1_the_4x3_matrix_maps_the_global_coordinate_system_to_the_image_plane():
    """Potmesil & Chakravarty, section 2.1: pan, tilt, swing, lens center, focal length."""
    center, points = np.array([1.0, 2, 3]), RANDOM.normal([0, 0, 30], 2, (20, 3))
    matrix = cam.image_from_world_matrix(5, -4, 10, center, 35)
    assert matrix.shape == (4, 3)
    row = np.concatenate([points, np.ones((20, 1))], axis=-1) @ matrix
    rotation = cam.orientation(5, -4, 10)
    left, up, depth = ((points - center) @ rotation).T
    np.testing.assert_allclose(row[:, 2], depth, atol=EXACT)
    expected = np.stack([-35 * left / depth, 35 * up / depth], -1)
    np.testing.assert_allclose(row[:, :2] / row[:, 2:], expected, atol=1e-11)
    np.testing.assert_allclose(cam.image_from_world(points, matrix), expected, atol=1e-11)


def test_paper_2_1_points_outside_the_viewing_pyramid_are_off_the_frame():
    """Section 2.1: the focal length along with the size of the frame is the viewing pyramid."""
    pyramid = cam.Frustum.from_lens(35, 36, 24, 1e-3, 1e3)
    points = RANDOM.uniform([-30, -30, -40], [30, 30, -1], (500, 3))
    image = cam.image_from_camera(points, 35)
    in_frame = (np.abs(image) <= [18, 12]).all(-1)
    assert 50 < in_frame.sum() < 450
    np.testing.assert_array_equal(pyramid.contains(points), in_frame)
