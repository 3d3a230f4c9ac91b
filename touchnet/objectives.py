"""What a network is trained for: the loss of a batch, the figures of a validation, the result that a picture shows.

Networks of one kind (`predicts`) share an objective; training itself does not tell them apart.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
import trimesh
from torch import Tensor, nn
from torch.utils.data import default_collate

from touchnet.completion import complete_points
from touchnet.data.dataset import TouchDataset
from touchnet.data.samples import Sample, validation_sample
from touchnet.frames import FILL
from touchnet.losses import Loss, occupancy_loss, points_loss
from touchnet.metrics import chamfer_distance, f_score, volumetric_iou
from touchnet.reconstruction import reconstruct_mesh

VALIDATION = ((2048, True), (512, True), (128, True), (2048, False), (512, False), (128, False))
THRESHOLD = 0.01  # of the F-score, in shares of the contacts' longest side


class Objective(Protocol):
    """One for each kind of output."""

    def loss(self, network: nn.Module, batch: Sample, kind: Loss) -> Tensor:
        """Mean over a batch of tensors: a scalar."""

    def scores(self, network: nn.Module, sample: Sample) -> dict[str, float]:
        """Of a batch of one, without gradients."""

    def result(self, network: nn.Module, touches: np.ndarray, normals: np.ndarray) -> trimesh.Trimesh | np.ndarray:
        """What becomes of contacts (N, 3) in their own frame; ValueError where nothing does."""


class Occupancy:
    """Inside or outside at labelled query points; the figure is the volumetric IoU on uniform ones."""

    def loss(self, network: nn.Module, batch: Sample, kind: Loss) -> Tensor:
        logits = network.logits(batch.touches, batch.queries, batch.normals, batch.key)
        return occupancy_loss(logits, batch.inside, kind)

    def scores(self, network: nn.Module, sample: Sample) -> dict[str, float]:
        occupancy = network(sample.touches, sample.queries, sample.normals)
        return {"iou": float(volumetric_iou(occupancy[0] >= 0.5, sample.inside[0] > 0.5))}

    def result(self, network: nn.Module, touches: np.ndarray, normals: np.ndarray) -> trimesh.Trimesh:
        return reconstruct_mesh(touches, normals=normals, weights=network, resolution=128)


class Points:
    """A cloud near the true surface; the figures are distances to stored samples of it."""

    def loss(self, network: nn.Module, batch: Sample, kind: Loss) -> Tensor:
        return points_loss(network(batch.touches, batch.normals, batch.key), batch.targets, kind)

    def scores(self, network: nn.Module, sample: Sample) -> dict[str, float]:
        # In shares of the longest side of the contacts, which fills FILL of the cube.
        cloud, targets = network.points(sample.touches, sample.normals).float() / FILL, sample.targets / FILL
        return {
            "chamfer": float(chamfer_distance(cloud, targets)),
            "f_score": float(f_score(cloud, targets, threshold=THRESHOLD)),
        }

    def result(self, network: nn.Module, touches: np.ndarray, normals: np.ndarray) -> np.ndarray:
        return complete_points(touches, network, normals=normals)


OBJECTIVES: dict[str, Objective] = {"occupancy": Occupancy(), "points": Points()}


def objective_of(network: nn.Module) -> Objective:
    """The objective for what the network predicts."""
    return OBJECTIVES[network.predicts]


@torch.no_grad()
def validate(network: nn.Module, data: TouchDataset, device: torch.device, precision: str) -> dict[str, float]:
    """The objective's figures (mean over shapes) for several numbers of contacts, and with and without normals where
    the network uses them. The frame comes from the touches alone."""
    objective = objective_of(network)
    settings = [way for way in VALIDATION if network.uses_normals or not way[1]]
    found: dict[str, list[float]] = {}
    for index in range(len(data)):
        shape = data.shape(index)
        has_touches = shape.array("touches").shape[0] > 0
        for contacts, normals in settings if has_touches else ():
            one = default_collate([validation_sample(shape, contacts, normals=normals, index=index)])
            sample = Sample(*(value.to(device) for value in one))
            with torch.autocast(device.type, dtype=torch.bfloat16, enabled=precision == "bf16"):
                scores = objective.scores(network, sample)
            for name, value in scores.items():
                found.setdefault(f"{name}/{contacts}" + ("+normals" if normals else ""), []).append(value)
    return {name: float(np.mean(values)) for name, values in found.items()}
