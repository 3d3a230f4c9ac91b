"""The two protocols of the reports, each with what does not depend on the prediction computed once for a true shape."""

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from touchnet.data.closest_points import ClosestPoints
from touchnet.farthest import farthest_point_sample
from touchnet.metrics.clouds import chamfer_distance, f_score, harmonic_mean
from touchnet.metrics.surfaces import (
    checked_points,
    face_normals_of,
    inside_mesh,
    is_closed,
    point_to_mesh,
    sample_surface,
)
from touchnet.metrics.volumes import Lattice, box_of, iou_along_lines, volumetric_iou

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
        self.face_normals = face_normals_of(mesh)
        self.normals = self.face_normals[face]
        self.lines = lines
        self.lattice = Lattice.over(box_of(mesh), lines, seed)
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
        normals = face_normals_of(mesh)
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
        points = checked_points(points)
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
        return iou_along_lines(self.lattice.crossings(mesh), self.crossings)

    def iou_of_labels(self, mesh: trimesh.Trimesh) -> float:
        """For an open mesh: IoU of the winding numbers' labels at random points of the box of both."""
        corners = np.concatenate([box_of(mesh), box_of(self.mesh)])
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
        **{f"f_score_{d:g}": harmonic_mean((there < d).mean(), (back < d).mean()) for d in thresholds},
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
        self.samples = checked_points(samples)
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
        return self._compared(self._thinned(checked_points(points), start=-1))

    def _compared(self, predicted: Tensor) -> dict[str, float]:
        return {
            "chamfer": float(chamfer_distance(predicted, self.truth)),
            "f_score": float(f_score(predicted, self.truth, threshold=self.threshold)),
            "empty": float(len(predicted) == 0),
        }

    def _thinned(self, points: NDArray[np.float64], *, start: int) -> Tensor:
        rows = torch.from_numpy(points)
        return rows[farthest_point_sample(rows, min(self.count, len(rows)), start=start)]
