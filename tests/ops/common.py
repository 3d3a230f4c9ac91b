"""Inputs shared by the tests and benchmarks of the operators."""

from collections.abc import Callable

import torch
from torch import Tensor

# A volume of the same values in every memory layout the operators promise to read without a copy.
LAYOUTS: dict[str, Callable[[Tensor], Tensor]] = {
    "contiguous": lambda volume: volume.contiguous(),
    "channels_last": lambda volume: volume.contiguous(memory_format=torch.channels_last_3d),
    "transposed": lambda volume: volume.transpose(2, 4).contiguous().transpose(2, 4),
    "strided": lambda volume: volume.repeat_interleave(2, 4)[..., ::2],
    "expanded": lambda volume: volume[:1].expand_as(volume),
}


def random_points(
    generator: torch.Generator, batch: int, n: int, *, dtype: torch.dtype = torch.float32, reach: float = 1.0
) -> Tensor:
    """(batch, n, 3) uniform in [-reach, reach]^3."""
    return (torch.rand(batch, n, 3, generator=generator, dtype=torch.float64) * 2 - 1).mul(reach).to(dtype)


def points_off_faces(
    generator: torch.Generator, batch: int, n: int, size: tuple[int, int, int], *, margin: float = 0.1
) -> Tensor:
    """(batch, n, 3) float64 at least `margin` of a cell from every cell face, where the weights have a kink."""
    cells = torch.tensor(size, dtype=torch.float64) - 1
    index = (torch.rand(batch, n, 3, generator=generator, dtype=torch.float64) * cells).floor()
    t = margin + (1 - 2 * margin) * torch.rand(batch, n, 3, generator=generator, dtype=torch.float64)
    return -1 + 2 * (index + t) / cells


def awkward_points(dtype: torch.dtype) -> Tensor:
    """(1, 14, 3): on vertices, on the cube's faces, beyond them, and not finite."""
    nan, inf = float("nan"), float("inf")
    rows = [
        [-1, -1, -1], [1, 1, 1], [1, -1, 0], [0, 0, 0], [-1, 0.5, 1], [0.25, 1, -1],
        [1.5, 0.1, 0.2], [-3, 0.1, 2], [0.1, 1.0001, 0.3], [1e30, 0, 0],
        [nan, 0.1, 0.1], [0.1, inf, 0.2], [0.1, 0.2, -inf], [nan, nan, nan],
    ]  # fmt: skip
    return torch.tensor([rows], dtype=dtype)
