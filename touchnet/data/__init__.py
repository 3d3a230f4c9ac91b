"""Data: closing meshes, labelling points, simulating touches, reading and writing them."""

from touchnet.data.exploration import Touches, simulate_touches
from touchnet.data.gp import GaussianProcess

__all__ = ["GaussianProcess", "Touches", "simulate_touches"]
