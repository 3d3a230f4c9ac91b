"""The bodies of the CUDA kernels, compiled for the host as serial loops (csrc/cuda/launch.h), against the reference.

This checks their arithmetic, indexing and bindings on machines without a GPU; launches, atomics and streams it cannot.
"""

import importlib.util
import shutil
import subprocess
import sysconfig
from pathlib import Path
from types import ModuleType

import pytest
import torch

from tests.ops.common import LAYOUTS, awkward_points, random_points
from touchnet import ops, reference
from touchnet.ops import _launch, sampling, splatting

CSRC = Path(__file__).resolve().parents[2] / "csrc"
MODULE = """
#include "cuda/bindings.h"
PYBIND11_MODULE(touchnet_cuda_on_host, m) { touchnet::cuda::define_volume_ops(m); }
"""


@pytest.fixture(scope="module")
def host_kernels(tmp_path_factory) -> ModuleType:
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        pytest.skip("no C++ compiler")
    pybind11 = pytest.importorskip("pybind11")
    folder = tmp_path_factory.mktemp("cuda_on_host")
    (folder / "module.cpp").write_text(MODULE)
    library = folder / "touchnet_cuda_on_host.so"
    includes = [CSRC, pybind11.get_include(), sysconfig.get_paths()["include"]]
    sources = [CSRC / "cuda" / f"{name}.cu" for name in ("gridding", "gridding_reverse", "sampling")]
    command = [compiler, "-std=c++17", "-O0", "-fPIC", "-shared", "-fvisibility=hidden", "-Wall", "-Werror"]
    command += [f"-I{path}" for path in includes]
    command += ["-o", library, folder / "module.cpp", "-x", "c++", *sources]
    subprocess.run(command, check=True)
    spec = importlib.util.spec_from_file_location("touchnet_cuda_on_host", library)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(params=["atomic", "sorted"])
def on_host(request, monkeypatch, host_kernels):
    """Makes the operators call the CUDA kernels' bodies; sorted: the deterministic path."""

    def scatter(name, dtype_of, points, size, clamped, *arguments):
        order = starts = None
        if request.param == "sorted":
            order, starts = _launch.sort_by_cell(points, size, clamped)
        pointers = (0 if x is None else x.data_ptr() for x in (order, starts))
        _launch.launch(name, dtype_of, *arguments, *pointers)

    def kernel(name, device, dtype):
        return getattr(host_kernels, f"cuda_{name}_{str(dtype).removeprefix('torch.')}")

    monkeypatch.setattr(_launch, "_kernel", kernel)
    monkeypatch.setattr(splatting, "launch_scatter", scatter)
    monkeypatch.setattr(sampling, "launch_scatter", scatter)


def check(name: str, inputs: list[torch.Tensor], tolerance: float, **options) -> None:
    """Result and gradients of an operator and its twin."""
    inputs = [x.detach().requires_grad_() for x in inputs]
    got, expected = (getattr(module, name)(*inputs, **options) for module in (ops, reference))
    torch.testing.assert_close(got, expected, rtol=tolerance, atol=tolerance, equal_nan=True)
    grad = torch.linspace(-1, 1, got.numel(), dtype=got.dtype).view(got.shape)
    wanted = inputs[:1] if name in ("addition_sample", "cubic_sample") else inputs
    pairs = zip(torch.autograd.grad(got, wanted, grad), torch.autograd.grad(expected, wanted, grad), strict=True)
    for a, b in pairs:
        torch.testing.assert_close(a, b, rtol=tolerance, atol=tolerance * (1 + float(b.abs().max())))


@pytest.fixture
def points(generator, dtype) -> torch.Tensor:
    spread = random_points(generator, 2, 60, dtype=dtype, reach=1.1)
    return torch.cat([spread, awkward_points(dtype).expand(2, -1, -1)], 1)


@pytest.mark.slow
@pytest.mark.parametrize("memory_format", [torch.contiguous_format, torch.channels_last_3d], ids=["first", "last"])
def test_gridding(on_host, points, dtype, generator, memory_format):
    tolerance = 1e-5 if dtype == torch.float32 else 1e-13
    check("gridding", [points], tolerance, size=(4, 6, 5), memory_format=memory_format)
    values = torch.randn(*points.shape[:2], 3, generator=generator, dtype=dtype).requires_grad_()
    given = points.detach().requires_grad_()
    got, expected = (m.gridding(given, (4, 6, 5), values=values, memory_format=memory_format) for m in (ops, reference))
    torch.testing.assert_close(got, expected, rtol=tolerance, atol=tolerance)
    grad = torch.randn(got.shape, generator=generator, dtype=dtype)
    for a, b in zip(*(torch.autograd.grad(x, (given, values), grad) for x in (got, expected)), strict=True):
        torch.testing.assert_close(a, b, rtol=tolerance, atol=10 * tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["trilinear_sample", "addition_sample", "cubic_sample"])
@pytest.mark.parametrize("layout", ["contiguous", "channels_last", "transposed"])
def test_samplers(on_host, points, dtype, generator, name, layout):
    volume = LAYOUTS[layout](torch.randn(2, 5, 4, 6, 5, generator=generator, dtype=dtype))
    check(name, [volume, points], 1e-5 if dtype == torch.float32 else 1e-13)


@pytest.mark.slow
def test_gridding_reverse(on_host, dtype, generator):
    volume = torch.rand(2, 1, 4, 6, 5, generator=generator, dtype=dtype)
    volume = torch.where(torch.rand(volume.shape, generator=generator) < 0.5, 0, volume)
    check("gridding_reverse", [volume], 1e-5 if dtype == torch.float32 else 1e-13, fill=0.25)
