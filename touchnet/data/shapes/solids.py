"""Simple solids: a few balls, boxes, cylinders, cones and rings grown into each other."""

import math
from typing import NamedTuple

import numpy as np

from touchnet.data.shapes.fields import Array, Field, Solid, ball, box, cylinder


class _Piece(NamedTuple):
    """A primitive in its own axes, and a ball around its origin that it lies in."""

    field: Field
    reach: float


def _primitive(rng: np.random.Generator, size: float) -> _Piece:
    """A ball, box, cylinder, cone or ring whose half extents are about `size`, none less than 0.3 of it."""
    kind = rng.choice(["ball", "box", "cylinder", "cone", "ring"], p=[0.2, 0.35, 0.2, 0.1, 0.15])
    a, b, c = (size * rng.uniform(0.3, 1.0, size=3) ** 0.7).astype(np.float32)
    rounding = 0.6 * min(a, b, c) * rng.random() ** 3

    if kind == "ball":
        return _Piece(ball((0, 0, 0), (a, b, c))[0], max(a, b, c))
    if kind == "box":
        return _Piece(box((0, 0, 0), (a, b, c), rounding)[0], math.hypot(a, b, c))
    if kind == "cylinder":
        return _Piece(cylinder((0, 0, 0), 1, a, b, rounding)[0], math.hypot(a, b))
    if kind == "cone":
        top = a * rng.uniform(0.0, 0.6)

        def cone(x: Array, y: Array, z: Array) -> Array:
            radius = a + (top - a) * (y / b + 1) / 2
            return np.minimum(radius - np.sqrt(x * x + z * z), b - np.abs(y))

        return _Piece(cone, math.hypot(a, b))
    tube = max(0.25 * a, 0.2 * size)

    def ring(x: Array, y: Array, z: Array) -> Array:
        return tube - np.sqrt((np.sqrt(x * x + z * z) - a) ** 2 + y * y)

    return _Piece(ring, a + tube)


def simple_solid(rng: np.random.Generator, resolution: int) -> Solid:
    """Up to four primitives grown into each other, turned at random or along the axes; some with a hole or a notch."""
    count = rng.choice([1, 2, 3, 4], p=[0.35, 0.3, 0.2, 0.15])
    upright = rng.random() < 0.6
    placed: list[tuple[Field, np.ndarray, float]] = []
    for n in range(count):
        size = 0.5 if n == 0 else rng.uniform(0.25, 0.5)
        piece = _primitive(rng, size)
        centre = np.zeros(3)
        if n:
            _, near, reach = placed[rng.integers(n)]
            away = rng.normal(size=3)
            centre = near + away / np.linalg.norm(away) * rng.uniform(0.3, 0.8) * reach
        placed.append((_turned(piece.field, centre, _turn(rng, upright)), centre, piece.reach))
    low = np.min([centre - reach for _, centre, reach in placed], axis=0)
    high = np.max([centre + reach for _, centre, reach in placed], axis=0)
    solid = Solid(low - 0.02, high + 0.02, resolution)
    blend = 0.05 * rng.random() if rng.random() < 0.5 else 0.0
    for field, centre, reach in placed:
        solid.add(field, centre - reach, centre + reach, blend=blend)
    if rng.random() < 0.3:
        piece = _primitive(rng, rng.uniform(0.12, 0.25))
        away = rng.normal(size=3)
        centre = away / np.linalg.norm(away) * rng.uniform(0.0, 0.6) * placed[0][2]
        solid.cut(_turned(piece.field, centre, _turn(rng, upright)), centre - piece.reach, centre + piece.reach)
    return solid


def _turn(rng: np.random.Generator, upright: bool) -> np.ndarray:
    """A random rotation, or one that exchanges axes."""
    if not upright:
        return np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.eye(3)[rng.permutation(3)]


def _turned(field: Field, centre: np.ndarray, turn: np.ndarray) -> Field:
    """The field moved to `centre`, its axes being the rows of `turn`."""
    rows, (cx, cy, cz) = turn.astype(np.float32), centre.astype(np.float32)

    def moved(x: Array, y: Array, z: Array) -> Array:
        x, y, z = x - cx, y - cy, z - cz
        return field(*(row[0] * x + row[1] * y + row[2] * z for row in rows))

    return moved
