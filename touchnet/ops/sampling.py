"""Features of a volume at points: trilinear_sample (FI), addition_sample (FA), cubic_sample (GRNet)."""

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
    volume_like,
)
from touchnet.reference import _checks


def _new_rows(kind: str, volume: Tensor, points: Tensor) -> Tensor:
    """An empty result: (B, M, C), for cubic sampling (B, M, 8, C)."""
    corners = (8,) if kind == "cubic" else ()
    return volume.new_empty((*points.shape[:2], *corners, volume.shape[1]))


def _sample_into(kind: str, volume: Tensor, points: Tensor, out: Tensor) -> Tensor:
    points = points.contiguous()
    launch(
        f"{kind}_forward",
        volume,
        volume.data_ptr(),
        volume.shape,
        volume.stride(),
        points.data_ptr(),
        points.shape[1],
        out.data_ptr(),
    )
    return out


@raw_kernel(fake=_new_rows)
def _sample_forward(kind: str, volume: Tensor, points: Tensor) -> Tensor:
    return _sample_into(kind, volume, points, _new_rows(kind, volume, points))


@raw_kernel(fake=lambda kind, grad, volume, points: volume_like(volume))
def _sample_backward_volume(kind: str, grad: Tensor, volume: Tensor, points: Tensor) -> Tensor:
    grad, points = grad.contiguous(), points.contiguous()
    result = volume_like(volume, points.dtype)  # half precision is summed in float32
    launch_scatter(
        f"{kind}_backward_volume",
        volume,
        points,
        volume.shape[2:],
        True,
        grad.data_ptr(),
        points.data_ptr(),
        points.shape[1],
        result.data_ptr(),
        result.shape,
        result.stride(),
    )
    return result.to(volume.dtype)


@raw_kernel(fake=lambda grad, volume, points: points.new_empty(points.shape))
def _trilinear_backward_points(grad: Tensor, volume: Tensor, points: Tensor) -> Tensor:
    grad, points = grad.contiguous(), points.contiguous()
    result = torch.empty_like(points)
    launch(
        "trilinear_backward_points",
        volume,
        grad.data_ptr(),
        volume.data_ptr(),
        volume.shape,
        volume.stride(),
        points.data_ptr(),
        points.shape[1],
        result.data_ptr(),
    )
    return result


class _TrilinearSample(torch.autograd.Function):
    @staticmethod
    def forward(ctx, volume, points):
        ctx.save_for_backward(volume, points)
        return _sample_forward("trilinear", volume, points)

    @staticmethod
    def backward(ctx, grad):
        volume, points = ctx.saved_tensors
        want_volume, want_points = ctx.needs_input_grad
        if backward_is_recorded():
            return tuple(
                differentiable_backward(reference.trilinear_sample, (volume, points), ctx.needs_input_grad, grad)
            )
        return (
            _sample_backward_volume("trilinear", grad, volume, points) if want_volume else None,
            _trilinear_backward_points(grad, volume, points) if want_points else None,
        )


def trilinear_sample(volume: Tensor, points: Tensor, *, out: Tensor | None = None) -> Tensor:
    """Features of a volume at points by trilinear interpolation ("FI", paper eq. 1-2).

    out[b, m, c] = sum over the eight corners v of the point's cell of w_v(p) volume[b, c, v].

    Args:
        volume: (B, C, X, Y, Z) float32 or float64 (on CUDA also float16 and bfloat16, beside float32 points) of any
            strides; at least 2 vertices along X, Y and Z, vertex i of n at -1 + 2 i / (n - 1). torch.channels_last_3d
            is the fast layout; no layout is copied.
        points: (B, M, 3), dtype of the volume, coordinates of the cube [-1, 1]^3. Coordinates beyond it are clamped,
            with zero gradient along the clamped axis. The row of a point that is not finite is NaN, its gradients zero.
        out: (B, M, C) contiguous: written and returned, for reuse in inference; refused where a gradient is recorded.

    Returns:
        (B, M, C). Differentiable twice in volume and points; the volume's gradient has the volume's memory format. On
        the CPU the same bits for every number of threads. Under autocast half precision input is computed in float32.

    Raises:
        TypeError, ValueError: an argument of the wrong kind, dtype or shape.

    Example:
        >>> volume = torch.zeros(1, 1, 4, 4, 4)
        >>> volume[0, 0, 3, 0, 0] = 1  # the corner at x = +1, y = z = -1
        >>> touchnet.ops.trilinear_sample(volume, torch.tensor([[[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]]])).flatten()
        tensor([1., 0.])
    """
    volume, points = _checks.check_sampling(volume, points)
    refuse_transforms("trilinear_sample")
    if out is not None:
        _checks.check_out(out, torch.Size((*points.shape[:2], volume.shape[1])), volume, points)
        return _sample_into("trilinear", volume, points, out)
    if torch.is_grad_enabled() and (volume.requires_grad or points.requires_grad):
        return _TrilinearSample.apply(volume, points)
    return _sample_forward("trilinear", volume, points)


