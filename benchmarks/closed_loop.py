"""python -m benchmarks.closed_loop DATA: how many touches a shape takes, by who says where to touch.

Contacts on true shapes of a data set directory, a batch at a time, until a budget is spent; the shape is reconstructed
from the contacts so far and compared with the truth. docs/where_to_touch.md says what came of it.
"""

import argparse
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

import touchnet
from touchnet.data.closest_points import ClosestPoints
from touchnet.data.dataset import TouchDataset
from touchnet.data.exploration import simulate_touches
from touchnet.explorer import Explorer
from touchnet.metrics import sample_surface, volumetric_iou
from touchnet.weights import load_model

START = 8  # touches at random points, before there is a surface to reason about
COUNTS = (16, 32, 64, 128, 256)
RESOLUTION = 64
LINES = 1 << 14
LABELS = {
    "advice": "advice of the explorer",
    "random pokes": "random pokes",
    "exploration": "exploration of the paper",
    "scattered": "scattered over the true surface",
}
MOST_TRIES = 5  # pokes for each contact, after which a method has to do with what it has
TOUCHES = 1e-4  # share of the longest side from the surface at which a finger touches
REACH = 0.3  # how far beyond the place suggested the finger goes on, as a share of the longest side


class Contacts(NamedTuple):
    points: NDArray[np.float64]
    normals: NDArray[np.float64]


