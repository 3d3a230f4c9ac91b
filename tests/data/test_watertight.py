import sys

import numpy as np
import pytest
import trimesh

from touchnet.data import watertight
from touchnet.data.watertight import inspect_mesh, make_watertight, signed_volume, winding_number


def inside(mesh, points):
    return winding_number(mesh.vertices, mesh.faces, points) > 0.5


def without_faces(mesh, drop):
    return trimesh.Trimesh(mesh.vertices, mesh.faces[~drop], process=False)


def joined(*meshes):
    return trimesh.util.concatenate(meshes)


def test_closed_mesh_keeps_its_faces(recwarn):
    box = trimesh.creation.box((2, 1, 1))
    closed = make_watertight(box)
    assert closed.metadata["closed_by"] == "closed already"
    assert len(closed.faces) == 12
    assert closed.volume == pytest.approx(2)
    np.testing.assert_allclose(closed.bounds, box.bounds)
    assert not recwarn.list


def test_units_and_offset_are_kept():
    box = trimesh.creation.box((2, 1, 1))
    box.apply_scale(1e-3)
    box.apply_translation((1000, -2000, 5))
    np.testing.assert_allclose(make_watertight(box).bounds, box.bounds, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        make_watertight(without_faces(box, np.arange(12) == 0), resolution=2000).bounds, box.bounds, rtol=0, atol=1e-5
    )


def test_D03_inverted_winding_is_flipped_with_a_warning(shared_data):
    mesh = trimesh.load(shared_data / "cases" / "D03_inverted_winding.obj", process=False)
    assert mesh.volume < 0
    with pytest.warns(UserWarning, match="12 of 12 faces wound inwards were flipped"):
        closed = make_watertight(mesh)
    assert closed.volume == pytest.approx(0.512)
    assert inside(closed, mesh.vertices.mean(0)).all()


def test_components_and_faces_are_oriented_one_by_one():
    near, far = trimesh.creation.box(), trimesh.creation.box()
    far.apply_translation((3, 0, 0))
    far.invert()
    faces = joined(near, far).faces.copy()
    faces[3] = faces[3, ::-1]
    mixed = trimesh.Trimesh(joined(near, far).vertices, faces, process=False)
    with pytest.warns(UserWarning, match="13 of 24 faces"):
        closed = make_watertight(mixed)
    assert closed.volume == pytest.approx(2)
    assert closed.is_winding_consistent


def test_hollow_sphere_with_an_inner_wall_stays_hollow():
    outer, inner = trimesh.creation.icosphere(3, 1.0), trimesh.creation.icosphere(3, 0.8)
    inner.invert()
    closed = make_watertight(joined(outer, inner))
    assert closed.metadata["closed_by"] == "closed already"
    assert not inside(closed, [[0, 0, 0]]).any()


def test_closed_parts_that_intersect_become_one_surface():
    a, b = trimesh.creation.box(), trimesh.creation.box()
    b.apply_translation((0.5, 0.25, 0.125))
    crossed = joined(a, b)
    assert not inspect_mesh(crossed).simple
    closed = make_watertight(crossed, resolution=2000)
    assert closed.metadata["closed_by"] == "manifold 2000"
    assert inspect_mesh(closed).simple
    union = 2 - 0.5 * 0.75 * 0.875
    assert closed.volume == pytest.approx(union, rel=0.03)


def test_D01_open_box_is_counted_and_closed(shared_data):
    mesh = trimesh.load(shared_data / "cases" / "D01_open_box.obj", process=False)
    report = inspect_mesh(mesh)
    assert report.open_edges == 4
    assert not report.closed
    closed = make_watertight(mesh, resolution=2000)
    assert inspect_mesh(closed).closed
    assert closed.metadata["closed_by"] != "closed already"


def test_small_hole_leaves_the_inside_solid():
    sphere = trimesh.creation.icosphere(4)
    cut = without_faces(sphere, sphere.triangles_center[:, 1] > 0.995)
    closed = make_watertight(cut, resolution=2000)
    assert closed.metadata["hollow"] < 0.05
    assert closed.volume == pytest.approx(sphere.volume, rel=0.05)


