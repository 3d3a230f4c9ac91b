"""Surface samples and labelled query points of a closed mesh."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from touchnet.data.watertight import edge_report, signed_volume, winding_number


class SurfaceSamples(NamedTuple):
    """points (n, 3) and the outward unit normals (n, 3) of their faces."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]


class LabelledPoints(NamedTuple):
    """points (n, 3) float16 and inside (n,) bool: the label of the rounded position."""

    points: NDArray[np.float16]
    inside: NDArray[np.bool_]


def sample_surface(mesh: trimesh.Trimesh, n: int, rng: np.random.Generator) -> SurfaceSamples:
    """n points spread uniformly over the area of the mesh (exactly n)."""
    _check_count("n", n)
    corners = np.asarray(mesh.vertices, dtype=np.float64)[np.asarray(mesh.faces)]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice_area = np.linalg.norm(cross, axis=1)
    total = np.cumsum(twice_area)
    if not len(total) or not 0 < total[-1] < np.inf:
        raise ValueError(f"mesh should have faces with an area, got {len(total)} faces")
    face = np.searchsorted(total, rng.random(n) * total[-1], side="right").clip(max=len(total) - 1)
    # Uniform on a triangle: Osada et al., "Shape distributions", 2002, eq. 1.
    r, s = np.sqrt(rng.random((n, 1))), rng.random((n, 1))
    a, b, c = corners[face].transpose(1, 0, 2)
    points = (1 - r) * a + r * (1 - s) * b + r * s * c
    return SurfaceSamples(points, cross[face] / np.maximum(twice_area[face], 1e-300)[:, None])


def contains(mesh: trimesh.Trimesh, points: ArrayLike) -> NDArray[np.bool_]:
    """Which of the points (M, 3) lie inside a closed mesh: winding number ≥ 0.5.

    A mesh wound inwards is labelled as if it were wound outwards, with a warning.

    Raises:
        ValueError: the mesh is open or its faces do not wind one way (`make_watertight` closes it).
    """
    faces = np.asarray(mesh.faces)
    if not len(faces):
        raise ValueError("mesh should be closed to tell inside from outside, got no faces")
    open_edges, consistent = edge_report(faces)
    if open_edges or not consistent:
        wrong = f"{open_edges} open edges" if open_edges else "faces that wind both ways"
        raise ValueError(f"mesh should be closed to tell inside from outside, got {wrong}: make_watertight closes it")
    values = winding_number(mesh.vertices, faces, points)
    if signed_volume(np.asarray(mesh.vertices, dtype=np.float64), faces) < 0:
        warnings.warn(f"{len(faces)} faces wind inwards; labelled as if they were flipped", stacklevel=2)
        values = -values
    return values >= 0.5


def label_near(
    mesh: trimesh.Trimesh, n: int, rng: np.random.Generator, *, sigmas: Sequence[float] = (0.01, 0.05)
) -> LabelledPoints:
    """n surface points moved by Gaussians of standard deviation sigmas[k] (in units of the mesh), and their labels.

    The points are split evenly, in order, over the sigmas (a remainder goes to the first ones).
    """
    if not sigmas or not all(0 < sigma < np.inf for sigma in sigmas):
        raise ValueError(f"sigmas should be positive numbers, got {tuple(sigmas)}")
    surface = sample_surface(mesh, n, rng).points
    spread = np.concatenate(
        [np.full(len(part), sigma) for part, sigma in zip(split(n, len(sigmas)), sigmas, strict=True)]
    )
    return _label(mesh, surface + spread[:, None] * rng.standard_normal((n, 3)))


def label_box(mesh: trimesh.Trimesh, n: int, rng: np.random.Generator) -> LabelledPoints:
    """n points uniform in the mesh's bounding box, and their labels."""
    _check_count("n", n)
    low, high = mesh.bounds
    return _label(mesh, low + rng.random((n, 3)) * (high - low))


def split(n: int, parts: int) -> list[range]:
    """range(n) cut into consecutive parts whose sizes differ by at most one, the larger ones first."""
    ends = np.cumsum([n // parts + (k < n % parts) for k in range(parts)])
    return [range(int(end) - n // parts - (k < n % parts), int(end)) for k, end in enumerate(ends)]


def _label(mesh: trimesh.Trimesh, points: NDArray[np.float64]) -> LabelledPoints:
    # Stored positions are what training sees: near a wall rounding first and labelling then is what keeps labels right.
    rounded = points.astype(np.float16)
    return LabelledPoints(rounded, contains(mesh, rounded.astype(np.float64)))


def _check_count(name: str, n: int) -> None:
    if n < 0:
        raise ValueError(f"{name} should be ≥ 0, got {n}")
