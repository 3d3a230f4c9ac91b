"""Places on a surface, and which of their touches would tell most about it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from touchnet import ops
from touchnet.contacts import thin
from touchnet.data.gp import _KERNELS, _LANES, GaussianProcess
from touchnet.frames import FILL, Frame
from touchnet.metrics import sample_surface
from touchnet.ops._ext import _C
from touchnet.reconstruction import Reconstruction

CANDIDATES = 1024  # places on the surface among which the next touches are chosen
LENGTH_SCALE = 0.15  # how far one touch tells, as a share of the longest side of the contacts
NOISE = 0.05  # standard deviation of a contact against the prior's 1: a touch never tells everything
MOST_KNOWN = 4096  # places in the Gaussian process: with more it starts anew with half as many, spread evenly
LATTICE = 48  # vertices along the cube at which the occupancy is looked up
POSSIBLE = 0.25  # occupancy from which on the object may well be there
DEPTH, STEPS = 0.15, 24  # how far a finger is followed, as a share of the longest side, and in how many steps


class Suggestions(NamedTuple):
    """Places to touch, the best first, in the frame and unit of the contacts.

    Attributes:
        positions: (k,3) where the finger should meet the surface.
        directions: (k,3) unit vectors along which it should come: from outside, against the surface's outward normal.
        gains: (k,) in 0..1, the share of what is not known of the whole surface that this touch is expected to tell,
            after those before it.
        expected_errors: (k,) how far the surface may lie from the position, as in the mesh's "expected_error".
        clearances: (k,) how far back from the position, against the direction, the path is free of the object as it is
            known; at most the longest side of the contacts. Fingers had best set out there: the object may be larger.
    """

    positions: NDArray[np.float64]
    directions: NDArray[np.float64]
    gains: NDArray[np.float64]
    expected_errors: NDArray[np.float64]
    clearances: NDArray[np.float64]


class Process:
    """The Gaussian process of a session, in coordinates where the contacts' longest side was 1 when it began."""

    def __init__(self, frame: Frame) -> None:
        self.frame, self.side = frame, FILL * frame.scale
        self.gp = GaussianProcess("matern32", length_scale=LENGTH_SCALE, noise=NOISE)
        self.seen = 0  # places that it was told of

    def has_room_for(self, points: NDArray[np.float64]) -> bool:
        """Whether it can be told of all the places (N,3), of which it knows the first."""
        return len(self.gp) + len(points) - self.seen <= MOST_KNOWN

    def to_unit(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return (points - self.frame.centre) / self.side

    def learn(self, points: NDArray[np.float64]) -> None:
        """Adds those of the places (N,3) that it was not told of yet; at the start, of very many an even choice."""
        new = points[self.seen :]
        if len(self.gp) + len(new) > MOST_KNOWN:
            new = new[thin(new, MOST_KNOWN // 2)]
        self.gp.add(self.to_unit(new))
        self.seen = len(points)


class Places:
    """Candidates for a touch: where fingers would meet the surface, what error is expected there, and the covariance of
    these errors, kept up with the contacts.

    Fingers set out from the surface where the occupancy is still low, which includes parts that the network only
    suspects, and go on against its normal until the occupancy is that of a surface, or highest.
    """

    def __init__(
        self,
        fit: Reconstruction,
        tree: cKDTree,
        level: float,
        process: Process,
        can_reach: Callable[[Places], NDArray[np.bool_]],
    ) -> None:
        mesh, self.frame = fit.mesh, fit.mesh.metadata["frame"]
        self.side, self.cell = FILL * self.frame.scale, 2 * self.frame.scale / (LATTICE - 1)
        axis = np.linspace(-1, 1, LATTICE)
        lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        self.volume = fit.field(self.frame.from_cube(lattice)).reshape(LATTICE, LATTICE, LATTICE)
        possible = min(POSSIBLE, level)
        # A lattice that misses thin parts altogether may nowhere reach the level; the mesh has them.
        around = mesh
        if self.volume.max() >= possible:
            vertices, faces = ops.marching_cubes(torch.from_numpy(self.volume), possible)
            around = trimesh.Trimesh(self.frame.from_cube(vertices.numpy()), faces.numpy(), process=False)
        # Even by area, so that a sum over candidates is an integral over the surface.
        begin, face = sample_surface(around, CANDIDATES, generator=np.random.default_rng(0))
        normals = around.face_normals[face]
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)

        depth = np.linspace(0, DEPTH * self.side, STEPS)
        along = self.occupancy(begin[:, None] - depth[:, None] * self.normals[:, None])
        met = along >= level
        stop = np.where(met.any(axis=1), met.argmax(axis=1), along.argmax(axis=1))
        self.positions = begin - depth[stop][:, None] * self.normals
        self.chance = np.minimum(1.0, along.max(axis=1) / level)  # of meeting anything
        # From two cells away on, so that the blur of the surface itself does not count.
        back = np.linspace(2 * self.cell, self.side, 2 * STEPS)
        blocked = self.occupancy(self.positions[:, None] + back[:, None] * self.normals[:, None]) >= level
        blocked = np.concatenate([blocked, np.ones((CANDIDATES, 1), dtype=bool)], axis=1)
        self.clearances = np.concatenate([[0.0], back])[blocked.argmax(axis=1)]
        distance, nearest = tree.query(self.positions)
        self.errors = mesh.vertex_attributes["expected_error"][nearest] + distance
        self.reachable = can_reach(self)
        self.unit = np.ascontiguousarray(process.to_unit(self.positions))
        self.known = 0
        self.solved = np.empty((CANDIDATES // _LANES, 0, _LANES))  # L⁻¹ k(X, candidates), as gp_extend keeps it
        self.variance = np.ones(CANDIDATES)
        self.covariance = np.empty((CANDIDATES, CANDIDATES))
        gp, at = process.gp, self.unit.ctypes.data
        out = self.covariance.ctypes.data
        _C.gp_kernel(_KERNELS[gp.kernel], gp.length_scale, at, CANDIDATES, at, CANDIDATES, out)
        self._follow(gp)
        # What the network expects is about what the contacts so far leave open.
        self.weights = self.errors / np.maximum(self.covariance.diagonal(), NOISE**2)

    def occupancy(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The network's occupancy (...) at points (...,3), between the vertices of the lattice; 0 outside of it."""
        at = (self.frame.to_cube(points) + 1) * (0.5 * (LATTICE - 1))
        return map_coordinates(self.volume, np.moveaxis(at, -1, 0), order=1, mode="constant")

    def _follow(self, gp: GaussianProcess) -> None:
        """Conditions the covariance on the contacts that are new."""
        known, n = self.known, len(gp)
        if n == known:
            return
        if n > self.solved.shape[1]:
            grown = np.empty((CANDIDATES // _LANES, n + n // 4, _LANES))
            grown[:, :known] = self.solved[:, :known]
            self.solved = grown
        _C.gp_extend(
            _KERNELS[gp.kernel],
            gp.length_scale,
            gp._points.ctypes.data,
            gp._factor.ctypes.data,
            known,
            n,
            self.unit.ctypes.data,
            CANDIDATES // _LANES,
            self.solved.shape[1],
            self.solved.ctypes.data,
            self.variance.ctypes.data,
        )
        new = self.solved[:, known:n].transpose(1, 0, 2).reshape(n - known, CANDIDATES)
        self.covariance -= new.T @ new
        self.known = n

    def best(self, process: Process, k: int) -> Suggestions:
        self._follow(process.gp)
        if not self.reachable.any():
            raise ValueError(
                "no place on the surface is reachable: approach, cone, floor, standoff or reachable are too strict"
            )
        covariance = self.covariance
        variance = covariance.diagonal().copy()
        total = float(self.weights @ variance)
        # What touching j would take off the whole is Σ_i w_i C_ij² / (C_jj + noise²). After a touch C loses the product
        # of a row r with itself, and Σ_i w_i C_ij² changes by -2 r_j Σ_i w_i r_i C_ij + r_j² Σ_i w_i r_i².
        square = self.weights @ covariance**2
        taken = np.empty((0, CANDIDATES))
        chosen: list[int] = []
        gains: list[float] = []
        left = self.reachable.copy()
        for _ in range(min(k, int(left.sum()))):
            removed = self.chance * square / (np.maximum(variance, 0) + NOISE**2)
            removed[~left] = -np.inf
            best = int(removed.argmax())
            chosen.append(best)
            gains.append(float(removed[best]) / max(total, 1e-300))
            left[best] = False
            row = (covariance[best] - taken[:, best] @ taken) / np.sqrt(max(variance[best], 0) + NOISE**2)
            weighted = self.weights * row
            square += row**2 * (weighted @ row) - 2 * row * (weighted @ covariance - (taken @ weighted) @ taken)
            variance -= row**2
            taken = np.concatenate([taken, row[None]])
        return Suggestions(
            self.positions[chosen],
            -self.normals[chosen],
            np.clip(gains, 0, 1),
            self.errors[chosen],
            self.clearances[chosen],
        )
