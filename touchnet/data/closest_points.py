"""Closest points on a triangle mesh, through the tree in csrc/closest_point.h."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchnet.ops._ext import _C

Vector = tuple[float, float, float]


class ClosestPoints:
    """Closest points on a triangle mesh: vertices (V, 3), faces (F, 3). The tree over the triangles is built once."""

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        faces = np.ascontiguousarray(faces, dtype=np.int64)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise ValueError(f"vertices should have shape (V, 3), got {vertices.shape}")
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise ValueError(f"faces should have shape (F, 3) with F ≥ 1, got {faces.shape}")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise ValueError(f"faces should index the {len(vertices)} vertices, got {faces.min()} to {faces.max()}")
        if not np.isfinite(vertices).all():
            raise ValueError("vertices should be finite")
        self._tree = _C.TriangleTree(vertices.ctypes.data, faces.ctypes.data, len(faces))
        self._one = np.zeros(3), np.zeros(3), np.zeros(1, dtype=np.int64), np.zeros(1)
        self._addresses = tuple(array.ctypes.data for array in self._one)

    def __call__(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """points (M, 3) -> closest points (M, 3), their faces (M,), distances (M,)."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"points should have shape (M, 3), got {points.shape}")
        if not np.isfinite(points).all():
            raise ValueError("points should be finite")
        closest, distance = np.empty_like(points), np.empty(len(points))
        face = np.empty(len(points), dtype=np.int64)
        self._tree.closest(points.ctypes.data, len(points), closest.ctypes.data, face.ctypes.data, distance.ctypes.data)
        return closest, face, distance

    def of_one(self, point: Vector) -> tuple[Vector, int, float]:
        """The same for one point, in microseconds: no fresh arrays. Not for several threads at once."""
        query, closest, face, distance = self._one
        query[:] = point
        at, found, index, length = self._addresses
        self._tree.closest(at, 1, found, index, length)
        return tuple(closest.tolist()), face.item(), distance.item()
