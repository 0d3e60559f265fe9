"""Faces cut to the frustum in homogeneous clip space."""

import numpy as np
import pytest

from potmesil_mi.optics import camera as cam

RANDOM = np.random.default_rng(4)
VIEW = cam.Frustum(60, 1.5, 1, 20)


def clip_of(points):
    return cam.multiply(VIEW.clip_from_camera(), cam.homogeneous(points))


def random_faces(count, corners=3):
    """Faces around the camera, many of which reach behind it; convex in their plane."""
    centers = RANDOM.uniform([-8, -8, -25], [8, 8, 5], (count, 1, 3))
    sides = RANDOM.normal(0, 6, (2, count, 1, 3))
    angles = np.sort(RANDOM.uniform(0, 2 * np.pi, (count, corners, 1)), axis=1)
    return centers + sides[0] * np.cos(angles) + sides[1] * np.sin(angles)


def area(polygon):
    """Of a flat polygon (k, 3) in space."""
    if len(polygon) == 0:
        return 0.0
    spread = polygon - polygon[0]
    return np.linalg.norm(np.cross(spread[1:-1], spread[2:]).sum(0)) / 2


def camera_of(clip):
    """Camera points of clip-space ones."""
    return (clip @ np.linalg.inv(VIEW.clip_from_camera()).T)[..., :3]


def test_a_face_inside_is_left_as_it_is():
    face = clip_of([(-1, 0, -5), (1, 0, -5), (0, 1, -6)])
    np.testing.assert_array_equal(cam.clip_face(face), face)


@pytest.mark.parametrize(
    "face",
    [
        [(-1, 0, 5), (1, 0, 5), (0, 1, 6)],
        [(50, 0, -5), (52, 0, -5), (51, 1, -5)],
        [(0, 0, -21), (1, 0, -25), (0, 1, -30)],
    ],
    ids=["behind", "to the right", "beyond the far plane"],
)
def test_a_face_outside_has_no_vertices(face):
    assert cam.clip_face(clip_of(face)).shape == (0, 4)
    assert cam.clip_faces(clip_of(np.array(face))).count == 0


def test_a_face_that_covers_the_picture_becomes_its_rectangle():
    face = cam.clip_face(clip_of([(-999, -999, -5), (999, -999, -5), (0, 2999, -5)]))
    ndc = cam.perspective_divide(face)
    assert len(ndc) == 4
    assert {tuple(xy) for xy in np.round(ndc[:, :2], 9)} == {(-1, -1), (1, -1), (1, 1), (-1, 1)}


def test_a_face_through_the_camera_shows_what_is_in_front_of_it():
    """The division would put the vertex behind the camera in front of it, on the other side."""
    floor = clip_of([(-1, -1, -10), (1, -1, -10), (0, -1, 10)])
    seen = camera_of(cam.clip_face(floor))
    np.testing.assert_allclose(seen[:, 1], -1, atol=1e-12)
    nearest = 1 / np.tan(np.radians(30))  # where the lower plane is 1 below the axis
    assert seen[:, 2].max() == pytest.approx(-nearest, rel=1e-12)
    assert seen[:, 2].min() == pytest.approx(-10, rel=1e-12)


@pytest.mark.parametrize("corners", [3, 4, 5])
def test_what_is_left_of_a_face_lies_in_its_plane_and_in_the_frustum(corners):
    faces = random_faces(300, corners)
    clipped = [cam.clip_face(clip) for clip in clip_of(faces)]
    cut = [(face, left) for face, left in zip(faces, clipped, strict=True) if len(left)]
    assert 50 < len(cut) < 300
    for face, left in cut:
        assert cam.inside_clip(left + np.array([0, 0, 0, 1e-9])).all()
        normal = np.cross(face[1] - face[0], face[2] - face[0])
        normal /= np.linalg.norm(normal)
        np.testing.assert_allclose((camera_of(left) - face[0]) @ normal, 0, atol=1e-9)


def test_the_area_left_is_the_share_of_the_face_that_is_in_the_frustum():
    """Against counting: points evenly over each triangle."""
    u, v = np.meshgrid((np.arange(200) + 0.5) / 200, (np.arange(200) + 0.5) / 200)
    u, v = u.ravel(), v.ravel()
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    for face in random_faces(60):
        points = face[0] + u[:, None] * (face[1] - face[0]) + v[:, None] * (face[2] - face[0])
        share = VIEW.contains(points).mean()
        left = area(camera_of(cam.clip_face(clip_of(face)))) / area(face)
        assert left == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize("corners", [3, 4])
def test_many_faces_at_once_are_the_faces_one_by_one(corners):
    clip = clip_of(random_faces(400, corners))
    vertices, count = cam.clip_faces(clip)
    assert len(vertices) == corners + 6
    for i, face in enumerate(clip):
        expected = cam.clip_face(face)
        found = np.stack([vertex[i] for vertex in vertices])
        assert count[i] == len(expected)
        if len(expected):
            np.testing.assert_allclose(found[: count[i]], expected, atol=1e-12)
            np.testing.assert_array_equal(
                found[count[i] :], found[:1].repeat(len(found) - count[i], 0)
            )


def test_points_on_the_planes_are_inside():
    corners = cam.multiply(VIEW.clip_from_camera(), cam.homogeneous(np.stack(VIEW.corners())))
    assert cam.inside_clip(np.sign(corners) * np.abs(corners[:, 3:])).all()


def test_planes_beyond_which_a_vertex_lies_are_named():
    found = cam.outside_planes((-2, 0, 3, 1))
    assert [name for name, value in zip(cam.FRUSTUM_PLANES, found, strict=True) if value] == [
        "left",
        "far",
    ]
    assert cam.PlaneValues._fields == cam.FRUSTUM_PLANES


@pytest.mark.parametrize(("shape"), [(2, 4), (3, 3), (3,), (2, 3, 4)])
def test_what_is_no_face_is_refused(shape):
    with pytest.raises(ValueError, match=r"^vertices: has shape \(.*\); must be \(3 or more, 4\)"):
        cam.clip_face(np.zeros(shape))


def test_two_vertices_are_no_faces():
    with pytest.raises(ValueError, match=r"^vertices: has 2; must have 3 or more"):
        cam.clip_faces(np.zeros((7, 2, 4)))
