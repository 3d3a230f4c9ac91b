"""Measures of two sets of points (torch), with a batch in front or without."""

from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

CDIST_AT_ONCE = 1 << 25  # distances computed at once on a device without a tree


def chamfer_distance(a: Tensor, b: Tensor) -> Tensor:
    """Chamfer distance of two point sets, eq. 9: mean over a of min squared distance, plus the same from b.

    Two single points 0.3 apart give 0.18. Differentiable in both sets (not where nearest points change).

    Args:
        a: (N, 3) or (B, N, 3), float32 or float64.
        b: (M, 3) or (B, M, 3), of the same type and device.

    Returns:
        scalar or (B,), >= 0; infinite where a set has no points (also when both have none).
    """
    a_batch, b_batch, single = _point_sets(a, b)
    if a_batch.shape[1] == 0 or b_batch.shape[1] == 0:
        result = a_batch.new_full((len(a_batch),), torch.inf)
    else:
        result = _squared_to_nearest(a_batch, b_batch).mean(1) + _squared_to_nearest(b_batch, a_batch).mean(1)
    return result[0] if single else result


def f_score(a: Tensor, b: Tensor, *, threshold: float) -> Tensor:
    """F-score of two point sets, eq. 10-12: harmonic mean of precision and recall at a distance.

    Precision is the share of `a` strictly nearer than `threshold` to a point of `b`; recall the share of `b` to `a`.

    Args:
        a: (N, 3) or (B, N, 3), the prediction.
        b: (M, 3) or (B, M, 3), the truth.
        threshold: distance in the units of the points, > 0. 0.01 is "1 %" where the longest side is 1.

    Returns:
        scalar or (B,) in [0, 1]; 0 where a set has no points (also when both have none).
    """
    if not threshold > 0:
        raise ValueError(f"threshold must be a positive distance, got {threshold}")
    a_batch, b_batch, single = _point_sets(a, b)
    if a_batch.shape[1] == 0 or b_batch.shape[1] == 0:
        result = a_batch.new_zeros(len(a_batch))
    else:
        with torch.no_grad():
            precision = (_squared_to_nearest(a_batch, b_batch).sqrt() < threshold).to(a.dtype).mean(1)
            recall = (_squared_to_nearest(b_batch, a_batch).sqrt() < threshold).to(a.dtype).mean(1)
        result = harmonic_mean(precision, recall)
    return result[0] if single else result


def hausdorff_95(a: Tensor, b: Tensor) -> Tensor:
    """The greater of the 95th percentiles of the distances from a to b and from b to a.

    Args:
        a: (N, 3) or (B, N, 3).
        b: (M, 3) or (B, M, 3).

    Returns:
        scalar or (B,), >= 0; infinite where a set has no points.
    """
    a_batch, b_batch, single = _point_sets(a, b)
    if a_batch.shape[1] == 0 or b_batch.shape[1] == 0:
        result = a_batch.new_full((len(a_batch),), torch.inf)
    else:
        with torch.no_grad():
            there = _squared_to_nearest(a_batch, b_batch).sqrt().quantile(0.95, dim=1)
            back = _squared_to_nearest(b_batch, a_batch).sqrt().quantile(0.95, dim=1)
        result = torch.maximum(there, back)
    return result[0] if single else result


def normal_consistency(a: Tensor, a_normals: Tensor, b: Tensor, b_normals: Tensor) -> Tensor:
    """Mean |cosine| between the normal of a point and that of the nearest point of the other set, both directions.

    Args:
        a, b: (N, 3) and (M, 3), or with a batch in front.
        a_normals, b_normals: shaped as the points, of any non-zero length.

    Returns:
        scalar or (B,) in [0, 1]; 0 where a set has no points.
    """
    a_batch, b_batch, single = _point_sets(a, b)
    for name, normals, points in (("a_normals", a_normals, a), ("b_normals", b_normals, b)):
        if normals.shape != points.shape:
            raise ValueError(
                f"{name} must have the shape of its points {tuple(points.shape)}, got {tuple(normals.shape)}"
            )
    if a_batch.shape[1] == 0 or b_batch.shape[1] == 0:
        result = a_batch.new_zeros(len(a_batch))
    else:
        a_unit = torch.nn.functional.normalize(a_normals.reshape(a_batch.shape), dim=-1)
        b_unit = torch.nn.functional.normalize(b_normals.reshape(b_batch.shape), dim=-1)
        there = (a_unit * _rows(b_unit, nearest(a_batch, b_batch))).sum(-1).abs().mean(1)
        back = (b_unit * _rows(a_unit, nearest(b_batch, a_batch))).sum(-1).abs().mean(1)
        result = (there + back) / 2
    return result[0] if single else result


@torch.no_grad()
def nearest(a: Tensor, b: Tensor) -> Tensor:
    """Index of the point of `b` nearest to each point of `a`.

    Args:
        a: (B, N, 3).
        b: (B, M, 3), M >= 1.

    Returns:
        (B, N) int64.
    """
    if a.device.type == "cpu":
        found = [cKDTree(y.numpy()).query(x.numpy())[1] for x, y in zip(a.detach(), b.detach(), strict=True)]
        return torch.from_numpy(np.asarray(found, dtype=np.int64).reshape(a.shape[:2]))
    rows = max(1, CDIST_AT_ONCE // (len(a) * b.shape[1]))
    return torch.cat([torch.cdist(part, b).argmin(2) for part in a.split(rows, dim=1)], dim=1)


def _point_sets(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor, bool]:
    """Both sets with a batch in front, and whether they came without one."""
    for name, points in (("a", a), ("b", b)):
        if not isinstance(points, Tensor):
            raise TypeError(f"{name} must be a torch.Tensor, got {type(points).__name__}")
        if points.ndim not in (2, 3) or points.shape[-1] != 3:
            raise ValueError(f"{name} must have shape (N, 3) or (B, N, 3), got {tuple(points.shape)}")
        if points.dtype not in (torch.float32, torch.float64):
            raise TypeError(f"{name} must be float32 or float64, got {points.dtype}")
        if not torch.isfinite(points).all():
            raise ValueError(f"{name} must be finite, got NaN or infinity")
    if a.dtype != b.dtype:
        raise TypeError(f"a and b must have one type, got {a.dtype} and {b.dtype}")
    if a.ndim != b.ndim or (a.ndim == 3 and len(a) != len(b)):
        raise ValueError(f"a and b must have the same batch, got shapes {tuple(a.shape)} and {tuple(b.shape)}")
    return (a[None], b[None], True) if a.ndim == 2 else (a, b, False)


def _rows(points: Tensor, index: Tensor) -> Tensor:
    return torch.gather(points, 1, index[..., None].expand(-1, -1, 3))


def _squared_to_nearest(a: Tensor, b: Tensor) -> Tensor:
    """(B, N) squared distance from each point of `a` to its nearest point of `b`; differentiable in both."""
    return (a - _rows(b, nearest(a, b))).square().sum(-1)


def harmonic_mean(precision: Any, recall: Any) -> Any:
    total = precision + recall
    return 2 * precision * recall / (total + (total == 0))
