"""How good a reconstruction is: of point sets (torch), of occupancies, and of meshes (numpy, float64).

Papers differ in what they call Chamfer distance or F-score; `DEFINITIONS` says what each name means here, and every
report prints it. Distances are in the units of the input; reports use the longest side of the shape's box as the unit.
"""

from typing import Any, NamedTuple, overload

import numpy as np
import torch
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from touchnet.data.exploration import ClosestPoints
from touchnet.data.watertight import winding_number
from touchnet.farthest import farthest_point_sample
from touchnet.raster import cover

DEFINITIONS = {
    "iou": "volume of the intersection over volume of the union, measured along parallel lines (inside: winding number "
    ">= 1); an open mesh is labelled at random points instead (winding number > 0.5)",
    "chamfer_l1": "half the sum of the mean distance prediction to truth and the mean distance truth to prediction",
    "chamfer": "mean squared distance prediction to truth plus mean squared distance truth to prediction (eq. 9)",
    "f_score": "2PR/(P+R), P (R): share of the prediction (truth) strictly nearer than d to the other (eq. 10-12)",
    "normal_consistency": "mean |cosine| between the normals of a point and its closest point, mean of both directions",
    "hausdorff_95": "the greater of the two 95th percentiles of the distances prediction to truth, truth to prediction",
    "watertight": "every edge lies in exactly two faces, which run along it in opposite directions",
    "empty": "no surface came out: IoU, F-score and normal consistency 0, distances infinite",
}

CDIST_AT_ONCE = 1 << 25  # distances computed at once on a device without a tree


# ---- point sets ------------------------------------------------------------------------------------------------------


def chamfer_distance(a: Tensor, b: Tensor) -> Tensor:
    """Chamfer distance of two point sets, eq. 9: mean over a of min squared distance, plus the same from b.

    Two single points 0.3 apart give 0.18. Differentiable in both sets (not where nearest points change).

    Args:
        a: (N, 3) or (B, N, 3), float32 or float64.
        b: (M, 3) or (B, M, 3), of the same type and device.

    Returns:
        scalar or (B,), >= 0; infinite where a set has no points (also when both have none).
    """
    a_batch, b_batch, single = _point_sets(a, b)
    if a_batch.shape[1] == 0 or b_batch.shape[1] == 0:
        result = a_batch.new_full((len(a_batch),), torch.inf)
    else:
        result = _squared_to_nearest(a_batch, b_batch).mean(1) + _squared_to_nearest(b_batch, a_batch).mean(1)
    return result[0] if single else result


def f_score(a: Tensor, b: Tensor, *, threshold: float) -> Tensor:
    """F-score of two point sets, eq. 10-12: harmonic mean of precision and recall at a distance.

    Precision is the share of `a` strictly nearer than `threshold` to a point of `b`; recall the share of `b` to `a`.

    Args:
        a: (N, 3) or (B, N, 3), the prediction.
        b: (M, 3) or (B, M, 3), the truth.
        threshold: distance in the units of the points, > 0. 0.01 is "1 %" where the longest side is 1.

    Returns:
        scalar or (B,) in [0, 1]; 0 where a set has no points (also when both have none).
    """
    if not threshold > 0:
        raise ValueError(f"threshold must be a positive distance, got {threshold}")
    a_batch, b_batch, single = _point_sets(a, b)
    if a_batch.shape[1] == 0 or b_batch.shape[1] == 0:
        result = a_batch.new_zeros(len(a_batch))
    else:
        with torch.no_grad():
            precision = (_squared_to_nearest(a_batch, b_batch).sqrt() < threshold).to(a.dtype).mean(1)
            recall = (_squared_to_nearest(b_batch, a_batch).sqrt() < threshold).to(a.dtype).mean(1)
        result = _harmonic_mean(precision, recall)
    return result[0] if single else result


def hausdorff_95(a: Tensor, b: Tensor) -> Tensor:
    """The greater of the 95th percentiles of the distances from a to b and from b to a.

    Args:
        a: (N, 3) or (B, N, 3).
        b: (M, 3) or (B, M, 3).

    Returns:
        scalar or (B,), >= 0; infinite where a set has no points.
    """
    a_batch, b_batch, single = _point_sets(a, b)
    if a_batch.shape[1] == 0 or b_batch.shape[1] == 0:
        result = a_batch.new_full((len(a_batch),), torch.inf)
    else:
        with torch.no_grad():
            there = _squared_to_nearest(a_batch, b_batch).sqrt().quantile(0.95, dim=1)
            back = _squared_to_nearest(b_batch, a_batch).sqrt().quantile(0.95, dim=1)
        result = torch.maximum(there, back)
    return result[0] if single else result