class Truth:
    """A closed mesh that fingers meet."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.mesh = mesh
        self.closest = ClosestPoints(mesh.vertices, mesh.faces)
        self.side = float(np.ptp(mesh.vertices, axis=0).max())

    def scattered(self, count: int, seed: int) -> Contacts:
        """Contacts at random points of the surface, evenly by area: more than a finger that cannot see could do."""
        rng = np.random.default_rng(seed)
        points, face = sample_surface(self.mesh, 4 * count, generator=rng)
        rows = rng.permutation(4 * count)[:count]
        return Contacts(points[rows], self.mesh.face_normals[face[rows]])

    def random(self, count: int, seed: int) -> tuple[Contacts, NDArray[np.int64]]:
        """Contacts of a finger that aims from a random side at a random point of the object's box, and goes straight.

        With them the number of pokes (count,) it took up to each: some meet nothing.
        """
        rng = np.random.default_rng(seed)
        low, high = self.mesh.bounds
        made, tries, attempts = Contacts(np.empty((0, 3)), np.empty((0, 3))), np.empty(0, dtype=np.int64), 0
        while len(tries) < count:
            aim, direction = rng.uniform(low, high, (256, 3)), rng.normal(size=(256, 3))
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            contacts, met = self.poke(aim, direction, np.full(256, 2 * self.side), beyond=2 * self.side)
            made = Contacts(*(np.concatenate(rows) for rows in zip(made, contacts, strict=True)))
            tries = np.concatenate([tries, attempts + 1 + np.flatnonzero(met)])
            attempts += 256
        return Contacts(made.points[:count], made.normals[:count]), tries[:count]

    def poke(
        self,
        positions: NDArray[np.float64],
        directions: NDArray[np.float64],
        paths: NDArray[np.float64],
        beyond: float | None = None,
    ) -> tuple[Contacts, NDArray[np.bool_]]:
        """Where fingers that set out `paths` before positions (M, 3) and come along directions meet the surface.

        Nothing is met up to `beyond` (REACH of the longest side) behind a position, or where a finger would have to set
        out from inside the object.

        Returns:
            the contacts made, and which of the fingers (M,) made them.
        """
        origins = positions - paths[:, None] * directions
        last = paths + (REACH * self.side if beyond is None else beyond)
        depth, met = np.zeros(len(origins)), np.zeros(len(origins), dtype=bool)
        face = np.zeros(len(origins), dtype=np.int64)
        going = np.arange(len(origins))
        # No surface is nearer than the closest point: so far each finger may go at once.
        for _ in range(500):
            _, face[going], free = self.closest(origins[going] + depth[going, None] * directions[going])
            met[going] = free < TOUCHES * self.side
            depth[going] += np.where(met[going], 0, free)
            going = going[~met[going] & (depth[going] <= last[going])]
            if not len(going):
                break
        normals = self.mesh.face_normals[face]
        met &= (normals * directions).sum(axis=1) < 0
        points = origins + depth[:, None] * directions
        return Contacts(points[met], normals[met]), met


class Stage(NamedTuple):
    """What a method has after so many contacts."""

    contacts: Contacts
    tries: int  # pokes, those that met nothing included
    mesh: trimesh.Trimesh | None = None  # where the method made it already


def advised(truth: Truth, explorer: Explorer, seed: int) -> Iterator[Stage]:
    """Pokes where the explorer says, after a few at random; stages as COUNTS."""
    begin, tries = truth.random(START, seed)
    explorer.add(*begin)
    spent = int(tries[-1])
    for count in COUNTS:
        while len(explorer) < count and spent < MOST_TRIES * count:
            batch = min(count - len(explorer), max(START, len(explorer) // 4))
            try:
                suggested = explorer.next(batch)
            except ValueError:  # no surface, or none of it within reach
                contacts, tries = truth.random(batch, seed + spent)
                explorer.add(*contacts)
                spent += int(tries[-1])
                continue
            contacts, met = truth.poke(suggested.positions, suggested.directions, suggested.clearances)
            spent += batch
            explorer.add(*contacts)
            explorer.add_misses(suggested.positions[~met])
        yield Stage(Contacts(explorer.points, explorer.normals), spent, _mesh_of(explorer))


def _mesh_of(explorer: Explorer) -> trimesh.Trimesh | None:
    try:
        return explorer.mesh()
    except ValueError:
        return None


def runs(truth: Truth, model: object, seed: int) -> dict[str, Iterator[Stage]]:
    poked, tries = truth.random(COUNTS[-1], seed)
    scattered = truth.scattered(COUNTS[-1], seed)
    planned = ((n, simulate_touches(truth.mesh, n, seed=seed)) for n in COUNTS)
    return {
        "advice": advised(truth, Explorer(weights=model, resolution=RESOLUTION), seed),
        "random pokes": (Stage(Contacts(poked.points[:n], poked.normals[:n]), int(tries[n - 1])) for n in COUNTS),
        "exploration": (Stage(Contacts(t.points, t.normals), n) for n, t in planned),
        "scattered": (Stage(Contacts(scattered.points[:n], scattered.normals[:n]), n) for n in COUNTS),
    }


def chosen(data: TouchDataset, count: int) -> list[int]:
    """Rows of `count` shapes that come from as many categories as possible, spread over each."""
    rows = {
        category: [i for i, record in enumerate(data.records) if record.category == category]
        for category in data.categories
    }
    taken: list[int] = []
    for turn in range(max(map(len, rows.values()))):
        taken += [of[turn] for of in rows.values() if turn < len(of)]
    return taken[:count]


def measure(truth: Truth, model: object, seed: int) -> list[dict]:
    """One record for each method and count: IoU of the reconstruction from the contacts so far."""
    records = []
    for method, stages in runs(truth, model, seed).items():
        for count, ((points, normals), tries, mesh) in zip(COUNTS, stages, strict=True):
            try:
                if mesh is None:
                    mesh = touchnet.reconstruct_mesh(points, normals=normals, weights=model, resolution=RESOLUTION)
                iou = volumetric_iou(mesh, truth.mesh, lines=LINES)
            except ValueError:  # contacts that bound no solid, or no surface
                iou = 0.0
            records.append({"method": method, "contacts": count, "made": len(points), "tries": tries, "iou": iou})
    return records


class Curve(NamedTuple):
    """A method over all shapes, at COUNTS."""

    mean: NDArray[np.float64]
    low: NDArray[np.float64]  # 95 % of bootstrap samples of the shapes
    high: NDArray[np.float64]
    tries: NDArray[np.float64]


def curves(records: list[dict]) -> dict[str, Curve]:
    rng = np.random.default_rng(0)
    shapes = sorted({record["shape"] for record in records})
    found = {}
    for method in dict.fromkeys(record["method"] for record in records):
        mine = {(r["shape"], r["contacts"]): r for r in records if r["method"] == method}
        iou = np.array([[mine[shape, n]["iou"] for n in COUNTS] for shape in shapes])
        tries = np.array([[mine[shape, n]["tries"] for n in COUNTS] for shape in shapes])
        means = iou[rng.integers(len(shapes), size=(2000, len(shapes)))].mean(axis=1)
        found[method] = Curve(iou.mean(axis=0), *np.quantile(means, [0.025, 0.975], axis=0), tries.mean(axis=0))
    return found


def contacts_to_reach(iou: float, mean: NDArray[np.float64]) -> float:
    """Between COUNTS by the logarithm; infinity where it is not reached."""
    highest = np.maximum.accumulate(mean)
    if highest[-1] < iou:
        return np.inf
    return float(np.exp(np.interp(iou, highest, np.log(COUNTS)))) if iou > highest[0] else float(COUNTS[0])


def report(records: list[dict], figure: Path | None) -> None:
    found = curves(records)
    print(f"{len({record['shape'] for record in records})} shapes; mean IoU (95 % interval), pokes")
    print("contacts       " + "".join(f"{count:>24}" for count in COUNTS))
    for method, curve in found.items():
        rows = zip(curve.mean, curve.low, curve.high, curve.tries, strict=True)
        print(f"{method:<15}" + "".join(f"{f'{m:.3f} ({a:.3f}-{b:.3f}) {t:.0f}':>24}" for m, a, b, t in rows))
    shapes = sorted({record["shape"] for record in records})
    by = {(r["shape"], r["method"], r["contacts"]): r["iou"] for r in records}
    rng = np.random.default_rng(0)
    for method in [name for name in found if name != "advice"]:
        gain = np.array([[by[s, "advice", n] - by[s, method, n] for n in COUNTS] for s in shapes])
        means = gain[rng.integers(len(shapes), size=(2000, len(shapes)))].mean(axis=1)
        low, high = np.quantile(means, [0.025, 0.975], axis=0)
        cells = [f"{m:+.3f} ({a:+.3f} {b:+.3f})" for m, a, b in zip(gain.mean(axis=0), low, high, strict=True)]
        print(f"advice - {method:<15}" + "".join(f"{cell:>24}" for cell in cells))
    print("\ncontacts to reach an IoU of")
    for iou in (0.4, 0.5, 0.6, 0.65, 0.7, 0.75):
        print(f"{iou:>5}  " + ", ".join(f"{m} {contacts_to_reach(iou, c.mean):.0f}" for m, c in found.items()))
    if figure is not None:
        draw(found, figure)


def draw(found: dict[str, Curve], path: Path) -> None:
    from matplotlib.figure import Figure

    picture = Figure(figsize=(6, 4), layout="constrained")
    axes = picture.subplots()
    for method, curve in found.items():
        axes.plot(COUNTS, curve.mean, "o-", label=LABELS[method], zorder=3)
        axes.fill_between(COUNTS, curve.low, curve.high, alpha=0.12)
    axes.set(xscale="log", xlabel="contacts", ylabel="volumetric IoU, mean over the shapes")
    axes.set_xticks(COUNTS, map(str, COUNTS))
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend()
    picture.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.closed_loop", description=__doc__)
    parser.add_argument("data", type=Path, help="a data set directory (touchnet simulate)")
    parser.add_argument("--split", default="test")
    parser.add_argument("--shapes", type=int, default=16, help="how many, from all categories in turn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--records", type=Path, required=True, help="JSON lines; shapes in it already are kept")
    parser.add_argument("--figure", type=Path, help="PNG to write")
    arguments = parser.parse_args()

    warnings.simplefilter("ignore", UserWarning)
    touchnet.tune_allocator()
    model = load_model()
    data = TouchDataset(arguments.data, split=arguments.split)
    arguments.records.touch()
    done = {json.loads(line)["shape"] for line in arguments.records.read_text().splitlines()}
    for i in chosen(data, arguments.shapes):
        shape = data.records[i].id
        if shape in done:
            continue
        records = measure(Truth(data.shape(i).mesh()), model, arguments.seed)
        with arguments.records.open("a") as file:
            file.writelines(json.dumps({"shape": shape, **record}) + "\n" for record in records)
        print(shape, flush=True)
    report([json.loads(line) for line in arguments.records.read_text().splitlines()], arguments.figure)


if __name__ == "__main__":
    main()