def test_open_shell_that_faces_outwards_is_filled():
    # Like a car body without a floor: no ball is too large for the hole.
    box = trimesh.creation.box((2, 0.6, 0.8)).subdivide().subdivide()
    shell = without_faces(box, box.face_normals[:, 1] < -0.5)
    closed = make_watertight(shell, resolution=2000)
    assert closed.metadata["closed_by"] == "winding fill"
    assert inside(closed, [[0, 0.1, 0]]).all()
    assert closed.bounds[0][1] > -0.31  # nothing bulges out of the missing floor


def test_filling_leaves_no_sealed_cavity():
    # In a box turned inside out and open at the top the winding number is low; all around it is filled.
    box = trimesh.creation.box((1, 1, 1)).subdivide().subdivide().subdivide()
    hole = (box.face_normals[:, 1] < -0.5) & (np.abs(box.triangles_center[:, [0, 2]]) < 0.2).all(1)
    pocket = trimesh.creation.box((0.4, 0.4, 0.4))
    pocket.invert()
    shell = joined(without_faces(box, hole), without_faces(pocket, pocket.face_normals[:, 1] < -0.5))
    assert (winding_number(shell.vertices, shell.faces, [[0, 0, 0]]) < 0.5).all()
    closed = make_watertight(shell, resolution=2000)
    assert closed.metadata["closed_by"] == "winding fill"
    assert inside(closed, [[0, 0, 0]]).all()


def test_manifold_alone_does_not_fill():
    box = trimesh.creation.box((2, 0.6, 0.8)).subdivide().subdivide()
    shell = without_faces(box, box.face_normals[:, 1] < -0.5)
    closed = make_watertight(shell, resolution=2000, method="manifold")
    assert not inside(closed, [[0, 0.1, 0]]).any()


def test_space_between_two_wings_stays_empty():
    # As far apart as they are wide, like a biplane's. Much closer ones look like the two sides of one hollow body.
    wings = [trimesh.creation.box((2, 0.02, 0.4)) for _ in range(2)]
    wings[1].apply_translation((0, 0.4, 0))
    open_wings = joined(*(without_faces(wing, np.arange(12) == 0) for wing in wings))
    closed = make_watertight(open_wings, resolution=2000)
    assert not inside(closed, [[0, 0.2, 0]]).any()


def test_cup_stays_open():
    outer = trimesh.creation.cylinder(0.5, 1.0, sections=48).subdivide().subdivide()
    inner = trimesh.creation.cylinder(0.42, 1.0, sections=48).subdivide().subdivide()
    inner.apply_translation((0, 0, 0.1))
    inner.invert()
    lid = lambda mesh: mesh.face_normals[:, 2] * (1 if mesh is outer else -1) > 0.5  # noqa: E731
    inner.vertices[:, 2] = np.minimum(inner.vertices[:, 2], 0.5)
    cup = joined(without_faces(outer, lid(outer)), without_faces(inner, lid(inner)))
    closed = make_watertight(cup, resolution=2000)
    assert not inside(closed, [[0, 0, 0.3], [0, 0, 0]]).any()
    assert inside(closed, [[0.46, 0, 0], [0, -0.46, 0.2], [0, 0, -0.45]]).all()  # the wall and the bottom


def test_sheet_without_thickness_becomes_twice_the_offset_thick():
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    closed = make_watertight(sheet, resolution=2000, offset=0.004)
    assert 0.0068 < closed.volume < 0.0082  # the rim is rounded off
    assert inspect_mesh(closed).thin > 0.9


def test_closing_fills_what_the_ball_cannot_enter():
    sphere = trimesh.creation.icosphere(4, 0.5)
    cut = without_faces(sphere, np.abs(sphere.triangles_center[:, 1]) > 0.4995)
    closed = make_watertight(cut, method="closing")
    assert inspect_mesh(closed).closed
    assert closed.volume == pytest.approx(sphere.volume, rel=0.03)
    distance = np.abs(np.linalg.norm(closed.vertices, axis=1) - 0.5)
    assert np.quantile(distance, 0.99) < 0.005


