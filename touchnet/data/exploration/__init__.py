"""Touch exploration of a closed mesh under a Gaussian process (paper section 4.2, eq. 8), and ways to compare it with.

A finger slides from contact to contact: along the gradient of the posterior variance in the tangent plane, one step,
back to the surface. A stroke ends where little is left to learn; the next starts where the variance is highest.

Inside this package the mesh's longest side is 1 and its box is centred; points are tuples where they come one by one.
"""

from touchnet.data.exploration.record import Touches
from touchnet.data.exploration.surface import Surface, coverage
from touchnet.data.exploration.trajectory import simulate_touches

__all__ = ["Surface", "Touches", "coverage", "simulate_touches"]