def normal_consistency(a: Tensor, a_normals: Tensor, b: Tensor, b_normals: Tensor) -> Tensor:
    """Mean |cosine| between the normal of a point and that of the nearest point of the other set, both directions.

    Args:
        a, b: (N, 3) and (M, 3), or with a batch in front.
        a_normals, b_normals: shaped as the points, of any non-zero length.

    Returns:
        scalar or (B,) in [0, 1]; 0 where a set has no points.
    """
    a_batch, b_batch, single = _point_sets(a, b)
    for name, normals, points in (("a_normals", a_normals, a), ("b_normals", b_normals, b)):
        if normals.shape != points.shape:
            raise ValueError(
                f"{name} must have the shape of its points {tuple(points.shape)}, got {tuple(normals.shape)}"
            )
    if a_batch.shape[1] == 0 or b_batch.shape[1] == 0:
        result = a_batch.new_zeros(len(a_batch))
    else:
        a_unit = torch.nn.functional.normalize(a_normals.reshape(a_batch.shape), dim=-1)
        b_unit = torch.nn.functional.normalize(b_normals.reshape(b_batch.shape), dim=-1)
        there = (a_unit * _rows(b_unit, nearest(a_batch, b_batch))).sum(-1).abs().mean(1)
        back = (b_unit * _rows(a_unit, nearest(b_batch, a_batch))).sum(-1).abs().mean(1)
        result = (there + back) / 2
    return result[0] if single else result


