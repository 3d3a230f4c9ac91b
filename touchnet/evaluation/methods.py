"""The methods that are compared: from contacts to a mesh or a cloud of points, called alike."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray

from touchnet import baselines
from touchnet.evaluation.conditions import TRUTH

if TYPE_CHECKING:
    from touchnet.evaluation.options import EvaluateConfig

Array = NDArray[np.float64]
Result = trimesh.Trimesh | NDArray[np.float64]  # a mesh, or points (K, 3)


class Method(NamedTuple):
    """One way from touches to a mesh or points."""

    name: str
    run: Callable[[Array, Array | None, EvaluateConfig, str], Result]  # contacts, normals, options, weights
    normals: tuple[bool, ...]  # runs with contact normals, without, or either
    needs: str | None = None  # a module that not every installation has
    files: tuple[str, ...] = ()  # of weights, one for each run

    @property
    def runs(self) -> int:
        return max(1, len(self.files))

    def weights(self, run: int, category: str) -> str:
        """File or name of the weights for a shape of that category; "" for a method without."""
        return self.files[run].replace("{category}", category) if self.files else ""


def _classical(name: str, reconstruct: Callable[..., Result], *, normals: bool, needs: str | None = None) -> Method:
    def run(points: Array, directions: Array | None, config: EvaluateConfig, weights: str) -> Result:
        return reconstruct(points, directions) if normals else reconstruct(points)

    return Method(name, run, (normals,), needs)


def _gaussian_process(points: Array, normals: Array | None, config: EvaluateConfig, weights: str) -> trimesh.Trimesh:
    return baselines.gaussian_process_surface(points, normals, resolution=config.resolution)


CLASSICAL = {
    method.name: method
    for method in (
        _classical("convex_hull", baselines.convex_hull, normals=False),
        _classical("alpha_shape", baselines.alpha_shape, normals=False),
        _classical("alpha_wrap", baselines.alpha_wrap, normals=False, needs="pymeshlab"),
        _classical("ball_pivoting", baselines.ball_pivoting, normals=True, needs="pymeshlab"),
        _classical("poisson", baselines.screened_poisson, normals=True, needs="pymeshlab"),
        Method("gpis", _gaussian_process, (True,)),
        Method("gpis_points", _gaussian_process, (False,)),
    )
}
LABELS = {"gpis": "GPIS", "gpis_points": "GPIS, surface only", "poisson": "screened Poisson"}


def methods_of(config: EvaluateConfig, categories: Sequence[str]) -> dict[str, Method]:
    """The methods asked for, by name, in a fixed order.

    Args:
        categories: of the shapes that will be asked.

    Raises:
        ValueError: --models does not read NAME=FILE, or a name is used twice.
        FileNotFoundError: there are no such weights.
    """
    asked = set(config.methods)
    if "all" in asked:
        asked |= {"model", *CLASSICAL}
    if "classical" in asked:
        asked |= set(CLASSICAL)
    found = {}
    if "model" in asked:
        found["model"] = network_method("model", config.weights, categories)
    for text in config.models:
        name, _, files = text.partition("=")
        if not name or not files:
            raise ValueError(f"models must read NAME=FILE, got {text!r}")
        if name in {"model", TRUTH, *CLASSICAL, *found}:
            raise ValueError(f"models: the name {name!r} is taken")
        found[name] = network_method(name, files, categories)
    return found | {name: method for name, method in CLASSICAL.items() if name in asked}


def network_method(name: str, files: str, categories: Sequence[str]) -> Method:
    """The method that runs the network in a file (see `EvaluateConfig.models`)."""
    from touchnet.weights import find_weights

    method = Method(name, _run_network, (True, False), files=tuple(files.split(",")))
    for run in range(method.runs):
        for category in categories:
            find_weights(method.weights(run, category))
    uses_normals = load(method.weights(0, categories[0])).uses_normals
    return method if uses_normals else method._replace(normals=(False,))


def label_of(methods: Mapping[str, Method], name: str, normals: bool) -> str:
    """How a method is called in tables and pictures."""
    label = LABELS.get(name, name.replace("_", " "))
    if name not in methods or len(methods[name].normals) == 1:
        return label
    return f"{label}, {'with' if normals else 'no'} normals"


def _run_network(points: Array, normals: Array | None, config: EvaluateConfig, weights: str) -> Result:
    from touchnet.completion import complete_points
    from touchnet.reconstruction import reconstruct_mesh

    network = load(weights)
    if network.predicts == "points":
        return complete_points(points, network, normals=normals, device=config.device)
    return reconstruct_mesh(
        points, normals=normals, weights=network, resolution=config.resolution, device=config.device
    )


@functools.lru_cache(maxsize=16)
def load(weights: str) -> torch.nn.Module:
    """The network in a file of weights, kept for the next call."""
    from touchnet.weights import load_model

    return load_model(weights)


@functools.lru_cache
def weights_digest(weights: str) -> str:
    """16 hexadecimal digits that stand for the values of the weights."""
    digest = hashlib.sha256()
    for name, tensor in sorted(load(weights).state_dict().items()):
        digest.update(name.encode() + tensor.contiguous().numpy().tobytes())
    return digest.hexdigest()[:16]
