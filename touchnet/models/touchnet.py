"""TouchNet: touches in, occupancy at query points out. Read from top to bottom it is figure 2 of the paper."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from touchnet import ops
from touchnet.config import MODELS, ModelConfig
from touchnet.models.query import HeadQuery
from touchnet.models.unet3d import BaseUNet3D, PaperUNet3D, channels_last

# Estimated normals are shorter than measured ones, so that the network can tell them apart, and fade where the first
# pass is flat: there its direction is noise.
ESTIMATED_LENGTH = 0.5
STEEP = 40.0  # change of the logit per unit of the cube at which the length is reached
STEP = 0.01  # of the differences, in the cube: under a cell of 64 vertices
PASSES = 8  # at most, the last one included
SETTLED = 0.05  # mean change of the estimates, as a share of their length, from which on no further pass is made


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
            normals: (B, N, 3) outward unit normals of the contacts; None or zero rows where they are unknown: they are
                estimated, see :meth:`encode`.

        Returns:
            (B, M)
        """
        return self.decode(self.encode(touches, normals), queries)

    def logits(
        self, touches: Tensor, queries: Tensor, normals: Tensor | None = None, keys: Tensor | None = None
    ) -> Tensor:
        """As :meth:`forward`, before the sigmoid (what the cross-entropy is computed from).

        Args:
            keys: (B,) random integers ≥ 0, which say how many passes each sample is given, as training wants it to
                vary: 1 (no estimates) for odd ones, 2 to 4 for the others. None: as many as it takes.
        """
        if keys is None:
            return self.decode_logits(self.encode(touches, normals), queries)
        if self.estimates_normals:
            normals = self._completed(touches, normals, torch.where(keys % 2 == 1, 1, 2 + keys // 2 % 3))
        return self.decode_logits(self._encode(touches, normals), queries)

    @property
    def estimates_normals(self) -> bool:
        """Whether contacts without a normal get one from a first pass."""
        return self.uses_normals and self.config.estimate_normals

    def encode(self, touches: Tensor, normals: Tensor | None = None, guess: Tensor | None = None) -> list[Tensor]:
        """Feature volumes of the touches, finest first: a list of (B, C, S, S, S), channels last in memory.

        Where normals are unknown and the configuration says so, the touches are encoded more than once: a first pass
        without those normals gives a field whose gradient stands in for them in the second, and so on until the normals
        settle (4 or 5 passes in the mean, at most 8).

        Args:
            guess: (B, N, 3) estimates to begin with in place of the first pass: :meth:`normals_of` a field of much the
                same touches. Where they hold, one pass is all.
        """
        if self.estimates_normals:
            if guess is not None:
                unknown = _unknown(touches, normals)
                begin = guess if normals is None else torch.where(unknown[..., None], guess, normals)
                features = self._encode(touches, begin)
                guess = self.normals_of(features, touches).to(begin)
                if (_change(begin, guess, unknown) <= SETTLED * ESTIMATED_LENGTH).all():
                    return features
            normals = self._completed(touches, normals, torch.full((len(touches),), PASSES), begin=guess)
        return self._encode(touches, normals)

    @torch.no_grad()
    def _completed(
        self, touches: Tensor, normals: Tensor | None, passes: Tensor, *, begin: Tensor | None = None
    ) -> Tensor:
        """Normals (B, N, 3) with estimates in place of those that are zero, for the last of at most `passes` passes
        (B,), all ≥ 1; the first one is made with the estimates `begin`."""
        unknown = _unknown(touches, normals)
        passes = passes.to(unknown.device)
        rows = unknown.any(dim=1).nonzero()[:, 0]
        completed = torch.zeros_like(touches) if normals is None else normals.clone()
        if begin is not None:
            completed = torch.where(unknown[..., None], begin, completed)
        for made in range(1, int(passes.max())):
            rows = rows[passes[rows] > made]
            if len(rows) == 0:
                break
            before, missing = completed[rows], unknown[rows]
            estimate = self.normals_of(self._encode(touches[rows], before), touches[rows]).to(before)
            after = torch.where(missing[..., None], estimate, before)
            completed[rows] = after
            rows = rows[_change(before, after, missing) > SETTLED * ESTIMATED_LENGTH]
        return completed

    @torch.no_grad()
    def normals_of(self, features: list[Tensor], points: Tensor) -> Tensor:
        """Outward normals of the encoded field at points near its surface: against the gradient of the logit.

        Args:
            features: what :meth:`encode` returned.
            points: (B, N, 3) in the cube.

        Returns:
            (B, N, 3) of length up to 0.5, shorter where the field is flat, zero where a point is not finite.
        """
        offsets = STEP * torch.cat([torch.eye(3), -torch.eye(3)]).to(points)  # (6, 3)
        around = (points[:, None] + offsets[:, None]).flatten(1, 2)  # (B, 6 N, 3)
        if len(points) == 1:
            logits = HeadQuery(features, self.head, sample=self.sample, sigmoid=False)(around[0])
        else:
            logits = self.decode_logits(features, around)
        ahead, behind = logits.view(len(points), 2, 3, -1).float().unbind(1)
        downhill = ((behind - ahead) / (2 * STEP)).transpose(1, 2)  # (B, N, 3)
        length = downhill.norm(dim=2, keepdim=True)
        return (downhill * (ESTIMATED_LENGTH / length.clamp_min(STEEP))).nan_to_num(0.0)

    def _encode(self, touches: Tensor, normals: Tensor | None) -> list[Tensor]:
        _check_shapes(touches, normals)
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


def _unknown(touches: Tensor, normals: Tensor | None) -> Tensor:
    """Which contacts (B, N) have no normal."""
    _check_shapes(touches, normals)
    finite = touches.isfinite().all(dim=2)
    return finite if normals is None else finite & ~normals.any(dim=2)


def _change(before: Tensor, after: Tensor, rows: Tensor) -> Tensor:
    """Mean length (B,) of the difference of two (B, N, 3) over the chosen rows (B, N); 0 where there are none."""
    lengths = (after - before).norm(dim=2).where(rows, 0.0)
    return lengths.sum(dim=1) / rows.sum(dim=1).clamp_min(1)


def _check_shapes(touches: Tensor, normals: Tensor | None) -> None:
    if touches.dim() != 3 or touches.shape[2] != 3:
        raise ValueError(f"touches should have shape (B, N, 3), got {tuple(touches.shape)}")
    if normals is not None and normals.shape != touches.shape:
        raise ValueError(f"normals should have the shape of touches {tuple(touches.shape)}, got {tuple(normals.shape)}")
