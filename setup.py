"""Builds touchnet._C by driving CMake with ninja; CMakeLists.txt describes the build, pyproject.toml the package."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).parent.resolve()


class CMakeBuild(build_ext):
    def build_extension(self, ext: Extension) -> None:
        import pybind11

        output = Path(self.get_ext_fullpath(ext.name)).resolve()
        build = Path(self.build_temp).resolve()
        build.mkdir(parents=True, exist_ok=True)
        cmake = shutil.which("cmake")
        if cmake is None:
            raise SystemExit("touchnet: cmake was not found; `pip install cmake ninja pybind11` and build again")
        configure = [
            cmake,
            "-S", str(ROOT),
            "-B", str(build),
            "-G", "Ninja",
            f"-DCMAKE_BUILD_TYPE={'Debug' if self.debug else 'Release'}",
            f"-DTOUCHNET_VERSION={self.distribution.get_version()}",
            f"-DTOUCHNET_CUDA={os.environ.get('TOUCHNET_CUDA', 'auto')}",
            f"-DTOUCHNET_SANITIZE={os.environ.get('TOUCHNET_SANITIZE', '')}",
            f"-DTOUCHNET_OUTPUT={output}",
            f"-DPython_EXECUTABLE={sys.executable}",
            f"-Dpybind11_DIR={pybind11.get_cmake_dir()}",
        ]  # fmt: skip
        try:
            subprocess.run(configure, check=True)
            subprocess.run([cmake, "--build", str(build)], check=True)
        except subprocess.CalledProcessError as error:
            raise SystemExit(
                f"touchnet: building the C++ extension failed (exit status {error.returncode}, messages above). "
                "It needs a C++17 compiler (Debian: apt install g++; macOS: xcode-select --install; Windows: the "
                "Visual Studio build tools). TOUCHNET_CUDA=0 leaves the CUDA kernels out."
            ) from None


setup(ext_modules=[Extension("touchnet._C", sources=[])], cmdclass={"build_ext": CMakeBuild})
