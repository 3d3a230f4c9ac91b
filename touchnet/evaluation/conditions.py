"""Under which conditions a method is tried: how many contacts, how noisy, from which exploration, how turned."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple
from zlib import crc32

import numpy as np
import trimesh
from numpy.typing import NDArray

from touchnet.data.dataset import ShapeFile
from touchnet.data.exploration import simulate_touches
from touchnet.data.samples import contact_rows

if TYPE_CHECKING:
    from touchnet.evaluation.methods import Method
    from touchnet.evaluation.options import EvaluateConfig

TRUTH = "truth, resampled"  # the row that shows what each protocol's sampling lets a perfect method reach
STORED = "stored"  # the exploration of the data set's own trajectories
GIVEN = "given"  # the orientation of the data set's meshes
CONTACTS = (32, 64, 128, 256, 512, 1024, 2048)
NOISES = (0.0, 0.0025, 0.005, 0.01, 0.02)
STRATEGIES = ("uniform", "random_walk", "scan_lines")
ORIENTATIONS = ("up", "free")


class Condition(NamedTuple):
    """What a method gets of a shape."""

    contacts: int
    noise: float = 0.0  # standard deviation of the positions along each axis, in shares of the longest side
    strategy: str = STORED
    orientation: str = GIVEN


class Task(NamedTuple):
    """One reconstruction; for the truth itself numbers are 0."""

    method: str
    run: int  # which of the weights of the same name
    trajectory: int
    normals: bool
    contacts: int
    noise: float = 0.0
    strategy: str = STORED
    orientation: str = GIVEN

    @property
    def condition(self) -> Condition:
        return Condition(self.contacts, self.noise, self.strategy, self.orientation)


def conditions_of(config: EvaluateConfig) -> list[Condition]:
    """Every condition that is asked, those of the table first, each once."""
    curves = {"contacts", "noise", "strategy", "orientation"} if "all" in config.curves else set(config.curves)
    asked = [Condition(n) for n in config.contacts]
    if "contacts" in curves:
        asked += [Condition(n) for n in config.curve_counts]
    usual = Condition(config.curve_contacts)
    if curves - {"contacts"}:
        asked.append(usual)
    if "noise" in curves:
        asked += [usual._replace(noise=noise) for noise in config.noises]
    if "strategy" in curves:
        asked += [usual._replace(strategy=strategy) for strategy in config.strategies]
    if "orientation" in curves:
        asked += [usual._replace(orientation=orientation) for orientation in config.orientations]
    return list(dict.fromkeys(asked))


def tasks_of(config: EvaluateConfig, methods: Iterable[Method], trajectories: int) -> list[Task]:
    """All that is asked of a shape with that many stored trajectories."""
    asked = {"both": (True, False), "with": (True,), "without": (False,)}[config.normals]
    used = trajectories if config.trajectories is None else min(trajectories, config.trajectories)
    tasks = [Task(TRUTH, 0, 0, False, 0)]
    for method in methods:
        # A method without the choice runs its one way whatever was asked of those that have it.
        ways = [way for way in method.normals if way in asked] if len(method.normals) > 1 else method.normals
        tasks += [
            Task(method.name, run, k, way, *condition)
            for run in range(method.runs)
            for k in range(used)
            for condition in conditions_of(config)
            for way in ways
        ]
    return tasks


class Contacts(NamedTuple):
    """Contacts as a method sees them, and the turn that takes the true shape there."""

    points: NDArray[np.float64]  # (n, 3)
    normals: NDArray[np.float64]  # (n, 3)
    turn: NDArray[np.float64]  # (3, 3) rotation; points of the true shape are multiplied by it from the left


def contacts_of(shape: ShapeFile, name: str, task: Task, *, take: str, seed: int) -> Contacts:
    """The contacts of a task. What is drawn depends on seed, shape, trajectory and kind of disturbance alone, so
    stronger noise is the same noise, scaled.

    Args:
        shape: in unit coordinates (longest side 1).
        name: of the shape, for the seed.
        take: see `contact_rows`.
    """
    key = [seed, crc32(name.encode()), task.trajectory]
    if task.strategy == STORED:
        touches = shape.array("touches")[task.trajectory], shape.array("touch_normals")[task.trajectory]
    else:
        touches = _explored(shape, task.strategy, shape.shape("touches")[1], tuple(key))
    rows = contact_rows(len(touches[0]), task.contacts, take)
    points, normals = (np.asarray(part[rows], dtype=np.float64) for part in touches)
    if task.noise:
        points = points + task.noise * np.random.default_rng([*key, 1]).normal(size=points.shape)
    turn = turn_of(task.orientation, np.random.default_rng([*key, 2]))
    return Contacts(points @ turn.T, normals @ turn.T, turn)


@functools.lru_cache(maxsize=4)
def _explored(
    shape: ShapeFile, strategy: str, count: int, key: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    seed = int(np.random.default_rng([*key, 3]).integers(2**31))
    touches = simulate_touches(shape.mesh(), count, seed=seed, strategy=strategy)
    return touches.points, touches.normals


def turn_of(orientation: str, generator: np.random.Generator) -> NDArray[np.float64]:
    """A random rotation matrix (3, 3): none ("given"), about +y ("up"), or any ("free")."""
    if orientation == GIVEN:
        return np.eye(3)
    if orientation == "up":
        angle = generator.uniform(0, 2 * np.pi)
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    turn, upper = np.linalg.qr(generator.normal(size=(3, 3)))
    turn = turn * np.sign(np.diag(upper))  # evenly distributed over all rotations and reflections
    return turn * np.linalg.det(turn)  # in three dimensions minus a reflection is a rotation


def turned_back(
    result: trimesh.Trimesh | NDArray[np.float64] | None, turn: NDArray[np.float64]
) -> trimesh.Trimesh | NDArray[np.float64] | None:
    """A mesh or points (K, 3) in the frame of the true shape."""
    if result is None or np.array_equal(turn, np.eye(3)):
        return result
    if isinstance(result, trimesh.Trimesh):
        return trimesh.Trimesh(result.vertices @ turn, result.faces, process=False)
    return result @ turn


def unseen_categories(records: Sequence) -> list[str]:
    """Categories of which no shape is in the split `train`; none where there is no training shape at all."""
    trained = {record.category for record in records if record.split == "train"}
    return sorted({record.category for record in records} - trained) if trained else []
