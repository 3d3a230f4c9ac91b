"""Configuring the extension on machines where something is missing or broken."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.slow


def configure(folder: Path, *options: str, **environment: str) -> subprocess.CompletedProcess:
    """Configure into folder / "build" as setup.py does; a value of "" takes a variable away."""
    cmake, ninja = shutil.which("cmake"), shutil.which("ninja")
    if cmake is None or ninja is None:
        pytest.skip("no cmake or ninja")
    pybind11 = pytest.importorskip("pybind11")
    env = {name: value for name, value in {**os.environ, **environment}.items() if value}
    command = [cmake, "-S", str(ROOT), "-B", str(folder / "build"), "-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={ninja}"]
    command += [f"-DPython_EXECUTABLE={sys.executable}", f"-Dpybind11_DIR={pybind11.get_cmake_dir()}", *options]
    return subprocess.run(command, capture_output=True, text=True, env=env, timeout=300)


def fake_nvcc(folder: Path, script: str) -> str:
    """A CUDA_HOME whose nvcc is a shell script."""
    nvcc = folder / "cuda" / "bin" / "nvcc"
    nvcc.parent.mkdir(parents=True)
    nvcc.write_text(f"#!/bin/sh\n{script}\n")
    nvcc.chmod(0o755)
    return str(folder / "cuda")


NVCC = {
    "too old": ("exit 1", "--list-gpu-arch failed"),
    "knows no architecture of ours": ("echo compute_35", "knows none of sm_75"),
    "broken": (
        '[ "$1" = --list-gpu-arch ] && echo compute_80 && exit; echo "fatal error: no host compiler" >&2; exit 2',
        "cannot compile and link a small program (fatal error: no host compiler)",
    ),
}


@pytest.mark.skipif(os.name == "nt", reason="the fake nvcc is a shell script")
@pytest.mark.parametrize("case", NVCC)
def test_bad_nvcc_leaves_cuda_out_in_one_line(case, tmp_path):
    script, reason = NVCC[case]
    home = fake_nvcc(tmp_path, script)
    result = configure(tmp_path, "-DTOUCHNET_CUDA=auto", CUDA_HOME=home)
    assert result.returncode == 0, result.stderr
    lines = [line for line in result.stdout.splitlines() if "without CUDA kernels" in line]
    assert len(lines) == 1 and reason in lines[0], result.stdout
    required = configure(tmp_path, "-DTOUCHNET_CUDA=1", CUDA_HOME=home)
    assert required.returncode != 0
    assert "TOUCHNET_CUDA=1, but" in required.stderr and reason.split("(")[0].strip() in " ".join(
        required.stderr.split()
    )


def test_without_cuda(tmp_path):
    result = configure(tmp_path, "-DTOUCHNET_CUDA=0", CUDA_HOME=str(tmp_path / "nowhere"))
    assert result.returncode == 0, result.stderr
    assert "building without CUDA kernels: TOUCHNET_CUDA=0" in result.stdout


def test_without_a_compiler_the_error_says_what_to_install(tmp_path):
    source = tmp_path / "source"
    source.mkdir()
    for name in ("setup.py", "CMakeLists.txt", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    shutil.copytree(ROOT / "csrc", source / "csrc")
    shutil.copytree(ROOT / "cmake", source / "cmake")
    pytest.importorskip("pybind11")
    if shutil.which("cmake") is None:
        pytest.skip("no cmake")
    result = subprocess.run(
        [sys.executable, "setup.py", "-q", "build_ext", "--inplace"],
        cwd=source,
        capture_output=True,
        text=True,
        env={**os.environ, "CXX": str(tmp_path / "no-compiler"), "TOUCHNET_CUDA": "0"},
        timeout=300,
    )
    assert result.returncode != 0
    assert "It needs a C++17 compiler" in result.stderr and "apt install g++" in result.stderr
    assert "Traceback" not in result.stderr
