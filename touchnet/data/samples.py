"""Training and validation samples: a shape's touches and labelled points, moved together into the model's cube."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from torch.utils.data import Dataset

from touchnet.config import SampleConfig
from touchnet.data.dataset import ShapeFile, TouchDataset
from touchnet.frames import Frame

NO_SHAPES = "data: there is no shape to train on (see its split, categories and licences)"


class Sample(NamedTuple):
    """Arrays in cube coordinates; collated by torch's default collate function into a batch of tensors."""

    touches: np.ndarray  # (N, 3) float32, rows of NaN are padding
    normals: np.ndarray  # (N, 3) float32, zero where unknown
    queries: np.ndarray  # (M, 3) float32
    inside: np.ndarray  # (M,) float32, 1 inside, 0 outside
    targets: np.ndarray  # (K, 3) float32, points of the true surface
    index: int  # row of TouchDataset.records
    key: int  # 63 random bits: what a network draws itself is seeded with them


class TrainingSamples(Dataset):
    """Samples keyed by (epoch, item): every draw comes from a generator seeded with (seed, epoch, item) alone, so that
    batches do not depend on workers, on processes or on where a run was resumed.

    An item is one trajectory of one shape; `len` is their number (shapes, where no trajectory is stored).
    """

    def __init__(self, data: TouchDataset, config: SampleConfig, *, seed: int = 0) -> None:
        if len(data) == 0:
            raise ValueError(NO_SHAPES)
        self.data, self.config, self.seed = data, config, seed
        shapes = [data.shape(i) for i in range(len(data))]
        trajectories = [max(1, len(shape.array("touches"))) for shape in shapes]
        self._items = np.repeat(np.arange(len(data)), trajectories)
        self._first = np.concatenate([[0], np.cumsum(trajectories)])
        self._extents = [np.ptp(shape.array("vertices"), axis=0) for shape in shapes]

    def __len__(self) -> int:
        return len(self._items)

    def weights(self, balance: float) -> np.ndarray:
        """Of each item (len,): the number of items in its category to the power -balance."""
        categories = np.array([record.category for record in self.data.records])[self._items]
        names, counts = np.unique(categories, return_counts=True)
        return counts[np.searchsorted(names, categories)] ** -float(balance)

    def __getitem__(self, key: tuple[int, int]) -> Sample:
        epoch, item = key
        rng = np.random.default_rng([self.seed, epoch, item])
        index = int(self._items[item])
        shape = self.data.shape(index)
        config = self.config
        contacts, normals = _draw_contacts(shape, item - int(self._first[index]), config, rng)
        if not (np.isfinite(contacts).all() and np.isfinite(normals).all()):
            raise ValueError(f"shape {self.data.records[index].id}: its touches hold values that are not finite")

        transform = _draw_transform(config, rng)
        contacts, normals = contacts @ transform.T, _unit(normals @ np.linalg.inv(transform))
        if rng.random() < config.noise:
            side = np.ptp(contacts, axis=0).max()
            sigma = config.noise_sigma * side * rng.random() ** 2
            contacts = contacts + rng.normal(scale=sigma, size=contacts.shape)
            normals = _unit(normals + rng.normal(scale=np.deg2rad(10) * rng.random(), size=normals.shape))
        if rng.random() < config.no_normals:
            normals = np.zeros_like(normals)
        frame = Frame.fit(contacts)
        queries, inside = _draw_queries(shape, self._extents[index], transform, frame, config, rng)
        targets = _draw_targets(shape, transform, frame, config.targets, rng)
        return Sample(
            _padded(frame.to_cube(contacts), config.max_contacts, np.nan),
            _padded(normals, config.max_contacts, 0.0),
            queries.astype(np.float32),
            inside.astype(np.float32),
            targets,
            index,
            int(rng.integers(2**63)),
        )


def contact_rows(stored: int, wanted: int, take: str = "spread") -> np.ndarray:
    """Which `wanted` rows of a trajectory of `stored` contacts are used (all, where it has fewer).

    Args:
        take: "spread" evenly along it (a probe that reports less often), or the "first" ones (not all sides seen yet).
    """
    if take == "first" or wanted >= stored:
        return np.arange(min(stored, wanted))
    return np.arange(wanted) * stored // wanted


def validation_sample(
    shape: ShapeFile, contacts: int, *, normals: bool, index: int = 0, queries: int = 16384
) -> Sample:
    """`contacts` contacts spread over the first trajectory and uniform labelled points of the shape's box, unmoved."""
    trajectory = shape.array("touches")[0]
    rows = contact_rows(len(trajectory), contacts)
    touches = trajectory[rows].astype(np.float64)
    directions = shape.array("touch_normals")[0, rows].astype(np.float64)
    frame = Frame.fit(touches)
    points = frame.to_cube(np.asarray(shape.rows("box", 0, queries), dtype=np.float64))
    return Sample(
        frame.to_cube(touches).astype(np.float32),
        (directions if normals else np.zeros_like(directions)).astype(np.float32),
        points.astype(np.float32),
        shape.inside("box")[:queries].astype(np.float32),
        frame.to_cube(np.asarray(shape.array("surface"), dtype=np.float64)).astype(np.float32),
        index,
        index,
    )


