"""touchnet: closed triangle meshes from touching trajectories.

The pipeline: :mod:`touchnet.data` (reading and simulating touches, data sets), :mod:`touchnet.ops` (gridding, feature
sampling, marching cubes), :mod:`touchnet.models`, :mod:`touchnet.reconstruction`, :mod:`touchnet.metrics`.
"""

import importlib
from typing import Any

_HOME = {
    "Explorer": "touchnet.explorer",
    "reconstruct_mesh": "touchnet.reconstruction",
    "load_model": "touchnet.weights",
    "save_weights": "touchnet.weights",
    "tune_allocator": "touchnet.allocator",
}
_MODULES = ("data", "frames", "metrics", "models", "ops", "reference")

__all__ = ["build_info", *_HOME, *_MODULES]


def build_info() -> dict[str, object]:
    """How this installation was built: version, compiler, threading, CUDA architectures ("" without CUDA kernels).

    Raises:
        ImportError: the compiled extension is missing or does not load.
    """
    from touchnet.ops._ext import _C

    return _C.build_info()


# Imported when first used: torch takes seconds to load, and `touchnet --help` or a simulation worker need none of it.
def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(importlib.import_module(_HOME[name]), name)
    elif name in _MODULES:
        value = importlib.import_module(f"touchnet.{name}")
    else:
        raise AttributeError(f"module 'touchnet' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
