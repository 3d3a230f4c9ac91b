"""The mesh as fingers meet it, and how much of it they have met."""

import math
from collections.abc import Iterator
from functools import cached_property

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from touchnet.data.closest_points import ClosestPoints


class Surface:
    """A mesh as a finger meets it: triangles with an area, in the frame of this package, and closest points on them.

    The tree over the triangles takes longer to build than a trajectory's closest points to find: many trajectories of
    one mesh share a Surface.

    Raises:
        TypeError: mesh is not a trimesh.Trimesh.
        ValueError: the mesh has no face with an area.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        if not isinstance(mesh, trimesh.Trimesh):
            raise TypeError(f"mesh should be a trimesh.Trimesh, got {type(mesh).__name__}")
        faces = np.asarray(mesh.faces, dtype=np.int64)
        corners = np.asarray(mesh.vertices, dtype=np.float64)[faces]
        if not len(faces) or not np.isfinite(corners).all():
            raise ValueError("mesh should have faces with finite corners")
        low, high = corners.min((0, 1)), corners.max((0, 1))
        self.centre, self.scale = (low + high) / 2, float((high - low).max())
        if not self.scale > 0:
            raise ValueError("mesh should have an extent, got a single point")
        corners = (corners - self.centre) / self.scale
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.sqrt((cross**2).sum(1))
        solid = length > 0
        if not solid.any():
            raise ValueError("mesh should have a face with an area")
        self.corners = np.ascontiguousarray(corners[solid])
        self.areas = length[solid] / 2
        self.normals = cross[solid] / length[solid, None]

    @cached_property
    def closest(self) -> ClosestPoints:
        """The tree, built when it is first asked for."""
        return ClosestPoints(*self.triangles())

    def triangles(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Unshared vertices (3 F, 3) and faces (F, 3)."""
        return self.corners.reshape(-1, 3), np.arange(3 * len(self.corners)).reshape(-1, 3)

    def to_mesh(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return points * self.scale + self.centre

    def from_mesh(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return (points - self.centre) / self.scale

    def sample(self, n: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """n area-uniform points (n, 3) and their faces (n,)."""
        cumulative = np.cumsum(self.areas)
        face = np.searchsorted(cumulative, rng.random(n) * cumulative[-1], side="right").clip(max=len(self.areas) - 1)
        u, v = rng.random((2, n))
        over = u + v > 1
        u[over], v[over] = 1 - u[over], 1 - v[over]
        a, b, c = self.corners[face].transpose(1, 0, 2)
        return a + u[:, None] * (b - a) + v[:, None] * (c - a), face

    def contours(self, axis: int, planes: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
        """The polylines (P, 3) in which planes across an axis, at these coordinates, cut the surface."""
        mesh = trimesh.Trimesh(*self.triangles(), process=False)
        mesh.merge_vertices()
        normal = np.eye(3)[axis]
        for plane in planes:
            path = mesh.section(plane_normal=normal, plane_origin=plane * normal)
            if path is not None:
                yield from path.discrete


def coverage(
    mesh: trimesh.Trimesh, points: ArrayLike, *, radius: float, samples: int = 100_000, seed: int = 0
) -> float:
    """Share in [0, 1] of the mesh's surface area that lies within `radius` of one of the points (N, 3).

    The radius is relative to the longest side of the mesh's bounding box. Estimated at area-uniform `samples`.
    """
    if not 0 < radius < math.inf:
        raise ValueError(f"radius should be a positive number, got {radius}")
    if samples < 1:
        raise ValueError(f"samples should be at least 1, got {samples}")
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"points should be finite with shape (N, 3), got shape {points.shape}")
    if not len(points):
        return 0.0
    surface = Surface(mesh)
    at, _ = surface.sample(samples, np.random.default_rng(seed))
    distance, _ = cKDTree(surface.from_mesh(points)).query(at, distance_upper_bound=radius)
    return float(np.isfinite(distance).mean())
