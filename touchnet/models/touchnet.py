"""TouchNet: touches in, occupancy at query points out. Read from top to bottom it is figure 2 of the paper."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from touchnet import ops
from touchnet.config import MODELS, ModelConfig
from touchnet.models.query import HeadQuery
from touchnet.models.unet3d import BaseUNet3D, PaperUNet3D, channels_last


class TouchNet(nn.Module):
    """Gridding, 3D U-Net, feature sampling, occupancy MLP ("End-to-end Surface Reconstruction For Touching
    Trajectories", ACCV 2022, section 3).

    Args:
        config: the architecture, or the name of one: "base" (the default) or "paper" (72,682,625 parameters).
        sampling: "trilinear" (FI) or "addition" (FA); None keeps the configuration's.
    """

    predicts = "occupancy"

    def __init__(self, config: ModelConfig | str = "base", *, sampling: str | None = None) -> None:
        super().__init__()
        if isinstance(config, str):
            if config not in MODELS:
                raise ValueError(f"config should be one of {sorted(MODELS)} or a ModelConfig, got {config!r}")
            config = MODELS[config]
        if sampling is not None:
            if sampling not in ("trilinear", "addition"):
                raise ValueError(f'sampling should be "trilinear" or "addition", got {sampling!r}')
            config = ModelConfig(**{**vars(config), "sampling": sampling})
        if config.grid < 16 or config.grid % 16:
            raise ValueError(f"config.grid should be a positive multiple of 16, got {config.grid}")
        if config.network == "paper" and config.grid != 64:
            raise ValueError(f"the paper's network takes a grid of 64, got {config.grid}")
        if not 1 <= config.scales <= len(config.channels):
            raise ValueError(f"config.scales should lie in 1..{len(config.channels)}, got {config.scales}")
        self.config = config
        self.sample = ops.trilinear_sample if config.sampling == "trilinear" else ops.addition_sample
        if config.network == "paper":
            self.unet, features = PaperUNet3D(), 16
        else:
            self.unet = BaseUNet3D(8 if config.use_normals else 4, config.channels, config.scales)
            features = sum(config.channels[: config.scales])
        self.head = nn.Sequential(
            nn.Linear(features, 64),
            nn.ReLU(),
            nn.Linear(64, 128),
            nn.ReLU(),
            nn.Linear(128, 32),
            nn.ReLU(),
            nn.Linear(32, 1),
        )
        self.to(memory_format=torch.channels_last_3d)

    @property
    def uses_normals(self) -> bool:
        """Whether contact normals change the result."""
        return self.config.network != "paper" and self.config.use_normals

    def forward(self, touches: Tensor, queries: Tensor, normals: Tensor | None = None) -> Tensor:
        """Occupancy in [0, 1] at `queries`: 1 inside, 0 outside, the surface at 0.5.

        Args:
            touches: (B, N, 3) contact points in the cube [-1, 1]^3 (y up); rows that are not finite are padding.
            queries: (B, M, 3) points in the same cube.
            normals: (B, N, 3) outward unit normals of the contacts; None or zero rows where they are unknown.

        Returns:
            (B, M)
        """
        return self.decode(self.encode(touches, normals), queries)

    def logits(self, touches: Tensor, queries: Tensor, normals: Tensor | None = None) -> Tensor:
        """As :meth:`forward`, before the sigmoid (what the cross-entropy is computed from)."""
        return self.decode_logits(self.encode(touches, normals), queries)

    def encode(self, touches: Tensor, normals: Tensor | None = None) -> list[Tensor]:
        """Feature volumes of the touches, finest first: a list of (B, C, S, S, S), channels last in memory."""
        if touches.dim() != 3 or touches.shape[2] != 3:
            raise ValueError(f"touches should have shape (B, N, 3), got {tuple(touches.shape)}")
        if normals is not None and normals.shape != touches.shape:
            raise ValueError(
                f"normals should have the shape of touches {tuple(touches.shape)}, got {tuple(normals.shape)}"
            )
        if self.config.network == "paper":
            volume = ops.gridding(touches, self.config.grid)  # (B, 1, S, S, S)
        else:
            volume = self._grid(touches, normals if self.config.use_normals else None)  # (B, 4 or 8, S, S, S)
        return [channels_last(features) for features in self.unet(channels_last(volume))]

    def decode_logits(self, features: list[Tensor], queries: Tensor) -> Tensor:
        """Logit of the occupancy at `queries` (B, M, 3) from the volumes that :meth:`encode` returned: (B, M)."""
        sampled = [self.sample(volume.float(), queries) for volume in features]  # each (B, M, C)
        return self.head(torch.cat(sampled, dim=2)).squeeze(2)  # (B, M)

    def decode(self, features: list[Tensor], queries: Tensor) -> Tensor:
        """Occupancy in [0, 1] at `queries` (B, M, 3) from the volumes that :meth:`encode` returned: (B, M)."""
        if not torch.is_grad_enabled() and len(queries) == 1:
            return HeadQuery(features, self.head, sample=self.sample)(queries[0])[None]
        return self.decode_logits(features, queries).float().sigmoid()

    def _grid(self, touches: Tensor, normals: Tensor | None) -> Tensor:
        """What each vertex knows of the contacts in its cells: log density, mean offset, mean normal, mean height.

        Gridding alone says how much contact there is near a vertex. The mean offset (vertex to contact, in cells) says
        where, and the mean height of the contacts' tangent planes over the vertex is a signed distance to the surface:
        both survive the coarse grid, so that the surface can be placed within a cell.
        """
        size, half_cells = self.config.grid, (self.config.grid - 1) / 2
        values = touches
        if self.config.use_normals:
            if normals is None:
                normals = torch.zeros_like(touches)
            values = torch.cat([touches, normals, (touches * normals).sum(2, keepdim=True)], dim=2)  # (B, N, 7)
        volume = ops.gridding(touches, size, values=values)  # (B, 4 or 8, S, S, S)
        density = volume[:, :1]
        axis = torch.linspace(-1, 1, size, dtype=volume.dtype, device=volume.device)
        vertices = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"))  # (3, S, S, S)
        weight = 1 / (density + 0.1)
        channels = [density.log1p(), (volume[:, 1:4] - vertices * density) * (half_cells * weight)]
        if self.config.use_normals:
            normal = volume[:, 4:7]
            height = (volume[:, 7:8] - (vertices * normal).sum(1, keepdim=True)) * half_cells
            channels += [normal * weight, height * weight]
        return torch.cat(channels, dim=1)
