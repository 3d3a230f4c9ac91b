"""Networks from touches to occupancy at query points (`predicts` "occupancy") or to a cloud of points ("points")."""

from torch import nn

from touchnet.config import AnyConfig, architecture_of
from touchnet.models.convonet import ConvONet
from touchnet.models.grnet import GRNet
from touchnet.models.pointnet2 import PointNet2
from touchnet.models.touchnet import TouchNet

__all__ = ["ConvONet", "GRNet", "PointNet2", "TouchNet", "build_model"]

_NETWORKS = {"touchnet": TouchNet, "grnet": GRNet, "pointnet2": PointNet2, "convonet": ConvONet}


def build_model(config: AnyConfig) -> nn.Module:
    """The network of a configuration, with random weights."""
    return _NETWORKS[architecture_of(config)](config)
