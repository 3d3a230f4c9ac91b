"""The options of `touchnet train`, and the recipes that fill in those not given."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from touchnet.config import (
    MODELS,
    PAPER_SAMPLES,
    PEERS,
    AnyConfig,
    ModelConfig,
    SampleConfig,
    architecture_of,
)
from touchnet.losses import Loss
from touchnet.weights import load_model


@dataclass(frozen=True)
class Recipe:
    """What `--recipe` stands for."""

    model: AnyConfig
    samples: SampleConfig
    loss: Loss
    batch_size: int
    learning_rate: float
    weight_decay: float
    schedule: Literal["cosine", "multistep", "constant"]
    average: float
    balance: float
    precision: Literal["no", "bf16"]
    steps: int | None = None
    epochs: int | None = None
    minutes: float | None = None


RECIPES = {
    "default": Recipe(
        model=MODELS["base"], samples=SampleConfig(), loss="cross_entropy", batch_size=4, learning_rate=2e-3,
        weight_decay=0.01, schedule="cosine", average=0.998, balance=0.5, precision="no", steps=3000,
    ),
    "paper": Recipe(
        model=MODELS["paper"], samples=PAPER_SAMPLES, loss="squared", batch_size=4, learning_rate=1e-4,
        weight_decay=0.0, schedule="multistep", average=0.0, balance=0.0, precision="no", epochs=200,
    ),
}  # fmt: skip

# What is different for networks other than TouchNet, in either recipe.
PEER_CHANGES: dict[str, dict[str, Any]] = {
    "grnet": {"loss": "chamfer_gridding", "learning_rate": 5e-4, "weight_decay": 0.0},
    "pointnet2": {"loss": "chamfer", "learning_rate": 1e-3, "weight_decay": 0.0},
    "convonet": {"learning_rate": 1e-3},
}
PEER_SAMPLES: dict[str, dict[str, Any]] = {
    "grnet": {"queries": 16, "targets": 8192},
    "pointnet2": {"queries": 16, "targets": 8192},
}


@dataclass(frozen=True)
class TrainConfig:
    """Train a network that turns touches into occupancy, or a peer to compare it with."""

    data: Path | None = None
    """Data set directory (see `touchnet simulate`). Without it the embedded procedural data set is built and used."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("runs/touchnet")
    """Folder for the checkpoint, the weights, the log (TensorBoard) and the picture."""
    recipe: Literal["default", "paper"] = "default"
    """Defaults of the options below that are not given; `paper` is the ACCV 2022 paper's training."""
    model: Literal["base", "paper", "tiny", "grnet", "pointnet2", "convonet"] | None = None
    """Size of the network (recipe default: base; paper: paper); tiny is for trying things out. grnet and pointnet2 give
    points, convonet occupancy: baselines, with a loss and a learning rate of their own in either recipe."""
    init: str | None = None
    """Weights to start from in place of random ones: `default` or a file; they bring their model with them. With few
    shapes of your own, start from `default` with a --learning-rate of 5e-4."""
    sampling: Literal["trilinear", "addition"] | None = None
    """How features are read at a query: interpolated (FI) or added (FA). Default: trilinear."""
    steps: int | None = None
    """Optimizer steps in all (recipe default: 3000)."""
    epochs: int | None = None
    """Passes over the data in all, instead of --steps (recipe paper: 200)."""
    minutes: float | None = None
    """Wall-clock time in all, instead of --steps: the schedule follows the clock, so two such runs differ."""
    batch_size: int | None = None
    """Samples of a step over all processes (both recipes: 4)."""
    accumulate: int = 1
    """Pieces a process's share of a batch is computed in, one after the other, where memory is short: the same training
    for base, whose samples do not see each other (batch norm, in paper, sees a piece)."""
    learning_rate: float | None = None
    """Peak learning rate of Adam(W) (recipe default: 2e-3; paper: 1e-4)."""
    schedule: Literal["cosine", "multistep", "constant"] | None = None
    """cosine: warm-up, then down to 1 % at the last step; multistep: halved every 50 epochs (recipe paper); constant:
    better for a thousand steps or fewer."""
    loss: Loss | None = None
    """cross_entropy (recipe default) or squared (recipe paper, eq. 5)."""
    balance: float | None = None
    """0: every shape equally often (recipe paper); 1: every category equally often; between: a shape is drawn in
    proportion to the size of its category to the power -balance (recipe default: 0.5)."""
    precision: Literal["no", "bf16"] | None = None
    """no: all in float32 (both recipes); bf16: convolutions in bfloat16, weights and updates in float32, which pays on
    processors with bfloat16 matrix units."""
    compile: bool = False
    """Compile the network with torch.compile: the first steps take minutes, the others less time; for long runs."""
    category: tuple[str, ...] = ()
    """Train on these categories only; `each`: one network for each category, in OUTPUT/CATEGORY."""
    limit: int | None = None
    """Train on this many shapes only, drawn at random; with the same seed smaller sets lie within larger ones."""
    exclude_licence: tuple[str, ...] = ()
    """Leave out shapes whose licence starts with one of these, such as GPL-2."""
    samples: SampleConfig = dataclasses.field(default_factory=SampleConfig)
    """How samples are drawn (recipe paper: 4000 queries, all contacts of a trajectory, mirrored and turned by quarters
    only; options given here go on top)."""
    shapes: int = 240
    """Size of the embedded data set."""
    cache: Path | None = None
    """Where the embedded data set is kept (default: the user's cache folder)."""
    resume: bool = False
    """Continue the run in --output from its checkpoint."""
    force: bool = False
    """Start anew although --output holds a run."""
    validate_every: int = 500
    """Steps between two validations."""
    checkpoint_every: int = 200
    """Steps between two checkpoints."""
    workers: int = 1
    """Processes that prepare samples (0: none beside the training process)."""
    seed: int = 0
    """Seed of the initial weights, the order and the augmentation."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to train."""


