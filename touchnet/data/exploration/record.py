"""Contacts as they are made and reported."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchnet.data.exploration.surface import Surface
from touchnet.data.exploration.vectors import Contact, Vector, tilted
from touchnet.data.gp import GaussianProcess


class Touches(NamedTuple):
    """Contacts in order of touch.

    points (n, 3) and outward unit normals (n, 3) in the mesh's frame; strokes (n,) int64, the number of the stroke each
    contact belongs to, counted from 0; variance (n,) of the Gaussian process at each contact just before it was touched
    (1: nothing known there).
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    strokes: NDArray[np.int64]
    variance: NDArray[np.float64]


class Record:
    """The contacts made so far, as they are reported, and the Gaussian process that knows them."""

    position_noise = normal_noise = dropout = 0.0

    def __init__(self, n: int, gp: GaussianProcess, rng: np.random.Generator) -> None:
        self.gp, self.rng, self.count = gp, rng, 0
        self._missed: Vector | None = None
        gp.reserve(n)
        self._points, self._normals = np.empty((n, 3)), np.empty((n, 3))
        self._strokes, self._variance = np.empty(n, dtype=np.int64), np.empty(n)

    def touch(self, contact: Contact, stroke: int) -> float:
        """The variance before the contact."""
        point, normal = contact
        self._missed = point if self.dropout and self.rng.random() < self.dropout else None
        if self._missed is not None:
            return float(self.gp.variance(point)[0])
        if self.position_noise:
            point = np.array(point) + self.position_noise * self.rng.standard_normal(3)
        if self.normal_noise:
            normal = tilted(np.array(normal), self.normal_noise * self.rng.standard_normal(2))
        variance = self.gp.add_one(point)
        i = self.count
        self._points[i], self._normals[i], self._strokes[i], self._variance[i] = point, normal, stroke, variance
        self.count = i + 1
        return variance

    def gradient(self) -> NDArray[np.float64]:
        """Gradient (3,) of the variance at the contact just made, as it was before it."""
        return self.gp.last_gradient() if self._missed is None else self.gp.variance_gradient(self._missed)[0]

    def touches(self, surface: Surface) -> Touches:
        i = self.count
        return Touches(surface.to_mesh(self._points[:i]), self._normals[:i], self._strokes[:i], self._variance[:i])
