"""python -m benchmarks.confidence DATA: how true the expected errors of a reconstruction are.

    python -m benchmarks.confidence DATA --split val --fit                 # constants for touchnet/confidence.py
    python -m benchmarks.confidence DATA --figure docs/images/confidence.png   # the report, on the test split

Shapes of a data set directory are reconstructed from more and fewer contacts, with and without normals, finished
explorations, ones that stopped early, and ones that left out a side. Vertices drawn evenly by area are measured against
the true mesh.
"""

import argparse
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.stats import spearmanr

import touchnet
from touchnet.confidence import DEFAULT, TOLERANCE, Calibration, features, vertex_normals, within
from touchnet.data.closest_points import ClosestPoints
from touchnet.data.dataset import ShapeFile, TouchDataset
from touchnet.data.samples import contact_rows
from touchnet.frames import FILL, Frame
from touchnet.reconstruction import reconstruct_field
from touchnet.weights import load_model

SETTINGS = ((64, "spread"), (128, "spread"), (512, "spread"), (2048, "spread"), (256, "first"), (1024, "one side"))
VERTICES = 1500  # of each reconstruction
RESOLUTION = 96
BINS = 10


class Measured(NamedTuple):
    """Vertices of many reconstructions; lengths are shares of the longest side of the contacts."""

    group: NDArray[np.int64]  # (V,) the reconstruction each vertex is from
    features: NDArray[np.float64]  # (V, F)
    error: NDArray[np.float64]  # (V,) true distance to the true surface
    distance: NDArray[np.float64]  # (V,) to the nearest contact


