"""Devices and layouts the operators are tested on."""

import pytest
import torch

from touchnet.ops._ext import _C


def why_no_cuda() -> str | None:
    """Why tests on CUDA cannot run here; None where they can."""
    if not _C.build_info()["cuda_architectures"]:
        return "touchnet was built without CUDA kernels"
    if not torch.cuda.is_available():
        return "torch sees no CUDA device"
    return None


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=pytest.mark.cuda)])
def device(request) -> torch.device:
    if request.param == "cuda" and (reason := why_no_cuda()):
        pytest.skip(reason)
    return torch.device(request.param)


@pytest.fixture(params=[torch.float32, torch.float64], ids=["float32", "float64"])
def dtype(request) -> torch.dtype:
    return request.param


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(20)
