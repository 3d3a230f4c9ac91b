"""One shape: its reconstructions by every method under every condition, measured, and its row of pictures."""

from __future__ import annotations

import functools
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import trimesh

from touchnet.data.dataset import ShapeFile, TouchDataset
from touchnet.data.samples import contact_rows
from touchnet.evaluation.conditions import GIVEN, STORED, TRUTH, Task, contacts_of, turned_back
from touchnet.evaluation.memory import measured_memory
from touchnet.evaluation.methods import Method, Result, label_of
from touchnet.evaluation.options import EvaluateConfig
from touchnet.evaluation.pictures import draw_strip
from touchnet.metrics import THRESHOLDS, PaperTruth, SurfaceTruth, inside_mesh, surface_keys

PAPER_SAMPLES = 4096  # of each kind (each sigma of `near`, and `box`) in the protocol `paper`
PAPER_COUNT = 2048
PAPER_THRESHOLD = 0.01
TRIED_WITH = 64  # contacts of the reconstruction that loads weights and libraries before anything is timed


class ShapeJob(NamedTuple):
    """What is asked of one shape."""

    index: int
    tasks: Sequence[Task]
    picture: Path | None  # where to draw its row


def result_keys(config: EvaluateConfig) -> list[str]:
    """Names of the measured columns."""
    keys = ["seconds", "memory", "faces"]
    if "surface" in config.protocols:
        keys += surface_keys(THRESHOLDS)
    if "paper" in config.protocols:
        keys += ["paper_chamfer", "paper_f_score", "paper_empty"]
    return keys


def evaluate_shape(config: EvaluateConfig, methods: Mapping[str, Method], job: ShapeJob) -> list[dict[str, Any]]:
    """Reconstructs and measures the tasks of one shape; draws its row of the gallery if a path is given.

    A method that finds no surface (raises ValueError) gives an empty result with the reason in `note`.
    """
    if config.jobs > 1:
        torch.set_num_threads(1)
    data = open_data(config)
    record, shape = data.records[job.index], data.shape(job.index)
    mesh = shape.mesh()
    try:
        truth = SurfaceTruth(mesh, samples=config.samples, seed=config.seed)
    except ValueError as error:
        raise ValueError(f"{record.id}: {error}") from None
    paper = (
        paper_truth(shape, len(data.parameters.get("sigmas", (0.01, 0.05)))) if "paper" in config.protocols else None
    )
    rows, drawn = [], {}
    for task in job.tasks:
        result, cost, notes = _reconstruct(config, methods, task, record.id, record.category, shape, mesh)
        row: dict[str, Any] = {"shape": record.id, "category": record.category, **task._asdict(), **cost}
        row["faces"] = len(result.faces) if isinstance(result, trimesh.Trimesh) else 0
        if "surface" in config.protocols:
            row |= truth.scores_of_points(result) if isinstance(result, np.ndarray) else truth.scores(result)
        if paper is not None:
            row |= {f"paper_{key}": value for key, value in _paper_scores(paper, result).items()}
        row["note"] = "; ".join(" ".join(note.split()) for note in notes)
        rows.append(row)
        if is_drawn(config, task):
            drawn[label_of(methods, task.method, task.normals)] = result
    if job.picture is not None:
        touches = shape.array("touches")[0].astype(np.float64)
        shown = contact_rows(len(touches), max(config.contacts), config.take)
        draw_strip(job.picture, touches[shown], drawn, mesh, None if paper is None else paper.samples)
    return rows


def _reconstruct(
    config: EvaluateConfig,
    methods: Mapping[str, Method],
    task: Task,
    name: str,
    category: str,
    shape: ShapeFile,
    mesh: trimesh.Trimesh,
) -> tuple[Result | None, dict[str, float], list[str]]:
    """The result of a task in unit coordinates (None: no surface), what it cost, and what was said."""
    cost = {"seconds": 0.0, "memory": 0.0}
    if task.method == TRUTH:
        return mesh, cost, []
    contacts = contacts_of(shape, name, task, take=config.take, seed=config.seed)
    method, notes = methods[task.method], []
    weights = method.weights(task.run, category)
    _try_once(method, weights, config.device, task.normals)
    result = None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with measured_memory(cost):
            start = time.perf_counter()
            try:
                result = method.run(contacts.points, contacts.normals if task.normals else None, config, weights)
            except ValueError as error:
                notes.append(str(error))
            cost["seconds"] = time.perf_counter() - start
    notes += sorted({str(warning.message) for warning in caught})
    return turned_back(result, contacts.turn), cost, notes


def _paper_scores(paper: PaperTruth, result: Result | None) -> dict[str, float]:
    if isinstance(result, np.ndarray):
        return paper.scores_of_points(result)
    return paper.scores(None if result is None else inside_mesh(paper.samples, result))


_tried: set[tuple[str, str]] = set()


def _try_once(method: Method, weights: str, device: str, normals: bool) -> None:
    """Reconstructs a ball before the first time counts, so that loading weights and libraries is not part of it."""
    if (method.name, weights) in _tried:
        return
    _tried.add((method.name, weights))
    points = np.random.default_rng(0).normal(size=(TRIED_WITH, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    config = EvaluateConfig(data=Path(), resolution=32, device=device)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            method.run(points, points if normals else None, config, weights)
        except ValueError:
            pass


def is_drawn(config: EvaluateConfig, task: Task) -> bool:
    """Whether the result belongs into the gallery: the first of its method at most contacts, undisturbed."""
    undisturbed = (task.noise, task.strategy, task.orientation) == (0.0, STORED, GIVEN)
    return (
        task.method != TRUTH
        and task.trajectory == task.run == 0
        and task.contacts == max(config.contacts)
        and undisturbed
    )


@functools.lru_cache(maxsize=1)
def _opened(directory: Path, split: str | None, categories: tuple[str, ...]) -> TouchDataset:
    return TouchDataset(directory, split, categories=categories or None)


def open_data(config: EvaluateConfig) -> TouchDataset:
    """The shapes that are asked."""
    return _opened(config.data, None if config.split == "all" else config.split, config.categories)


def paper_truth(shape: ShapeFile, kinds: int) -> PaperTruth:
    """The common samples: the first points of each displacement of `near`, and of `box`."""
    near, near_inside = shape.array("near"), shape.inside("near")
    share = len(near) // kinds
    first = np.concatenate([np.arange(k * share, k * share + min(PAPER_SAMPLES, share)) for k in range(kinds)])
    samples = np.concatenate([near[first], shape.rows("box", 0, PAPER_SAMPLES)])
    inside = np.concatenate([near_inside[first], shape.inside("box")[:PAPER_SAMPLES]])
    return PaperTruth(samples, inside, count=PAPER_COUNT, threshold=PAPER_THRESHOLD)