@torch.no_grad()
def nearest(a: Tensor, b: Tensor) -> Tensor:
    """Index of the point of `b` nearest to each point of `a`.

    Args:
        a: (B, N, 3).
        b: (B, M, 3), M >= 1.

    Returns:
        (B, N) int64.
    """
    if a.device.type == "cpu":
        found = [cKDTree(y.numpy()).query(x.numpy())[1] for x, y in zip(a.detach(), b.detach(), strict=True)]
        return torch.from_numpy(np.asarray(found, dtype=np.int64).reshape(a.shape[:2]))
    rows = max(1, CDIST_AT_ONCE // (len(a) * b.shape[1]))
    return torch.cat([torch.cdist(part, b).argmin(2) for part in a.split(rows, dim=1)], dim=1)


def _point_sets(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor, bool]:
    """Both sets with a batch in front, and whether they came without one."""
    for name, points in (("a", a), ("b", b)):
        if not isinstance(points, Tensor):
            raise TypeError(f"{name} must be a torch.Tensor, got {type(points).__name__}")
        if points.ndim not in (2, 3) or points.shape[-1] != 3:
            raise ValueError(f"{name} must have shape (N, 3) or (B, N, 3), got {tuple(points.shape)}")
        if points.dtype not in (torch.float32, torch.float64):
            raise TypeError(f"{name} must be float32 or float64, got {points.dtype}")
        if not torch.isfinite(points).all():
            raise ValueError(f"{name} must be finite, got NaN or infinity")
    if a.dtype != b.dtype:
        raise TypeError(f"a and b must have one type, got {a.dtype} and {b.dtype}")
    if a.ndim != b.ndim or (a.ndim == 3 and len(a) != len(b)):
        raise ValueError(f"a and b must have the same batch, got shapes {tuple(a.shape)} and {tuple(b.shape)}")
    return (a[None], b[None], True) if a.ndim == 2 else (a, b, False)


def _rows(points: Tensor, index: Tensor) -> Tensor:
    return torch.gather(points, 1, index[..., None].expand(-1, -1, 3))


def _squared_to_nearest(a: Tensor, b: Tensor) -> Tensor:
    """(B, N) squared distance from each point of `a` to its nearest point of `b`; differentiable in both."""
    return (a - _rows(b, nearest(a, b))).square().sum(-1)


def _harmonic_mean(precision: Any, recall: Any) -> Any:
    total = precision + recall
    return 2 * precision * recall / (total + (total == 0))


# ---- occupancies and volumes -----------------------------------------------------------------------------------------


@overload
def volumetric_iou(a: Tensor, b: Tensor) -> Tensor: ...
@overload
def volumetric_iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> NDArray[np.float64]: ...
@overload
def volumetric_iou(a: trimesh.Trimesh, b: trimesh.Trimesh, *, lines: int = ..., seed: int = ...) -> float: ...


def volumetric_iou(a: Any, b: Any, *, lines: int = 1 << 16, seed: int = 0) -> Any:
    """Intersection over union of two solids, given by labels at common points or as closed meshes.

    Meshes are compared along parallel lines, on which inside is known exactly (winding number >= 1, from the crossings
    counted with their signs) and so are the lengths of intersection and union. That takes fewer samples than labelled
    points do, above all for thin shapes.

    Args:
        a, b: boolean arrays or tensors of one shape, (N,) or (B, N); or two closed meshes wound outwards.
        lines: meshes only: about how many lines cross the box of both.
        seed: meshes only: of the position of the lines.

    Returns:
        (a & b).sum(-1) / (a | b).sum(-1), in [0, 1], 1 where both are empty: a scalar or (B,) of the kind that came;
        a float for meshes.

    Raises:
        ValueError: shapes differ, or a mesh is not closed.
        TypeError: not booleans, nor meshes.
    """
    if isinstance(a, trimesh.Trimesh) and isinstance(b, trimesh.Trimesh):
        for name, mesh in (("a", a), ("b", b)):
            if not is_closed(mesh.faces):
                raise ValueError(f"{name} must be a closed mesh, got one with open or inconsistently wound edges")
        if len(a.faces) == 0 or len(b.faces) == 0:
            return float(len(a.faces) == len(b.faces))
        lattice = Lattice.over(np.concatenate([_box(a), _box(b)]), lines, seed)
        return _iou_along_lines(lattice.crossings(a), lattice.crossings(b))
    for name, labels in (("a", a), ("b", b)):
        if not isinstance(labels, Tensor | np.ndarray) or str(labels.dtype).removeprefix("torch.") != "bool":
            kind = getattr(labels, "dtype", type(labels).__name__)
            raise TypeError(f"{name} must be a boolean array or tensor, or both closed meshes, got {kind}")
    if a.shape != b.shape or a.ndim not in (1, 2):
        raise ValueError(f"a and b must have one shape (N,) or (B, N), got {tuple(a.shape)} and {tuple(b.shape)}")
    common, either = (a & b).sum(-1), (a | b).sum(-1)
    return (common + (either == 0)) / (either + (either == 0))


class Crossings(NamedTuple):
    """Where the lines of a lattice cross a mesh."""

    i: NDArray[np.int64]  # (C,) the line
    j: NDArray[np.int64]
    depth: NDArray[np.float64]  # (C,) along the line
    step: NDArray[np.int64]  # (C,) change of the winding number there, +1 (into the solid) or -1


class Lattice(NamedTuple):
    """Parallel lines through the points of a square lattice."""

    turn: NDArray[np.float64]  # (3, 3) rotation: the rows are the lattice's two axes and the direction of the lines
    origin: NDArray[np.float64]  # (2,) of the lattice, in its own axes
    spacing: float

    @classmethod
    def over(cls, points: NDArray[np.float64], lines: int, seed: int) -> "Lattice":
        """About `lines` lines through the box of the points (N, 3), along its shortest side.

        The lattice is turned by an odd angle, so that sides of the shape do not run along its rows.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        size = np.maximum(high - low, 1e-12 * max(1.0, float(np.abs(points).max())))
        axis = int(np.argmin(size))
        across, up = (axis + 1) % 3, (axis + 2) % 3
        sine, cosine = np.sin(0.37), np.cos(0.37)
        turn = np.zeros((3, 3))
        turn[0, across], turn[0, up] = cosine, sine
        turn[1, across], turn[1, up] = -sine, cosine
        turn[2, axis] = 1
        spacing = float(np.sqrt(size[across] * size[up] / lines))
        shift = np.random.default_rng(seed).random(2) * spacing
        return cls(turn, (turn @ low)[:2] + shift, spacing)

    def crossings(self, mesh: trimesh.Trimesh) -> Crossings:
        turned = np.asarray(mesh.vertices, dtype=np.float64) @ self.turn.T
        uv = (turned[:, :2] - self.origin) / self.spacing
        depth = turned[:, 2][mesh.faces]  # (F, 3)
        parts = [
            # Counter-clockwise seen along the lines' direction from above: the line leaves the solid there.
            Crossings(p.i, p.j, (p.weights * depth[p.face]).sum(axis=1), np.where(p.left, -1, 1))
            for p in cover(uv, mesh.faces)
        ]
        if not parts:
            return Crossings(*(np.zeros(0, dtype=np.int64) for _ in range(2)), np.zeros(0), np.zeros(0, dtype=np.int64))
        return Crossings(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _iou_along_lines(a: Crossings, b: Crossings) -> float:
    """Length of the lines inside both over length inside either; 0 when no line meets either."""
    i, j, depth = (np.concatenate(pair) for pair in zip(a[:3], b[:3], strict=True))
    if len(i) == 0:
        return 0.0
    line = (i - i.min()) * (j.max() - j.min() + 1) + (j - j.min())
    low, high = depth.min(), depth.max()
    order = np.argsort(line + 0.999 * (depth - low) / max(high - low, 1e-300))
    line, depth = line[order], depth[order]
    step_a = np.concatenate([a.step, np.zeros_like(b.step)])[order]
    step_b = np.concatenate([np.zeros_like(a.step), b.step])[order]
    last = np.append(np.diff(line) != 0, True)  # of its line
    # Between a crossing and the next; the sums run on over the lines, for on a closed mesh they end every line at 0.
    # Should rounding next to a vertex break that on some line, the line is left out.
    winding_a, winding_b = np.cumsum(step_a), np.cumsum(step_b)
    if winding_a[last].any() or winding_b[last].any():
        count = np.diff(np.flatnonzero(last), prepend=-1)
        starts = np.cumsum(count) - count
        sound = (np.add.reduceat(step_a, starts) == 0) & (np.add.reduceat(step_b, starts) == 0)
        kept = np.repeat(sound, count)
        depth, last = depth[kept], last[kept]
        winding_a, winding_b = np.cumsum(step_a[kept]), np.cumsum(step_b[kept])
        if not kept.any():
            return 0.0
    length = np.where(last, 0.0, np.diff(depth, append=depth[-1]))
    inside_a, inside_b = winding_a >= 1, winding_b >= 1
    either = length[inside_a | inside_b].sum()
    return float(length[inside_a & inside_b].sum() / either) if either > 0 else 0.0


# ---- meshes ----------------------------------------------------------------------------------------------------------


def is_closed(faces: ArrayLike) -> bool:
    """Whether every edge lies in exactly two faces that run along it in opposite directions.

    Args:
        faces: (F, 3) integer indices of vertices. No face at all counts as closed.
    """
    faces = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    if len(faces) == 0:
        return True
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    base = faces.max() + 1
    there, back = np.sort(start * base + end), np.sort(end * base + start)
    return bool((start != end).all() and (np.diff(there) > 0).all() and np.array_equal(there, back))


def inside_mesh(points: ArrayLike, mesh: trimesh.Trimesh) -> NDArray[np.bool_]:
    """Which points (N, 3) lie inside a mesh: generalised winding number > 0.5. Meaningful for open meshes too."""
    points = _checked_points(points)
    if len(points) == 0 or len(mesh.faces) == 0:
        return np.zeros(len(points), dtype=bool)
    return winding_number(mesh.vertices, mesh.faces, points) > 0.5


def point_to_mesh(points: ArrayLike, mesh: trimesh.Trimesh) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Exact distances from points to the surface of a mesh.

    Args:
        points: (N, 3), finite.
        mesh: with at least one face.

    Returns:
        distance (N,) and the index of the closest face (N,).
    """
    points = _checked_points(points)
    if len(mesh.faces) == 0:
        raise ValueError("mesh must have at least one face, got none")
    _, face, distance = ClosestPoints(mesh.vertices, mesh.faces)(points)
    return distance, face


def sample_surface(
    mesh: trimesh.Trimesh, count: int, *, generator: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points spread over the surface evenly by area, stratified: each of `count` equal shares of area gets one.

    Returns:
        points (count, 3) in the order of the faces, and the face of each (count,).

    Raises:
        ValueError: the mesh has no area.
    """
    triangles = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]  # (F, 3, 3)
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    total = np.cumsum(area)
    if len(area) == 0 or not (np.isfinite(total[-1]) and total[-1] > 0):
        raise ValueError("mesh must have a finite surface area above 0")
    at = (np.arange(count) + generator.random(count)) * (total[-1] / count)
    face = np.minimum(np.searchsorted(total, at, side="right"), len(area) - 1)
    root, split = np.sqrt(generator.random((count, 1))), generator.random((count, 1))
    corners = triangles[face]
    points = (1 - root) * corners[:, 0] + root * (1 - split) * corners[:, 1] + root * split * corners[:, 2]
    return points, face


THRESHOLDS = (0.005, 0.01, 0.02)


class SurfaceTruth:
    """A true shape with everything that does not depend on the prediction computed once.

    Protocol `surface` of the reports: `scores(mesh)` compares a mesh with the truth by exact point-to-mesh distances
    of surface samples in both directions, and by volume.

    Args:
        mesh: closed, wound outwards.
        samples: points on each of the two surfaces.
        lines: along which volumes are compared (see `volumetric_iou`).
        seed: of samples and lines.
    """

    def __init__(self, mesh: trimesh.Trimesh, *, samples: int = 100_000, lines: int = 1 << 14, seed: int = 0) -> None:
        if len(mesh.faces) == 0 or not is_closed(mesh.faces):
            raise ValueError("mesh must be closed, got one without faces or with open or inconsistently wound edges")
        self.mesh = mesh
        self.samples = samples
        self.seed = seed
        self.points, face = sample_surface(mesh, samples, generator=np.random.default_rng([seed, 0]))
        self.closest = ClosestPoints(mesh.vertices, mesh.faces)
        self.face_normals = _face_normals(mesh)
        self.normals = self.face_normals[face]
        self.lines = lines
        self.lattice = Lattice.over(_box(mesh), lines, seed)
        self.crossings = self.lattice.crossings(mesh)

    def scores(self, mesh: trimesh.Trimesh | None, *, thresholds: tuple[float, ...] = THRESHOLDS) -> dict[str, float]:
        """The measures of a predicted mesh; `None` or a mesh without area counts as empty.

        Returns:
            the keys `surface_keys(thresholds)`, the same in every case; `watertight` and `empty` are 0 or 1.

        Raises:
            ValueError: a vertex is not finite.
        """
        if mesh is not None and not np.isfinite(mesh.vertices).all():
            raise ValueError("mesh must have finite vertices, got NaN or infinity")
        if mesh is None or len(mesh.faces) == 0 or not mesh.area > 0:
            return _empty_scores(thresholds)
        points, face = sample_surface(mesh, self.samples, generator=np.random.default_rng([self.seed, 1]))
        normals = _face_normals(mesh)
        _, near_true, there = self.closest(points)
        back, near_predicted = point_to_mesh(self.points, mesh)
        consistency_there = np.abs((normals[face] * self.face_normals[near_true]).sum(axis=1)).mean()
        consistency_back = np.abs((self.normals * normals[near_predicted]).sum(axis=1)).mean()
        closed = is_closed(mesh.faces)
        iou = self.iou(mesh) if closed else self.iou_of_labels(mesh)
        scores = {
            "iou": iou,
            **_distance_scores(there, back, thresholds),
            "normal_consistency": (consistency_there + consistency_back) / 2,
            "watertight": closed,
            "empty": False,
        }
        return {name: float(scores[name]) for name in surface_keys(thresholds)}

    def scores_of_points(
        self, points: NDArray[np.floating], *, thresholds: tuple[float, ...] = THRESHOLDS
    ) -> dict[str, float]:
        """The measures of a predicted cloud (K, 3): exact distances to the true surface, and from its samples to the
        nearest predicted point. NaN where a measure needs faces: IoU, normals, watertight. No point counts as empty.
        """
        points = _checked_points(points)
        scores = _empty_scores(thresholds)
        if len(points):
            _, _, there = self.closest(points)
            back = cKDTree(points).query(self.points)[0]
            scores |= _distance_scores(there, back, thresholds) | {"empty": 0.0}
        return scores | dict.fromkeys(("iou", "normal_consistency", "watertight"), float("nan"))

    def iou(self, mesh: trimesh.Trimesh) -> float:
        """As `volumetric_iou(mesh, truth)`, on lines laid over the truth; wider ones for a far larger prediction."""
        extent, true_extent = np.ptp(mesh.vertices, axis=0).max(), np.ptp(self.mesh.vertices, axis=0).max()
        if extent > 3 * true_extent:
            return volumetric_iou(mesh, self.mesh, lines=self.lines, seed=self.seed)
        return _iou_along_lines(self.lattice.crossings(mesh), self.crossings)

    def iou_of_labels(self, mesh: trimesh.Trimesh) -> float:
        """For an open mesh: IoU of the winding numbers' labels at random points of the box of both."""
        corners = np.concatenate([_box(mesh), _box(self.mesh)])
        generator = np.random.default_rng([self.seed, 2])
        points = generator.uniform(corners.min(axis=0), corners.max(axis=0), (self.samples, 3))
        return float(volumetric_iou(inside_mesh(points, mesh), inside_mesh(points, self.mesh)))


def surface_keys(thresholds: tuple[float, ...] = THRESHOLDS) -> tuple[str, ...]:
    """The names of what `SurfaceTruth.scores` returns, in order."""
    return tuple(_empty_scores(thresholds))


def _distance_scores(
    there: NDArray[np.float64], back: NDArray[np.float64], thresholds: tuple[float, ...]
) -> dict[str, float]:
    """Of the distances prediction to truth, and truth to prediction."""
    scores = {
        "chamfer_l1": (there.mean() + back.mean()) / 2,
        "chamfer": np.square(there).mean() + np.square(back).mean(),
        **{f"f_score_{d:g}": _harmonic_mean((there < d).mean(), (back < d).mean()) for d in thresholds},
        "hausdorff_95": max(np.quantile(there, 0.95), np.quantile(back, 0.95)),
    }
    return {name: float(value) for name, value in scores.items()}


def _empty_scores(thresholds: tuple[float, ...]) -> dict[str, float]:
    return {
        "iou": 0.0,
        "chamfer_l1": float("inf"),
        "chamfer": float("inf"),
        **{f"f_score_{d:g}": 0.0 for d in thresholds},
        "normal_consistency": 0.0,
        "hausdorff_95": float("inf"),
        "watertight": 0.0,
        "empty": 1.0,
    }


class PaperTruth:
    """Protocol `paper` of the reports: the points labelled "in" among common samples, thinned to farthest points.

    Args:
        samples: (N, 3) common query points.
        inside: (N,) true labels.
        count: farthest points taken of each set (all of a smaller one).
        threshold: of the F-score.
    """

    def __init__(
        self, samples: NDArray[np.floating], inside: NDArray[np.bool_], *, count: int = 2048, threshold: float = 0.01
    ) -> None:
        self.samples = _checked_points(samples)
        self.inside = np.asarray(inside, dtype=bool)
        self.count = count
        self.threshold = threshold
        self.truth = self._thinned(self.samples[self.inside], start=0)

    def scores(self, inside: NDArray[np.bool_] | None) -> dict[str, float]:
        """Chamfer distance and F-score (eq. 9-12) of the points that a method labels "in"; `None`: it gave none."""
        if inside is None:
            inside = np.zeros(len(self.samples), dtype=bool)
        # Started at the other end, so that a perfect prediction shows the ceiling that the thinning allows.
        return self._compared(self._thinned(self.samples[inside], start=-1))

    def scores_of_points(self, points: NDArray[np.floating]) -> dict[str, float]:
        """The same for a predicted cloud (K, 3) in place of the samples labelled "in"."""
        return self._compared(self._thinned(_checked_points(points), start=-1))

    def _compared(self, predicted: Tensor) -> dict[str, float]:
        return {
            "chamfer": float(chamfer_distance(predicted, self.truth)),
            "f_score": float(f_score(predicted, self.truth, threshold=self.threshold)),
            "empty": float(len(predicted) == 0),
        }

    def _thinned(self, points: NDArray[np.float64], *, start: int) -> Tensor:
        rows = torch.from_numpy(points)
        return rows[farthest_point_sample(rows, min(self.count, len(rows)), start=start)]


def _box(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """The two corners (2, 3) of the box around the vertices that faces use."""
    used = np.asarray(mesh.vertices, dtype=np.float64)[np.unique(mesh.faces)]
    return np.stack([used.min(axis=0), used.max(axis=0)])


def _face_normals(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """(F, 3) unit normals; zero for faces without area, which trimesh would drop."""
    triangles = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1)


def _checked_points(points: ArrayLike) -> NDArray[np.float64]:
    array = np.ascontiguousarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"points must have shape (N, 3), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError("points must be finite, got NaN or infinity")
    return array
