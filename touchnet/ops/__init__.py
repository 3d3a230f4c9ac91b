"""touchnet's operators. The environment variable TOUCHNET_BACKEND, read at import, picks who computes them: "compiled"
(the default: C++ and CUDA kernels) or "reference" (the same functions of touchnet.reference, slow, without the extension).
"""

import os

BACKEND = os.environ.get("TOUCHNET_BACKEND") or "compiled"

if BACKEND == "compiled":
    from touchnet.ops.sampling import addition_sample, trilinear_sample
    from touchnet.ops.splatting import gridding
elif BACKEND == "reference":
    from touchnet.reference import addition_sample, gridding, trilinear_sample
else:
    raise ImportError(f'TOUCHNET_BACKEND: expected "compiled" or "reference", got {BACKEND!r}')

__all__ = ["BACKEND", "addition_sample", "gridding", "trilinear_sample"]
