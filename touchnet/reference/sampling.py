"""Reading a volume at points, in plain torch: the specification of the samplers of touchnet.ops."""

import torch
from torch import Tensor

from touchnet.reference import _cells, _checks


def _corner_features(volume: Tensor, points: Tensor) -> tuple[list[Tensor], list[Tensor], Tensor]:
    """Features (B, M, C) and trilinear weights (B, M) of the eight corners of each point's cell, and (B, M): finite."""
    size = tuple(volume.shape[2:])
    finite = torch.isfinite(points).all(-1)
    cells = _cells.locate(torch.where(finite[..., None], points, torch.zeros_like(points)), size)
    rows = volume.flatten(2).transpose(1, 2)  # (B, X Y Z, C)
    features, weights = [], []
    for vertices, weight in _cells.corners(cells):
        vertex = _cells.flat(vertices, size)[..., None].expand(-1, -1, volume.shape[1])  # (B, M, C)
        features.append(rows.gather(1, vertex))
        weights.append(weight)
    return features, weights, finite


def _nan_rows(result: Tensor, finite: Tensor) -> Tensor:
    """NaN in the rows of points that are not finite; (B, M, ...) and (B, M)."""
    shape = finite.shape + (1,) * (result.dim() - 2)
    return torch.where(finite.view(shape), result, torch.full_like(result, torch.nan))


def trilinear_sample(volume: Tensor, points: Tensor, *, out: Tensor | None = None) -> Tensor:
    """See touchnet.ops.trilinear_sample."""
    volume, points = _checks.check_sampling(volume, points)
    features, weights, finite = _corner_features(volume, points)
    total = sum(weight[..., None] * feature for weight, feature in zip(weights, features, strict=True))
    result = _nan_rows(total, finite)
    if out is None:
        return result
    _checks.check_out(out, result.shape, volume, points)
    return out.copy_(result)


def addition_sample(volume: Tensor, points: Tensor) -> Tensor:
    """See touchnet.ops.addition_sample."""
    volume, points = _checks.check_sampling(volume, points)
    features, _, finite = _corner_features(volume, points)
    return _nan_rows(sum(features), finite)


def cubic_sample(volume: Tensor, points: Tensor) -> Tensor:
    """See touchnet.ops.cubic_sample."""
    volume, points = _checks.check_sampling(volume, points)
    features, _, finite = _corner_features(volume, points)
    return _nan_rows(torch.stack(features, 2), finite)
