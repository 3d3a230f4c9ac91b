"""Many queries of one encoded cloud: feature sampling and the occupancy head, without leaving the cache."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from touchnet import ops

# Points at a time where torch multiplies. The activations of a chunk (about 1 KB a point) then stay in the cache, and a
# matrix product is long enough to share between threads; a GPU wants chunks that fill it.
CPU_CHUNK = 8192
CUDA_CHUNK = 1 << 18


class HeadQuery:
    """A field, points (M,3) -> values (M,), made of feature volumes and an MLP: what extraction asks millions of times.

    The same numbers as `head(torch.cat([sample(volume, points) for volume in volumes], dim=2))` up to the order of
    float32 sums (tested to 2e-6 relative to the largest value), without gradients. On an x86-64 processor with AVX2 one
    compiled pass does it all; elsewhere torch multiplies in buffers allocated once. bfloat16 and convolutions of size 1
    were measured beside both (benchmarks/extraction.py).

    One object serves one thread at a time. Weights and volumes are taken as they are when it is made.

    Args:
        volumes: feature volumes (1,C,X,Y,Z), float32, best channels last in memory, over the cube [-1,1]^3.
        head: nn.Sequential of Linear layers with ReLU between them, from sum of C to 1 output.
        sample: how features are read: ops.trilinear_sample or ops.addition_sample.
        sigmoid: apply a sigmoid to the head's output.
        chunk: points at a time where torch multiplies; by default 8192 on the CPU and 262144 on CUDA.
        compiled: False for torch's products even where the compiled pass could run.
    """

    def __init__(
        self,
        volumes: Sequence[Tensor],
        head: nn.Sequential,
        *,
        sample: Callable[..., Tensor] = ops.trilinear_sample,
        sigmoid: bool = True,
        chunk: int | None = None,
        compiled: bool = True,
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
        volumes = [volume.detach().float() for volume in volumes]
        weights = [layer.weight.detach().float() for layer in linear]
        biases = [layer.bias.detach().float() for layer in linear]
        self.device, self.sigmoid = volumes[0].device, sigmoid
        samplers = {ops.trilinear_sample: True, ops.addition_sample: False}
        if compiled and self.device.type == "cpu" and sample in samplers and _compiled_head_runs():
            from touchnet.ops.head import CompiledHead

            self.compute: Callable[[Tensor], Tensor] = CompiledHead(
                volumes, weights, biases, trilinear=samplers[sample]
            )
        else:
            chunk = chunk or (CPU_CHUNK if self.device.type == "cpu" else CUDA_CHUNK)
            self.compute = BufferedHead(volumes, weights, biases, sample, chunk)

    @torch.no_grad()
    def __call__(self, points: Tensor) -> Tensor:
        """Values (M,) float32 at points (M,3) of the cube."""
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"points: expected shape (M, 3), got {tuple(points.shape)}")
        values = self.compute(points.detach().to(self.device, torch.float32))
        return values.sigmoid_() if self.sigmoid else values


def _compiled_head_runs() -> bool:
    if ops.BACKEND != "compiled":
        return False
    from touchnet.ops.head import CompiledHead

    return CompiledHead.is_supported()


class BufferedHead:
    """The same by torch, a chunk at a time. Samples, activations and weights live in buffers allocated once; the
    volumes' features are never joined: the first layer adds up one product per volume.
    """

    def __init__(
        self,
        volumes: Sequence[Tensor],
        weights: Sequence[Tensor],
        biases: Sequence[Tensor],
        sample: Callable[..., Tensor],
        chunk: int,
    ) -> None:
        self.volumes, self.biases, self.sample, self.chunk = list(volumes), list(biases), sample, chunk
        channels = [volume.shape[1] for volume in volumes]
        transposed = [weight.t().contiguous() for weight in weights]
        self.first = [part.contiguous() for part in transposed[0].split(channels)]
        self.later, self.last = transposed[1:-1], transposed[-1][:, 0].contiguous()
        self.samples = [volumes[0].new_empty(1, chunk, c) for c in channels]
        self.hidden = [volumes[0].new_empty(chunk, len(weight)) for weight in weights[:-1]]

    def __call__(self, points: Tensor) -> Tensor:
        """Values (M,) before the sigmoid at points (M,3)."""
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
        return values
