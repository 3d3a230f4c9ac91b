"""python -m benchmarks.coverage DATA: how well explorations of 2048 contacts cover real shapes (docs/exploration.md).

The first shape of each category of a data set directory's test split is explored anew by each strategy. Coverage is the
share of the surface within a radius of a contact, "far" the 99th percentile of the distance from the surface to the
nearest contact; both in shares of the longest side, the mean over shapes.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from touchnet.data import Surface, coverage, simulate_touches
from touchnet.data.dataset import TouchDataset

STRATEGIES = ("gp", "scan_lines", "random_walk")
SETTINGS = ((128, 0.05), (512, 0.05), (2048, 0.03))  # contacts used, radius


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path, help="data set directory; its split test is used")
    options = parser.parse_args()
    data = TouchDataset(options.data, "test")
    first = {record.category: index for index, record in reversed(list(enumerate(data.records)))}
    found: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for index in sorted(first.values()):
        mesh = data.shape(index).mesh()
        surface = Surface(mesh)
        at, _ = surface.sample(50_000, np.random.default_rng(0))
        for strategy in STRATEGIES:
            points = simulate_touches(surface, 2048, seed=0, strategy=strategy).points
            for count, radius in SETTINGS:
                share = coverage(mesh, points[:count], radius=radius, samples=50_000)
                distance, _ = cKDTree(surface.from_mesh(points[:count])).query(at)
                found.setdefault((strategy, count), []).append((share, float(np.percentile(distance, 99))))
    print(f"{len(first)} shapes; coverage / far")
    print("| contacts used | " + " | ".join(STRATEGIES) + " |")
    for count, radius in SETTINGS:
        cells = [np.mean(found[strategy, count], axis=0) for strategy in STRATEGIES]
        print(f"| {count}, r = {radius} | " + " | ".join(f"{share:.3f} / {far:.3f}" for share, far in cells) + " |")


if __name__ == "__main__":
    main()
