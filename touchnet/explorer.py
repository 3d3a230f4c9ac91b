"""Where to touch next: a session of contacts, the surface they suggest, and the places that would tell most about it.

How a place is chosen, and what that is worth in contacts saved: docs/where_to_touch.md.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from torch import nn

from touchnet import ops
from touchnet.data.gp import _KERNELS, _LANES, GaussianProcess
from touchnet.frames import FILL, Frame
from touchnet.metrics import sample_surface
from touchnet.ops._ext import _C
from touchnet.reconstruction import (
    Reconstruction,
    Up,
    check_contacts,
    pick_device,
    ready_model,
    reconstruct_with_field,
    thin,
)

__all__ = ["Explorer", "Suggestions"]

Reachable = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]

CANDIDATES = 1024  # places on the surface among which the next touches are chosen
LENGTH_SCALE = 0.15  # how far one touch tells, as a share of the longest side of the contacts
NOISE = 0.05  # standard deviation of a contact against the prior's 1: a touch never tells everything
MOST_KNOWN = 4096  # places in the Gaussian process: with more it starts anew with half as many, spread evenly
GROWTH = 1.1  # how far the contacts' longest side may grow before the Gaussian process starts anew
LATTICE = 48  # vertices along the cube at which the occupancy is looked up
POSSIBLE = 0.25  # occupancy from which on the object may well be there
DEPTH, STEPS = 0.15, 24  # how far a finger is followed, as a share of the longest side, and in how many steps
STALE = 1.25  # the surface is fitted again once there are so many times as many contacts as it was fitted to
ASTRAY = 0.03  # ... or one of them lies so far from it, as a share of the longest side


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


class Explorer:
    """A session with a probe: contacts come in, a closed mesh and the next places to touch come out.

    Contacts accumulate; `mesh` is the reconstruction from all of them, computed when asked for and then kept; `next`
    chooses among places on its surface. What is not known of the surface is taken as a Gaussian field: its variance at
    a place is the error the network expects there ("expected_error" of `reconstruct_mesh`), how two places go together
    is the posterior correlation of a Gaussian process that knows the contacts. The place chosen is the one whose touch
    lowers the variance summed over the whole surface most; the field is then conditioned on that touch before the next
    is chosen, which spreads a batch over the object.

    New contacts are put into the Gaussian process at once. The surface is fitted again by `next` only where they
    contradict it or have become a quarter more, so that a few contacts more cost milliseconds.

    Args:
        points, normals: the first contacts, as in `add`.
        up, weights, device, level: as in `reconstruct_mesh`.
        resolution: cells along the cube for `mesh` and the surface that `next` looks at.
        floor: height along `up` of a table: no place less than `standoff` above it is suggested. Needs `up`.
        approach: (3,) direction the finger comes from, such as (0, 0, 1) for a tool that hangs from above z up;
            suggested directions lie within `cone` of it. None: any.
        cone: half angle in degrees, in (0, 180].
        standoff: length of straight path before the contact that has to be free of the object, in the unit of the
            contacts; None: 5 % of their longest side.
        reachable: a function of positions (M,3) and directions (M,3) to bool (M,): where the robot can touch.

    Raises:
        ValueError: options or contacts that do not fit.

    Example:
        >>> explorer = touchnet.Explorer(points, up="z", floor=0.0)
        >>> positions, directions, *_ = explorer.next(4)
        >>> explorer.add(contacts_made_there)
        >>> mesh = explorer.mesh()
    """

    def __init__(
        self,
        points: ArrayLike | None = None,
        normals: ArrayLike | None = None,
        *,
        up: Up = None,
        weights: str | os.PathLike[str] | nn.Module = "default",
        resolution: int = 128,
        device: str | torch.device = "auto",
        level: float = 0.5,
        floor: float | None = None,
        approach: ArrayLike | None = None,
        cone: float = 90.0,
        standoff: float | None = None,
        reachable: Reachable | None = None,
    ) -> None:
        if up not in ("x", "y", "z", None):
            raise ValueError(f'up should be "x", "y", "z" or None, got {up!r}')
        if floor is not None and up is None:
            raise ValueError('floor needs up="x", "y" or "z", the axis along which it is a height')
        if floor is not None and not np.isfinite(floor):
            raise ValueError(f"floor should be a finite height, got {floor}")
        if not 0 < cone <= 180:
            raise ValueError(f"cone should be a half angle in (0, 180] degrees, got {cone}")
        if standoff is not None and not (np.isfinite(standoff) and standoff >= 0):
            raise ValueError(f"standoff should be a length ≥ 0, got {standoff}")
        self.up, self.level, self.resolution = up, level, int(resolution)
        self.floor, self.cone, self.standoff, self.reachable = floor, float(cone), standoff, reachable
        self.approach = None if approach is None else _direction(approach)
        self.device = pick_device(device)
        self.model = ready_model(weights, self.device)
        self._points, self._normals = np.empty((0, 3)), np.empty((0, 3))
        self._visited = np.empty((0, 3))  # contacts and misses, as they came
        self._fit: Reconstruction | None = None
        self._fitted = 0  # how many contacts it knows
        self._afresh = 0  # how many the last fit knew that did not begin with the normals of the one before
        self._gp: _Process | None = None
        self._places: _Places | None = None
        if points is not None:
            self.add(points, normals)
        elif normals is not None:
            raise ValueError("normals without points")

    def __len__(self) -> int:
        return len(self._points)

    @property
    def points(self) -> NDArray[np.float64]:
        """The contacts so far (N,3), in the order they came."""
        return self._points.copy()

    @property
    def normals(self) -> NDArray[np.float64] | None:
        """Their outward unit normals (N,3), zero rows where unknown; None where none is known."""
        return self._normals.copy() if self._normals.any() else None

    def add(self, points: ArrayLike, normals: ArrayLike | None = None) -> None:
        """Adds contacts.

        Args:
            points: (N,3) or (3,), finite, in one frame and unit for the whole session.
            normals: as points, outward directions; None or zero rows where they are not known.

        Raises:
            ValueError: another shape, or values that are not finite; nothing is added then.
        """
        points = np.atleast_2d(np.asarray(points, dtype=np.float64))
        normals = None if normals is None else np.atleast_2d(np.asarray(normals, dtype=np.float64))
        points, normals = check_contacts(points, normals)
        self._points = np.concatenate([self._points, points])
        self._normals = np.concatenate([self._normals, np.zeros_like(points) if normals is None else normals])
        self._visited = np.concatenate([self._visited, points])

    def add_misses(self, points: ArrayLike) -> None:
        """Tells that fingers came to these places (N,3) or (3,) and met nothing, so that they are not suggested again.

        The network knows of contacts only: `mesh` stays as it is.

        Raises:
            ValueError: another shape, or values that are not finite.
        """
        points, _ = check_contacts(np.atleast_2d(np.asarray(points, dtype=np.float64)), None)
        self._visited = np.concatenate([self._visited, points])

    def mesh(self, resolution: int | None = None) -> trimesh.Trimesh:
        """The closed surface from all contacts so far: what `reconstruct_mesh` returns for them.

        Where normals are not known, their estimates begin with those of the session's last surface while a quarter of
        the contacts or fewer are new to it, and the surface is the same only up to where estimates settle.

        Args:
            resolution: another one than the session's.

        Raises:
            ValueError: contacts that bound no solid, or no surface.
        """
        if resolution is not None and resolution != self.resolution:
            return self._reconstruct(resolution).mesh
        if self._fit is None or self._fitted < len(self):
            self._fit, self._fitted, self._places = self._reconstruct(self.resolution), len(self), None
            self._tree = cKDTree(self._fit.mesh.vertices)
        return self._fit.mesh

    def next(self, k: int = 1, *, refit: bool | None = None) -> Suggestions:
        """The k places whose touches are expected to tell most, to be made in this order or all at once.

        Args:
            k: how many, ≥ 1; fewer are returned where fewer are reachable.
            refit: fit the surface to all contacts first. None: where they contradict it or are a quarter more than it
                was fitted to. False: only where there is none yet, which bounds the time this takes.

        Raises:
            ValueError: contacts that bound no solid, no surface, or no reachable place on it.
        """
        if k < 1:
            raise ValueError(f"k should be at least 1, got {k}")
        if self._fit is None or (self._is_stale() if refit is None else refit):
            self.mesh()
        process = self._process()
        if self._places is None:
            self._places = _Places(self._fit, self._tree, self.level, process, self._can_reach)
        return self._places.best(process, k)

    def _reconstruct(self, resolution: int) -> Reconstruction:
        # Estimates made of few contacts may hold on to an error that those of all contacts would not make.
        guess = None if self._fit is None or len(self) >= STALE * self._afresh else self._fit.normals
        if guess is None:
            self._afresh = len(self)
        return reconstruct_with_field(
            self._points,
            normals=self.normals,
            up=self.up,
            weights=self.model,
            resolution=resolution,
            device=self.device,
            level=self.level,
            guess=guess,
        )

    def _is_stale(self) -> bool:
        new = self._points[self._fitted :]
        if not len(new):
            return False
        if len(self) >= STALE * self._fitted:
            return True
        # Vertices stand for the surface: they lie closer together than ASTRAY.
        return bool(self._tree.query(new)[0].max() > ASTRAY * FILL * self._fit.mesh.metadata["frame"].scale)

    def _process(self) -> _Process:
        """The Gaussian process of all places visited; it starts anew where they have outgrown its length scale or
        become too many for it."""
        if self._gp is None or self._gp.seen < len(self._visited):
            frame, gp = Frame.fit(self._points), self._gp
            outgrown = gp is not None and frame.scale > GROWTH * gp.frame.scale
            full = gp is not None and len(gp.gp) + len(self._visited) - gp.seen > MOST_KNOWN
            if gp is None or outgrown or full:
                self._gp, self._places = _Process(frame), None
            self._gp.learn(self._visited)
        return self._gp

    def _can_reach(self, places: _Places) -> NDArray[np.bool_]:
        positions, normals = places.positions, places.normals
        standoff = 0.05 * places.side if self.standoff is None else self.standoff
        allowed = np.ones(len(positions), dtype=bool)
        if self.approach is not None:
            allowed &= normals @ self.approach >= np.cos(np.deg2rad(self.cone)) - 1e-12
        if self.floor is not None:
            axis = "xyz".index(self.up)
            lowest = positions[:, axis] + np.minimum(0.0, normals[:, axis]) * standoff
            allowed &= lowest >= self.floor + 0.2 * standoff
        if self.reachable is not None:
            said = np.asarray(self.reachable(positions.copy(), -normals))
            if said.shape != (len(positions),) or said.dtype != bool:
                raise ValueError(
                    f"reachable should return {len(positions)} bools, got {said.dtype} of shape {said.shape}"
                )
            allowed &= said
        return allowed & (places.clearances >= standoff)


class _Process:
    """The Gaussian process of a session, in coordinates where the contacts' longest side was 1 when it began."""

    def __init__(self, frame: Frame) -> None:
        self.frame, self.side = frame, FILL * frame.scale
        self.gp = GaussianProcess("matern32", length_scale=LENGTH_SCALE, noise=NOISE)
        self.seen = 0  # places that it was told of

    def to_unit(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return (points - self.frame.centre) / self.side

    def learn(self, points: NDArray[np.float64]) -> None:
        """Adds those of the places (N,3) that it was not told of yet; at the start, of very many an even choice."""
        new = points[self.seen :]
        if len(self.gp) + len(new) > MOST_KNOWN:
            new = new[thin(new, MOST_KNOWN // 2)]
        self.gp.add(self.to_unit(new))
        self.seen = len(points)


class _Places:
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
        process: _Process,
        can_reach: Callable[[_Places], NDArray[np.bool_]],
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

    def best(self, process: _Process, k: int) -> Suggestions:
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


def _direction(vector: ArrayLike) -> NDArray[np.float64]:
    vector = np.asarray(vector, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not np.any(vector):
        raise ValueError(f"approach should be a direction (3,), finite and not zero, got {vector.tolist()}")
    return vector / np.linalg.norm(vector)
