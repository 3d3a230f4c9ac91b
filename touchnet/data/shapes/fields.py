"""What the shapes are made of: fields that are positive inside, and the grid on which they are united into a solid.

A field is a function of coordinate arrays that broadcast; inside it is about the distance to its surface. The functions
that make one return it with the corners of a box outside of which it is negative.
"""

import functools
import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from touchnet.ops import marching_cubes

Array = NDArray[np.float32]
Field = Callable[[Array, Array, Array], Array]
Vector = Sequence[float]


class Solid:
    """A union of parts on a grid over the box low..high, spacing = longest side / resolution."""

    def __init__(self, low: Vector, high: Vector, resolution: int) -> None:
        self.low = np.asarray(low, dtype=np.float64)
        self.spacing = float((np.asarray(high) - self.low).max()) / resolution
        self.shape = np.ceil((np.asarray(high) - self.low) / self.spacing).astype(int) + 1
        self.field = np.full(self.shape, -1, dtype=np.float32)

    def window(self, low: Vector, high: Vector) -> tuple[tuple[slice, ...], list[Array]]:
        """The part of the grid in a box, and its coordinates ready to broadcast."""
        first = np.clip(np.floor((np.asarray(low) - self.low) / self.spacing).astype(int) - 1, 0, self.shape)
        last = np.clip(np.ceil((np.asarray(high) - self.low) / self.spacing).astype(int) + 2, 0, self.shape)
        axes = []
        for axis in range(3):
            x = (self.low[axis] + self.spacing * np.arange(first[axis], last[axis])).astype(np.float32)
            axes.append(x.reshape([-1 if other == axis else 1 for other in range(3)]))
        return tuple(slice(a, b) for a, b in zip(first, last, strict=True)), axes

    def add(self, field: Field, low: Vector, high: Vector, *, blend: float = 0.0) -> None:
        """Union with field ≥ 0, which must be negative outside the box; `blend` rounds the joint (length)."""
        where, axes = self.window(np.asarray(low) - blend, np.asarray(high) + blend)
        self.field[where] = smooth_max(self.field[where], field(*axes), blend)

    def cut(self, field: Field, low: Vector, high: Vector) -> None:
        """Difference with field ≥ 0, which must be negative outside the box."""
        where, axes = self.window(low, high)
        self.field[where] = np.minimum(self.field[where], -field(*axes))

    def mesh(self) -> trimesh.Trimesh:
        high = self.low + self.spacing * (self.shape - 1)
        vertices, faces = marching_cubes(
            torch.from_numpy(self.field).double(), 0.0, box=(tuple(self.low.tolist()), tuple(high.tolist()))
        )
        mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
        parts = mesh.split(only_watertight=False)
        # Parts that the numbers left without contact would float in the air.
        mesh = max(parts, key=lambda part: len(part.faces)) if len(parts) > 1 else mesh
        low, high = mesh.bounds
        return trimesh.Trimesh((mesh.vertices - (low + high) / 2) / (high - low).max(), mesh.faces, process=False)


def smooth_max(a: Array, b: Array, width: float) -> Array:
    if width <= 0:
        return np.maximum(a, b)
    # Quilez' polynomial blend: exact where the two differ by more than the width.
    h = np.maximum(width - np.abs(a - b), 0) / width
    return np.maximum(a, b) + h * h * (width / 4)


def smooth_min(a: Array, b: Array, width: float) -> Array:
    return -smooth_max(-a, -b, width)


def curve(knots: Sequence[tuple[float, float]]) -> Callable[[Array], Array]:
    """A curve through the knots (x, y) without overshoot, constant beyond the ends."""
    x, y = np.array(sorted(knots), dtype=np.float64).T
    keep = np.concatenate([[True], np.diff(x) > 1e-6])
    x, y = x[keep], y[keep]
    through = PchipInterpolator(x, y)
    return lambda at: through(np.clip(at, x[0], x[-1])).astype(np.float32)


def polyline(knots: Sequence[tuple[float, float]]) -> Callable[[Array], Array]:
    x, y = np.array(sorted(knots), dtype=np.float64).T
    return lambda at: np.interp(at, x, y).astype(np.float32)


