"""Touch exploration of a closed mesh under a Gaussian process (paper section 4.2, eq. 8).

A finger slides from contact to contact: along the gradient of the posterior variance in the tangent plane, one step,
back to the surface. A stroke ends where little is left to learn; the next starts where the variance is highest.
"""

import math
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from touchnet.data.gp import _KERNELS, _LANES, GaussianProcess, KernelName
from touchnet.ops._ext import _C

__all__ = ["ClosestPoints", "Touches", "simulate_touches"]


class Touches(NamedTuple):
    """Contacts in order of touch: points (n, 3) and outward unit normals (n, 3) in the mesh's frame, the number of the
    stroke each belongs to (n,) int64, counted from 0, and the variance (n,) of the Gaussian process at each just
    before it was touched (prior 1)."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    strokes: NDArray[np.int64]
    variance: NDArray[np.float64]


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
        self._addresses = [array.ctypes.data for array in self._one]

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

    def of_one(self, point: tuple[float, float, float]) -> tuple[tuple[float, float, float], int, float]:
        """The same for one point, without the cost of three fresh arrays: a step of the finger takes microseconds."""
        query, closest, face, distance = self._one
        query[:] = point
        address = self._addresses
        self._tree.closest(address[0], 1, address[1], address[2], address[3])
        return tuple(closest.tolist()), int(face[0]), float(distance[0])


def simulate_touches(
    mesh: trimesh.Trimesh,
    n: int = 2048,
    *,
    seed: int = 0,
    step: float = 0.02,
    kernel: KernelName = "matern32",
    length_scale: float = 0.15,
    noise: float = 1e-3,
    candidates: int = 2048,
    stop: float = 0.3,
    stroke_length: int = 32,
) -> Touches:
    """n contacts of a finger that explores the closed, outward-wound mesh; the same seed gives the same bytes.

    Lengths are relative to the longest side of the mesh's bounding box.

    Args:
        mesh: closed triangle mesh, any number of components.
        n: number of contacts.
        seed: of the starting point and of every other random choice.
        step: distance of consecutive contacts of a stroke.
        kernel, length_scale, noise: of the Gaussian process (noise is a standard deviation).
        candidates: surface points among which a new stroke's start is chosen.
        stop: a stroke ends when the variance found at its contacts falls below this share of what an undisturbed
            stroke finds (or of the highest variance on the surface, once that is lower).
        stroke_length: most contacts of a stroke.

    Raises:
        TypeError: mesh is not a trimesh.Trimesh.
        ValueError: an argument is out of range, or the mesh has no face with an area.
    """
    surface = _Surface(mesh)
    rng = np.random.default_rng(seed)
    gp = GaussianProcess(kernel, length_scale=length_scale, noise=noise)
    gp.reserve(n)
    starts = _Starts(gp, surface.sample(candidates, rng), n)
    free = _free_variance(kernel, length_scale, noise, step)

    points, normals = np.empty((n, 3)), np.empty((n, 3))
    strokes, variances = np.empty(n, dtype=np.int64), np.empty(n)
    count, stroke = 0, -1
    while count < n:
        stroke += 1
        contact, face, highest = starts.next(rng)
        low = stop * min(free, highest)
        length = quiet = 0
        while count < n:
            normal = surface.normals[face]
            variance, gradient = gp.add_with_gradient(contact)
            points[count], normals[count], strokes[count], variances[count] = contact, normal, stroke, variance
            count += 1
            length += 1
            quiet = quiet + 1 if variance < low else 0
            if quiet >= 4 or length >= stroke_length:
                break
            direction = _tangent(tuple(gradient.tolist()), normal, length_scale, variance, rng)
            following = surface.slide(contact, normal, direction, step)
            if following is None:
                break
            contact, face = following
    return Touches(surface.to_mesh(points), normals, strokes, variances)


Vector = tuple[float, float, float]


class _Surface:
    """The mesh with its longest side 1 and its box centred, as the exploration sees it."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        if not isinstance(mesh, trimesh.Trimesh):
            raise TypeError(f"mesh should be a trimesh.Trimesh, got {type(mesh).__name__}")
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        faces = np.asarray(mesh.faces, dtype=np.int64)
        if not len(faces) or not np.isfinite(vertices[faces]).all():
            raise ValueError("mesh should have faces with finite corners")
        used = vertices[faces.ravel()]
        low, high = used.min(0), used.max(0)
        self.centre, self.scale = (low + high) / 2, float((high - low).max())
        if not self.scale > 0:
            raise ValueError("mesh should have an extent, got a single point")
        self.corners = ((vertices - self.centre) / self.scale)[faces]
        cross = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        length = np.linalg.norm(cross, axis=1)
        solid = length > 0
        if not solid.any():
            raise ValueError("mesh should have a face with an area")
        self.corners, self.areas = self.corners[solid], length[solid] / 2
        self.face_normals = cross[solid] / length[solid, None]
        self.normals = [tuple(row) for row in self.face_normals.tolist()]
        self.closest = ClosestPoints(self.corners.reshape(-1, 3), np.arange(3 * len(self.corners)).reshape(-1, 3))

    def to_mesh(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return points * self.scale + self.centre

    def sample(self, n: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """n area-uniform points (n, 3) and their faces (n,), neighbours in space kept near each other in order."""
        cumulative = np.cumsum(self.areas)
        face = np.searchsorted(cumulative, rng.random(n) * cumulative[-1], side="right").clip(max=len(self.areas) - 1)
        u, v = rng.random((2, n))
        over = u + v > 1
        u[over], v[over] = 1 - u[over], 1 - v[over]
        a, b, c = self.corners[face].transpose(1, 0, 2)
        points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
        order = _along_curve(points)
        return points[order], face[order]

    def slide(self, contact: Vector, normal: Vector, direction: Vector, step: float) -> tuple[Vector, int] | None:
        """The contact one step on, or None where the finger makes no headway. At a convex edge the step off the face
        falls back onto the edge; there the finger goes round it: the step is bent towards the inside."""
        for angle in (0.0, math.pi / 4, math.pi / 2):
            along, into = step * math.cos(angle), step * math.sin(angle)
            target = tuple(p + along * d - into * m for p, d, m in zip(contact, direction, normal, strict=True))
            found, face, _ = self.closest.of_one(target)
            if math.dist(found, contact) > 0.5 * step:
                return found, face
        return None


def _tangent(
    gradient: Vector, normal: Vector, length_scale: float, variance: float, rng: np.random.Generator
) -> Vector:
    """Unit vector along the gradient's part in the tangent plane; a random tangent where that part vanishes."""
    along = sum(g * m for g, m in zip(gradient, normal, strict=True))
    tangent = [g - along * m for g, m in zip(gradient, normal, strict=True)]
    size = math.hypot(*tangent)
    if size * length_scale <= 1e-6 * variance:
        while size <= 1e-3:
            random = rng.standard_normal(3).tolist()
            along = sum(g * m for g, m in zip(random, normal, strict=True))
            tangent = [g - along * m for g, m in zip(random, normal, strict=True)]
            size = math.hypot(*tangent)
    return (tangent[0] / size, tangent[1] / size, tangent[2] / size)


class _Starts:
    """Where the next stroke starts: a random candidate first, then the one of highest variance."""

    def __init__(self, gp: GaussianProcess, candidates: tuple[NDArray[np.float64], NDArray[np.int64]], n: int) -> None:
        self.gp, self.n = gp, n
        self.points, self.faces = candidates
        self.groups = -(-len(self.points) // _LANES)
        self.padded = np.repeat(self.points[-1:], self.groups * _LANES, axis=0)
        self.padded[: len(self.points)] = self.points
        self.variance = np.ones(self.groups * _LANES)
        self.solved = np.empty((self.groups, n, _LANES))
        self.known = np.zeros(self.groups, dtype=np.uint64)

    def next(self, rng: np.random.Generator) -> tuple[Vector, int, float]:
        gp = self.gp
        if len(gp) == 0:
            index = int(rng.integers(len(self.points)))
        else:
            index = _C.gp_highest(
                _KERNELS[gp.kernel],
                gp.length_scale,
                gp._points.ctypes.data,
                gp._factor.ctypes.data,
                len(gp),
                self.padded.ctypes.data,
                self.groups,
                self.n,
                self.solved.ctypes.data,
                self.variance.ctypes.data,
                self.known.ctypes.data,
            )
        highest = float(self.variance[index])
        index = min(index, len(self.points) - 1)
        return tuple(self.points[index].tolist()), int(self.faces[index]), highest


def _free_variance(kernel: KernelName, length_scale: float, noise: float, step: float) -> float:
    """The variance that a straight stroke finds at its next contact when nothing else was touched."""
    gp = GaussianProcess(kernel, length_scale=length_scale, noise=noise)
    line = np.arange(17)[:, None] * [step, 0.0, 0.0]
    gp.add(line[:-1])
    return float(gp.variance(line[-1:])[0])


def _along_curve(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order (n,) of points (n, 3) along a Morton curve through their box."""
    low = points.min(0)
    cell = ((points - low) / max(float(np.ptp(points, axis=0).max()), 1e-300) * 1023).astype(np.int64)
    key = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")
