"""Losses on occupancy: from logits (B, M) and labels (B, M) in {0, 1} to a scalar."""

from __future__ import annotations

from typing import Literal

from torch import Tensor
from torch.nn import functional as F

Loss = Literal["cross_entropy", "squared"]


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
