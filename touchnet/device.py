"""The device that networks run on."""

import torch

from touchnet import ops


def pick_device(name: str | torch.device) -> torch.device:
    """The device called "cpu", "cuda", ..., or for "auto" CUDA where a device and kernels for it are at hand.

    Raises:
        ValueError: no such device.
    """
    if str(name) == "auto":
        return torch.device("cuda" if torch.cuda.is_available() and _cuda_kernels() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise ValueError(f'device should be "auto", "cpu" or "cuda", got {name!r}') from None
    if device.type not in ("cpu", "cuda"):
        raise ValueError(f'device should be "auto", "cpu" or "cuda", got {str(name)!r}')
    if device.type == "cuda" and not torch.cuda.is_available():
        raise ValueError(f"device {str(name)!r} asked for, but this torch finds no CUDA device; use cpu")
    if device.type == "cuda" and not _cuda_kernels():
        raise ValueError(f"device {str(name)!r} asked for, but touchnet was built without CUDA kernels; use cpu")
    return device


def _cuda_kernels() -> bool:
    if ops.BACKEND == "reference":
        return True
    from touchnet.ops._ext import _C

    return bool(_C.build_info()["cuda_architectures"])
