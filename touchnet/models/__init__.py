"""Networks that map touches and query points to occupancy."""

from touchnet.models.touchnet import TouchNet

__all__ = ["TouchNet"]
