"""Where a stroke starts, and which way it goes."""

import logging
import math

import numpy as np
from numpy.typing import NDArray

from touchnet.data.exploration.record import Record
from touchnet.data.exploration.vectors import Contact, Vector, in_plane, random_tangent
from touchnet.data.gp import _KERNELS, _LANES, GaussianProcess
from touchnet.ops._ext import _C

_log = logging.getLogger(__name__)


class UpTheVariance:
    """Steers along the tangential part of the variance gradient; at random where that vanishes."""

    def __init__(self, length_scale: float, rng: np.random.Generator) -> None:
        self.length_scale, self.rng = length_scale, rng

    def begin(self) -> None:
        pass

    def __call__(self, record: Record, contact: Contact, variance: float) -> Vector:
        slope = tuple(record.gradient().tolist())
        # The gradient before the contact scales with the variance, so the threshold holds for any noise.
        smallest = 1e-6 * variance / self.length_scale
        direction = in_plane(slope, contact[1], smallest)
        if direction is None:
            _log.debug("no tangential gradient at %s: random direction", contact[0])
            return random_tangent(contact[1], self.rng)
        return direction


class Wander:
    """Steers straight on, turned at each step by a random angle of 0.3 rad standard deviation."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.begin()

    def begin(self) -> None:
        self.heading: Vector | None = None

    def __call__(self, record: Record, contact: Contact, variance: float) -> Vector:
        normal = contact[1]
        ahead = None if self.heading is None else in_plane(self.heading, normal)
        if ahead is None:
            ahead = random_tangent(normal, self.rng)
        turn = 0.3 * float(self.rng.standard_normal())
        aside = np.cross(normal, ahead).tolist()
        self.heading = tuple(math.cos(turn) * a + math.sin(turn) * b for a, b in zip(ahead, aside, strict=True))
        return self.heading


class Starts:
    """Where the next stroke starts: a random candidate first, then the one of highest variance (or anywhere)."""

    def __init__(
        self,
        gp: GaussianProcess,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
        n: int,
        *,
        anywhere: bool = False,
    ) -> None:
        order = _along_curve(points)  # a group's candidates lie together, so their variances fall together
        self.gp, self.n, self.anywhere = gp, n, anywhere
        self.points, self.normals = points[order], normals[order]
        self.groups = -(-len(points) // _LANES)
        self.padded = np.repeat(self.points[-1:], self.groups * _LANES, axis=0)
        self.padded[: len(points)] = self.points
        self.variance = np.ones(self.groups * _LANES)
        self.solved = np.empty((self.groups, n, _LANES))
        self.known = np.zeros(self.groups, dtype=np.uintp)
        self.jitter = gp.jitter

    def next(self, rng: np.random.Generator) -> tuple[Contact, float]:
        """A contact, and the highest variance of the candidates (1 where it is not looked for)."""
        gp = self.gp
        if self.anywhere or len(gp) == 0:
            index, highest = int(rng.integers(len(self.points))), 1.0
        else:
            if gp.jitter != self.jitter:  # the factor was built anew
                self.jitter = gp.jitter
                self.variance[:], self.known[:] = 1.0, 0
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
        return (tuple(self.points[index].tolist()), tuple(self.normals[index].tolist())), highest


def _along_curve(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order (n,) of points (n, 3) along a Morton curve through their box."""
    side = max(float(np.ptp(points, axis=0).max()), 1e-300)
    cell = ((points - points.min(0)) / side * 1023).astype(np.int64)
    key = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")
