"""Where to touch next: a session of contacts, the surface they suggest, and the places that would tell most about it.

How a place is chosen, and what that is worth in contacts saved: docs/where_to_touch.md.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
import torch
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from torch import nn

from touchnet.contacts import check_contacts
from touchnet.device import pick_device
from touchnet.frames import FILL, Frame
from touchnet.places import Places, Process, Suggestions
from touchnet.reconstruction import (
    Reconstruction,
    Up,
    ready_model,
    reconstruct_with_field,
)

__all__ = ["Explorer", "Suggestions"]

Reachable = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]

GROWTH = 1.1  # how far the contacts' longest side may grow before the Gaussian process starts anew
STALE = 1.25  # the surface is fitted again once there are so many times as many contacts as it was fitted to
ASTRAY = 0.03  # ... or one of them lies so far from it, as a share of the longest side


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
        self._gp: Process | None = None
        self._places: Places | None = None
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
            self._places = Places(self._fit, self._tree, self.level, process, self._can_reach)
        return self._places.best(process, k)

    def _reconstruct(self, resolution: int) -> Reconstruction:
        # Estimates made of few contacts may hold on to an error that those of all contacts would not make.
        guess = None if self._fit is None or len(self) >= STALE * self._afresh else self._fit.normals
        fit = reconstruct_with_field(
            self._points,
            normals=self.normals,
            up=self.up,
            weights=self.model,
            resolution=resolution,
            device=self.device,
            level=self.level,
            guess=guess,
        )
        if guess is None:
            self._afresh = len(self)
        return fit

    def _is_stale(self) -> bool:
        new = self._points[self._fitted :]
        if not len(new):
            return False
        if len(self) >= STALE * self._fitted:
            return True
        # Vertices stand for the surface: they lie closer together than ASTRAY.
        return bool(self._tree.query(new)[0].max() > ASTRAY * FILL * self._fit.mesh.metadata["frame"].scale)

    def _process(self) -> Process:
        """The Gaussian process of all places visited; it starts anew where they have outgrown its length scale or
        become too many for it."""
        if self._gp is None or self._gp.seen < len(self._visited):
            frame, gp = Frame.fit(self._points), self._gp
            outgrown = gp is not None and frame.scale > GROWTH * gp.frame.scale
            full = gp is not None and not gp.has_room_for(self._visited)
            if gp is None or outgrown or full:
                self._gp, self._places = Process(frame), None
            self._gp.learn(self._visited)
        return self._gp

    def _can_reach(self, places: Places) -> NDArray[np.bool_]:
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


def _direction(vector: ArrayLike) -> NDArray[np.float64]:
    vector = np.asarray(vector, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not np.any(vector):
        raise ValueError(f"approach should be a direction (3,), finite and not zero, got {vector.tolist()}")
    return vector / np.linalg.norm(vector)
