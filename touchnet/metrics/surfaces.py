"""Questions to a mesh: whether it is closed, what lies inside, how far away it is, points spread over it."""

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from touchnet.data.closest_points import ClosestPoints
from touchnet.data.watertight import winding_number


def is_closed(faces: ArrayLike) -> bool:
    """Whether every edge lies in exactly two faces that run along it in opposite directions.

    Args:
        faces: (F, 3) integer indices of vertices. No face at all counts as closed.
    """
    faces = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    if len(faces) == 0:
        return True
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    base = faces.max() + 1
    there, back = np.sort(start * base + end), np.sort(end * base + start)
    return bool((start != end).all() and (np.diff(there) > 0).all() and np.array_equal(there, back))


def inside_mesh(points: ArrayLike, mesh: trimesh.Trimesh) -> NDArray[np.bool_]:
    """Which points (N, 3) lie inside a mesh: generalised winding number > 0.5. Meaningful for open meshes too."""
    points = checked_points(points)
    if len(points) == 0 or len(mesh.faces) == 0:
        return np.zeros(len(points), dtype=bool)
    return winding_number(mesh.vertices, mesh.faces, points) > 0.5


def point_to_mesh(points: ArrayLike, mesh: trimesh.Trimesh) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Exact distances from points to the surface of a mesh.

    Args:
        points: (N, 3), finite.
        mesh: with at least one face.

    Returns:
        distance (N,) and the index of the closest face (N,).
    """
    points = checked_points(points)
    if len(mesh.faces) == 0:
        raise ValueError("mesh must have at least one face, got none")
    _, face, distance = ClosestPoints(mesh.vertices, mesh.faces)(points)
    return distance, face


def sample_surface(
    mesh: trimesh.Trimesh, count: int, *, generator: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points spread over the surface evenly by area, stratified: each of `count` equal shares of area gets one.

    Returns:
        points (count, 3) in the order of the faces, and the face of each (count,).

    Raises:
        ValueError: the mesh has no area.
    """
    triangles = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]  # (F, 3, 3)
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    total = np.cumsum(area)
    if len(area) == 0 or not (np.isfinite(total[-1]) and total[-1] > 0):
        raise ValueError("mesh must have a finite surface area above 0")
    at = (np.arange(count) + generator.random(count)) * (total[-1] / count)
    face = np.minimum(np.searchsorted(total, at, side="right"), len(area) - 1)
    root, split = np.sqrt(generator.random((count, 1))), generator.random((count, 1))
    corners = triangles[face]
    points = (1 - root) * corners[:, 0] + root * (1 - split) * corners[:, 1] + root * split * corners[:, 2]
    return points, face


def face_normals_of(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """(F, 3) unit normals; zero for faces without area, which trimesh would drop."""
    triangles = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1)


def checked_points(points: ArrayLike) -> NDArray[np.float64]:
    array = np.ascontiguousarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"points must have shape (N, 3), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError("points must be finite, got NaN or infinity")
    return array
