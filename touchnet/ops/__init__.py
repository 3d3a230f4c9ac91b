"""The operators. The environment variable TOUCHNET_BACKEND, read at import, says what computes them: "compiled" (the
default) C++ and CUDA kernels, or "reference" the functions of touchnet.reference, slow, which need no extension.
"""

import os

BACKEND = os.environ.get("TOUCHNET_BACKEND") or "compiled"

if BACKEND == "compiled":
    from touchnet.ops.cubes import marching_cubes
    from touchnet.ops.octree import octree_marching_cubes
    from touchnet.ops.sampling import addition_sample, cubic_sample, trilinear_sample
    from touchnet.ops.splatting import gridding, gridding_reverse
elif BACKEND == "reference":
    from touchnet.reference import (
        addition_sample,
        cubic_sample,
        gridding,
        gridding_reverse,
        marching_cubes,
        octree_marching_cubes,
        trilinear_sample,
    )
else:
    raise ImportError(f'TOUCHNET_BACKEND: expected "compiled" or "reference", got {BACKEND!r}')

__all__ = [
    "BACKEND",
    "addition_sample",
    "cubic_sample",
    "gridding",
    "gridding_reverse",
    "marching_cubes",
    "octree_marching_cubes",
    "trilinear_sample",
]
