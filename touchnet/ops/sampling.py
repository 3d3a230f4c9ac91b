"""Features of a volume at points: trilinear_sample (FI), addition_sample (FA)."""

import torch
from torch import Tensor

from touchnet import reference
from touchnet.ops._launch import differentiable_backward, launch, refuse_transforms, volume_like
from touchnet.reference import _checks


def _forward(kernel: str, volume: Tensor, points: Tensor, out: Tensor) -> Tensor:
    """Run a sampler's forward kernel into `out`."""
    points = points.contiguous()
    launch(
        kernel,
        volume,
        volume.data_ptr(),
        volume.shape,
        volume.stride(),
        points.data_ptr(),
        points.shape[1],
        out.data_ptr(),
    )
    return out


def _backward_volume(kernel: str, grad: Tensor, volume: Tensor, points: Tensor) -> Tensor:
    """The gradient of the volume, in the volume's memory format."""
    grad, points = grad.contiguous(), points.contiguous()
    result = volume_like(volume)
    launch(
        kernel,
        volume,
        grad.data_ptr(),
        points.data_ptr(),
        points.shape[1],
        result.data_ptr(),
        result.shape,
        result.stride(),
    )
    return result


def _backward_points(kernel: str, grad: Tensor, volume: Tensor, points: Tensor) -> Tensor:
    """The gradient of the points."""
    grad, points = grad.contiguous(), points.contiguous()
    result = torch.empty_like(points)
    launch(
        kernel,
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


def _trilinear_forward(volume: Tensor, points: Tensor) -> Tensor:
    out = volume.new_empty(points.shape[0], points.shape[1], volume.shape[1])
    return _forward("trilinear_forward", volume, points, out)


class _TrilinearSample(torch.autograd.Function):
    @staticmethod
    def forward(ctx, volume, points):
        ctx.save_for_backward(volume, points)
        return _trilinear_forward(volume, points)

    @staticmethod
    def backward(ctx, grad):
        volume, points = ctx.saved_tensors
        want_volume, want_points = ctx.needs_input_grad
        if torch.is_grad_enabled():
            return tuple(
                differentiable_backward(reference.trilinear_sample, (volume, points), ctx.needs_input_grad, grad)
            )
        return (
            _backward_volume("trilinear_backward_volume", grad, volume, points) if want_volume else None,
            _backward_points("trilinear_backward_points", grad, volume, points) if want_points else None,
        )


def trilinear_sample(volume: Tensor, points: Tensor, *, out: Tensor | None = None) -> Tensor:
    """Features of a volume at points by trilinear interpolation ("FI", paper eq. 1-2).

    out[b, m, c] = sum over the eight corners v of the point's cell of w_v(p) volume[b, c, v].

    Args:
        volume: (B, C, X, Y, Z) float32 or float64 of any strides; at least 2 vertices along X, Y and Z, vertex i of n at
            -1 + 2 i / (n - 1). torch.channels_last_3d is the fast layout; no layout is copied.
        points: (B, M, 3), dtype of the volume, coordinates of the cube [-1, 1]^3. Coordinates beyond it are clamped, with
            zero gradient along the clamped axis. The row of a point that is not finite is NaN and has zero gradients.
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
        return _forward("trilinear_forward", volume, points, out)
    if torch.is_grad_enabled() and (volume.requires_grad or points.requires_grad):
        return _TrilinearSample.apply(volume, points)
    return _trilinear_forward(volume, points)


def _addition_forward(volume: Tensor, points: Tensor) -> Tensor:
    out = volume.new_empty(points.shape[0], points.shape[1], volume.shape[1])
    return _forward("addition_forward", volume, points, out)


class _AdditionSample(torch.autograd.Function):
    @staticmethod
    def forward(ctx, volume, points):
        ctx.save_for_backward(volume, points)
        return _addition_forward(volume, points)

    @staticmethod
    def backward(ctx, grad):
        volume, points = ctx.saved_tensors
        if torch.is_grad_enabled():
            wanted = (ctx.needs_input_grad[0], False)
            return tuple(differentiable_backward(reference.addition_sample, (volume, points), wanted, grad))
        if not ctx.needs_input_grad[0]:
            return None, None
        return _backward_volume("addition_backward_volume", grad, volume, points), None


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
    return _addition_forward(volume, points)