class _AdditionSample(torch.autograd.Function):
    @staticmethod
    def forward(ctx, volume, points):
        ctx.save_for_backward(volume, points)
        return _sample_forward("addition", volume, points)

    @staticmethod
    def backward(ctx, grad):
        volume, points = ctx.saved_tensors
        if backward_is_recorded():
            return tuple(differentiable_backward(reference.addition_sample, (volume, points), (True, False), grad))
        return _sample_backward_volume("addition", grad, volume, points), None


def addition_sample(volume: Tensor, points: Tensor) -> Tensor:
    """Sum of the features at the eight corners of each point's cell ("FA", the paper's ablation).

    out[b, m, c] = sum over the eight corners v of the point's cell of volume[b, c, v].

    Args and errors as for trilinear_sample. A point on a face between cells belongs to the upper one, +1 to the last.

    Returns:
        (B, M, C). Differentiable in the volume, linearly; the points, which only choose the cell, get no gradient.

    Example:
        >>> volume = torch.ones(1, 2, 4, 4, 4)
        >>> touchnet.ops.addition_sample(volume, torch.zeros(1, 1, 3)).flatten()
        tensor([8., 8.])
    """
    volume, points = _checks.check_sampling(volume, points)
    refuse_transforms("addition_sample")
    if torch.is_grad_enabled() and volume.requires_grad:
        return _AdditionSample.apply(volume, points)
    return _sample_forward("addition", volume, points)


class _CubicSample(torch.autograd.Function):
    @staticmethod
    def forward(ctx, volume, points):
        ctx.save_for_backward(volume, points)
        return _sample_forward("cubic", volume, points)

    @staticmethod
    def backward(ctx, grad):
        volume, points = ctx.saved_tensors
        if backward_is_recorded():
            return tuple(differentiable_backward(reference.cubic_sample, (volume, points), (True, False), grad))
        return _sample_backward_volume("cubic", grad, volume, points), None


def cubic_sample(volume: Tensor, points: Tensor) -> Tensor:
    """Features at the eight corners of each point's cell, one by one (GRNet's cubic feature sampling).

    out[b, m, 4 di + 2 dj + dk, c] = volume[b, c, i + di, j + dj, k + dk] for the cell (i, j, k) of point m.

    Args and errors as for trilinear_sample. A point on a face between cells belongs to the upper one, +1 to the last.

    Returns:
        (B, M, 8, C). Differentiable in the volume, linearly; the points, which only choose the cell, get no gradient.

    Example:
        >>> volume = torch.arange(8.0).view(1, 1, 2, 2, 2)
        >>> touchnet.ops.cubic_sample(volume, torch.zeros(1, 1, 3)).flatten()
        tensor([0., 1., 2., 3., 4., 5., 6., 7.])
    """
    volume, points = _checks.check_sampling(volume, points)
    refuse_transforms("cubic_sample")
    if torch.is_grad_enabled() and volume.requires_grad:
        return _CubicSample.apply(volume, points)
    return _sample_forward("cubic", volume, points)