def resolve_recipe(config: TrainConfig) -> Recipe:
    """The recipe with the options that were given in place of its defaults."""
    recipe = RECIPES[config.recipe]
    if config.model in PEERS:
        if config.sampling is not None:
            raise ValueError(f"sampling is how TouchNet reads features, {config.model} has none")
        samples = dataclasses.replace(recipe.samples, **PEER_SAMPLES.get(config.model, {}))
        recipe = dataclasses.replace(recipe, model=PEERS[config.model], samples=samples, **PEER_CHANGES[config.model])
    names = ("batch_size", "learning_rate", "schedule", "loss", "balance", "precision")
    given = {name: getattr(config, name) for name in names if getattr(config, name) is not None}
    usual = vars(SampleConfig())
    changed = {name: value for name, value in vars(config.samples).items() if value != usual[name]}
    given["samples"] = dataclasses.replace(recipe.samples, **changed)
    if config.model in MODELS:
        given["model"] = MODELS[config.model]
    if config.init is not None:
        if config.model is not None or config.sampling is not None:
            raise ValueError("init brings its model with it: leave --model and --sampling out")
        given["model"] = load_model(config.init).config
    if config.sampling is not None:
        given["model"] = dataclasses.replace(given.get("model", recipe.model), sampling=config.sampling)
    lengths = {name: getattr(config, name) for name in ("steps", "epochs", "minutes")}
    named = [name for name, value in lengths.items() if value is not None]
    if len(named) > 1:
        raise ValueError(f"{' and '.join(named)} were both given; expected one of them")
    if named:
        given |= lengths
    recipe = dataclasses.replace(recipe, **given)
    if config.limit is not None and config.limit < 1:
        raise ValueError(f"limit should be positive, got {config.limit}")
    for name in ("steps", "epochs", "minutes", "batch_size", "learning_rate"):
        value = getattr(recipe, name)
        if value is not None and not value > 0:
            raise ValueError(f"{name} should be positive, got {value}")
    return recipe


def described(model: AnyConfig) -> str:
    """What a network is called in messages."""
    return model.network if isinstance(model, ModelConfig) else architecture_of(model)