def test_same_input_gives_the_same_bytes():
    box = trimesh.creation.box()
    open_box = without_faces(box, np.arange(12) == 5)
    a, b = (make_watertight(open_box, resolution=2000) for _ in range(2))
    assert a.vertices.tobytes() == b.vertices.tobytes()
    assert a.faces.tobytes() == b.faces.tobytes()


def test_broken_corners_and_repeated_vertices_are_dropped():
    box = trimesh.creation.box()
    vertices = np.concatenate([box.vertices, [[np.nan, 0, 0]], box.vertices[:1]])
    faces = np.concatenate([box.faces, [[0, 1, 8], [0, 9, 1], [2, 2, 3]]])
    closed = make_watertight(trimesh.Trimesh(vertices, faces, process=False))
    assert closed.volume == pytest.approx(1)


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3), int), "faces with finite corners, got none"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], "faces with finite corners, got none"),
        (np.zeros((3, 3)), [[0, 1, 2]], "triangles with an extent"),
    ],
)
def test_unusable_meshes_are_refused(vertices, faces, words):
    with pytest.raises(ValueError, match=words):
        make_watertight(trimesh.Trimesh(vertices, faces, process=False))


def test_unknown_method_is_refused():
    with pytest.raises(ValueError, match="method should be one of auto, manifold, closing, alpha_wrap, got 'magic'"):
        make_watertight(trimesh.creation.box(), method="magic")


def test_alpha_wrap_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymeshlab", None)
    with pytest.raises(ImportError, match=r"touchnet\[data\]"):
        make_watertight(trimesh.creation.box(), method="alpha_wrap")


@pytest.mark.slow
def test_alpha_wrap_tries_a_larger_alpha_where_the_result_is_hollow(monkeypatch):
    pytest.importorskip("pymeshlab", reason="extra [data]")
    sphere = trimesh.creation.icosphere(3)
    pierced = without_faces(sphere, np.arange(len(sphere.faces)) == 0)  # the hole is 7 % of the diameter wide
    closed = make_watertight(pierced, method="alpha_wrap")
    assert closed.metadata["closed_by"] == "alpha wrap 0.03" and closed.metadata["hollow"] == 0
    assert inspect_mesh(closed).closed
    assert closed.volume == pytest.approx(sphere.volume, rel=0.03)
    monkeypatch.setattr(watertight, "HOLLOW_SHARE", 1.0)
    first = make_watertight(pierced, method="alpha_wrap")
    assert first.metadata["closed_by"] == "alpha wrap 0.01" and first.metadata["hollow"] > 0.9
    assert first.volume < 0.1 * sphere.volume


def test_signed_volume_far_from_the_origin():
    box = trimesh.creation.box((1, 2, 3))
    assert signed_volume(box.vertices + 1e6, box.faces) == pytest.approx(6)
    assert signed_volume(box.vertices, box.faces[:, ::-1]) == pytest.approx(-6)


def test_inspection_counts_faces_that_share_an_edge_three_times():
    fan = [[0, 1, 2], [0, 1, 3], [0, 1, 4]]
    report = inspect_mesh(trimesh.Trimesh(np.eye(5, 3) + np.arange(15).reshape(5, 3) ** 2 / 50, fan, process=False))
    assert report.open_edges == 7
    with pytest.raises(ValueError, match="should have faces"):
        inspect_mesh(trimesh.Trimesh(np.eye(3), np.zeros((0, 3), int), process=False))


def test_winding_numbers_agree_with_the_exact_sum():
    igl = pytest.importorskip("igl", reason="libigl is the oracle")
    rng = np.random.default_rng(0)
    mesh = make_watertight(without_faces(trimesh.creation.torus(0.5, 0.1), np.arange(2048) < 9), resolution=3000)
    points = mesh.vertices[rng.integers(len(mesh.vertices), size=500)] + rng.normal(0, 0.01, (500, 3))
    exact = igl.winding_number(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64), points)
    ours = winding_number(mesh.vertices, mesh.faces, points)
    assert np.abs(ours - exact).max() < 0.1
    np.testing.assert_array_equal(ours >= 0.5, exact >= 0.5)
    assert winding_number(mesh.vertices, mesh.faces, np.zeros((0, 3))).shape == (0,)
