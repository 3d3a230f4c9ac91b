"""How the operators call the compiled kernels: eagerly, under torch.compile, and in recorded backward passes."""

from collections.abc import Callable, Sequence
from functools import cache, wraps
from typing import Any

import torch
from torch import Tensor

from touchnet.ops._ext import _C

_SUFFIX = {
    torch.float32: "float32",
    torch.float64: "float64",
    torch.float16: "float16",
    torch.bfloat16: "bfloat16",
}


@cache
def _kernel(name: str, device: str, dtype: torch.dtype) -> Callable[..., None]:
    if device == "cpu":
        return getattr(_C, f"{name}_{_SUFFIX[dtype]}")
    if device != "cuda":
        raise ValueError(f"touchnet.ops: expected tensors on cpu or cuda, got {device}")
    if not _C.build_info()["cuda_architectures"]:
        raise RuntimeError(
            "touchnet was built without CUDA kernels. Build it again where nvcc works with TOUCHNET_CUDA=1, "
            "move the tensors to the CPU, or set TOUCHNET_BACKEND=reference."
        )
    return getattr(_C, f"cuda_{name}_{_SUFFIX[dtype]}")


def launch(name: str, dtype_of: Tensor, *arguments: object) -> None:
    """Call the kernel for the tensor's dtype and device, with torch's number of threads or its current stream last."""
    device = dtype_of.device
    kernel = _kernel(name, device.type, dtype_of.dtype)
    if device.type == "cpu":
        kernel(*arguments, torch.get_num_threads())
    else:
        with torch.cuda.device(device):
            kernel(*arguments, torch.cuda.current_stream(device).cuda_stream)


def launch_scatter(
    name: str, dtype_of: Tensor, points: Tensor, size: Sequence[int], clamped: bool, *arguments: object
) -> None:
    """Launch a kernel that adds points (B, N, 3) into a volume of `size`, in a fixed order where torch asks for one.

    The CPU kernels have one. Those of CUDA add atomically, or by cell of the points sorted under
    torch.use_deterministic_algorithms(True). `clamped`: points outside belong to the nearest cell.
    """
    if points.device.type == "cpu":
        launch(name, dtype_of, *arguments)
    elif torch.are_deterministic_algorithms_enabled():
        order, starts = sort_by_cell(points, size, clamped)
        launch(name, dtype_of, *arguments, order.data_ptr(), starts.data_ptr())
    else:
        launch(name, dtype_of, *arguments, 0, 0)


def sort_by_cell(points: Tensor, size: Sequence[int], clamped: bool) -> tuple[Tensor, Tensor]:
    """Points (B, N, 3) in the order of their cells: numbers (B N,), and where each cell starts (cells + 1,), int64."""
    cells = points.shape[0] * (size[0] - 1) * (size[1] - 1) * (size[2] - 1)
    numbers = torch.empty(points.shape[0] * points.shape[1], dtype=torch.int64, device=points.device)
    shape = (points.shape[0], 1, *size)
    launch("cell_numbers", points, points.data_ptr(), points.shape[1], shape, clamped, numbers.data_ptr())
    ordered, order = torch.sort(numbers, stable=True)
    return order, torch.searchsorted(ordered, torch.arange(cells + 1, device=points.device))


def raw_kernel(fake: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Make a function that launches kernels known to torch.compile as a custom operator with this fake.

    Eager calls go straight to the function: the dispatcher would add some 20 microseconds.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        operator = torch.library.custom_op(f"touchnet::{function.__name__.lstrip('_')}", function, mutates_args=())
        operator.register_fake(fake)

        @wraps(function)
        def call(*arguments):
            return operator(*arguments) if torch.compiler.is_compiling() else function(*arguments)

        call.operator = operator
        return call

    return decorate


def volume_like(volume: Tensor, dtype: torch.dtype | None = None) -> Tensor:
    """An empty dense tensor of a volume's shape: channels last where the volume is, contiguous otherwise."""
    last = volume.is_contiguous(memory_format=torch.channels_last_3d) and not volume.is_contiguous()
    return torch.empty_like(
        volume, dtype=dtype, memory_format=torch.channels_last_3d if last else torch.contiguous_format
    )


def refuse_transforms(name: str) -> None:
    """One clear error for vmap, jacrev and the other transforms of torch.func."""
    if not torch.compiler.is_compiling() and torch._C._are_functorch_transforms_active():
        raise NotImplementedError(
            f"{name} does not take part in torch.func transforms (vmap, grad, jacrev, ...): fold the mapped axis into "
            "the batch, use torch.autograd, or set TOUCHNET_BACKEND=reference"
        )


def backward_is_recorded() -> bool:
    """Whether a backward pass is itself being recorded (create_graph=True); torch.compile records none."""
    return torch.is_grad_enabled() and not torch.compiler.is_compiling()


def differentiable_backward(
    function: Callable[..., Tensor], inputs: Sequence[Tensor | None], wanted: Sequence[bool], grad: Tensor
) -> list[Tensor | None]:
    """Gradients that can be differentiated again: autograd records the reference formula."""
    aliases = [None if x is None else x.view_as(x) for x in inputs]  # cut off from each other's history
    output = function(*aliases)
    chosen = [alias for alias, want in zip(aliases, wanted, strict=True) if want]
    found = iter(torch.autograd.grad(output, chosen, grad, create_graph=True, allow_unused=True))
    return [next(found) if want else None for want in wanted]
