"""What a run goes on from: weights, their average, the state of the optimizer, the step."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import torch
from torch import nn

from touchnet import outputs
from touchnet.training.average import Average
from touchnet.training.options import Recipe


def save_checkpoint(
    path: Path,
    network: nn.Module,
    average: Average,
    optimizer: torch.optim.Optimizer,
    recipe: Recipe,
    step: int,
    seconds: float,
) -> None:
    """Writes what `--resume` needs: plain tensors and numbers (torch.load's weights_only=True reads it)."""
    state = {
        "network": network.state_dict(),
        "average": average.network.state_dict(),
        "optimizer": optimizer.state_dict(),
        "model": dataclasses.asdict(recipe.model),
        "step": step,
        "seconds": seconds,
    }
    with outputs.atomic_output(path, force=True) as temporary:
        torch.save(state, temporary)


def load_checkpoint(
    path: Path,
    network: nn.Module,
    average: Average,
    optimizer: torch.optim.Optimizer,
    recipe: Recipe,
) -> tuple[int, float]:
    """Restores what :func:`save_checkpoint` wrote; returns the step to go on from and the seconds until there."""
    # Not the device: in a group of processes the processor is "cpu:0", which torch.load does not know.
    state = torch.load(path, map_location="cpu", weights_only=True)
    if state["model"] != dataclasses.asdict(recipe.model):
        raise ValueError(
            f"resume: {path} holds the model {state['model']}, asked for {dataclasses.asdict(recipe.model)}"
        )
    network.load_state_dict(state["network"])
    average.network.load_state_dict(state["average"])
    optimizer.load_state_dict(state["optimizer"])
    return state["step"], state.get("seconds", 0.0)  # checkpoints of the first version have no clock
