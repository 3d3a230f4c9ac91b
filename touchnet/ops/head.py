"""The occupancy head at many points, without gradients: sampling and MLP in one compiled pass."""

from collections.abc import Sequence

import torch
from torch import Tensor

from touchnet.ops._ext import _C


class CompiledHead:
    """Features sampled from volumes, joined, and an MLP with ReLU between its layers, over tiles of points that stay in
    the first-level cache from the volumes to the output (csrc/head.h).

    The value at a point depends neither on the other points of the call nor on the number of threads.

    Args:
        volumes: (1,C,X,Y,Z) float32 on the CPU, of any strides, over the cube [-1,1]^3; read in place at every call.
        weights: (outputs, inputs) float32 of each layer, from the sum of C to 1; copied, as are the biases.
        biases: (outputs,) float32 of each layer.
        trilinear: True for trilinear sampling, False for the sum of a cell's corners.
        wide: use AVX-512 where the processor has it: 1.6 times as fast as AVX2, with the same bits.
    """

    def __init__(
        self,
        volumes: Sequence[Tensor],
        weights: Sequence[Tensor],
        biases: Sequence[Tensor],
        *,
        trilinear: bool,
        wide: bool = True,
    ) -> None:
        self.wide = wide
        self.volumes = list(volumes)  # the kernel keeps addresses: these keep the memory
        self.head = _C.Head([(v.data_ptr(), v.shape, v.stride()) for v in volumes], trilinear)
        for weight, bias in zip(weights, biases, strict=True):
            weight, bias = weight.contiguous(), bias.contiguous()
            self.head.add_layer(weight.data_ptr(), bias.data_ptr(), weight.shape[1], weight.shape[0])

    @staticmethod
    def is_supported() -> bool:
        """Whether the processor has the instructions: x86-64 with AVX2 and fused multiply-add."""
        return _C.Head.is_supported()

    def __call__(self, points: Tensor) -> Tensor:
        """Values (M,) before the sigmoid at points (M,3), float32 on the CPU."""
        points = points.contiguous()
        values = points.new_empty(len(points))
        self.head.query(points.data_ptr(), len(points), values.data_ptr(), torch.get_num_threads(), self.wide)
        return values
