"""How the operators call the compiled kernels: kernel of a dtype and device, threads or stream, gradients of gradients."""

from collections.abc import Callable, Sequence
from functools import cache

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
    """Call kernel `name` of the tensor's dtype and device, with torch's number of threads or its current stream last."""
    device = dtype_of.device
    kernel = _kernel(name, device.type, dtype_of.dtype)
    if device.type == "cpu":
        kernel(*arguments, torch.get_num_threads())
    else:
        with torch.cuda.device(device):
            kernel(*arguments, torch.cuda.current_stream(device).cuda_stream)


def volume_like(volume: Tensor) -> Tensor:
    """An empty dense tensor of a volume's shape: channels last where the volume is, contiguous otherwise."""
    if volume.is_contiguous():
        return torch.empty_like(volume, memory_format=torch.contiguous_format)
    if volume.is_contiguous(memory_format=torch.channels_last_3d):
        return torch.empty_like(volume, memory_format=torch.channels_last_3d)
    return torch.empty_like(volume, memory_format=torch.contiguous_format)


def refuse_transforms(name: str) -> None:
    """One clear error for vmap, jacrev and the other transforms of torch.func."""
    if torch._C._are_functorch_transforms_active():
        raise NotImplementedError(
            f"{name} does not take part in torch.func transforms (vmap, grad, jacrev, ...): fold the mapped axis into "
            "the batch, use torch.autograd, or set TOUCHNET_BACKEND=reference"
        )


def differentiable_backward(
    function: Callable[..., Tensor], inputs: Sequence[Tensor | None], wanted: Sequence[bool], grad: Tensor
) -> list[Tensor | None]:
    """Gradients that can be differentiated again: through the reference formula, recorded by autograd.

    Used only while a backward pass is itself being recorded (create_graph=True).
    """
    aliases = [None if x is None else x.view_as(x) for x in inputs]  # cut off from each other's history
    with torch.enable_grad():
        output = function(*aliases)
    chosen = [alias for alias, want in zip(aliases, wanted, strict=True) if want]
    found = iter(torch.autograd.grad(output, chosen, grad, create_graph=True, allow_unused=True))
    return [next(found) if want else None for want in wanted]
