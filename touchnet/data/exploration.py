"""Touch exploration of a closed mesh under a Gaussian process (paper section 4.2, eq. 8), and ways to compare it with.

A finger slides from contact to contact: along the gradient of the posterior variance in the tangent plane, one step,
back to the surface. A stroke ends where little is left to learn; the next starts where the variance is highest.

Inside this module the mesh's longest side is 1 and its box is centred; points are tuples where they come one by one.
"""

import logging
import math
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Literal, NamedTuple, get_args

import numpy as np
import point_cloud_utils as pcu
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from touchnet.data.gp import _KERNELS, _LANES, GaussianProcess, KernelName
from touchnet.ops._ext import _C

__all__ = ["ClosestPoints", "Surface", "Touches", "coverage", "simulate_touches"]

Strategy = Literal["gp", "random_walk", "scan_lines", "uniform"]
Vector = tuple[float, float, float]
Contact = tuple[Vector, Vector]  # a point of the surface and the outward unit normal there

_log = logging.getLogger(__name__)


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


def simulate_touches(
    mesh: "trimesh.Trimesh | Surface",
    n: int = 2048,
    *,
    seed: int = 0,
    start: ArrayLike | None = None,
    strategy: Strategy = "gp",
    step: float | tuple[float, float] | None = None,
    stroke_length: int | None = None,
    max_strokes: int | None = None,
    stop: float = 0.4,
    kernel: KernelName = "matern32",
    length_scale: float = 0.15,
    noise: float = 1e-3,
    candidates: int = 2048,
    finger_radius: float = 0.0,
    unreachable: ArrayLike | Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None = None,
    position_noise: float = 0.0,
    normal_noise: float = 0.0,
    dropout: float = 0.0,
) -> Touches:
    """n contacts of a finger that explores the closed, outward-wound mesh; the same seed gives the same bytes.

    The defaults are ideal contacts. Lengths (step, length_scale, finger_radius, position_noise) are relative to the
    longest side of the mesh's bounding box; start and unreachable are in the mesh's own frame.

    Args:
        mesh: closed triangle mesh, any number of components; or a Surface made of it, which serves any number of
            trajectories.
        n: number of contacts.
        seed: of the starting point and of every other random choice.
        start: point (3,) next to which the first contact is made; None draws it uniformly from the surface.
        strategy: "gp" slides along the gradient of the variance and restarts where the variance is highest;
            "random_walk" slides with a heading that wanders, and restarts anywhere; "scan_lines" follows the
            contours of equally spaced parallel planes, across the longest side; "uniform" touches independent random
            points, each a stroke of its own.
        step: distance of consecutive contacts of a stroke, or (low, high) between which each step is drawn. None:
            sqrt(area / n), the spacing of n contacts spread evenly over the surface, but at most 0.1.
            "scan_lines" spaces its planes so that n contacts with this step cover them all.
        stroke_length: most contacts of a stroke; None: 32, or n / max_strokes where that is more. ("gp" and
            "random_walk".)
        max_strokes: the exploration ends after so many strokes, with fewer than n contacts if need be.
        stop: a stroke of "gp" ends when the variance found at four contacts running is below this share of what an
            undisturbed stroke finds (or of the highest variance on the surface, once that is lower).
        kernel, length_scale, noise: of the Gaussian process (see GaussianProcess; for "thin_plate" length_scale is R).
        candidates: number of surface points among which starts are chosen.
        finger_radius: the finger is a sphere; only where it can rest is there a contact, so that narrow concavities
            stay untouched. Contact normals point to its centre.
        unreachable: where no contact can be made: a box ((3,), (3,)) of low and high corners, or a function from points
            (M, 3) to bool (M,), true where unreachable. A stroke ends there.
        position_noise: standard deviation of the reported positions, isotropic. The Gaussian process sees these.
        normal_noise: standard deviation, in degrees, of the tilt of the reported normals about two tangent axes.
        dropout: probability in [0, 1) that a contact goes unnoticed; n are still returned, except by "scan_lines".

    Raises:
        TypeError: mesh is neither a trimesh.Trimesh nor a Surface.
        ValueError: an argument is out of range, the mesh has no face with an area, or no contact is reachable.
    """
    _check(n >= 1, "n", "at least 1", n)
    low_step, high_step = (0.1, 0.1) if step is None else step if np.ndim(step) else (step, step)
    _check(0 < low_step <= high_step <= 1, "step", "in (0, 1], or 0 < low ≤ high ≤ 1", step)
    _check(stroke_length is None or stroke_length >= 1, "stroke_length", "None or at least 1", stroke_length)
    _check(max_strokes is None or max_strokes >= 1, "max_strokes", "None or at least 1", max_strokes)
    _check(0 <= stop < 1, "stop", "in [0, 1)", stop)
    _check(candidates >= 1, "candidates", "at least 1", candidates)
    _check(0 <= finger_radius <= 1, "finger_radius", "in [0, 1]", finger_radius)
    _check(0 <= position_noise < 1, "position_noise", "in [0, 1)", position_noise)
    _check(0 <= normal_noise < 90, "normal_noise", "in [0, 90) degrees", normal_noise)
    _check(0 <= dropout < 1, "dropout", "in [0, 1)", dropout)
    _check(strategy in get_args(Strategy), "strategy", f"one of {', '.join(get_args(Strategy))}", strategy)

    rng = np.random.default_rng(seed)
    surface = mesh if isinstance(mesh, Surface) else Surface(mesh)
    if step is None:
        low_step = high_step = min(0.1, math.sqrt(float(surface.areas.sum()) / n))
    finger = _Finger(surface, finger_radius, _forbidden(unreachable))
    record = _Record(n, GaussianProcess(kernel, length_scale=length_scale, noise=noise), rng)
    record.position_noise, record.normal_noise, record.dropout = position_noise, math.radians(normal_noise), dropout
    if strategy == "uniform":
        _touch_uniform(finger, record, n if max_strokes is None else min(n, max_strokes), rng)
    elif strategy == "scan_lines":
        _scan_lines(finger, record, n, (low_step + high_step) / 2, max_strokes)
    else:
        first = None if start is None else finger.nearest(surface.from_mesh(_point(start, "start")))
        limit = stroke_length or max(32, -(-n // max_strokes) if max_strokes else 0)
        steer = _UpTheVariance(length_scale, rng) if strategy == "gp" else _Wander(rng)
        if strategy == "random_walk":
            stop = 0.0
        low = stop * _free_variance(kernel, length_scale, noise, (low_step + high_step) / 2)
        starts = _Starts(record.gp, *finger.starts(candidates, rng), n, anywhere=strategy == "random_walk")
        stroke = 0
        while record.count < n and stroke != max_strokes:
            contact, highest = starts.next(rng) if stroke or first is None else (first, 1.0)
            enough = min(low, stop * highest)
            length = quiet = 0
            steer.begin()
            while True:
                variance = record.touch(contact, stroke)
                length += 1
                quiet = quiet + 1 if variance < enough else 0
                if record.count == n or quiet == 4 or length == limit:
                    break
                direction = steer(record, contact, variance)
                distance = low_step if low_step == high_step else float(rng.uniform(low_step, high_step))
                following = finger.slide(contact, direction, distance)
                if following is None:
                    break
                contact = following
            stroke += 1
    return record.touches(surface)


def coverage(
    mesh: trimesh.Trimesh, points: ArrayLike, *, radius: float, samples: int = 100_000, seed: int = 0
) -> float:
    """Share in [0, 1] of the mesh's surface area that lies within `radius` of one of the points (N, 3).

    The radius is relative to the longest side of the mesh's bounding box. Estimated at area-uniform `samples`.
    """
    _check(0 < radius < math.inf, "radius", "a positive number", radius)
    _check(samples >= 1, "samples", "at least 1", samples)
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"points should be finite with shape (N, 3), got shape {points.shape}")
    if not len(points):
        return 0.0
    surface = Surface(mesh)
    at, _ = surface.sample(samples, np.random.default_rng(seed))
    distance, _ = cKDTree(surface.from_mesh(points)).query(at, distance_upper_bound=radius)
    return float(np.isfinite(distance).mean())


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
        self._addresses = tuple(array.ctypes.data for array in self._one)

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

    def of_one(self, point: Vector) -> tuple[Vector, int, float]:
        """The same for one point, in microseconds: no fresh arrays. Not for several threads at once."""
        query, closest, face, distance = self._one
        query[:] = point
        at, found, index, length = self._addresses
        self._tree.closest(at, 1, found, index, length)
        return tuple(closest.tolist()), face.item(), distance.item()


class Surface:
    """A mesh as a finger meets it: triangles with an area, in the frame of this module, and closest points on them.

    The tree over the triangles takes longer to build than a trajectory's closest points to find: many trajectories of
    one mesh share a Surface.

    Raises:
        TypeError: mesh is not a trimesh.Trimesh.
        ValueError: the mesh has no face with an area.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        if not isinstance(mesh, trimesh.Trimesh):
            raise TypeError(f"mesh should be a trimesh.Trimesh, got {type(mesh).__name__}")
        faces = np.asarray(mesh.faces, dtype=np.int64)
        corners = np.asarray(mesh.vertices, dtype=np.float64)[faces]
        if not len(faces) or not np.isfinite(corners).all():
            raise ValueError("mesh should have faces with finite corners")
        low, high = corners.min((0, 1)), corners.max((0, 1))
        self.centre, self.scale = (low + high) / 2, float((high - low).max())
        if not self.scale > 0:
            raise ValueError("mesh should have an extent, got a single point")
        corners = (corners - self.centre) / self.scale
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.sqrt((cross**2).sum(1))
        solid = length > 0
        if not solid.any():
            raise ValueError("mesh should have a face with an area")
        self.corners = np.ascontiguousarray(corners[solid])
        self.areas = length[solid] / 2
        self.normals = cross[solid] / length[solid, None]

    @cached_property
    def closest(self) -> ClosestPoints:
        """The tree, built when it is first asked for."""
        return ClosestPoints(*self.triangles())

    def triangles(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Unshared vertices (3 F, 3) and faces (F, 3)."""
        return self.corners.reshape(-1, 3), np.arange(3 * len(self.corners)).reshape(-1, 3)

    def to_mesh(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return points * self.scale + self.centre

    def from_mesh(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return (points - self.centre) / self.scale

    def sample(self, n: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """n area-uniform points (n, 3) and their faces (n,)."""
        cumulative = np.cumsum(self.areas)
        face = np.searchsorted(cumulative, rng.random(n) * cumulative[-1], side="right").clip(max=len(self.areas) - 1)
        u, v = rng.random((2, n))
        over = u + v > 1
        u[over], v[over] = 1 - u[over], 1 - v[over]
        a, b, c = self.corners[face].transpose(1, 0, 2)
        return a + u[:, None] * (b - a) + v[:, None] * (c - a), face

    def contours(self, axis: int, planes: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
        """The polylines (P, 3) in which planes across an axis, at these coordinates, cut the surface."""
        mesh = trimesh.Trimesh(*self.triangles(), process=False)
        mesh.merge_vertices()
        normal = np.eye(3)[axis]
        for plane in planes:
            path = mesh.section(plane_normal=normal, plane_origin=plane * normal)
            if path is not None:
                yield from path.discrete


class _Finger:
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
            ahead = _in_plane(direction, normal)
            if ahead is None:
                return None
            direction = ahead
        return (touched, normal) if math.dist(touched, point) > 0.5 * step else None


_BENDS = ((1.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5)), (0.0, 1.0))  # shares of a step along the face and into it


class _Record:
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
            normal = _tilted(np.array(normal), self.normal_noise * self.rng.standard_normal(2))
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


class _UpTheVariance:
    """Steers along the tangential part of the variance gradient; at random where that vanishes."""

    def __init__(self, length_scale: float, rng: np.random.Generator) -> None:
        self.length_scale, self.rng = length_scale, rng

    def begin(self) -> None:
        pass

    def __call__(self, record: _Record, contact: Contact, variance: float) -> Vector:
        slope = tuple(record.gradient().tolist())
        # The gradient before the contact scales with the variance, so the threshold holds for any noise.
        smallest = 1e-6 * variance / self.length_scale
        direction = _in_plane(slope, contact[1], smallest)
        if direction is None:
            _log.debug("no tangential gradient at %s: random direction", contact[0])
            return _random_tangent(contact[1], self.rng)
        return direction


class _Wander:
    """Steers straight on, turned at each step by a random angle of 0.3 rad standard deviation."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.begin()

    def begin(self) -> None:
        self.heading: Vector | None = None

    def __call__(self, record: _Record, contact: Contact, variance: float) -> Vector:
        normal = contact[1]
        ahead = None if self.heading is None else _in_plane(self.heading, normal)
        if ahead is None:
            ahead = _random_tangent(normal, self.rng)
        turn = 0.3 * float(self.rng.standard_normal())
        aside = np.cross(normal, ahead).tolist()
        self.heading = tuple(math.cos(turn) * a + math.sin(turn) * b for a, b in zip(ahead, aside, strict=True))
        return self.heading


class _Starts:
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


def _touch_uniform(finger: _Finger, record: _Record, n: int, rng: np.random.Generator) -> None:
    stroke = 0
    while record.count < n:
        for point, normal in zip(*finger.starts(n, rng), strict=True):
            if record.count == n:
                return
            record.touch((tuple(point.tolist()), tuple(normal.tolist())), stroke)
            stroke += 1


def _scan_lines(finger: _Finger, record: _Record, n: int, step: float, max_strokes: int | None) -> None:
    surface = finger.surface
    extent = surface.corners.max((0, 1)) - surface.corners.min((0, 1))
    axis = int(extent.argmax())

    def lines(planes: int) -> list[NDArray[np.float64]]:
        # half a spacing inside the ends, and off the coordinates that vertices tend to lie on
        at = (np.arange(planes) + 0.5 + 1e-4) / planes - 0.5
        return list(surface.contours(axis, at * extent[axis]))

    def length_of(line: NDArray[np.float64]) -> float:
        return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())

    trial = 16
    total = sum(map(length_of, lines(trial)))
    found = lines(max(1, round(trial * n * step / max(total, 1e-9))))
    if max_strokes is not None:
        found = found[:max_strokes]
    # n contacts in all (before any turns out to be unreachable), evenly over the lines
    lengths = np.array([length_of(line) for line in found])
    if not lengths.sum() > 0:
        raise ValueError("no contour found: the mesh has no extent between the scan planes")
    position = (np.arange(n) + 0.5) / n * lengths.sum()
    ends = np.cumsum(lengths)
    owner = np.searchsorted(ends, position, side="right").clip(max=len(found) - 1)
    points = np.empty((n, 3))
    for index, line in enumerate(found):
        mine = owner == index
        along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        for k in range(3):
            points[mine, k] = np.interp(position[mine] - (ends[index] - lengths[index]), along, line[:, k])
    closest, face, _ = surface.closest(points)
    contacts, normals, fits = finger.place(closest, face)
    if not fits.any():
        raise ValueError("no contact is reachable on the scan lines")
    for index in np.flatnonzero(fits):
        record.touch((tuple(contacts[index].tolist()), tuple(normals[index].tolist())), int(owner[index]))


def _free_variance(kernel: KernelName, length_scale: float, noise: float, step: float) -> float:
    """The variance that a straight stroke finds at its next contact when nothing else was touched."""
    gp = GaussianProcess(kernel, length_scale=length_scale, noise=noise)
    behind = 16 if kernel != "thin_plate" else max(1, min(16, int(length_scale / step)))  # within R
    line = np.arange(behind + 1)[:, None] * [step, 0.0, 0.0]
    gp.add(line[:-1])
    return float(gp.variance(line[-1:])[0])


def _along_curve(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order (n,) of points (n, 3) along a Morton curve through their box."""
    side = max(float(np.ptp(points, axis=0).max()), 1e-300)
    cell = ((points - points.min(0)) / side * 1023).astype(np.int64)
    key = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")


def _in_plane(vector: Vector, normal: Vector, smallest: float = 1e-9) -> Vector | None:
    """Unit vector along the part of a vector across the normal; None where that part is no longer than `smallest`."""
    (x, y, z), (nx, ny, nz) = vector, normal
    along = x * nx + y * ny + z * nz
    x, y, z = x - along * nx, y - along * ny, z - along * nz
    size = math.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size) if size > smallest else None


def _random_tangent(normal: Vector, rng: np.random.Generator) -> Vector:
    while True:
        tangent = _in_plane(tuple(rng.standard_normal(3).tolist()), normal, 1e-3)
        if tangent is not None:
            return tangent


def _tilted(normal: NDArray[np.float64], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """A unit normal tilted by two angles (radians) towards two tangents."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    tilted = normal + np.tan(angles[0]) * first + np.tan(angles[1]) * np.cross(normal, first)
    return tilted / np.linalg.norm(tilted)


def _point(value: ArrayLike, name: str) -> NDArray[np.float64]:
    point = np.asarray(value, dtype=np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ValueError(f"{name} should be a finite point of shape (3,), got {value}")
    return point


def _forbidden(
    unreachable: ArrayLike | Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None,
) -> Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None:
    if unreachable is None or callable(unreachable):
        return unreachable
    box = np.asarray(unreachable, dtype=np.float64)
    if box.shape != (2, 3) or not (box[0] <= box[1]).all():
        raise ValueError(f"unreachable should be a function or a box (low (3,), high (3,)), got {unreachable}")
    return lambda points: ((points >= box[0]) & (points <= box[1])).all(1)


def _check(holds: bool, name: str, expected: str, got: object) -> None:
    if not holds:
        raise ValueError(f"{name} should be {expected}, got {got}")
