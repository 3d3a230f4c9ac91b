"""Losses: of logits against labels in {0, 1}, and of clouds of points against points of the true surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from torch import Tensor
from torch.nn import functional as F

from touchnet import ops
from touchnet.metrics import chamfer_distance

Loss = Literal["cross_entropy", "squared", "chamfer", "chamfer_gridding"]

GRIDDING_SIZE, GRIDDING_WEIGHT = 128, 0.1  # GRNet's


def occupancy_loss(logits: Tensor, inside: Tensor, kind: Loss = "cross_entropy") -> Tensor:
    """Mean over all points.

    Args:
        logits: (B, M) before the sigmoid.
        inside: (B, M) 1 inside, 0 outside.
        kind: "cross_entropy", or "squared": the paper's eq. 5 on the occupancy after the sigmoid.
    """
    if logits.shape != inside.shape:
        raise ValueError(
            f"logits and inside should have one shape, got {tuple(logits.shape)} and {tuple(inside.shape)}"
        )
    logits, inside = logits.float(), inside.float()
    if kind == "cross_entropy":
        return F.binary_cross_entropy_with_logits(logits, inside)
    if kind == "squared":
        return F.mse_loss(logits.sigmoid(), inside)
    raise ValueError(f'kind should be "cross_entropy" or "squared", got {kind!r}')


def points_loss(clouds: Sequence[Tensor], targets: Tensor, kind: Loss = "chamfer") -> Tensor:
    """Sum over the clouds (coarse to fine) of their mean distance to the targets.

    Args:
        clouds: each (B, K, 3), in the cube [-1, 1]^3.
        targets: (B, M, 3) points of the true surface.
        kind: "chamfer" (eq. 9), or "chamfer_gridding": with the gridding loss of each cloud added.
    """
    if kind not in ("chamfer", "chamfer_gridding"):
        raise ValueError(f'kind should be "chamfer" or "chamfer_gridding", got {kind!r}')
    total = targets.new_zeros(())
    for cloud in clouds:
        total = total + chamfer_distance(cloud.float(), targets).mean()
        if kind == "chamfer_gridding":
            total = total + GRIDDING_WEIGHT * gridding_loss(cloud.float(), targets)
    return total


def gridding_loss(cloud: Tensor, targets: Tensor, *, size: int = GRIDDING_SIZE) -> Tensor:
    """Mean absolute difference of the two gridded clouds (GRNet, section 3.6), each weighing as the targets do.

    Args:
        cloud: (B, K, 3).
        targets: (B, M, 3).
        size: vertices along each side of the grids.
    """
    share = targets.shape[1] / cloud.shape[1]
    return (share * ops.gridding(cloud, size) - ops.gridding(targets, size)).abs().mean()
