"""The operators of touchnet.ops in plain Python and torch: same names and signatures, written to be read."""

from touchnet.reference.sampling import addition_sample, cubic_sample, trilinear_sample
from touchnet.reference.splatting import gridding, gridding_reverse

__all__ = ["addition_sample", "cubic_sample", "gridding", "gridding_reverse", "trilinear_sample"]
