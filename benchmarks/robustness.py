"""python -m benchmarks.robustness DATA: what bad touches cost, in IoU on the split test, mean over categories.

Three things that happen to a probe, each beside the same contacts without it: a tenth of the contacts is off by noise
of 1 % of the longest side (their normals stay), there are 256 contacts in place of 2048, a tenth of the contacts is
missing in whole strokes on one side. For the last the confidence at vertices that are nearer to a missing contact than
to any other stands beside the confidence elsewhere.
"""

import argparse
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np
import torch
import trimesh
from scipy.spatial import cKDTree

from touchnet import reconstruct_mesh
from touchnet.data.dataset import ShapeFile, TouchDataset
from touchnet.data.samples import contact_rows
from touchnet.metrics import volumetric_iou
from touchnet.metrics.surfaces import is_closed

SHARE, NOISE = 0.1, 0.01
FEW = 256


def without_a_side(points: np.ndarray, strokes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Which contacts (N,) are left when whole strokes on one side, a tenth of all contacts or more, are missing."""
    along = points @ rng.normal(size=3)
    names, inverse, counts = np.unique(strokes, return_inverse=True, return_counts=True)
    order = np.argsort(-np.bincount(inverse, along) / counts)
    before = np.concatenate([[0], np.cumsum(counts[order])[:-1]])
    missing = names[order[before < SHARE * len(points)]]
    kept = ~np.isin(strokes, missing)
    return kept if kept.sum() >= len(points) // 2 else np.ones(len(points), dtype=bool)


class Tally:
    """Scores by what was done, number of contacts and whether normals were known; all of them by category."""

    def __init__(self, weights: str) -> None:
        self.weights = weights
        self.iou: dict[tuple, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
        self.confidence: dict[bool, list[tuple[float, float]]] = defaultdict(list)
        self.closed = self.all = 0

    def reconstruct(self, key: tuple, category: str, truth: trimesh.Trimesh, points, normals) -> trimesh.Trimesh | None:
        self.all += 1
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            try:
                mesh = reconstruct_mesh(points, normals=normals, resolution=128, device="cpu", weights=self.weights)
            except ValueError:  # no surface
                self.iou[key][category].append(0.0)
                return None
        self.closed += is_closed(mesh.faces)
        self.iou[key][category].append(volumetric_iou(mesh, truth))
        return mesh

    def add(self, shape: ShapeFile, category: str, rng: np.random.Generator) -> None:
        truth = shape.mesh()
        touches = shape.array("touches")[0].astype(np.float64)
        directions = shape.array("touch_normals")[0].astype(np.float64)
        for known in (True, False):

            def run(name: str, n: int, points: np.ndarray, rows: np.ndarray, known: bool = known):
                normals = directions[rows] if known else None
                return self.reconstruct((name, n, known), category, truth, points, normals)

            for n in (2048, 512):
                rows = contact_rows(len(touches), n)
                points = touches[rows]
                run("as touched", n, points, rows)
                off = rng.random(len(points)) < SHARE
                noise = rng.normal(scale=NOISE * np.ptp(points, axis=0).max(), size=points.shape)
                run("a tenth noisy", n, points + off[:, None] * noise, rows)
                kept = without_a_side(points, shape.array("strokes")[0][rows], rng)
                mesh = run("a side missing", n, points[kept], rows[kept])
                if mesh is not None and not kept.all():
                    to_kept, to_missing = (cKDTree(points[mask]).query(mesh.vertices)[0] for mask in (kept, ~kept))
                    there, sure = to_missing < to_kept, mesh.vertex_attributes["confidence"]
                    if there.any():
                        self.confidence[known].append((float(sure[there].mean()), float(sure[~there].mean())))
            rows = contact_rows(len(touches), FEW)
            run("as touched", FEW, touches[rows], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path, help="data set directory")
    parser.add_argument("--split", default="test")
    parser.add_argument("--weights", default="default")
    parser.add_argument("--threads", type=int, default=None)
    options = parser.parse_args()
    if options.threads is not None:
        torch.set_num_threads(options.threads)
    data = TouchDataset(options.data, options.split)
    tally = Tally(options.weights)
    for index, record in enumerate(data.records):
        tally.add(data.shape(index), record.category, np.random.default_rng(index))
    print(f"{len(data)} shapes of split {options.split}; {tally.closed} of {tally.all} reconstructions closed")
    mean = {key: np.mean([np.mean(scores) for scores in found.values()]) for key, found in tally.iou.items()}
    for (name, n, known), value in sorted(mean.items()):
        beside = mean["as touched", 2048 if name == "as touched" else n, known]
        print(f"{name:>15} {n:5} {'with normals' if known else 'points alone'}: {value:.3f} ({value - beside:+.3f})")
    for known, pairs in tally.confidence.items():
        there, elsewhere = np.array(pairs).T
        print(
            f"confidence where a side is missing, {'with normals' if known else 'points alone'}: {there.mean():.2f} "
            f"there, {elsewhere.mean():.2f} elsewhere; lower there in {np.mean(there < elsewhere):.0%} of {len(pairs)}"
        )


if __name__ == "__main__":
    main()
