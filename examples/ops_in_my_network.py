"""The operators in a network of your own: contacts of balls in, a signed distance out.

    python examples/ops_in_my_network.py --steps 200

`gridding` makes a volume of a point cloud, `trilinear_sample` reads features at any point; both are differentiable in
everything, so they go between any layers. `octree_marching_cubes` makes a closed mesh of whatever you trained.
"""

import argparse

import torch
from torch import Tensor, nn

from touchnet import ops


class DistanceNet(nn.Module):
    """Contacts (B, N, 3) and queries (B, M, 3) in the cube [-1, 1]^3 to signed distances (B, M), positive inside."""

    def __init__(self, size: int, channels: int) -> None:
        super().__init__()
        self.size = size
        self.convolutions = nn.Sequential(
            nn.Conv3d(4, channels, 3, padding=1),
            nn.ReLU(),
            nn.Conv3d(channels, channels, 4, padding=1, stride=2),
            nn.ReLU(),
            nn.Conv3d(channels, channels, 4, padding=1, stride=2),
            nn.ReLU(),
        )
        self.head = nn.Sequential(nn.Linear(channels + 3, 64), nn.ReLU(), nn.Linear(64, 1))

    def encode(self, contacts: Tensor) -> Tensor:
        volume = ops.gridding(contacts, self.size, values=contacts)  # (B, 1 + 3, S, S, S): how many, and where
        return self.convolutions(volume)  # (B, C, S / 4, S / 4, S / 4)

    def decode(self, volume: Tensor, queries: Tensor) -> Tensor:
        features = ops.trilinear_sample(volume, queries)  # (B, M, C)
        return self.head(torch.cat([features, queries], dim=2)).squeeze(2)  # (B, M)


def balls(batch: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Contacts (B, 256, 3), queries (B, 512, 3) and their distances (B, 512) to random balls."""
    radius = 0.3 + 0.4 * torch.rand(batch, 1, 1, generator=generator)
    centre = 0.4 * torch.rand(batch, 1, 3, generator=generator) - 0.2
    directions = nn.functional.normalize(torch.randn(batch, 256, 3, generator=generator), dim=2)
    queries = 2 * torch.rand(batch, 512, 3, generator=generator) - 1
    return centre + radius * directions, queries, radius[..., 0] - (queries - centre).norm(dim=2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=200, help="training steps")
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--size", type=int, default=16, help="vertices along each side of the volume")
    parser.add_argument("--channels", type=int, default=16)
    parser.add_argument("--resolution", type=int, default=64, help="cells of the mesh along each side")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    torch.manual_seed(options.seed)
    generator = torch.Generator().manual_seed(options.seed)
    network = DistanceNet(options.size, options.channels)
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, options.steps)
    for step in range(options.steps):
        contacts, queries, distance = balls(options.batch, generator)
        loss = (network.decode(network.encode(contacts), queries) - distance).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % max(1, options.steps // 5) == 0 or step == options.steps - 1:
            print(f"step {step}: mean error of the distance {loss.item():.4f}")

    contacts, _, _ = balls(1, generator)
    with torch.inference_mode():
        volume = network.encode(contacts)
        vertices, faces = ops.octree_marching_cubes(
            lambda points: network.decode(volume, points[None])[0],
            resolution=options.resolution,
            level=0.0,
            seeds=contacts[0],
        )
    print(f"closed mesh of {len(faces)} faces")
    for name, points in (("contacts", contacts[0]), ("mesh", vertices)):
        low, high = points.amin(dim=0), points.amax(dim=0)
        print(f"{name:>8}: from {low.numpy().round(2)} to {high.numpy().round(2)}")


if __name__ == "__main__":
    main()
