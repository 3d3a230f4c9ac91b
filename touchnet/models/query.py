"""Many queries of one encoded cloud: feature sampling and the occupancy head in buffers that stay in the cache."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from touchnet import ops

# Points at a time. The activations of a chunk (about 1 KB a point) then stay in the cache, and a matrix product is long
# enough to share between threads; a GPU wants chunks that fill it.
CPU_CHUNK = 8192
CUDA_CHUNK = 1 << 18


class HeadQuery:
    """A field, points (M,3) -> values (M,), made of feature volumes and an MLP: what extraction asks millions of times.

    The same numbers as `head(torch.cat([sample(volume, points) for volume in volumes], dim=2))` up to the order of
    float32 sums (tested to 2e-6 relative to the largest value), without gradients. Samples, activations and weights
    live in buffers allocated once; the volumes' features are never joined: the first layer adds up one product per
    volume. Convolutions of size 1 and bfloat16 were measured beside it (benchmarks/extraction.py): once the chunk stays
    in the cache they gain nothing.

    One object serves one thread at a time. Weights and volumes are taken as they are when it is made.

    Args:
        volumes: feature volumes (1,C,X,Y,Z), float32, best channels last in memory, over the cube [-1,1]^3.
        head: nn.Sequential of Linear layers with ReLU between them, from sum of C to 1 output.
        sample: how features are read: ops.trilinear_sample or ops.addition_sample.
        sigmoid: apply a sigmoid to the head's output.
        chunk: points at a time; by default 8192 on the CPU and 262144 on CUDA.
    """

    def __init__(
        self,
        volumes: Sequence[Tensor],
        head: nn.Sequential,
        *,
        sample: Callable[..., Tensor] = ops.trilinear_sample,
        sigmoid: bool = True,
        chunk: int | None = None,
    ) -> None:
        linear = list(head)[::2]
        between = list(head)[1::2]
        if not all(isinstance(m, nn.Linear) for m in linear) or not all(isinstance(m, nn.ReLU) for m in between):
            raise TypeError(f"head: expected Linear layers with ReLU between them, got {head}")
        if len(linear) < 2 or len(linear) == len(between):
            raise ValueError(f"head: expected at least two Linear layers, the last without ReLU, got {head}")
        channels = [volume.shape[1] for volume in volumes]
        if any(volume.ndim != 5 or volume.shape[0] != 1 for volume in volumes):
            raise ValueError(f"volumes: expected (1, C, X, Y, Z) each, got {[tuple(v.shape) for v in volumes]}")
        if linear[0].in_features != sum(channels) or linear[-1].out_features != 1:
            raise ValueError(
                f"head: expected {sum(channels)} inputs (channels of the volumes {channels}) and 1 output, "
                f"got {linear[0].in_features} and {linear[-1].out_features}"
            )
        self.volumes = [volume.detach().float() for volume in volumes]
        self.sample, self.sigmoid = sample, sigmoid
        device = self.volumes[0].device
        self.chunk = chunk or (CPU_CHUNK if device.type == "cpu" else CUDA_CHUNK)
        weights = [layer.weight.detach().float().t().contiguous() for layer in linear]
        self.biases = [layer.bias.detach().float() for layer in linear]
        self.first = [part.contiguous() for part in weights[0].split(channels)]
        self.later, self.last = weights[1:-1], weights[-1][:, 0].contiguous()
        self.samples = [torch.empty(1, self.chunk, c, device=device) for c in channels]
        self.hidden = [torch.empty(self.chunk, layer.out_features, device=device) for layer in linear[:-1]]

    @torch.no_grad()
    def __call__(self, points: Tensor) -> Tensor:
        """Values (M,) float32 at points (M,3) of the cube."""
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"points: expected shape (M, 3), got {tuple(points.shape)}")
        points = points.detach().to(self.volumes[0])
        values = points.new_empty(len(points))
        for begin in range(0, len(points), self.chunk):
            part = points[begin : begin + self.chunk]
            n = len(part)
            previous = self.biases[0]
            state = self.hidden[0][:n]
            for volume, buffer, weight in zip(self.volumes, self.samples, self.first, strict=True):
                if self.sample is ops.trilinear_sample:  # the one sampler that can write into a buffer
                    features = self.sample(volume, part[None], out=buffer[:, :n])
                else:
                    features = self.sample(volume, part[None])
                torch.addmm(previous, features[0], weight, out=state)
                previous = state
            for buffer, weight, bias in zip(self.hidden[1:], self.later, self.biases[1:-1], strict=True):
                state = torch.addmm(bias, state.relu_(), weight, out=buffer[:n])
            torch.addmv(self.biases[-1], state.relu_(), self.last, out=values[begin : begin + n])
        return values.sigmoid_() if self.sigmoid else values
