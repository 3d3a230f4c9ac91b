"""The CUDA kernels of marching cubes: their bodies on the host as serial loops, and on a GPU where there is one."""

import importlib.util
import shutil
import subprocess
import sysconfig
from pathlib import Path

import pytest
import torch

from tests.ops.conftest import why_no_cuda
from tests.ops.surfaces import RANDOM_VOLUMES, assert_same_mesh, on_lattice, small_volumes, torus
from touchnet.ops import _launch, cubes, marching_cubes

CSRC = Path(__file__).resolve().parents[2] / "csrc"
MODULE = """
#include "cuda/extraction_bindings.h"
PYBIND11_MODULE(touchnet_cubes_on_host, m) { touchnet::cuda::define_extraction(m); }
"""


@pytest.fixture(scope="module")
def host_kernels(tmp_path_factory):
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        pytest.skip("no C++ compiler")
    pybind11 = pytest.importorskip("pybind11")
    folder = tmp_path_factory.mktemp("cubes_on_host")
    (folder / "module.cpp").write_text(MODULE)
    library = folder / "touchnet_cubes_on_host.so"
    command = [compiler, "-std=c++17", "-O0", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=off", "-Wall"]
    command += [f"-I{path}" for path in (CSRC, pybind11.get_include(), sysconfig.get_paths()["include"])]
    command += ["-Werror", "-o", library, folder / "module.cpp", "-x", "c++", CSRC / "cuda" / "marching_cubes.cu"]
    subprocess.run(command, check=True)
    spec = importlib.util.spec_from_file_location("touchnet_cubes_on_host", library)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_bodies_give_the_mesh_of_the_cpu(monkeypatch, host_kernels, generator):
    monkeypatch.setattr(
        _launch, "_kernel", lambda name, _, dtype: getattr(host_kernels, f"cuda_{name}_{str(dtype)[6:]}")
    )
    for kind in RANDOM_VOLUMES:
        for volume, level in small_volumes(generator, kind, 10):
            arguments = volume, level, [-1.0, 0.0, 5.0], [1.0, 0.5, 0.25], True
            ours, expected = cubes._extract_on_gpu(*arguments), cubes._extract(*arguments)
            assert_same_mesh(ours, expected)
            # The edge of each vertex is that of the vertex at the same place.
            for mesh in (ours, expected):
                order = sorted(range(len(mesh[0])), key=mesh[0].tolist().__getitem__)
                mesh[2].copy_(mesh[2][order])
                mesh[3].copy_(mesh[3][order])
            assert torch.equal(ours[2], expected[2]) and torch.equal(ours[3], expected[3])
    with pytest.raises(ValueError, match="got 4 NaN"):
        volume = torch.ones(2, 2, 2).index_fill(0, torch.tensor([0]), torch.nan)
        cubes._extract_on_gpu(volume, 0.5, [0.0] * 3, [1.0] * 3, False)


@pytest.mark.cuda
def test_a_gpu_gives_the_mesh_of_the_cpu(generator):
    if reason := why_no_cuda():
        pytest.skip(reason)
    volume = on_lattice(torus, 40)
    for values in (volume, volume.double(), torch.randn(20, 30, 9, generator=generator)):
        leaf = values.cuda().requires_grad_()
        mesh = marching_cubes(leaf, 0.0)
        assert_same_mesh([t.cpu() for t in mesh], marching_cubes(values, 0.0))
        mesh[0].square().sum().backward()
        other = values.clone().requires_grad_()
        marching_cubes(other, 0.0)[0].square().sum().backward()
        torch.testing.assert_close(leaf.grad.cpu(), other.grad, rtol=1e-4, atol=1e-4)
