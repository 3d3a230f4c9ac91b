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
from touchnet.data.dataset import TouchDataset
from touchnet.data.exploration import simulate_touches
from touchnet.explorer import Explorer
from touchnet.metrics import sample_surface, volumetric_iou
from touchnet.weights import load_model

START = 8  # touches at random points, before there is a surface to reason about
COUNTS = (16, 32, 64, 128, 256)
RESOLUTION = 64
LINES = 1 << 14
MOST_TRIES = 5  # pokes for each contact, after which a method has to do with what it has
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
        made: list[Contacts] = []
        tries = []
        attempt = 0
        while len(made) < count:
            attempt += 1
            aim, direction = rng.uniform(low, high), rng.normal(size=3)
            direction /= np.linalg.norm(direction)
            contact = self.poke(aim, direction, 2 * self.side, beyond=2 * self.side)
            if len(contact.points):
                made.append(contact)
                tries.append(attempt)
        return Contacts(*(np.concatenate(rows) for rows in zip(*made, strict=True))), np.array(tries)

    def poke(
        self, position: NDArray[np.float64], direction: NDArray[np.float64], path: float, beyond: float | None = None
    ) -> Contacts:
        """Where a finger that sets out `path` before a position and comes along a direction meets the surface: 1 or 0.

        0 where there is nothing up to `beyond` (REACH of the longest side) behind the position, and where the finger
        would have to set out from inside the object.
        """
        origin = position - path * direction
        depth, face = self.first_hit(origin, direction)
        if depth > path + (REACH * self.side if beyond is None else beyond):
            return Contacts(np.empty((0, 3)), np.empty((0, 3)))
        return Contacts((origin + depth * direction)[None], self.mesh.face_normals[face][None])

    def first_hit(self, origin: NDArray[np.float64], direction: NDArray[np.float64]) -> tuple[float, int]:
        """Depth along a ray of the first face, if it is met from outside, otherwise infinity; and the face."""
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
            hit = (determinant != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (depth >= 0)
        depth = np.where(hit, depth, np.inf)
        face = int(depth.argmin())
        entering = determinant[face] > 0
        return float(depth[face]) if entering else np.inf, face


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
            paths = zip(suggested.positions, suggested.directions, suggested.clearances, strict=True)
            for place, contact in zip(suggested.positions, [truth.poke(*path) for path in paths], strict=True):
                spent += 1
                if len(contact.points):
                    explorer.add(*contact)
                else:
                    explorer.add_misses(place)
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


if __name__ == "__main__":
    main()