def _draw_contacts(
    shape: ShapeFile, trajectory: int, config: SampleConfig, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Contacts (n, 3) and outward normals (n, 3) in unit coordinates, float64."""
    low, high = np.log(config.min_contacts), np.log(config.max_contacts + 1)
    n = min(int(np.exp(rng.uniform(low, high))), config.max_contacts)
    touches = shape.array("touches")
    if touches.shape[0] == 0 or rng.random() < config.uniform_contacts:
        surface = shape.array("surface")
        rows = rng.choice(len(surface), size=min(n, len(surface)), replace=False)
        contacts, normals = surface[rows], shape.array("surface_normals")[rows]
    else:
        contacts, normals = touches[trajectory], shape.array("touch_normals")[trajectory]
        # Half of the time the exploration so far, half of the time a finished one at a lower rate.
        n = min(n, len(contacts))
        rows = np.arange(n) if rng.random() < 0.5 else np.sort(rng.choice(len(contacts), size=n, replace=False))
        contacts, normals = contacts[rows], normals[rows]
    contacts, normals = np.asarray(contacts, dtype=np.float64), np.asarray(normals, dtype=np.float64)
    if rng.random() < config.one_side:
        side = contacts @ _unit(rng.normal(size=3))
        kept = side < np.quantile(side, rng.uniform(0.75, 0.95))
        contacts, normals = contacts[kept], normals[kept]
    return contacts, normals


def _draw_transform(config: SampleConfig, rng: np.random.Generator) -> np.ndarray:
    """(3, 3) matrix applied to the unit shape: a stretch along its axes, then a turn (and a mirror)."""
    stretch = np.ones(3)
    if rng.random() < config.stretch:
        stretch = np.exp(rng.uniform(-np.log(4 / 3), np.log(4 / 3), size=3))
    kind = rng.random()
    if kind < config.rotate_free:
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    else:
        quarter = np.pi / 2 * rng.integers(4)
        angle = rng.uniform(0, 2 * np.pi) if kind < config.rotate_free + config.rotate_up else quarter
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        if rng.random() < 0.5:
            turn = turn @ np.diag([-1.0, 1.0, 1.0])
    return turn @ np.diag(stretch)


def _draw_queries(
    shape: ShapeFile,
    extents: np.ndarray,
    transform: np.ndarray,
    frame: Frame,
    config: SampleConfig,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Exactly config.queries points of the cube (M, 3) and their labels (M,)."""
    near = round(config.queries * config.near_share)
    uniform = config.queries - near
    points, inside = [], []
    # The stored near points are ordered by sigma: as many from each half.
    stored = len(shape.array("near"))
    halves = ("near", 0, stored // 2, near // 2), ("near", stored // 2, stored, near - near // 2)
    whole = ("box", 0, len(shape.array("box")), uniform)
    for name, begin, end, count in (*halves, whole):
        # A fifth more than needed: the points outside the cube are dropped.
        count = min(end - begin, count + count // 5)
        start = int(rng.integers(begin, end - count + 1))
        points.append(_to_cube(shape.rows(name, start, start + count), transform, frame))
        inside.append(shape.inside(name)[start : start + count])
    far = rng.uniform(-1, 1, size=(uniform, 3))
    unit = frame.from_cube(far) @ np.linalg.inv(transform).T
    outside_box = (np.abs(unit) > extents / 2).any(axis=1)
    points.append(far[outside_box])
    inside.append(np.zeros(int(outside_box.sum()), dtype=bool))

    wanted = (near // 2, near - near // 2, uniform - uniform // 2, uniform // 2)
    valid = [np.flatnonzero((np.abs(part) <= 1).all(axis=1)) for part in points]
    offsets = np.cumsum([0, *(len(part) for part in points[:-1])])
    rows = np.concatenate([part[:n] + at for part, n, at in zip(valid, wanted, offsets, strict=True)])
    short = config.queries - len(rows)
    if short:
        # Where one kind runs out (the touches' cube cuts the object, or the box fills the cube) the others stand in.
        every = np.concatenate([part + at for part, at in zip(valid, offsets, strict=True)])
        if len(every) == 0:
            raise ValueError("no labelled point of the shape lies in the cube of its touches")
        spare = np.setdiff1d(every, rows)
        rows = np.concatenate(
            [rows, rng.choice(spare if len(spare) else every, size=short, replace=len(spare) < short)]
        )
    return np.concatenate(points)[rows], np.concatenate(inside)[rows]


def _draw_targets(
    shape: ShapeFile, transform: np.ndarray, frame: Frame, count: int, rng: np.random.Generator
) -> np.ndarray:
    """(count, 3) points of the surface in the cube, float32; all different where the shape stores as many."""
    if count == 0:
        return np.empty((0, 3), dtype=np.float32)
    surface = shape.array("surface")
    rows = rng.choice(len(surface), size=count, replace=len(surface) < count)
    return _to_cube(surface[rows], transform, frame).astype(np.float32)


def _to_cube(points: np.ndarray, transform: np.ndarray, frame: Frame) -> np.ndarray:
    return frame.to_cube(np.asarray(points, dtype=np.float64) @ transform.T)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _padded(rows: np.ndarray, n: int, value: float) -> np.ndarray:
    padded = np.full((n, 3), value, dtype=np.float32)
    padded[: len(rows)] = rows
    return padded
