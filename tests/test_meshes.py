import numpy as np
import pytest
import trimesh

from touchnet.meshes import check_closed, distances_to, fill_cavities


def tetrahedron(offset=0.0):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float) + offset
    return vertices, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def mesh(vertices, faces):
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize("make", [trimesh.creation.icosphere, trimesh.creation.box, trimesh.creation.torus])
def test_closed_meshes_pass(make):
    check_closed(make(1.0, 0.3) if make is trimesh.creation.torus else make())


def test_a_small_solid_far_away_passes():
    vertices, faces = tetrahedron()
    check_closed(mesh(vertices * 1e-3 + 1e6, faces))


def test_no_faces():
    with pytest.raises(ValueError, match="no faces"):
        check_closed(mesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=int)))


def test_a_missing_face():
    vertices, faces = tetrahedron()
    with pytest.raises(ValueError, match="not closed: 3 of 6 edges have 1 to 1 faces"):
        check_closed(mesh(vertices, faces[:3]))


def test_one_face_turned():
    vertices, faces = tetrahedron()
    faces[0] = faces[0, ::-1]
    with pytest.raises(ValueError, match="3 edges that both of their faces run through in the same direction"):
        check_closed(mesh(vertices, faces))


def test_inside_out():
    vertices, faces = tetrahedron()
    with pytest.raises(ValueError, match=r"inside out: its volume is -0\.16"):
        check_closed(mesh(vertices, faces[:, ::-1]))


def test_two_solids_that_share_a_vertex():
    vertices, faces = tetrahedron()
    both = np.vstack([vertices, -vertices[1:]])
    other = np.where(faces == 0, 0, faces + 3)[:, ::-1]
    with pytest.raises(ValueError, match="touches itself: 8 fans of faces at 7 vertices"):
        check_closed(mesh(both, np.vstack([faces, other])))


def test_two_solids_that_share_an_edge():
    vertices, faces = tetrahedron()
    both = np.vstack([vertices, -vertices[2:]])
    other = np.array([0, 1, 4, 5])[faces]
    with pytest.raises(ValueError, match="have 4 to 4 faces"):
        check_closed(mesh(both, np.vstack([faces, other])))


def test_a_face_without_area():
    vertices, faces = tetrahedron()
    # A vertex in the middle of edge 1-2 splits face (1, 2, 3); the face beside the edge is cut there with no area.
    vertices = np.vstack([vertices, (vertices[1] + vertices[2]) / 2])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 4, 3], [4, 2, 3], [0, 3, 2], [1, 2, 4]])
    with pytest.raises(ValueError, match="1 of 6 faces without area"):
        check_closed(mesh(vertices, faces))


def test_stray_and_broken_vertices():
    vertices, faces = tetrahedron()
    with pytest.raises(ValueError, match="1 vertices without a face"):
        check_closed(mesh(np.vstack([vertices, [[9, 9, 9]]]), faces))
    vertices[0, 0] = np.nan
    with pytest.raises(ValueError, match="1 vertices that are not finite"):
        check_closed(mesh(vertices, faces))


def shells(*radii_and_signs, at=(0.0, 0.0, 0.0)):
    parts = []
    for radius, inwards in radii_and_signs:
        ball = trimesh.creation.icosphere(2, radius)
        if inwards:
            ball.invert()
        ball.apply_translation(at)
        parts.append(ball)
    mesh = trimesh.util.concatenate(parts)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (5e6, -5e6, 5e6)])
def test_enclosed_cavity_and_what_floats_in_it_are_dropped(at):
    vertices, faces = shells((1.0, False), (0.8, True), (0.3, False), at=at)
    left, kept, cavities = fill_cavities(vertices, faces)
    assert cavities == 1
    filled = trimesh.Trimesh(left - np.array(at), kept, process=False)
    assert filled.volume == pytest.approx(trimesh.creation.icosphere(2, 1.0).volume, rel=1e-6)
    check_closed(filled)


def test_cavity_that_was_touched_is_kept():
    vertices, faces = shells((1.0, False), (0.8, True))
    outside, inside = trimesh.creation.icosphere(2, 1.0).vertices, trimesh.creation.icosphere(2, 0.8).vertices
    assert fill_cavities(vertices, faces, outside)[2] == 1
    assert fill_cavities(vertices, faces, np.vstack([outside, inside[:2]]))[2] == 1
    assert fill_cavities(vertices, faces, np.vstack([outside, inside[:20]]))[2] == 0


def test_solids_side_by_side_are_kept_as_they_are():
    a, b = shells((1.0, False)), shells((0.5, False), at=(3.0, 0, 0))
    vertices, faces = np.vstack([a[0], b[0]]), np.vstack([a[1], b[1] + len(a[0])])
    left, kept, cavities = fill_cavities(vertices, faces)
    assert cavities == 0 and np.array_equal(left, vertices) and np.array_equal(kept, faces)


def test_distances_are_to_the_faces_not_to_the_vertices():
    box = trimesh.creation.box()
    points = np.array([[0.5, 0.2, 0.1], [0.75, 0, 0], [0.75, 0.75, 0], [0, 0, 0.5 + 1e-9], [0, 0, 0], [0.5, 0.5, 0.5]])
    expected = [0, 0.25, 0.125**0.5, 1e-9, 0.5, 0]
    np.testing.assert_allclose(distances_to(box, points), expected, rtol=1e-6, atol=1e-15)


def test_distances_to_a_fine_mesh_are_those_to_all_of_its_faces():
    mesh = trimesh.creation.torus(1.0, 0.3, major_sections=90, minor_sections=25)
    points = np.random.default_rng(0).normal(size=(400, 3))
    _, expected, _ = trimesh.proximity.closest_point_naive(mesh, points)
    np.testing.assert_allclose(distances_to(mesh, points), expected, rtol=1e-3, atol=1e-12)
