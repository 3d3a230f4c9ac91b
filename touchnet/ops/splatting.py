"""Points into a volume: gridding."""

import torch
from torch import Tensor

from touchnet import reference
from touchnet.ops._launch import differentiable_backward, launch, refuse_transforms
from touchnet.reference import _checks


def _forward(points: Tensor, values: Tensor | None, size: list[int], channels_last: bool) -> Tensor:
    points = points.contiguous()
    values = None if values is None else values.contiguous()
    channels = 1 if values is None else 1 + values.shape[2]
    volume = torch.empty(
        (points.shape[0], channels, *size),
        dtype=points.dtype,
        device=points.device,
        memory_format=torch.channels_last_3d if channels_last else torch.contiguous_format,
    )
    launch(
        "gridding_forward",
        points,
        points.data_ptr(),
        0 if values is None else values.data_ptr(),
        points.shape[1],
        volume.data_ptr(),
        volume.shape,
        volume.stride(),
    )
    return volume


def _backward(
    grad: Tensor, points: Tensor, values: Tensor | None, want_points: bool, want_values: bool
) -> tuple[Tensor, Tensor]:
    """Gradients of points and values; an empty tensor for one that is not wanted."""
    points = points.contiguous()
    values = None if values is None else values.contiguous()
    grad_points = torch.empty_like(points) if want_points else points.new_empty(0)
    grad_values = torch.empty_like(values) if want_values and values is not None else points.new_empty(0)
    launch(
        "gridding_backward",
        points,
        grad.data_ptr(),
        grad.shape,
        grad.stride(),
        points.data_ptr(),
        0 if values is None else values.data_ptr(),
        points.shape[1],
        grad_points.data_ptr(),
        grad_values.data_ptr(),
    )
    return grad_points, grad_values


class _Gridding(torch.autograd.Function):
    @staticmethod
    def forward(ctx, points, values, size, channels_last):
        ctx.save_for_backward(points, values)
        ctx.size = size
        return _forward(points, values, size, channels_last)

    @staticmethod
    def backward(ctx, grad):
        points, values = ctx.saved_tensors
        want_points, want_values = ctx.needs_input_grad[:2]
        if torch.is_grad_enabled():
            size = tuple(ctx.size)
            found = differentiable_backward(
                lambda points, values: reference.gridding(points, size, values=values),
                (points, values),
                (want_points, want_values),
                grad,
            )
            return (*found, None, None)
        grad_points, grad_values = _backward(grad, points, values, want_points, want_values)
        return grad_points if want_points else None, grad_values if want_values else None, None, None


def gridding(
    points: Tensor,
    size: int | tuple[int, int, int],
    *,
    values: Tensor | None = None,
    memory_format: torch.memory_format = torch.contiguous_format,
) -> Tensor:
    """Spread points over the vertices of a volume, each over the eight corners of its cell by trilinear weights.

    With w_v(p) the trilinear weight of vertex v for point p (paper, section 3.1): volume[b, 0, v] = sum over p of
    w_v(p), and volume[b, 1 + k, v] = sum over p of w_v(p) values[b, p, k].

    Args:
        points: (B, N, 3) float32 or float64, coordinates of the cube [-1, 1]^3. +1 belongs to the last cell. Points
            outside the cube or not finite (NaN rows are padding) have no weight and a zero gradient.
        size: S or (X, Y, Z) >= 2 vertices along each axis; vertex i of n sits at -1 + 2 i / (n - 1).
        values: (B, N, K), dtype of the points: K more channels. Rows of points without weight are not read.
        memory_format: torch.contiguous_format or torch.channels_last_3d, of the result.

    Returns:
        (B, 1 + K, X, Y, Z): density, then the values' channels. Differentiable twice in points and values. On the CPU
        the same bits for every number of threads. Under autocast half precision input is computed in float32.

    Raises:
        TypeError, ValueError: an argument of the wrong kind, dtype or shape.

    Example:
        >>> touch = torch.tensor([[[-1.0, -1.0, 0.0]]])  # halfway between two vertices of an edge
        >>> volume = touchnet.ops.gridding(touch, 2)
        >>> volume[0, 0, 0, 0]
        tensor([0.5000, 0.5000])
    """
    size = _checks.check_gridding(points, size, values, memory_format)
    refuse_transforms("gridding")
    points, values = _checks.full_precision(points, values)
    _checks.check_dtypes({"points": points} if values is None else {"points": points, "values": values})
    channels_last = memory_format == torch.channels_last_3d
    if torch.is_grad_enabled() and (points.requires_grad or (values is not None and values.requires_grad)):
        return _Gridding.apply(points, values, size, channels_last)
    return _forward(points, values, size, channels_last)
