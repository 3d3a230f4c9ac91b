"""A convolutional occupancy network with a feature volume ("Convolutional Occupancy Networks", ECCV 2020): touches in,
occupancy at query points out. Shapes are for a grid of 32 cells and a width of 32.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from touchnet import ops
from touchnet.config import ConvONetConfig


class ConvONet(nn.Module):
    """A point network pooled within cells, a 3D U-Net over the cells, and a conditioned decoder.

    A cell is what lies nearest to a vertex of the volume, so that features are read where they were pooled.
    """

    predicts = "occupancy"

    def __init__(self, config: ConvONetConfig | None = None) -> None:
        super().__init__()
        config = config or ConvONetConfig()
        if config.grid < 8 or config.grid % 4:
            raise ValueError(f"config.grid should be a multiple of 4 from 8 on, got {config.grid}")
        self.config = config
        width = config.hidden
        self.enter = nn.Linear(6 if config.use_normals else 3, 2 * width)
        self.point_blocks = nn.ModuleList(ResnetBlock(2 * width, width) for _ in range(config.blocks))
        self.leave = nn.Linear(width, width)
        self.unet = UNet3D(width)
        self.query = nn.Linear(3, width)
        self.condition = nn.ModuleList(nn.Linear(width, width) for _ in range(config.blocks))
        self.decoder_blocks = nn.ModuleList(ResnetBlock(width, width) for _ in range(config.blocks))
        self.out = nn.Linear(width, 1)

    @property
    def uses_normals(self) -> bool:
        """Whether contact normals change the result."""
        return self.config.use_normals

    def forward(self, touches: Tensor, queries: Tensor, normals: Tensor | None = None) -> Tensor:
        """Occupancy (B, M) in [0, 1] at queries (B, M, 3); arguments as those of TouchNet."""
        return self.decode(self.encode(touches, normals), queries)

    def logits(
        self, touches: Tensor, queries: Tensor, normals: Tensor | None = None, keys: Tensor | None = None
    ) -> Tensor:
        """As :meth:`forward`, before the sigmoid. This network draws nothing at random: `keys` change nothing."""
        return self.decode_logits(self.encode(touches, normals), queries)

    def encode(self, touches: Tensor, normals: Tensor | None = None) -> list[Tensor]:
        """The feature volume of touches (B, N, 3), rows that are not finite being padding: one (B, 32, 32, 32, 32)."""
        if touches.dim() != 3 or touches.shape[2] != 3:
            raise ValueError(f"touches should have shape (B, N, 3), got {tuple(touches.shape)}")
        valid = torch.isfinite(touches).all(dim=2)  # (B, N)
        points = torch.where(valid[..., None], touches, 0.0)
        inputs = points
        if self.config.use_normals:
            inputs = torch.cat([points, torch.zeros_like(points) if normals is None else normals], dim=2)  # (B, N, 6)
        cell = self._cells(points, valid)  # (B, N), the last one for padding
        state = self.point_blocks[0](self.enter(inputs))  # (B, N, 32)
        for block in self.point_blocks[1:]:
            pooled = self._pooled(state, cell, "amax")  # (B, cells + 1, 32)
            around = torch.gather(pooled, 1, cell[..., None].expand_as(state))  # (B, N, 32)
            state = block(torch.cat([state, around], dim=2))  # (B, N, 32)
        size = self.config.grid
        volume = self._pooled(self.leave(state), cell, "mean")[:, :-1]  # (B, cells, 32)
        volume = volume.transpose(1, 2).unflatten(2, (size, size, size))  # (B, 32, 32, 32, 32)
        return [self.unet(volume.contiguous(memory_format=torch.channels_last_3d))]

    def decode_logits(self, features: list[Tensor], queries: Tensor) -> Tensor:
        """Logit of the occupancy at `queries` (B, M, 3) from what :meth:`encode` returned: (B, M)."""
        sampled = ops.trilinear_sample(features[0].float(), queries)  # (B, M, 32)
        state = self.query(queries)  # (B, M, 32)
        for condition, block in zip(self.condition, self.decoder_blocks, strict=True):
            state = block(state + condition(sampled))  # (B, M, 32)
        return self.out(state.relu()).squeeze(2)  # (B, M)

    def decode(self, features: list[Tensor], queries: Tensor) -> Tensor:
        """Occupancy in [0, 1] at `queries` (B, M, 3): (B, M)."""
        return self.decode_logits(features, queries).float().sigmoid()

    def _cells(self, points: Tensor, valid: Tensor) -> Tensor:
        """Index of each point's nearest vertex, x-major; one more for padding and for what lies outside the cube."""
        size = self.config.grid
        index = ((points + 1) * ((size - 1) / 2)).round().long().clamp(0, size - 1)
        inside = valid & (points.abs() <= 1).all(dim=2)
        flat = (index[..., 0] * size + index[..., 1]) * size + index[..., 2]
        return torch.where(inside, flat, size**3)

    def _pooled(self, state: Tensor, cell: Tensor, reduce: str) -> Tensor:
        """(B, cells + 1, C): mean or greatest of the points' state (B, N, C) in each cell, 0 in empty ones."""
        empty = state.new_zeros(len(state), self.config.grid**3 + 1, state.shape[2])
        return empty.scatter_reduce(1, cell[..., None].expand_as(state), state, reduce, include_self=False)


class ResnetBlock(nn.Module):
    """Two fully connected layers beside a straight (or linear) way, over the last dimension."""

    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        middle = min(before, after)
        self.first, self.second = nn.Linear(before, middle), nn.Linear(middle, after)
        self.straight = nn.Identity() if before == after else nn.Linear(before, after, bias=False)
        nn.init.zeros_(self.second.weight)  # a block starts as its straight way

    def forward(self, x: Tensor) -> Tensor:
        return self.straight(x) + self.second(self.first(x.relu()).relu())


class UNet3D(nn.Module):
    """Three levels of two 3^3 convolutions, pooled by the greatest and joined by concatenation."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.down1, self.down2 = _convolved(width, width), _convolved(width, 2 * width)
        self.bottom = _convolved(2 * width, 4 * width)
        self.up2, self.up1 = _convolved(6 * width, 2 * width), _convolved(3 * width, width)
        self.last = nn.Conv3d(width, width, kernel_size=1)

    def forward(self, volume: Tensor) -> Tensor:
        down1 = self.down1(volume)  # (B, 32, 32, 32, 32)
        down2 = self.down2(F.max_pool3d(down1, 2))  # (B, 64, 16, 16, 16)
        bottom = self.bottom(F.max_pool3d(down2, 2))  # (B, 128, 8, 8, 8)
        up2 = self.up2(torch.cat([F.interpolate(bottom, scale_factor=2), down2], dim=1))  # (B, 64, 16, 16, 16)
        up1 = self.up1(torch.cat([F.interpolate(up2, scale_factor=2), down1], dim=1))  # (B, 32, 32, 32, 32)
        return self.last(up1)  # (B, 32, 32, 32, 32)


def _convolved(before: int, after: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for channels in (before, after):
        layers += [
            nn.Conv3d(channels, after, kernel_size=3, padding=1, bias=False),
            nn.GroupNorm(min(8, after), after),
            nn.ReLU(),
        ]
    return nn.Sequential(*layers)
