import subprocess
import sys

import numpy as np
import pytest
import trimesh

from touchnet.data.occupancy import contains, label_box, label_near, sample_surface, split


def rng(seed=0):
    return np.random.default_rng(seed)


def in_box(points, half):
    return (np.abs(points) < half).all(axis=1)


def test_labels_of_a_box_are_exact_at_the_rounded_positions():
    mesh = trimesh.creation.box((1, 0.5, 0.25))
    for found in (label_box(mesh, 3000, rng()), label_near(mesh, 3000, rng(), sigmas=(0.003, 0.05))):
        assert found.points.dtype == np.float16
        assert found.inside.dtype == bool
        points = found.points.astype(np.float64)
        on_the_surface = np.isclose(np.abs(points), [0.5, 0.25, 0.125], rtol=0, atol=1e-9).any(axis=1)
        expected = in_box(points, [0.5, 0.25, 0.125])
        np.testing.assert_array_equal(found.inside[~on_the_surface], expected[~on_the_surface])
        assert 0.2 < found.inside.mean() <= 1


def test_D06_thin_plate_gives_exactly_what_was_asked_for(shared_data):
    plate = trimesh.load(shared_data / "cases" / "D06_thin_plate.obj", process=False)
    found = label_near(plate, 4000, rng())
    assert found.points.shape == (4000, 3)
    assert found.inside.shape == (4000,)
    assert 0 < found.inside.sum() < 400
    assert len(label_box(plate, 4000, rng()).inside) == 4000


def test_D01_open_mesh_is_refused(shared_data):
    mesh = trimesh.load(shared_data / "cases" / "D01_open_box.obj", process=False)
    with pytest.raises(ValueError, match="should be closed to tell inside from outside, got 4 open edges"):
        contains(mesh, [[0, 0, 0]])


def test_mixed_winding_is_refused():
    box = trimesh.creation.box()
    faces = box.faces.copy()
    faces[0] = faces[0, ::-1]
    with pytest.raises(ValueError, match="faces that wind both ways"):
        contains(trimesh.Trimesh(box.vertices, faces, process=False), [[0, 0, 0]])


def test_D03_inverted_mesh_is_labelled_as_if_flipped(shared_data):
    mesh = trimesh.load(shared_data / "cases" / "D03_inverted_winding.obj", process=False)
    with pytest.warns(UserWarning, match="12 faces wind inwards"):
        labels = contains(mesh, [mesh.vertices.mean(0), mesh.vertices.mean(0) + 10])
    assert labels.tolist() == [True, False]


def test_D07_labelling_needs_no_rtree(shared_data):
    code = """
import sys
for name in ("rtree", "embreex", "igl", "pymeshlab"):
    sys.modules[name] = None
import numpy as np, trimesh
from touchnet.data.occupancy import contains
mesh = trimesh.load(sys.argv[1], process=False)
mesh.invert()
points = np.random.default_rng(0).uniform(-0.6, 0.6, (1000, 3))
print(int(contains(mesh, mesh.bounds.mean(0) + points).sum()))
"""
    case = shared_data / "cases" / "D03_inverted_winding.obj"
    run = subprocess.run([sys.executable, "-c", code, str(case)], capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (1000, 3))
    assert int(run.stdout) == int(in_box(points, [0.4, 0.4, 0.4]).sum())


def test_near_points_follow_the_sigmas_in_order():
    mesh = trimesh.creation.box((1, 1, 1))
    found = label_near(mesh, 3001, rng(), sigmas=(0.001, 0.01, 0.1))
    depth = np.abs(np.abs(found.points.astype(float)).max(axis=1) - 0.5)
    first, second, third = (depth[part.start : part.stop].mean() for part in split(3001, 3))
    assert first < 0.002 < second < 0.02 < third


@pytest.mark.parametrize(("n", "parts", "sizes"), [(10, 2, [5, 5]), (11, 3, [4, 4, 3]), (1, 2, [1, 0]), (0, 2, [0, 0])])
def test_split_covers_everything_in_order(n, parts, sizes):
    found = split(n, parts)
    assert [len(part) for part in found] == sizes
    assert [i for part in found for i in part] == list(range(n))


def test_surface_samples_are_uniform_in_area_and_face_outwards():
    mesh = trimesh.creation.box((1, 1, 4))
    points, normals = sample_surface(mesh, 20_000, rng())
    assert points.shape == normals.shape == (20_000, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    assert np.isclose((points * normals).sum(1), np.where(np.abs(normals[:, 2]) > 0.5, 2, 0.5)).all()
    ends = np.abs(normals[:, 2]) > 0.5
    assert ends.mean() == pytest.approx(2 / 18, abs=0.01)
    assert np.histogram(points[~ends, 2], 4, (-2, 2))[0] == pytest.approx([4444] * 4, rel=0.07)


def test_same_generator_gives_the_same_points():
    mesh = trimesh.creation.icosphere(2)
    a, b = (label_near(mesh, 500, rng(3)) for _ in range(2))
    assert a.points.tobytes() == b.points.tobytes()
    assert a.inside.tobytes() == b.inside.tobytes()
    assert label_near(mesh, 500, rng(4)).points.tobytes() != a.points.tobytes()


def test_nothing_asked_for_nothing_given():
    mesh = trimesh.creation.box()
    assert label_box(mesh, 0, rng()).points.shape == (0, 3)
    assert label_near(mesh, 0, rng()).inside.shape == (0,)
    assert sample_surface(mesh, 0, rng()).normals.shape == (0, 3)


def test_bad_arguments_are_named():
    mesh = trimesh.creation.box()
    with pytest.raises(ValueError, match="n should be ≥ 0, got -1"):
        label_box(mesh, -1, rng())
    with pytest.raises(ValueError, match="sigmas should be positive numbers"):
        label_near(mesh, 10, rng(), sigmas=())
    with pytest.raises(ValueError, match="sigmas should be positive numbers"):
        label_near(mesh, 10, rng(), sigmas=(0.1, 0))
    with pytest.raises(ValueError, match="faces with an area"):
        sample_surface(trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False), 5, rng())
