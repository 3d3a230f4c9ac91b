"""The operators of touchnet.ops in plain Python and torch: same names and signatures, written to be read."""

from touchnet.reference.cubes import marching_cubes
from touchnet.reference.octree import octree_marching_cubes
from touchnet.reference.sampling import addition_sample, cubic_sample, trilinear_sample
from touchnet.reference.splatting import gridding, gridding_reverse

__all__ = [
    "addition_sample",
    "cubic_sample",
    "gridding",
    "gridding_reverse",
    "marching_cubes",
    "octree_marching_cubes",
    "trilinear_sample",
]
