"""The two 3D U-Nets: volumes of gridded touches in, feature volumes out. Shapes are for a grid of 64 vertices."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class PaperUNet3D(nn.Module):
    """The paper's network: four convolutions with pooling, two fully connected layers, four transposed convolutions.

    Input (B, 1, 64, 64, 64); output one volume (B, 16, 64, 64, 64). Skips by addition at 4^3, 8^3, 16^3 and 32^3.
    """

    def __init__(self) -> None:
        super().__init__()
        self.down = nn.ModuleList(
            nn.Sequential(
                nn.Conv3d(before, after, kernel_size=4, padding=2),
                nn.BatchNorm3d(after),
                nn.LeakyReLU(0.2),
                nn.MaxPool3d(2),
            )
            for before, after in [(1, 32), (32, 64), (64, 128), (128, 256)]
        )
        self.squeeze = nn.Sequential(nn.Linear(256 * 4**3, 2048), nn.LeakyReLU(0.2))
        self.expand = nn.Sequential(nn.Linear(2048, 256 * 4**3), nn.LeakyReLU(0.2))
        self.up = nn.ModuleList(
            nn.Sequential(
                nn.ConvTranspose3d(before, after, kernel_size=4, stride=2, padding=1, bias=False),
                nn.BatchNorm3d(after),
                nn.ReLU(),
            )
            for before, after in [(256, 128), (128, 64), (64, 32), (32, 16)]
        )

    def forward(self, volume: Tensor) -> list[Tensor]:
        down1 = self.down[0](volume)  # (B, 32, 32, 32, 32)
        down2 = self.down[1](down1)  # (B, 64, 16, 16, 16)
        down3 = self.down[2](down2)  # (B, 128, 8, 8, 8)
        down4 = self.down[3](down3)  # (B, 256, 4, 4, 4)
        code = self.squeeze(down4.flatten(1))  # (B, 2048)
        up4 = self.expand(code).view_as(down4) + down4  # (B, 256, 4, 4, 4)
        up3 = self.up[0](up4) + down3  # (B, 128, 8, 8, 8)
        up2 = self.up[1](up3) + down2  # (B, 64, 16, 16, 16)
        up1 = self.up[2](up2) + down1  # (B, 32, 32, 32, 32)
        return [self.up[3](up1)]  # (B, 16, 64, 64, 64)


class BaseUNet3D(nn.Module):
    """The default network: strided convolutions, group norm, a convolutional bottleneck, a skip at full resolution.

    Input (B, `inputs`, S, S, S), S a multiple of 16; output the decoder's volumes from full resolution down, `scales`
    of them: (B, channels[k], S/2^k, S/2^k, S/2^k). Nothing depends on the other samples of the batch, so that one
    process with a large batch and several with small ones compute the same.
    """

    def __init__(self, inputs: int, channels: tuple[int, ...], scales: int) -> None:
        super().__init__()
        full, half, quarter, eighth, sixteenth = channels
        self.scales = scales
        # No norm at full resolution: it would cost as much as the convolution there.
        self.enter = nn.Sequential(nn.Conv3d(inputs, full, kernel_size=3, padding=1), nn.LeakyReLU(0.2))
        self.down = nn.ModuleList(
            nn.Sequential(
                nn.Conv3d(before, after, kernel_size=4, stride=2, padding=1, bias=False),
                nn.GroupNorm(after // 8, after),
                nn.LeakyReLU(0.2),
            )
            for before, after in [(full, half), (half, quarter), (quarter, eighth), (eighth, sixteenth)]
        )
        # At 4^3 two 3^3 convolutions see the whole object: what the paper's fully connected layers
        # are for, at a fiftieth of their parameters.
        self.bottleneck = nn.Sequential(
            *(
                layer
                for _ in range(2)
                for layer in (
                    nn.Conv3d(sixteenth, sixteenth, kernel_size=3, padding=1, bias=False),
                    nn.GroupNorm(sixteenth // 8, sixteenth),
                    nn.LeakyReLU(0.2),
                )
            )
        )
        self.up = nn.ModuleList(
            nn.Sequential(
                nn.ConvTranspose3d(before, after, kernel_size=4, stride=2, padding=1, bias=False),
                nn.GroupNorm(after // 8, after),
                nn.LeakyReLU(0.2),
            )
            for before, after in [(sixteenth, eighth), (eighth, quarter), (quarter, half)]
        )
        self.leave = nn.ConvTranspose3d(half, full, kernel_size=4, stride=2, padding=1)

    def forward(self, volume: Tensor) -> list[Tensor]:
        enter = self.enter(volume)  # (B, 16, 64, 64, 64)
        down1 = self.down[0](enter)  # (B, 32, 32, 32, 32)
        down2 = self.down[1](down1)  # (B, 64, 16, 16, 16)
        down3 = self.down[2](down2)  # (B, 128, 8, 8, 8)
        down4 = self.down[3](down3)  # (B, 160, 4, 4, 4)
        up4 = self.bottleneck(down4) + down4  # (B, 160, 4, 4, 4)
        up3 = self.up[0](up4) + down3  # (B, 128, 8, 8, 8)
        up2 = self.up[1](up3) + down2  # (B, 64, 16, 16, 16)
        up1 = self.up[2](up2) + down1  # (B, 32, 32, 32, 32)
        leave = self.leave(up1) + enter  # (B, 16, 64, 64, 64)
        return [leave, up1, up2, up3, up4][: self.scales]


def parameter_count(module: nn.Module) -> int:
    """Number of trainable values."""
    return sum(parameter.numel() for parameter in module.parameters() if parameter.requires_grad)


def channels_last(volume: Tensor) -> Tensor:
    """`volume` (B, C, X, Y, Z) with the channels of a vertex side by side in memory: the fast layout."""
    return volume.contiguous(memory_format=torch.channels_last_3d)
