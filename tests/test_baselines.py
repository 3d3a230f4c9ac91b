"""The baselines are called as touchnet's own reconstruction is, and say what is wrong in one line."""

import sys

import numpy as np
import pytest
import trimesh

from touchnet.baselines import (
    alpha_shape,
    alpha_wrap,
    ball_pivoting,
    convex_hull,
    gaussian_process_surface,
    screened_poisson,
    spacing,
)
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
    with pytest.raises(ImportError, match=r"pip install 'touchnet\[baselines\]'"):
        screened_poisson(np.zeros((4, 3)), np.zeros((4, 3)))


def ball(n: int, radius: float = 0.5) -> tuple[trimesh.Trimesh, np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    points, face = sample_surface(mesh, n, generator=np.random.default_rng(1))
    return mesh, points, mesh.face_normals[face]


def test_spacing_is_the_distance_to_the_sixth_neighbour_and_scales() -> None:
    axis = np.arange(12.0)
    lattice = np.stack(np.meshgrid(axis, axis, [0.0]), axis=-1).reshape(-1, 3)
    # Inside of a square lattice four neighbours at 1 and four at sqrt 2; at its sides and corners farther.
    assert spacing(lattice) == pytest.approx(2.0)
    assert spacing(10 * lattice) == pytest.approx(20.0)
    assert spacing(np.zeros((5, 3))) == 0.0


def test_alpha_shape_of_two_cubes_keeps_them_apart_where_the_hull_joins_them() -> None:
    axis = np.arange(4.0)
    cube = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    cube = cube + np.random.default_rng(0).uniform(-1e-3, 1e-3, cube.shape)
    points = np.concatenate([cube, cube + np.array([10.0, 0, 0])])
    mesh = alpha_shape(points, alpha=1.5)
    assert mesh.volume == pytest.approx(2 * 27, rel=0.02)  # positive: wound outwards
    assert convex_hull(points).volume > 100
    with pytest.raises(ValueError, match=r"no tetrahedron of 128 points has a circumscribed sphere smaller than 0.1"):
        alpha_shape(points, alpha=0.1)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.eye(3), np.random.default_rng(0).random((9, 3)) * [1, 1, 0]])
def test_points_without_an_alpha_shape_are_refused(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match=rf"^points have no alpha shape: {len(points)} of them, or all in one plane$"):
        alpha_shape(points)


def test_alpha_wrap_and_ball_pivoting_recover_a_sphere() -> None:
    pytest.importorskip("pymeshlab", reason="alpha wrap and ball pivoting are extras")
    truth, points, normals = ball(800)
    wrap, pivoted = alpha_wrap(points), ball_pivoting(points, normals)
    assert is_closed(wrap.faces) and volumetric_iou(wrap, truth) > 0.9
    distance = np.abs(np.linalg.norm(pivoted.vertices, axis=1) - 0.5)
    assert len(pivoted.faces) > 1000 and distance.max() < 0.01
    outwards = (pivoted.face_normals * pivoted.triangles_center).sum(axis=1) > 0
    assert outwards.mean() > 0.99
    with pytest.raises(ValueError, match="alpha wrap needs 4 distinct points, got 2"):
        alpha_wrap(points[:2])
    with pytest.raises(ValueError, match="ball pivoting found no surface in 1 points"):
        ball_pivoting(points[:1], normals[:1])


def test_gaussian_process_surface_recovers_a_sphere_with_and_without_normals() -> None:
    truth, points, normals = ball(200)
    moved = 100 * points + 7
    mesh = gaussian_process_surface(moved, normals, resolution=48)
    assert is_closed(mesh.faces)
    mesh.vertices = (mesh.vertices - 7) / 100  # in the frame of the contacts
    assert volumetric_iou(mesh, truth) > 0.95
    _, many, _ = ball(400)  # the shell around 200 contacts leaks
    shell = gaussian_process_surface(many, resolution=48)
    assert is_closed(shell.faces) and volumetric_iou(shell, truth) > 0.9
    with pytest.raises(ValueError, match="a Gaussian process surface needs 4 distinct points, got 3"):
        gaussian_process_surface(points[:3])
