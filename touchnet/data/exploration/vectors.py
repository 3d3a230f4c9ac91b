"""Vectors that come one by one: tuples, which are quicker than arrays of three."""

import math

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
Contact = tuple[Vector, Vector]  # a point of the surface and the outward unit normal there


def in_plane(vector: Vector, normal: Vector, smallest: float = 1e-9) -> Vector | None:
    """Unit vector along the part of a vector across the normal; None where that part is no longer than `smallest`."""
    (x, y, z), (nx, ny, nz) = vector, normal
    along = x * nx + y * ny + z * nz
    x, y, z = x - along * nx, y - along * ny, z - along * nz
    size = math.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size) if size > smallest else None


def random_tangent(normal: Vector, rng: np.random.Generator) -> Vector:
    while True:
        tangent = in_plane(tuple(rng.standard_normal(3).tolist()), normal, 1e-3)
        if tangent is not None:
            return tangent


def tilted(normal: NDArray[np.float64], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """A unit normal tilted by two angles (radians) towards two tangents."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    tilted = normal + np.tan(angles[0]) * first + np.tan(angles[1]) * np.cross(normal, first)
    return tilted / np.linalg.norm(tilted)
