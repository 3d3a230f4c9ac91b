"""PointNet++ displacement: touches in, displaced points out ("PointNet++", NeurIPS 2017; the noise beside the features
as in "P2P-NET", SIGGRAPH 2018). Shapes are for 2048 touches and 8 copies of width 32.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn

from touchnet.config import PointNet2Config
from touchnet.farthest import farthest_point_sample


class PointNet2(nn.Module):
    """Set abstractions by farthest points and ball queries, feature propagations, a displacement for each point."""

    predicts = "points"

    def __init__(self, config: PointNet2Config | None = None) -> None:
        super().__init__()
        config = config or PointNet2Config()
        if len(config.centres) != len(config.radii):
            raise ValueError(f"config.radii should be {len(config.centres)}, one a level, got {len(config.radii)}")
        self.config = config
        channels = [3 if config.use_normals else 0] + [config.width * 2 ** (k + 1) for k in range(len(config.centres))]
        self.abstractions = nn.ModuleList(
            _SharedMLP(before + 3, after // 2, after // 2, after) for before, after in itertools.pairwise(channels)
        )
        self.propagations = nn.ModuleList()
        coarse = channels[-1]
        for fine in channels[-2::-1]:
            width = max(fine, 2 * config.width)
            self.propagations.append(_SharedMLP(coarse + fine, width, width))
            coarse = width
        self.displacement = nn.Sequential(
            nn.Linear(coarse + 3 + config.noise, 128), nn.ReLU(), nn.Linear(128, 64), nn.ReLU(), nn.Linear(64, 3)
        )

    @property
    def uses_normals(self) -> bool:
        """Whether contact normals change the result."""
        return self.config.use_normals

    def forward(self, touches: Tensor, normals: Tensor | None = None, keys: Tensor | None = None) -> list[Tensor]:
        """The displaced points.

        Args:
            touches: (B, N, 3) contact points in the cube [-1, 1]^3; rows that are not finite are padding.
            normals: (B, N, 3), used if the configuration says so; zero rows where unknown.
            keys: (B,) int64 seeds of the noise; None: zeros.

        Returns:
            a single (B, points * copies, 3).
        """
        config = self.config
        rows = [_as_many(cloud, config.points) for cloud in touches]
        xyz = [torch.stack([cloud[row] for cloud, row in zip(touches, rows, strict=True)])]  # (B, 2048, 3)
        features: list[Tensor | None] = [None]  # finest first
        if config.use_normals:
            given = torch.zeros_like(touches) if normals is None else normals
            features = [torch.stack([cloud[row] for cloud, row in zip(given, rows, strict=True)])]  # (B, 2048, 3)
        levels = zip(config.centres, config.radii, self.abstractions, strict=True)
        for count, radius, mlp in levels:  # 512, 128, 32 centres with 64, 128, 256 channels
            centres, balls = _grouped(xyz[-1], count, radius, config.neighbours)  # (B, S), (B, S, K)
            middle = _rows(xyz[-1], centres)  # (B, S, 3)
            local = (_rows(xyz[-1], balls) - middle[:, :, None]) / radius  # (B, S, K, 3)
            if features[-1] is not None:
                local = torch.cat([local, _rows(features[-1], balls)], dim=3)  # (B, S, K, 3 + C)
            features.append(mlp(local).amax(dim=2))  # (B, S, C')
            xyz.append(middle)
        state = features[-1]  # (B, 32, 256)
        for level, mlp in zip(range(len(xyz) - 2, -1, -1), self.propagations, strict=True):
            spread = _interpolated(xyz[level], xyz[level + 1], state)  # (B, S, C)
            skip = [] if features[level] is None else [features[level]]
            state = mlp(torch.cat([spread, *skip], dim=2))  # (B, 128, 128), (B, 512, 64), (B, 2048, 64)
        start = xyz[0].repeat_interleave(config.copies, dim=1)  # (B, 16384, 3)
        state = state.repeat_interleave(config.copies, dim=1)  # (B, 16384, 64)
        noise = _noise(start.shape[:2], config.noise, keys).to(state)  # (B, 16384, 32)
        return [start + self.displacement(torch.cat([state, start, noise], dim=2))]  # (B, 16384, 3)

    def points(self, touches: Tensor, normals: Tensor | None = None) -> Tensor:
        """The displaced points (B, points * copies, 3)."""
        return self(touches, normals)[-1]


class _SharedMLP(nn.Module):
    """Linear, batch norm and ReLU in turn, over the last dimension."""

    def __init__(self, *widths: int) -> None:
        super().__init__()
        pairs = list(itertools.pairwise(widths))
        self.linear = nn.ModuleList(nn.Linear(before, after, bias=False) for before, after in pairs)
        self.norm = nn.ModuleList(nn.BatchNorm1d(after) for _, after in pairs)

    def forward(self, x: Tensor) -> Tensor:
        flat = x.reshape(-1, x.shape[-1])
        for linear, norm in zip(self.linear, self.norm, strict=True):
            flat = norm(linear(flat)).relu()
        return flat.reshape(*x.shape[:-1], -1)


def _as_many(cloud: Tensor, count: int) -> Tensor:
    """`count` indices of the finite rows of a cloud (N, 3): evenly thinned, or repeated in turn."""
    valid = torch.isfinite(cloud).all(dim=1).nonzero().squeeze(1)
    if len(valid) == 0:
        raise ValueError("touches hold no finite row")
    if len(valid) >= count:
        return valid[torch.arange(count, device=valid.device) * len(valid) // count]
    return valid.repeat(-(-count // len(valid)))[:count]


def _grouped(xyz: Tensor, count: int, radius: float, neighbours: int) -> tuple[Tensor, Tensor]:
    """Farthest points (B, S) of each cloud (B, N, 3), and up to `neighbours` points of the ball around each (B, S, K);
    where there are fewer the centre stands in."""
    count = min(count, xyz.shape[1])
    centres = farthest_point_sample(xyz.detach(), count)
    balls = []
    for cloud, centre in zip(xyz.detach().cpu().numpy(), centres.cpu().numpy(), strict=True):
        k = min(neighbours, len(cloud))
        distance, ball = cKDTree(cloud).query(cloud[centre], k=list(range(1, k + 1)), distance_upper_bound=radius)
        balls.append(np.where(np.isfinite(distance), ball, centre[:, None]))
    return centres, torch.from_numpy(np.stack(balls)).to(xyz.device)


def _interpolated(fine: Tensor, coarse: Tensor, features: Tensor) -> Tensor:
    """Features (B, S, C) of the coarse points at the fine ones (B, N, 3): inverse distance weights of the nearest 3."""
    k = min(3, coarse.shape[1])
    near = [
        cKDTree(b.cpu().numpy()).query(a.cpu().numpy(), k=list(range(1, k + 1)))
        for a, b in zip(fine.detach(), coarse.detach(), strict=True)
    ]
    weights = torch.from_numpy(np.stack([1 / (distance + 1e-8) for distance, _ in near])).to(features)  # (B, N, 3)
    index = torch.from_numpy(np.stack([rows for _, rows in near])).to(fine.device)  # (B, N, 3)
    weights = weights / weights.sum(dim=2, keepdim=True)
    return (_rows(features, index) * weights[..., None]).sum(dim=2)


def _rows(values: Tensor, index: Tensor) -> Tensor:
    """values (B, N, C) at index (B, ...): (B, ..., C)."""
    flat = index.reshape(len(index), -1)
    picked = torch.gather(values, 1, flat[..., None].expand(-1, -1, values.shape[2]))
    return picked.reshape(*index.shape, values.shape[2])


def _noise(shape: Sequence[int], channels: int, keys: Tensor | None) -> Tensor:
    """Standard normal (B, N, channels), each sample's from its own seed."""
    seeds = [0] * shape[0] if keys is None else keys.tolist()
    drawn = [torch.randn(shape[1], channels, generator=torch.Generator().manual_seed(seed)) for seed in seeds]
    return torch.stack(drawn)
