"""python -m benchmarks.closed_loop DATA: how many touches a shape takes, by who says where to touch.

Contacts on true shapes of a data set directory, a batch at a time, until a budget is spent; the shape is reconstructed
from the contacts so far and compared with the truth. docs/where_to_touch.md says what came of it.
"""

import argparse
import json
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

import touchnet
from touchnet.data.dataset import TouchDataset
from touchnet.data.exploration import simulate_touches
from touchnet.explorer import Explorer
from touchnet.metrics import sample_surface, volumetric_iou
from touchnet.weights import load_model

START = 8  # touches at random points, before there is a surface to reason about
COUNTS = (8, 16, 24, 32, 48, 64, 96, 128, 192, 256)
RESOLUTION = 96
LINES = 1 << 14
REACH = 0.3  # how far beyond the place suggested the finger goes on, as a share of the longest side


class Contacts(NamedTuple):
    points: NDArray[np.float64]
    normals: NDArray[np.float64]


class Truth:
    """A closed mesh that fingers meet."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.mesh = mesh
        self.corners = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]  # (F, 3, 3)
        self.side = float(np.ptp(mesh.vertices, axis=0).max())

    def random(self, count: int, seed: int) -> Contacts:
        """Touches spread at random, evenly by area, in random order: as if every place could be aimed at blindly."""
        rng = np.random.default_rng(seed)
        points, face = sample_surface(self.mesh, 4 * count, generator=rng)
        rows = rng.permutation(4 * count)[:count]
        return Contacts(points[rows], self.mesh.face_normals[face[rows]])

    def poke(self, position: NDArray[np.float64], direction: NDArray[np.float64], path: float) -> Contacts:
        """Where a finger that starts `path` before a position and comes along a direction meets the surface: 1 or 0."""
        origin = position - path * direction
        depth, face = self.first_hit(origin, direction)
        if depth > path + REACH * self.side:
            return Contacts(np.empty((0, 3)), np.empty((0, 3)))
        return Contacts((origin + depth * direction)[None], self.mesh.face_normals[face][None])

    def first_hit(self, origin: NDArray[np.float64], direction: NDArray[np.float64]) -> tuple[float, int]:
        """Depth along a ray of the first face it meets from outside, and the face; infinity where it meets none."""
        a, b, c = self.corners.transpose(1, 0, 2)
        e, f = b - a, c - a
        p = np.cross(direction, f)
        determinant = (e * p).sum(1)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = origin - a
            u = (t * p).sum(1) / determinant
            q = np.cross(t, e)
            v = (q @ direction) / determinant
            depth = (f * q).sum(1) / determinant
            # The determinant is positive where the ray enters.
            hit = (determinant > 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (depth >= 0)
        depth = np.where(hit, depth, np.inf)
        face = int(depth.argmin())
        return float(depth[face]), face


def advised(truth: Truth, explorer: Explorer, counts: tuple[int, ...], seed: int) -> Iterator[Contacts]:
    """Touches where the explorer says, one that meets nothing counted too; yields the contacts at each count."""
    explorer.add(*truth.random(START, seed))
    spent = START
    for count in counts:
        while spent < count:
            batch = min(count - spent, max(START, spent // 4))
            spent += batch
            positions, directions, _, _ = explorer.next(batch, refit=True)
            pokes = [truth.poke(p, d, 0.05 * truth.side) for p, d in zip(positions, directions, strict=True)]
            for place, contact in zip(positions, pokes, strict=True):
                if len(contact.points):
                    explorer.add(*contact)
                else:
                    explorer.add_misses(place)
        yield Contacts(explorer.points, explorer.normals)


def runs(truth: Truth, methods: dict[str, Callable[[], Explorer]], seed: int) -> dict[str, Iterator[Contacts]]:
    uniform = truth.random(COUNTS[-1], seed)
    paper = simulate_touches(truth.mesh, COUNTS[-1], seed=seed)
    planned = (simulate_touches(truth.mesh, count, seed=seed) for count in COUNTS)
    return {
        **{name: advised(truth, make(), COUNTS, seed) for name, make in methods.items()},
        "random": (Contacts(uniform.points[:n], uniform.normals[:n]) for n in COUNTS),
        "exploration": (Contacts(paper.points[:n], paper.normals[:n]) for n in COUNTS),
        "exploration, planned": (Contacts(t.points, t.normals) for t in planned),
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


def measure(truth: Truth, methods: dict[str, Callable[[], Explorer]], model: object, seed: int) -> list[dict]:
    """One record for each method and count: IoU of the reconstruction from the contacts so far."""
    records = []
    for method, contacts in runs(truth, methods, seed).items():
        for count, (points, normals) in zip(COUNTS, contacts, strict=True):
            try:
                mesh = touchnet.reconstruct_mesh(points, normals=normals, weights=model, resolution=RESOLUTION)
                iou = volumetric_iou(mesh, truth.mesh, lines=LINES)
            except ValueError:  # contacts that bound no solid, or no surface
                iou = 0.0
            records.append({"method": method, "touches": count, "contacts": len(points), "iou": iou})
    return records


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.closed_loop", description=__doc__)
    parser.add_argument("data", type=Path, help="a data set directory (touchnet simulate)")
    parser.add_argument("--split", default="test")
    parser.add_argument("--shapes", type=int, default=16, help="how many, from all categories in turn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--records", type=Path, required=True, help="JSON lines; shapes in it already are kept")
    arguments = parser.parse_args()

    warnings.simplefilter("ignore", UserWarning)
    touchnet.tune_allocator()
    model = load_model()
    methods = {"advice": lambda: Explorer(weights=model, resolution=64)}
    data = TouchDataset(arguments.data, split=arguments.split)
    arguments.records.touch()
    done = {json.loads(line)["shape"] for line in arguments.records.read_text().splitlines()}
    for i in chosen(data, arguments.shapes):
        shape = data.records[i].id
        if shape in done:
            continue
        records = measure(Truth(data.shape(i).mesh()), methods, model, arguments.seed)
        with arguments.records.open("a") as file:
            file.writelines(json.dumps({"shape": shape, **record}) + "\n" for record in records)
        print(shape, flush=True)


if __name__ == "__main__":
    main()
