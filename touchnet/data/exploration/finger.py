"""What a finger can touch, and how it slides on."""

import math
from collections.abc import Callable

import numpy as np
import point_cloud_utils as pcu
from numpy.typing import NDArray

from touchnet.data.exploration.surface import Surface
from touchnet.data.exploration.vectors import Contact, Vector, in_plane

_BENDS = ((1.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5)), (0.0, 1.0))  # shares of a step along the face and into it


class Finger:
    """A sphere (a point, with radius 0) that touches the surface from outside, where that is not forbidden."""

    def __init__(
        self,
        surface: Surface,
        radius: float,
        forbidden: Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None,
    ) -> None:
        self.surface, self.radius, self.forbidden = surface, radius, forbidden

    def allowed(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        if self.forbidden is None:
            return np.ones(len(points), dtype=bool)
        return ~self.forbidden(self.surface.to_mesh(points))

    def place(
        self, points: NDArray[np.float64], faces: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Contacts (m, 3), normals (m, 3) that the finger makes at surface points (m, 3), and whether it can (m,)."""
        surface, radius = self.surface, self.radius
        normals = surface.normals[faces]
        if radius == 0:
            return points, normals, self.allowed(points)
        centres = points + radius * normals
        contacts, distance = points, np.full(len(points), radius)
        for _ in range(12):  # pushed out of whatever is nearer than the radius; between two walls it never settles
            contacts, _, distance = surface.closest(centres)
            near = (distance < radius) & (distance > 0)
            out = (centres[near] - contacts[near]) / distance[near, None]
            centres[near] = contacts[near] + radius * out
        contacts, _, distance = surface.closest(centres)
        fits = (np.abs(distance - radius) <= 1e-3 * radius) & self.allowed(contacts)
        fits &= np.linalg.norm(contacts - points, axis=1) <= radius
        vertices, triangles = surface.triangles()
        fits[fits] = (
            np.abs(pcu.triangle_soup_fast_winding_number(vertices, triangles.astype(np.int32), centres[fits])) < 0.5
        )
        normals = (centres - contacts) / np.maximum(distance, 1e-300)[:, None]
        return contacts, normals, fits

    def starts(self, n: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """At most n area-uniform contacts and their normals."""
        contacts, normals, fits = self.place(*self.surface.sample(n, rng))
        if not fits.any():
            raise ValueError(
                f"no contact is reachable: none of {n} surface points, with finger_radius={self.radius:g}"
                + ("" if self.forbidden is None else " and the unreachable region")
            )
        return contacts[fits], normals[fits]

    def nearest(self, point: NDArray[np.float64]) -> Contact:
        """The contact next to a point (3,)."""
        closest, face, _ = self.surface.closest(point[None])
        contacts, normals, fits = self.place(closest, face)
        if not fits[0]:
            raise ValueError(f"start should be next to a reachable contact, got {self.surface.to_mesh(point).tolist()}")
        return tuple(contacts[0].tolist()), tuple(normals[0].tolist())

    def slide(self, contact: Contact, direction: Vector, step: float) -> Contact | None:
        """The contact one step on, or None where the finger makes no headway or may not go."""
        following = self._roll(contact, direction, step) if self.radius else self._step(contact, direction, step)
        if following is None or self.forbidden is None or self.allowed(np.array(following[0])[None])[0]:
            return following
        return None

    def _step(self, contact: Contact, direction: Vector, step: float) -> Contact | None:
        # At a convex edge the step off the face falls back onto the edge; there the step is bent round it.
        (x, y, z), (nx, ny, nz) = contact
        dx, dy, dz = direction
        for along, into in _BENDS:
            a, b = along * step, into * step
            found, face, _ = self.surface.closest.of_one(
                (x + a * dx - b * nx, y + a * dy - b * ny, z + a * dz - b * nz)
            )
            if math.dist(found, contact[0]) > 0.5 * step:
                return found, tuple(self.surface.normals[face].tolist())
        return None

    def _roll(self, contact: Contact, direction: Vector, step: float) -> Contact | None:
        radius, (point, normal) = self.radius, contact
        parts = math.ceil(2 * step / radius)  # less than the radius at a time: the centre cannot pass a wall
        length = step / parts
        centre = tuple(p + radius * m for p, m in zip(point, normal, strict=True))
        touched = point
        for _ in range(parts + math.ceil(math.pi * radius / length)):  # the latter: once round a sharp edge
            following = tuple(c + length * d for c, d in zip(centre, direction, strict=True))
            for _ in range(12):
                touched, _, distance = self.surface.closest.of_one(following)
                if abs(distance - radius) <= 1e-3 * radius or distance == 0:
                    break
                following = tuple(t + (f - t) * radius / distance for t, f in zip(touched, following, strict=True))
            if abs(distance - radius) > 1e-3 * radius or math.dist(following, centre) < 0.25 * length:
                return None
            centre = following
            normal = tuple((c - t) / distance for c, t in zip(centre, touched, strict=True))
            if math.dist(touched, point) >= 0.9 * step:
                return touched, normal
            ahead = in_plane(direction, normal)
            if ahead is None:
                return None
            direction = ahead
        return (touched, normal) if math.dist(touched, point) > 0.5 * step else None
