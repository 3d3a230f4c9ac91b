"""Checks of arguments, shared by the compiled operators and their reference twins: both refuse the same input alike."""

import torch
from torch import Tensor

FLOATING = (torch.float32, torch.float64)
REDUCED = (torch.float16, torch.bfloat16)


def describe(value: object) -> str:
    """How an error names what it got."""
    if isinstance(value, Tensor):
        return f"a {value.dtype} tensor of shape {tuple(value.shape)} on {value.device}"
    return f"{type(value).__name__} {value!r}"


def check_tensor(name: str, value: object, axes: tuple[str, ...], *, last: int | None = None) -> None:
    """Require a tensor with the named axes, of dtype float32 or float64; `last` fixes the length of the last axis.

    Half precision is let through on CUDA (kernels for the sampled volume) and under autocast (cast to float32).
    """
    expected = f"({', '.join(axes)})"
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a tensor of shape {expected}, got {describe(value)}")
    if value.dim() != len(axes) or (last is not None and value.shape[-1] != last):
        raise ValueError(f"{name}: expected shape {expected}, got {tuple(value.shape)}")
    if value.layout != torch.strided:
        raise TypeError(f"{name}: expected a dense tensor, got layout {value.layout}")


def check_dtypes(tensors: dict[str, Tensor], *, reduced: str | None = None) -> None:
    """Require one dtype and one device; on CUDA the argument `reduced` may be half precision beside float32."""
    for name, tensor in tensors.items():
        allowed = FLOATING + REDUCED if name == reduced and tensor.is_cuda else FLOATING
        if tensor.dtype not in allowed:
            names = " or ".join(str(dtype).removeprefix("torch.") for dtype in allowed)
            raise TypeError(f"{name}: expected dtype {names}, got {str(tensor.dtype).removeprefix('torch.')}")
    (first_name, first), *rest = tensors.items()
    for name, tensor in rest:
        if tensor.device != first.device:
            raise ValueError(f"{name}: expected the device of {first_name}, {first.device}, got {tensor.device}")
        expected = torch.float32 if first_name == reduced and first.dtype in REDUCED else first.dtype
        if tensor.dtype != expected:
            raise TypeError(
                f"{first_name} and {name}: expected one dtype, got "
                f"{str(first.dtype).removeprefix('torch.')} and {str(tensor.dtype).removeprefix('torch.')}"
            )


def check_batch(name: str, tensor: Tensor, other_name: str, other: Tensor) -> None:
    """Require the same batch size of two tensors."""
    if tensor.shape[0] != other.shape[0]:
        raise ValueError(f"{name}: expected the batch size of {other_name}, {other.shape[0]}, got {tensor.shape[0]}")


def check_volume(name: str, volume: object) -> None:
    """Require a volume (B, C, X, Y, Z) with at least one channel and two vertices along every axis."""
    check_tensor(name, volume, ("B", "C", "X", "Y", "Z"))
    if volume.shape[1] < 1 or min(volume.shape[2:]) < 2:
        raise ValueError(f"{name}: expected C >= 1 and at least 2 vertices along X, Y and Z, got {tuple(volume.shape)}")
    if max(volume.shape[2:]) >= 2**24:
        raise ValueError(f"{name}: expected fewer than 2**24 vertices along an axis, got {tuple(volume.shape)}")


def check_points(name: str, points: object, axis: str) -> None:
    """Require points (B, axis, 3)."""
    check_tensor(name, points, ("B", axis, "3"), last=3)


def check_size(size: object) -> tuple[int, int, int]:
    """Vertices along x, y and z from an integer or three of them."""
    sizes = (size,) * 3 if isinstance(size, int) else size
    if not isinstance(sizes, (tuple, list, torch.Size)) or not all(isinstance(n, int) for n in sizes):
        raise TypeError(f"size: expected an integer or three, got {describe(size)}")
    if len(sizes) != 3 or min(sizes) < 2 or max(sizes) >= 2**24:
        raise ValueError(f"size: expected an integer from 2 to 2**24 - 1, or three of them, got {size!r}")
    return tuple(sizes)


def full_precision(*tensors: Tensor | None) -> tuple[Tensor | None, ...]:
    """Under autocast, half precision tensors in float32 (differentiably), as torch.amp.custom_fwd casts them."""
    device = next(tensor.device.type for tensor in tensors if isinstance(tensor, Tensor))
    if not torch.is_autocast_enabled(device):
        return tensors
    return tuple(
        tensor.float() if isinstance(tensor, Tensor) and tensor.dtype in REDUCED else tensor for tensor in tensors
    )


def check_gridding(
    points: object, size: object, values: object | None, memory_format: torch.memory_format
) -> tuple[int, int, int]:
    """Shapes of gridding's arguments; returns the size as three integers."""
    check_points("points", points, "N")
    if values is not None:
        check_tensor("values", values, ("B", "N", "K"))
        if values.shape[:2] != points.shape[:2]:
            raise ValueError(
                f"values: expected shape (B, N, K) with (B, N) = {tuple(points.shape[:2])}, got {tuple(values.shape)}"
            )
    if memory_format not in (torch.contiguous_format, torch.channels_last_3d):
        raise ValueError(f"memory_format: expected contiguous_format or channels_last_3d, got {memory_format}")
    return check_size(size)


def check_sampling(volume: object, points: object) -> tuple[Tensor, Tensor]:
    """Shapes and dtypes of a sampler's arguments; returns them, in float32 where autocast asks for it."""
    check_volume("volume", volume)
    check_points("points", points, "M")
    check_batch("points", points, "volume", volume)
    volume, points = full_precision(volume, points)
    check_dtypes({"volume": volume, "points": points}, reduced="volume")
    return volume, points


def check_density(volume: object) -> Tensor:
    """Shape and dtype of a volume of one channel; returns it, in float32 where autocast asks for it."""
    check_volume("volume", volume)
    if volume.shape[1] != 1:
        raise ValueError(f"volume: expected shape (B, 1, X, Y, Z), got {tuple(volume.shape)}")
    (volume,) = full_precision(volume)
    check_dtypes({"volume": volume})
    return volume


def check_out(out: object, shape: torch.Size, *inputs: Tensor) -> None:
    """Require a contiguous tensor to write a result of `shape` into, with nothing to differentiate."""
    if not isinstance(out, Tensor):
        raise TypeError(f"out: expected a tensor of shape {tuple(shape)}, got {describe(out)}")
    volume = inputs[0]
    if out.shape != shape or out.dtype != volume.dtype or out.device != volume.device or not out.is_contiguous():
        raise ValueError(
            f"out: expected a contiguous {volume.dtype} tensor of shape {tuple(shape)} on {volume.device}, "
            f"got {describe(out)}{'' if out.is_contiguous() else ', not contiguous'}"
        )
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in (out, *inputs)):
        raise ValueError("out: cannot be used where a gradient is recorded; call under torch.no_grad()")
