"""The baselines are called as touchnet's own reconstruction is, and say what is wrong in one line."""

import sys

import numpy as np
import pytest
import trimesh

from touchnet.baselines import convex_hull, screened_poisson
from touchnet.metrics import is_closed, sample_surface, volumetric_iou


def test_hull_of_a_cube_and_what_lies_inside_it() -> None:
    cube = trimesh.creation.box((1, 2, 3))
    points = np.concatenate([cube.vertices, np.random.default_rng(0).uniform(-0.4, 0.4, (50, 3))])
    hull = convex_hull(points)
    assert is_closed(hull.faces) and len(hull.vertices) == 8
    assert hull.volume == pytest.approx(6)  # positive: wound outwards


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), np.zeros((1, 3)), np.eye(3), np.random.default_rng(0).random((9, 3)) * [1, 1, 0]]
)
def test_points_without_a_hull_are_refused_in_one_line(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match=rf"^points have no convex hull: {len(points)} of them, or all in one plane$"):
        convex_hull(points)


def test_baselines_name_arguments_that_do_not_fit() -> None:
    with pytest.raises(ValueError, match=r"points must have shape \(N, 3\), got \(3,\)"):
        convex_hull(np.zeros(3))
    with pytest.raises(ValueError, match="points must be finite"):
        convex_hull(np.full((4, 3), np.nan))


def test_poisson_recovers_a_sphere_and_refuses_a_point() -> None:
    pytest.importorskip("pymeshlab", reason="screened Poisson is an extra")
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    points, face = sample_surface(ball, 800, generator=np.random.default_rng(0))
    mesh = screened_poisson(points, ball.face_normals[face])
    assert is_closed(mesh.faces) and volumetric_iou(mesh, ball) > 0.97
    with pytest.raises(ValueError, match="screened Poisson found no surface in 1 points"):
        screened_poisson(points[:1], ball.face_normals[face[:1]])
    with pytest.raises(ValueError, match=r"normals must have the shape of points \(800, 3\), got \(799, 3\)"):
        screened_poisson(points, points[1:])


def test_poisson_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pymeshlab", None)
    with pytest.raises(ImportError, match=r"pip install 'touchnet\[data\]'"):
        screened_poisson(np.zeros((4, 3)), np.zeros((4, 3)))
