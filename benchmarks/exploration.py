"""Touch simulation: the growing factor against factorising anew, closest points, one whole trajectory."""

from collections.abc import Iterator

import numpy as np
import point_cloud_utils as pcu
import trimesh
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from benchmarks.cases import Case, benchmark
from touchnet.data import GaussianProcess, simulate_touches
from touchnet.data.closest_points import ClosestPoints

LENGTH, NOISE = 0.15, 1e-3


def bumpy_sphere() -> trimesh.Trimesh:
    """A closed mesh of 20,480 faces."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.4)
    x, y, z = mesh.vertices.T
    mesh.vertices *= 1 + 0.15 * (np.sin(9 * x) * np.cos(7 * y) + np.sin(8 * z))[:, None]
    return mesh


def matern(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    t = np.sqrt(3.0) / LENGTH * np.sqrt(((a[:, None] - b) ** 2).sum(-1))
    return (1 + t) * np.exp(-t)


def gradient_of(weights: np.ndarray, x: np.ndarray, points: np.ndarray) -> np.ndarray:
    away = x - points
    slope = -3 / LENGTH**2 * np.exp(-np.sqrt(3.0) / LENGTH * np.sqrt((away**2).sum(1)))
    return -2 * (weights * slope) @ away


@benchmark
def gaussian_process() -> Iterator[Case]:
    points = simulate_touches(bumpy_sphere(), 2048).points

    # Sixteen contacts of one trajectory stand for it: factorising anew at each of the 2048 takes minutes. A timed run
    # leaves each process one contact longer, which changes its size by less than a part in a hundred.
    sizes = range(128, 2049, 128)
    grown = []
    for n in sizes:
        gp = GaussianProcess("matern32", length_scale=LENGTH, noise=NOISE)
        gp.reserve(n + 64)
        gp.add(points[: n - 1])
        grown.append(gp)

    def append() -> None:
        for n, gp in zip(sizes, grown, strict=True):
            gp.add_with_gradient(points[n - 1])

    def refit() -> None:
        for n in sizes:
            known, x = points[: n - 1], points[n - 1]
            factor = cho_factor(matern(known, known) + NOISE**2 * np.eye(n - 1), lower=True)
            gradient_of(cho_solve(factor, matern(known, x[None])[:, 0]), x, known)

    yield Case("every 128th of 2048 contacts, gradient", append, refit, "scipy, refit", target=70, repeats=5)

    lowers = []
    for n in sizes:
        known = points[: n - 1]
        covariance = matern(known, known) + NOISE**2 * np.eye(n - 1)
        lowers.append(np.asfortranarray(np.linalg.cholesky(covariance)))

    def incremental() -> None:
        for n, lower in zip(sizes, lowers, strict=True):
            known, x = points[: n - 1], points[n - 1]
            row = solve_triangular(lower, matern(known, x[None])[:, 0], lower=True, check_finite=False)
            weights = solve_triangular(lower, row, lower=True, trans=1, check_finite=False)
            gradient_of(weights, x, known)

    yield Case("every 128th of 2048 contacts, gradient", append, incremental, "scipy, two substitutions", repeats=5)

    def whole() -> None:
        gp = GaussianProcess("matern32", length_scale=LENGTH, noise=NOISE)
        gp.reserve(len(points))
        for point in points:
            gp.add_with_gradient(point)

    # every contact reads the factor once: n³/6 numbers in all
    factor = np.ones(len(points) * (len(points) + 1) // 2)
    reads = len(points) ** 3 / 6 / len(factor)

    def read() -> None:
        for _ in range(int(reads)):
            factor.sum()

    yield Case(
        "2048 contacts one by one, gradient at each",
        whole,
        limit=read,
        limit_name="reading the factor",
        repeats=5,
    )


@benchmark
def exploration() -> Iterator[Case]:
    mesh = bumpy_sphere()
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32)
    closest = ClosestPoints(vertices, faces)
    near = np.random.default_rng(0).uniform(-0.5, 0.5, (20_000, 3))
    yield Case(
        "closest point, 20 k faces, 20 k points",
        lambda: closest(near),
        lambda: pcu.closest_points_on_mesh(near, vertices, faces),
        "point-cloud-utils",
        repeats=5,
    )
    one = near[:1]
    yield Case(
        "closest point, 20 k faces, one point",
        lambda: closest.of_one((0.3, 0.2, 0.1)),
        lambda: pcu.closest_points_on_mesh(one, vertices, faces),
        "point-cloud-utils",
        target=100,
    )
    yield Case("trajectory of 2048 contacts, 20 k faces", lambda: simulate_touches(mesh, 2048), repeats=3)
    yield Case(
        "trajectory of 2048 contacts, finger of 2 %", lambda: simulate_touches(mesh, finger_radius=0.02), repeats=3
    )
