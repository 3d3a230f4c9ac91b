"""Farthest point sampling: how clouds are thinned for the paper's protocol and for PointNet++."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


def farthest_point_sample(points: Tensor, count: int, *, start: int = 0) -> Tensor:
    """Indices of `count` points, each the farthest from those chosen before it. Computed on the CPU in float64.

    Args:
        points: (N, 3) or (B, N, 3), finite, on any device.
        count: 0 <= count <= N.
        start: index of the first one; negative counts from the end.

    Returns:
        (count,) or (B, count) int64 on the device of the points, all different.
    """
    if not isinstance(points, Tensor):
        raise TypeError(f"points must be a torch.Tensor, got {type(points).__name__}")
    if points.ndim not in (2, 3) or points.shape[-1] != 3:
        raise ValueError(f"points must have shape (N, 3) or (B, N, 3), got {tuple(points.shape)}")
    if not torch.isfinite(points).all():
        raise ValueError("points must be finite, got NaN or infinity")
    batch = points[None] if points.ndim == 2 else points
    n = batch.shape[1]
    if not 0 <= count <= n:
        raise ValueError(f"count must be between 0 and the number of points {n}, got {count}")
    if count and not -n <= start < n:
        raise ValueError(f"start must be an index of {n} points, got {start}")
    chosen = [_farthest(cloud, count, start) for cloud in batch.detach().to("cpu", torch.float64).numpy()]
    result = torch.from_numpy(np.array(chosen, dtype=np.int64).reshape(len(batch), count)).to(points.device)
    return result[0] if points.ndim == 2 else result


def _farthest(points: NDArray[np.float64], count: int, start: int) -> NDArray[np.int64]:
    # |x - y|^2 = |x|^2 - 2 x.y + |y|^2 takes half the passes over memory; about the middle it keeps its digits.
    points = points - points.mean(axis=0) if len(points) else points
    square = np.square(points).sum(axis=1)
    doubled = 2 * points
    distance, step = np.full(len(points), np.inf), np.empty(len(points))
    chosen = np.empty(count, dtype=np.int64)
    latest = start % max(len(points), 1)
    for k in range(count):
        chosen[k] = latest
        np.dot(points, doubled[latest], out=step)
        np.subtract(square, step, out=step)
        step += square[latest]
        np.minimum(distance, step, out=distance)
        distance[latest] = -np.inf  # chosen once only, also among duplicates
        latest = distance.argmax()
    return chosen
