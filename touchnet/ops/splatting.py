"""Points into a volume and back: gridding, gridding_reverse."""

from typing import Sequence  # noqa: UP035 - torch 2.4 knows no other in the signature of an operator

import torch
from torch import Tensor

from touchnet import reference
from touchnet.ops._launch import (
    backward_is_recorded,
    differentiable_backward,
    launch,
    launch_scatter,
    raw_kernel,
    refuse_transforms,
)
from touchnet.reference import _checks


def _new_volume(points: Tensor, values: Tensor | None, size: Sequence[int], channels_last: bool) -> Tensor:
    return torch.empty(
        (points.shape[0], 1 if values is None else 1 + values.shape[2], *size),
        dtype=points.dtype,
        device=points.device,
        memory_format=torch.channels_last_3d if channels_last else torch.contiguous_format,
    )


@raw_kernel(fake=_new_volume)
def _gridding_forward(points: Tensor, values: Tensor | None, size: Sequence[int], channels_last: bool) -> Tensor:
    points = points.contiguous()
    values = None if values is None else values.contiguous()
    volume = _new_volume(points, values, size, channels_last)
    launch_scatter(
        "gridding_forward",
        points,
        points,
        size,
        False,
        points.data_ptr(),
        0 if values is None else values.data_ptr(),
        points.shape[1],
        volume.data_ptr(),
        volume.shape,
        volume.stride(),
    )
    return volume


def _new_gradients(
    grad: Tensor, points: Tensor, values: Tensor | None, want_points: bool, want_values: bool
) -> tuple[Tensor, Tensor]:
    """Tensors for the gradients of points and values; without elements where one is not wanted."""
    return (
        points.new_empty(points.shape if want_points else 0),
        points.new_empty(values.shape if want_values and values is not None else 0),
    )


@raw_kernel(fake=_new_gradients)
def _gridding_backward(
    grad: Tensor, points: Tensor, values: Tensor | None, want_points: bool, want_values: bool
) -> tuple[Tensor, Tensor]:
    points = points.contiguous()
    values = None if values is None else values.contiguous()
    grad_points, grad_values = _new_gradients(grad, points, values, want_points, want_values)
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
        return _gridding_forward(points, values, size, channels_last)

    @staticmethod
    def backward(ctx, grad):
        points, values = ctx.saved_tensors
        want_points, want_values = ctx.needs_input_grad[:2]
        if backward_is_recorded():
            size = tuple(ctx.size)
            found = differentiable_backward(
                lambda points, values: reference.gridding(points, size, values=values),
                (points, values),
                (want_points, want_values),
                grad,
            )
            return (*found, None, None)
        grad_points, grad_values = _gridding_backward(grad, points, values, want_points, want_values)
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
    return _gridding_forward(points, values, size, channels_last)


@raw_kernel(fake=lambda volume, fill: volume.new_empty(volume.shape[0], volume[0].numel(), 3))
def _gridding_reverse_forward(volume: Tensor, fill: float) -> Tensor:
    volume = volume.contiguous()
    points = volume.new_empty(volume.shape[0], volume.shape[2] * volume.shape[3] * volume.shape[4], 3)
    launch(
        "gridding_reverse_forward", volume, volume.data_ptr(), volume.shape, volume.stride(), fill, points.data_ptr()
    )
    return points


@raw_kernel(fake=lambda grad, volume: volume.new_empty(volume.shape))
def _gridding_reverse_backward(grad: Tensor, volume: Tensor) -> Tensor:
    grad, volume = grad.contiguous(), volume.contiguous()
    result = torch.empty_like(volume)
    launch(
        "gridding_reverse_backward",
        volume,
        grad.data_ptr(),
        volume.data_ptr(),
        volume.shape,
        volume.stride(),
        result.data_ptr(),
    )
    return result


class _GriddingReverse(torch.autograd.Function):
    @staticmethod
    def forward(ctx, volume, fill):
        ctx.save_for_backward(volume)
        return _gridding_reverse_forward(volume, fill)

    @staticmethod
    def backward(ctx, grad):
        (volume,) = ctx.saved_tensors
        if backward_is_recorded():
            return (*differentiable_backward(reference.gridding_reverse, (volume,), (True,), grad), None)
        return _gridding_reverse_backward(grad, volume), None


def gridding_reverse(volume: Tensor, *, fill: float = 0.0) -> Tensor:
    """One point for each cell of a density: the mean of the cell's corners, weighted by the density (GRNet).

    For the cell of vertices v at x_v with weights w_v: point = sum of w_v x_v / sum of w_v. The density of a single
    point gives that point back.

    Args:
        volume: (B, 1, X, Y, Z) float32 or float64 with at least 2 vertices along X, Y and Z.
        fill: coordinates of rows without a point: cells whose weights sum to less than 1e-6 (negative sums too), and
            the rows of the last vertices, which have no cell. float("nan") sets them apart from a point at the origin.

    Returns:
        (B, X Y Z, 3): row (i Y + j) Z + k belongs to the cell whose lower corner is vertex (i, j, k). Differentiable
        twice; rows without a point have zero gradient. On the CPU the same bits for every number of threads.

    Raises:
        TypeError, ValueError: an argument of the wrong kind, dtype or shape.

    Example:
        >>> volume = touchnet.ops.gridding(torch.tensor([[[0.25, -0.5, 0.5]]]), 2)
        >>> touchnet.ops.gridding_reverse(volume)[0, 0]
        tensor([ 0.2500, -0.5000,  0.5000])
    """
    volume = _checks.check_density(volume)
    refuse_transforms("gridding_reverse")
    if torch.is_grad_enabled() and volume.requires_grad:
        return _GriddingReverse.apply(volume, float(fill))
    return _gridding_reverse_forward(volume, float(fill))
