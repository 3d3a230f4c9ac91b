"""Typed settings of the models and of training; every default stands here once."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

Sampling = Literal["trilinear", "addition"]


@dataclass(frozen=True)
class ModelConfig:
    """Architecture of :class:`touchnet.models.TouchNet`; stored beside the weights."""

    network: Literal["paper", "base"] = "base"
    """`paper`: pooling, batch norm, two fully connected layers. `base`: strided convolutions, group norm, a
    convolutional bottleneck, a skip at full resolution, features read from several scales."""
    grid: int = 64
    """Vertices along each side of the gridded volume; a multiple of 16."""
    channels: tuple[int, ...] = (16, 32, 64, 128, 160)
    """Channels of the volumes at grid, grid/2, ..., grid/16 (the `paper` network has its own)."""
    scales: int = 3
    """How many decoder volumes are sampled at a query, from full resolution down (`base` only)."""
    sampling: Sampling = "trilinear"
    """Features at a query: trilinear interpolation ("FI") or the sum of the cell's corners ("FA")."""
    use_normals: bool = True
    """Whether contact normals, when given, are gridded as further input channels (`base` only)."""
    estimate_normals: bool = True
    """Whether contacts without a normal get one from a first pass (where `use_normals`)."""


MODELS: dict[str, ModelConfig] = {
    "paper": ModelConfig(network="paper", channels=(16, 32, 64, 128, 256), scales=1, use_normals=False),
    "base": ModelConfig(),
    # For tests and for trying out a data set: a step takes a hundredth of the time.
    "tiny": ModelConfig(grid=16, channels=(8, 8, 16, 16, 16)),
}


@dataclass(frozen=True)
class GRNetConfig:
    """Architecture of :class:`touchnet.models.GRNet`; the defaults are the published ones."""

    grid: int = 64
    """Vertices along each side of the gridded volume; a multiple of 16."""
    channels: tuple[int, ...] = (32, 64, 128, 256)
    """Channels of the volumes at grid/2, ..., grid/16."""
    code: int = 2048
    """Values between the two fully connected layers."""
    sparse: int = 2048
    """Points taken from the reversed gridding, among them the touches."""
    copies: int = 8
    """Dense points for each of them."""


@dataclass(frozen=True)
class PointNet2Config:
    """Architecture of :class:`touchnet.models.PointNet2`."""

    points: int = 2048
    """Touches that enter: fewer are repeated, more are thinned."""
    copies: int = 8
    """Displaced points for each of them, each with noise of its own."""
    noise: int = 32
    """Random values beside the features of a point (as in P2P-NET)."""
    width: int = 32
    """Channels of the first level; each level doubles them."""
    centres: tuple[int, ...] = (512, 128, 32)
    """Farthest points of each set abstraction."""
    radii: tuple[float, ...] = (0.2, 0.4, 0.8)
    """Of their balls, in the cube of side 2."""
    neighbours: int = 32
    """Points of a ball."""
    use_normals: bool = False
    """Whether contact normals enter."""


@dataclass(frozen=True)
class ConvONetConfig:
    """Architecture of :class:`touchnet.models.ConvONet`."""

    grid: int = 32
    """Vertices along each side of the feature volume; a multiple of 4."""
    hidden: int = 32
    """Width of the point network, of the volume and of the decoder."""
    blocks: int = 5
    """Residual blocks of the point network and of the decoder."""
    use_normals: bool = True
    """Whether contact normals, when given, enter beside the positions."""


AnyConfig = ModelConfig | GRNetConfig | PointNet2Config | ConvONetConfig

# What `touchnet train --model` offers beside the sizes of TouchNet.
PEERS: dict[str, AnyConfig] = {
    "grnet": GRNetConfig(),
    "pointnet2": PointNet2Config(),
    "convonet": ConvONetConfig(),
}

# Names in the header of a file of weights.
ARCHITECTURES: dict[str, type] = {
    "touchnet": ModelConfig,
    "grnet": GRNetConfig,
    "pointnet2": PointNet2Config,
    "convonet": ConvONetConfig,
}


def architecture_of(config: AnyConfig) -> str:
    """The name under which a configuration is stored."""
    return next(name for name, kind in ARCHITECTURES.items() if type(config) is kind)


def model_config_from_dict(values: dict, architecture: str = "touchnet") -> AnyConfig:
    """The inverse of :func:`dataclasses.asdict` after a trip through JSON; unknown fields raise ValueError."""
    if architecture not in ARCHITECTURES:
        raise ValueError(f"model architecture {architecture!r} is unknown; written by a newer touchnet?")
    kind = ARCHITECTURES[architecture]
    known = {field.name for field in dataclasses.fields(kind)}
    unknown = sorted(set(values) - known)
    if unknown:
        raise ValueError(f"model configuration has unknown fields {unknown}; written by a newer touchnet?")
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})


@dataclass(frozen=True)
class SampleConfig:
    """How one training sample is drawn from a shape: touches, query points, augmentation (together for both)."""

    queries: int = 8192
    """Labelled query points of a sample."""
    targets: int = 0
    """Points of the true surface in a sample: what networks that give points are trained with (their recipes: 8192)."""
    near_share: float = 0.5
    """Share of the queries that lie near the surface; the others are uniform: in the shape's box and in the cube."""
    min_contacts: int = 64
    """Fewest contacts of a sample; their number is drawn log-uniformly from here to `max_contacts`."""
    max_contacts: int = 2048
    """Most contacts of a sample."""
    uniform_contacts: float = 0.4
    """Share of the samples touched uniformly over the surface rather than along a trajectory."""
    one_side: float = 0.1
    """Share of the samples that lose all contacts on one side."""
    no_normals: float = 0.6
    """Share of the samples that come without contact normals; half of them then get estimated ones."""
    noise: float = 0.4
    """Share of the samples with noisy contacts: positions up to `noise_sigma`, normals up to 10 degrees."""
    noise_sigma: float = 0.02
    """Largest standard deviation of a contact's position, in longest sides of the contacts; small ones are drawn more
    often (a quarter of the samples with noise lies under a sixteenth of it)."""
    stretch: float = 0.5
    """Share of the samples scaled by 0.75 ... 1.33 along each axis."""
    rotate_up: float = 0.2
    """Share of the samples turned about the up axis by any angle (the others by quarter turns, mirrored in half)."""
    rotate_free: float = 0.25
    """Share of the samples turned freely."""

    def __post_init__(self) -> None:
        if not 4 <= self.min_contacts <= self.max_contacts:
            raise ValueError(
                f"samples: min_contacts should lie between 4 and max_contacts, got {self.min_contacts} and "
                f"{self.max_contacts}"
            )
        if self.targets < 0:
            raise ValueError(f"samples: targets should be ≥ 0, got {self.targets}")
        if self.queries < 4:
            raise ValueError(f"samples: queries should be at least 4, got {self.queries}")
        for name, value in vars(self).items():
            if isinstance(value, float) and not 0 <= value <= 1:
                raise ValueError(f"samples: {name} should lie between 0 and 1, got {value}")


PAPER_SAMPLES = SampleConfig(
    queries=4000, min_contacts=2048, uniform_contacts=0, one_side=0, no_normals=1, noise=0, stretch=0, rotate_up=0,
    rotate_free=0,
)  # fmt: skip
