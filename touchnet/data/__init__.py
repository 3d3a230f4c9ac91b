"""Data: closing meshes, labelling points, simulating touches, reading and writing them."""

from touchnet.data.exploration import ClosestPoints, Touches, coverage, simulate_touches
from touchnet.data.files import Points, read_mesh, read_points, split_strokes, write_mesh
from touchnet.data.gp import GaussianProcess

__all__ = [
    "ClosestPoints",
    "GaussianProcess",
    "Points",
    "Touches",
    "coverage",
    "read_mesh",
    "read_points",
    "simulate_touches",
    "split_strokes",
    "write_mesh",
]