def capsule(a: Vector, b: Vector, radius: float, end: float | None = None) -> tuple[Field, Vector, Vector]:
    """Segment a-b thickened by `radius`, which changes to `end` along the way."""
    a, b = np.asarray(a, dtype=np.float32), np.asarray(b, dtype=np.float32)
    end = radius if end is None else end
    along = b - a
    length2 = max(float(along @ along), 1e-12)

    def field(x: Array, y: Array, z: Array) -> Array:
        dx, dy, dz = x - a[0], y - a[1], z - a[2]
        t = np.clip((dx * along[0] + dy * along[1] + dz * along[2]) / length2, 0, 1)
        gap = np.sqrt((dx - t * along[0]) ** 2 + (dy - t * along[1]) ** 2 + (dz - t * along[2]) ** 2)
        return radius + t * (end - radius) - gap

    reach = max(radius, end)
    return field, np.minimum(a, b) - reach, np.maximum(a, b) + reach


def tube(points: Sequence[Vector], radius: float | Sequence[float]) -> tuple[Field, Vector, Vector]:
    """Capsules along a polyline, of one radius or of one at each point."""
    radii = np.broadcast_to(radius, len(points)).tolist()
    ends = itertools.pairwise(zip(points, radii, strict=True))
    pieces = [capsule(a, b, start, end) for (a, start), (b, end) in ends]

    def field(x: Array, y: Array, z: Array) -> Array:
        return functools.reduce(np.maximum, [piece[0](x, y, z) for piece in pieces])

    return field, np.min([piece[1] for piece in pieces], axis=0), np.max([piece[2] for piece in pieces], axis=0)


def cylinder(
    centre: Vector, axis: int, radius: float, half: float, rounding: float = 0.0
) -> tuple[Field, Vector, Vector]:
    centre = np.asarray(centre, dtype=np.float32)
    u, v = (k for k in range(3) if k != axis)

    def field(x: Array, y: Array, z: Array) -> Array:
        d = (x - centre[0], y - centre[1], z - centre[2])
        return smooth_min(radius - np.sqrt(d[u] ** 2 + d[v] ** 2), half - np.abs(d[axis]), rounding)

    reach = np.full(3, radius)
    reach[axis] = half
    return field, centre - reach, centre + reach


def box(centre: Vector, half: Vector, rounding: float = 0.0, pitch: float = 0.0) -> tuple[Field, Vector, Vector]:
    """A box with rounded edges, turned by `pitch` about z through its centre."""
    centre, half = np.asarray(centre, dtype=np.float32), np.asarray(half, dtype=np.float32)
    cos, sin = math.cos(pitch), math.sin(pitch)

    def field(x: Array, y: Array, z: Array) -> Array:
        dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
        a, b = cos * dx + sin * dy, cos * dy - sin * dx
        return smooth_min(
            smooth_min(half[0] - np.abs(a), half[1] - np.abs(b), rounding), half[2] - np.abs(dz), rounding
        )

    reach = np.array([abs(cos) * half[0] + abs(sin) * half[1], abs(sin) * half[0] + abs(cos) * half[1], half[2]])
    return field, centre - reach, centre + reach


def ball(centre: Vector, radii: Vector) -> tuple[Field, Vector, Vector]:
    """An ellipsoid."""
    centre, radii = np.asarray(centre, dtype=np.float32), np.asarray(radii, dtype=np.float32)

    def field(x: Array, y: Array, z: Array) -> Array:
        dx, dy, dz = ((at - middle) / radius for at, middle, radius in zip((x, y, z), centre, radii, strict=True))
        return (1 - np.sqrt(dx * dx + dy * dy + dz * dz)) * radii.min()

    return field, centre - radii, centre + radii


def superellipse(x: Array, z: Array, a: Array, b: Array, power: Array | float) -> Array:
    """About the distance to the inside of (|x|/a)^n + (|z|/b)^n = 1."""
    a, b = np.maximum(a, 1e-4), np.maximum(b, 1e-4)
    u, v = np.abs(x) / a, np.abs(z) / b
    norm = (u**power + v**power + 1e-12) ** (1 / power)
    return (1 - norm) * np.minimum(a, b)
