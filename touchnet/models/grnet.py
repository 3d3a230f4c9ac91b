"""GRNet: touches in, a dense cloud of points out ("GRNet: Gridding Residual Network for Dense Point Cloud Completion",
ECCV 2020). Shapes are for a grid of 64 vertices, 2048 sparse points and 8 copies.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from touchnet import ops
from touchnet.config import GRNetConfig


class GRNet(nn.Module):
    """Gridding, 3D U-Net, gridding reverse, cubic feature sampling, MLP to offsets. Contact normals are not used."""

    predicts = "points"
    uses_normals = False

    def __init__(self, config: GRNetConfig | None = None) -> None:
        super().__init__()
        config = config or GRNetConfig()
        if config.grid < 16 or config.grid % 16:
            raise ValueError(f"config.grid should be a positive multiple of 16, got {config.grid}")
        self.config = config
        half, quarter, eighth, sixteenth = config.channels
        flat = sixteenth * (config.grid // 16) ** 3
        self.down = nn.ModuleList(
            nn.Sequential(
                nn.Conv3d(before, after, kernel_size=4, padding=2),
                nn.BatchNorm3d(after),
                nn.LeakyReLU(0.2),
                nn.MaxPool3d(2),
            )
            for before, after in [(1, half), (half, quarter), (quarter, eighth), (eighth, sixteenth)]
        )
        self.squeeze = nn.Sequential(nn.Linear(flat, config.code), nn.ReLU())
        self.expand = nn.Sequential(nn.Linear(config.code, flat), nn.ReLU())
        self.up = nn.ModuleList(
            nn.Sequential(
                nn.ConvTranspose3d(before, after, kernel_size=4, stride=2, padding=1, bias=False),
                nn.BatchNorm3d(after),
                nn.ReLU(),
            )
            for before, after in [(sixteenth, eighth), (eighth, quarter), (quarter, half), (half, 1)]
        )
        features = 8 * (half + quarter + eighth)
        self.offsets = nn.Sequential(
            nn.Linear(features, features),
            nn.ReLU(),
            nn.Linear(features, features // 4),
            nn.ReLU(),
            nn.Linear(features // 4, features // 16),
            nn.ReLU(),
            nn.Linear(features // 16, 3 * config.copies),
        )

    def forward(self, touches: Tensor, normals: Tensor | None = None, keys: Tensor | None = None) -> list[Tensor]:
        """Sparse and dense points.

        Args:
            touches: (B, N, 3) contact points in the cube [-1, 1]^3; rows that are not finite are padding.
            normals: ignored.
            keys: (B,) int64 seeds of the choice among the reversed grid's points; None: zeros.

        Returns:
            (B, sparse, 3) and (B, sparse * copies, 3): the coarse cloud, and the one that counts.
        """
        volume = ops.gridding(touches, self.config.grid)  # (B, 1, 64, 64, 64)
        down1 = self.down[0](volume)  # (B, 32, 32, 32, 32)
        down2 = self.down[1](down1)  # (B, 64, 16, 16, 16)
        down3 = self.down[2](down2)  # (B, 128, 8, 8, 8)
        down4 = self.down[3](down3)  # (B, 256, 4, 4, 4)
        code = self.squeeze(down4.flatten(1))  # (B, 2048)
        up4 = self.expand(code).view_as(down4) + down4  # (B, 256, 4, 4, 4)
        up3 = self.up[0](up4) + down3  # (B, 128, 8, 8, 8)
        up2 = self.up[1](up3) + down2  # (B, 64, 16, 16, 16)
        up1 = self.up[2](up2) + down1  # (B, 32, 32, 32, 32)
        density = self.up[3](up1) + volume  # (B, 1, 64, 64, 64)
        cells = ops.gridding_reverse(density.float(), fill=float("nan"))  # (B, 64^3, 3)
        sparse = self._chosen(cells, touches, keys)  # (B, 2048, 3)
        sampled = [ops.cubic_sample(level.float(), sparse).flatten(2) for level in (up1, up2, up3)]  # (B, 2048, 8 C)
        offsets = self.offsets(torch.cat(sampled, dim=2))  # (B, 2048, 24)
        dense = sparse.repeat_interleave(self.config.copies, dim=1) + offsets.reshape(len(sparse), -1, 3)
        return [sparse, dense]  # (B, 2048, 3), (B, 16384, 3)

    def points(self, touches: Tensor, normals: Tensor | None = None) -> Tensor:
        """The dense cloud (B, sparse * copies, 3) alone."""
        return self(touches, normals)[-1]

    def _chosen(self, cells: Tensor, touches: Tensor, keys: Tensor | None) -> Tensor:
        """`sparse` rows of each sample: of its touches and of the cells that hold a point, drawn at random."""
        chosen = []
        for row in range(len(cells)):
            both = torch.cat([touches[row], cells[row]])
            if not torch.isfinite(touches[row]).all(dim=1).any():
                raise ValueError("touches hold no finite row")
            valid = torch.isfinite(both).all(dim=1).nonzero().squeeze(1)
            generator = torch.Generator().manual_seed(0 if keys is None else int(keys[row]))
            order = torch.randperm(len(valid), generator=generator).to(valid.device)
            order = order.repeat(-(-self.config.sparse // len(order)))[: self.config.sparse]
            chosen.append(both[valid[order]])
        return torch.stack(chosen)
