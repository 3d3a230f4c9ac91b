"""Which reconstructions are asked, and what their contacts are."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.solids import TOUCHES, write_solids
from touchnet.data.dataset import TouchDataset
from touchnet.evaluation.conditions import (
    TRUTH,
    Condition,
    Task,
    conditions_of,
    contacts_of,
    tasks_of,
    turn_of,
    turned_back,
    unseen_categories,
)
from touchnet.evaluation.methods import CLASSICAL, Method
from touchnet.evaluation.options import EvaluateConfig
from touchnet.metrics import point_to_mesh

MODEL = Method("model", lambda *arguments: None, (True, False), files=("a", "b"))


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> TouchDataset:
    return TouchDataset(write_solids(tmp_path_factory.mktemp("data")))


def asked(**changes: object) -> EvaluateConfig:
    return dataclasses.replace(EvaluateConfig(data=Path(), contacts=(8,), trajectories=3), **changes)


def test_each_method_runs_with_its_kinds_of_input() -> None:
    tasks = tasks_of(asked(), [MODEL, CLASSICAL["convex_hull"], CLASSICAL["poisson"]], 2)
    assert tasks[0] == Task(TRUTH, 0, 0, False, 0)
    models = [t for t in tasks if t.method == "model"]
    assert [(t.run, t.trajectory, t.normals) for t in models[:4]] == [
        (0, 0, True),
        (0, 0, False),
        (0, 1, True),
        (0, 1, False),
    ]
    assert [t.run for t in models] == [0] * 4 + [1] * 4  # two files of weights
    # The hull never takes normals and Poisson always does, so each runs once a trajectory.
    assert [t for t in tasks if t.method == "convex_hull"] == [Task("convex_hull", 0, k, False, 8) for k in (0, 1)]
    assert [t for t in tasks if t.method == "poisson"] == [Task("poisson", 0, k, True, 8) for k in (0, 1)]
    without = tasks_of(asked(normals="without"), [MODEL], 4)
    assert [t.trajectory for t in without if t.run == 0 and t.method == "model"] == [0, 1, 2]
    assert not any(t.normals for t in without)


def test_curves_vary_one_thing_at_a_time() -> None:
    assert conditions_of(asked()) == [Condition(8)]
    counted = conditions_of(asked(curves=("contacts",), curve_counts=(4, 8, 16)))
    assert counted == [Condition(8), Condition(4), Condition(16)]
    curves = conditions_of(
        asked(
            curves=("all",),
            curve_contacts=16,
            curve_counts=(),
            noises=(0, 0.01),
            orientations=("up",),
            strategies=("uniform",),
        )
    )
    usual = Condition(16)
    assert curves == [
        Condition(8),
        usual,
        usual._replace(noise=0.01),
        usual._replace(strategy="uniform"),
        usual._replace(orientation="up"),
    ]


def test_noise_grows_but_stays_the_same_noise(data: TouchDataset) -> None:
    shape = data.shape(0)
    still, some, more = (
        contacts_of(shape, "ball/round", Task("m", 0, 1, True, TOUCHES, noise), take="spread", seed=3)
        for noise in (0.0, 0.01, 0.02)
    )
    assert np.array_equal(still.points, shape.array("touches")[1].astype(float))
    assert np.allclose(more.points - still.points, 2 * (some.points - still.points))
    assert np.std(some.points - still.points) == pytest.approx(0.01, rel=0.15)
    other = contacts_of(shape, "ball/other", Task("m", 0, 1, True, TOUCHES, 0.01), take="spread", seed=3)
    assert not np.array_equal(other.points, some.points)


@pytest.mark.parametrize("orientation", ["up", "free"])
def test_a_turned_object_is_turned_back(data: TouchDataset, orientation: str) -> None:
    shape = data.shape(2)
    task = Task("m", 0, 0, True, TOUCHES, orientation=orientation)
    given = contacts_of(shape, "box/cube", task._replace(orientation="given"), take="spread", seed=0)
    turned = contacts_of(shape, "box/cube", task, take="spread", seed=0)
    assert np.array_equal(given.turn, np.eye(3)) and not np.allclose(turned.points, given.points, atol=0.01)
    assert np.linalg.det(turned.turn) == pytest.approx(1) and np.allclose(turned.turn @ turned.turn.T, np.eye(3))
    assert np.allclose(turned_back(turned.points, turned.turn), given.points)
    assert np.allclose(turned_back(turned.normals, turned.turn), given.normals)
    mesh = trimesh.Trimesh(shape.mesh().vertices @ turned.turn.T, shape.mesh().faces, process=False)
    assert np.allclose(turned_back(mesh, turned.turn).vertices, shape.mesh().vertices)
    assert turned_back(None, turned.turn) is None
    if orientation == "up":
        assert np.allclose(turned.turn @ [0, 1, 0], [0, 1, 0])


def test_free_turns_favour_no_direction() -> None:
    turns = np.array([turn_of("free", np.random.default_rng(k)) for k in range(2000)])
    assert np.abs(turns.mean(axis=0)).max() < 0.06


def test_other_explorations_touch_the_shape(data: TouchDataset) -> None:
    shape = data.shape(2)
    touched = [
        contacts_of(shape, "box/cube", Task("m", 0, k, True, 32, strategy=strategy), take="spread", seed=0).points
        for strategy, k in (("uniform", 0), ("scan_lines", 0), ("uniform", 1), ("uniform", 0))
    ]
    for points in touched:
        assert points.shape == (32, 3) and point_to_mesh(points, shape.mesh())[0].max() < 1e-6
    assert np.array_equal(touched[0], touched[3])
    assert not np.allclose(touched[0], touched[1]) and not np.allclose(touched[0], touched[2])


def test_unseen_are_the_categories_without_training_shapes(data: TouchDataset) -> None:
    assert unseen_categories(data.records) == []  # nothing was trained on: no difference to tell
    records = [record._replace(split="train") if record.category == "box" else record for record in data.records]
    assert unseen_categories(records) == ["ball"]