def gather(data: TouchDataset, model: torch.nn.Module) -> Measured:
    parts = []
    for i in range(len(data)):
        shape = data.shape(i)
        mesh = shape.mesh()
        truth = ClosestPoints(mesh.vertices, mesh.faces)
        for number, (count, take) in enumerate(SETTINGS):
            for with_normals in (True, False):
                rng = np.random.default_rng([i, number, with_normals])
                part = reconstruction(shape, truth, model, count, take, with_normals, rng)
                if part is not None:
                    parts.append((np.full(len(part[1]), len(parts)), *part))
        print(f"{i + 1}/{len(data)} {data.records[i].id}", flush=True)
    return Measured(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def reconstruction(
    shape: ShapeFile,
    truth: ClosestPoints,
    model: torch.nn.Module,
    count: int,
    take: str,
    with_normals: bool,
    rng: np.random.Generator,
) -> tuple[NDArray, NDArray, NDArray] | None:
    """Features, true errors and distances to the nearest contact at vertices of one reconstruction."""
    trajectory = shape.array("touches")[0].astype(np.float64)
    rows = contact_rows(len(trajectory), count, "first" if take == "first" else "spread")
    if take == "one side":
        along = trajectory[rows] @ rng.normal(size=3)
        rows = rows[along < np.quantile(along, 0.85)]
    contacts = trajectory[rows]
    frame = Frame.fit(contacts)
    touches = frame.to_cube(contacts)
    normals = shape.array("touch_normals")[0, rows].astype(np.float32) if with_normals else None
    with torch.inference_mode():
        encoded = model.encode(
            torch.from_numpy(touches).float()[None], None if normals is None else torch.from_numpy(normals)[None]
        )

        def field(queries: torch.Tensor) -> torch.Tensor:
            return model.decode(encoded, queries[None])[0].float()

        try:
            mesh = reconstruct_field(field, frame, resolution=RESOLUTION, seeds=contacts, dtype=torch.float32)
        except ValueError:  # no surface
            return None
        share = np.bincount(mesh.faces.reshape(-1), np.repeat(mesh.area_faces, 3), minlength=len(mesh.vertices))
        chosen = rng.choice(len(share), size=VERTICES, p=share / share.sum())
        vertices = mesh.vertices[chosen]
        directions = vertex_normals(mesh.vertices, mesh.faces)[chosen]
        rows = features(field, frame.to_cube(vertices), directions, touches)
    side = FILL * frame.scale
    return rows, truth(vertices)[2] / side, cKDTree(contacts).query(vertices)[0] / side


def fit(measured: Measured) -> Calibration:
    """Coefficients ≥ 0 (but the constant) for the expected error, then the Weibull law's shape, by likelihood."""
    error = np.maximum(measured.error, 1e-5)

    def loss(coefficients: NDArray) -> tuple[float, NDArray]:
        # Of a gamma law: it is smallest where expectations are true on average, whatever the spread around them.
        log = measured.features @ coefficients
        ratio = error * np.exp(-log)
        return float((ratio + log).mean()), measured.features.T @ (1 - ratio) / len(ratio)

    start = np.array([np.log(error.mean()), *[0.0] * (measured.features.shape[1] - 1)])
    bounds = [(None, None)] + [(0.0, None)] * (len(start) - 1)
    coefficients = minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B").x
    expected = np.exp(measured.features @ coefficients)

    def misfit(shape: float) -> float:
        calibration = Calibration((), shape)
        return sum(
            abs(float((error <= t).mean() - within(expected, t, calibration=calibration).mean()))
            for t in (0.003, 0.005, TOLERANCE, 0.02, 0.03)
        )

    shape = min(np.arange(0.3, 2.0, 0.01), key=misfit)
    return Calibration(tuple(round(float(c), 3) for c in coefficients), round(float(shape), 2))


def expected_of(measured: Measured, calibration: Calibration) -> NDArray[np.float64]:
    return np.exp(measured.features @ np.array(calibration.coefficients))


def ranks(measured: Measured, values: NDArray) -> tuple[float, float]:
    """Spearman's correlation of values with the true error: mean over reconstructions, and over all vertices."""
    each = []
    for group in np.unique(measured.group):
        mine = measured.group == group
        each.append(spearmanr(values[mine], measured.error[mine])[0])
    return float(np.nanmean(each)), float(spearmanr(values, measured.error)[0])


def report(measured: Measured, calibration: Calibration, figure: Path | None) -> None:
    expected = expected_of(measured, calibration)
    confidence = within(expected, TOLERANCE, calibration=calibration)
    print(f"{measured.group.max() + 1} reconstructions, {len(expected)} vertices")
    for name, values in (("expected error", expected), ("distance to the nearest contact", measured.distance)):
        within_each, over_all = ranks(measured, values)
        print(f"Spearman, {name}: {within_each:.3f} within a reconstruction, {over_all:.3f} over all")
    print("\nexpected error, %   found, %     confidence   found within 1 %")
    tables = []
    for values, found in ((expected, measured.error), (confidence, (measured.error <= TOLERANCE).astype(float))):
        order = np.array_split(np.argsort(values), BINS)
        tables.append([(values[bin].mean(), found[bin].mean()) for bin in order])
    for (a, b), (c, d) in zip(*tables, strict=True):
        print(f"{100 * a:>17.2f}{100 * b:>11.2f}{c:>15.2f}{d:>19.2f}")
    if figure is not None:
        draw(tables, figure)


def draw(tables: list[list[tuple[float, float]]], path: Path) -> None:
    from matplotlib.figure import Figure

    picture = Figure(figsize=(8, 3.6), layout="constrained")
    left, right = picture.subplots(1, 2)
    predicted, found = 100 * np.array(tables[0]).T
    ends = [min(predicted.min(), found.min()) / 1.3, 1.3 * max(predicted.max(), found.max())]
    left.loglog(ends, ends, color="0.7", linewidth=1)
    left.loglog(predicted, found, "o-")
    ticks = [t for t in (0.1, 0.2, 0.5, 1, 2, 5, 10) if ends[0] <= t <= ends[1]]
    left.set_xticks(ticks, map(str, ticks))
    left.set_yticks(ticks, map(str, ticks))
    left.minorticks_off()
    left.set(xlabel="expected error, % of the longest side", ylabel="mean true error, %", xlim=ends, ylim=ends)
    right.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    right.plot(*np.array(tables[1]).T, "o-")
    right.set(xlabel="confidence", ylabel="share within 1 % of the longest side", xlim=(0, 1), ylim=(0, 1))
    picture.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.confidence", description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path, help="a data set directory (touchnet simulate)")
    parser.add_argument("--split", default="test")
    parser.add_argument("--weights", default="default")
    parser.add_argument(
        "--fit", action="store_true", help="fit the constants to this split instead of using those there are"
    )
    parser.add_argument("--figure", type=Path, help="PNG to write")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    arguments = parser.parse_args()

    warnings.simplefilter("ignore", UserWarning)
    torch.set_num_threads(arguments.threads)
    touchnet.tune_allocator()
    measured = gather(TouchDataset(arguments.data, split=arguments.split), load_model(arguments.weights))
    calibration = fit(measured) if arguments.fit else DEFAULT
    if arguments.fit:
        print(f"DEFAULT = {calibration}")
    report(measured, calibration, arguments.figure)


if __name__ == "__main__":
    main()
