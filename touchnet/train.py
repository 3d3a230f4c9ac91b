"""`python -m touchnet.train`: trains a network on a data set directory, or without one on the embedded shapes.

The loop is `train` below. It runs unchanged under `torchrun` and `accelerate launch`: each process takes its share of
every batch, and what a sample looks like depends on (seed, epoch, item) alone.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import math
import os
import signal
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import torch
import tyro
from accelerate import Accelerator
from torch import Tensor, nn
from torch.utils.data import DataLoader, Sampler
from tqdm import tqdm

from touchnet import cli, outputs
from touchnet.allocator import tune_allocator
from touchnet.config import (
    MODELS,
    PAPER_SAMPLES,
    PEERS,
    AnyConfig,
    ModelConfig,
    SampleConfig,
    architecture_of,
)
from touchnet.data.dataset import TouchDataset
from touchnet.data.samples import Sample, TrainingSamples
from touchnet.losses import Loss
from touchnet.models import build_model
from touchnet.objectives import objective_of, validate
from touchnet.weights import load_model, save_weights

EACH = "each"  # in place of a category
COMPILER = "inductor"  # of torch.compile


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
    """cosine: warm-up, then down to 1 % at the last step; multistep: halved every 50 epochs (recipe paper)."""
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


class Step(nn.Module):
    """The network together with its loss, so that one forward call is what processes are synchronised around."""

    def __init__(self, network: nn.Module, loss: Loss) -> None:
        super().__init__()
        self.network, self.kind, self.objective = network, loss, objective_of(network)

    def forward(self, *batch: Tensor) -> Tensor:
        return self.objective.loss(self.network, Sample(*batch), self.kind)


class StepBatches(Sampler[list[tuple[int, int]]]):
    """The (epoch, item) keys of each step's batch from step `start` to `steps`, this process's share of them.

    Every epoch is a permutation keyed by (seed, epoch), or with `weights` (items,) as many draws in proportion to them.
    Its last batch is filled from its beginning, so that all have one size (batch norm never meets a single sample).
    """

    def __init__(
        self,
        items: int,
        batch_size: int,
        *,
        seed: int,
        start: int,
        steps: int,
        rank: int,
        world: int,
        weights: np.ndarray | None = None,
    ) -> None:
        if batch_size % world:
            raise ValueError(f"batch_size should be a multiple of the {world} processes, got {batch_size}")
        self.items, self.batch_size, self.seed = items, batch_size, seed
        self.start, self.steps, self.rank, self.world = start, steps, rank, world
        self.shares = None if weights is None else weights / weights.sum()

    def __len__(self) -> int:
        return self.steps - self.start

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        per_epoch = steps_per_epoch(self.items, self.batch_size)
        for step in range(self.start, self.steps):
            epoch, batch = divmod(step, per_epoch)
            rng = np.random.default_rng([self.seed, epoch])
            if self.shares is None:
                order = rng.permutation(self.items)
            else:
                order = rng.choice(self.items, size=self.items, p=self.shares)
            order = np.resize(order, per_epoch * self.batch_size)
            rows = order[batch * self.batch_size : (batch + 1) * self.batch_size]
            yield [(epoch, int(item)) for item in rows[self.rank :: self.world]]


def steps_per_epoch(items: int, batch_size: int) -> int:
    return -(-items // batch_size)


def learning_rate(step: int, steps: int, per_epoch: int, peak: float, schedule: str) -> float:
    """Learning rate of step `step` (counted from 0) of `steps`."""
    if schedule == "constant":
        return peak
    if schedule == "multistep":
        return peak * 0.5 ** (step // per_epoch // 50)
    warm_up = min(200, steps // 10)
    if step < warm_up:
        return peak * (step + 1) / warm_up
    return peak * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * (step - warm_up) / max(1, steps - warm_up))))


class Budget(NamedTuple):
    """When training ends: at a step, or when the time is up."""

    steps: int | None
    seconds: float | None

    def planned(self, step: int, elapsed: float) -> int:
        """How many steps there will be in all, as far as `step` steps in `elapsed` seconds tell."""
        if self.seconds is None:
            return self.steps
        if step == 0:
            return UNKNOWN_STEPS
        return max(step + 1, round(step * self.seconds / elapsed))

    def spent(self, done: int, elapsed: float) -> bool:
        """Whether step `done` was the last."""
        return done >= self.steps if self.seconds is None else elapsed >= self.seconds


UNKNOWN_STEPS = 2000  # before the first step has told how long one takes
ENDLESS = 1 << 40  # more steps than any time allows


class Average:
    """Exponential moving average of a network's weights; what is validated and saved. A decay of 0 is the network."""

    def __init__(self, network: nn.Module, decay: float) -> None:
        self.network, self.decay = copy.deepcopy(network).eval().requires_grad_(False), decay

    @torch.no_grad()
    def update(self, network: nn.Module, step: int) -> None:
        # Early on the average forgets faster, or it would keep the initial weights for a thousand steps.
        decay = min(self.decay, (1 + step) / (10 + step))
        pairs = zip(self.network.state_dict().values(), network.state_dict().values(), strict=True)
        for average, value in pairs:
            if average.is_floating_point():
                average.lerp_(value, 1 - decay)
            else:
                average.copy_(value)


def train(config: TrainConfig) -> dict[str, float]:
    """Trains as `config` says; returns the last validation's figures.

    Writes to config.output: `weights.safetensors` (for `touchnet reconstruct --weights`), `checkpoint.pt` (for
    `--resume`), `config.json`, `metrics.jsonl`, TensorBoard's event file and `reconstructions.png`.

    Raises:
        ValueError: an option that does not fit, a data set without shapes, a loss that is not finite.
        FileExistsError: config.output holds a run and neither resume nor force was asked for.
    """
    recipe = resolve_recipe(config)
    checkpoint = config.output / "checkpoint.pt"
    if checkpoint.exists() and not (config.resume or config.force):
        raise FileExistsError(f"{config.output} holds a run; --resume continues it, --force starts anew")
    if config.resume and not checkpoint.exists():
        raise FileNotFoundError(f"resume: there is no checkpoint {checkpoint}")
    tune_allocator()
    accelerator = Accelerator(
        cpu=config.device == "cpu",
        mixed_precision=recipe.precision,
        step_scheduler_with_optimizer=False,
        dynamo_backend=COMPILER if config.compile else None,
    )
    if config.device == "cuda" and accelerator.device.type != "cuda":
        raise ValueError("device: cuda was asked for, but this torch sees no CUDA device")
    main = accelerator.is_main_process
    share = config.accumulate * accelerator.num_processes
    if config.accumulate < 1 or recipe.batch_size % share:
        raise ValueError(
            f"batch_size should be a multiple of {config.accumulate} piece(s) x {accelerator.num_processes} "
            f"process(es), got {recipe.batch_size}"
        )
    if main and recipe.precision == "bf16" and accelerator.device.type == "cpu" and not fast_bfloat16():
        warnings.warn(
            "this processor has no bfloat16 instructions: --precision bf16 will take many times as long as float32",
            stacklevel=2,
        )

    data = config.data
    if data is None:
        with accelerator.main_process_first():
            data = embedded_data(config)
    options = {"categories": config.category or None, "exclude_licences": config.exclude_licence}
    chosen = TouchDataset(data, "train", **options)
    chosen.records = _drawn(chosen.records, config.limit, config.seed)
    samples = TrainingSamples(chosen, recipe.samples, seed=config.seed)
    held_out = TouchDataset(data, "val", **options)
    per_epoch = steps_per_epoch(len(samples), recipe.batch_size)
    budget = budget_of(recipe, per_epoch)

    torch.manual_seed(config.seed)
    network = build_model(recipe.model)
    if config.init is not None:
        network.load_state_dict(load_model(config.init).state_dict())
    fused = accelerator.device.type in ("cpu", "cuda")
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay, fused=fused
    )
    model, optimizer = accelerator.prepare(Step(network, recipe.loss), optimizer)
    average = Average(network, recipe.average)
    start, earlier = 0, 0.0
    if config.resume:
        start, earlier = load_checkpoint(checkpoint, network, average, optimizer, recipe, accelerator.device)
        if budget.spent(start, earlier):
            raise NothingLeft(
                f"resume: {checkpoint} is at step {start} after {earlier / 60:.1f} minutes, nothing is left of "
                + (f"{budget.steps} steps (see --steps)" if budget.seconds is None else f"{recipe.minutes:g} minutes")
            )
    batches = StepBatches(
        len(samples), recipe.batch_size, seed=config.seed, start=start,
        steps=ENDLESS if budget.steps is None else budget.steps,
        rank=accelerator.process_index, world=accelerator.num_processes,
        weights=samples.weights(recipe.balance) if recipe.balance else None,
    )  # fmt: skip
    loader = DataLoader(samples, batch_sampler=batches, num_workers=config.workers)
    log = Log(config, recipe, budget=budget, start=start, shapes=len(samples.data)) if main else None
    say = accelerator.print
    name, ending = described(recipe.model), f"{recipe.minutes:g} minutes" if budget.steps is None else budget.steps
    say(
        f"{len(samples.data)} shapes ({len(samples)} trajectories), {len(held_out)} held out; {name} network, "
        f"{sum(p.numel() for p in network.parameters()):,} parameters; steps {start}..{ending} of "
        f"{recipe.batch_size} samples on {accelerator.num_processes} process(es), {accelerator.device}"
    )

    figures: dict[str, float] = {}
    losses: list[float] = []
    done, elapsed, began = start, earlier, time.perf_counter()
    model.train()
    with stop_requests() as stopped, tqdm(total=budget.steps, initial=start, disable=not main, unit="step") as bar:
        for step, batch in enumerate(map(lambda rows: Sample(*rows), loader), start):
            batch = Sample(*(value.to(accelerator.device) for value in batch))
            planned = budget.planned(step, elapsed)
            rate = learning_rate(step, planned, per_epoch, recipe.learning_rate, recipe.schedule)
            for group in optimizer.param_groups:
                group["lr"] = rate
            loss = 0.0
            for number, piece in enumerate(pieces_of(batch, config.accumulate), 1):
                # Processes exchange gradients once, after the last piece.
                waiting = accelerator.no_sync(model) if number < config.accumulate else nullcontext()
                with waiting:
                    part = model(*piece) / config.accumulate
                    if not torch.isfinite(part):
                        names = ", ".join(samples.data.records[int(i)].id for i in piece.index)
                        raise ValueError(
                            f"the loss is {part.item()} at step {step}; the batch holds {names}. Nothing was updated."
                        )
                    accelerator.backward(part)
                loss += part.item()
            accelerator.clip_grad_norm_(model.parameters(), 1.0)
            optimizer.step()
            optimizer.zero_grad()
            average.update(network, step)

            done = step + 1
            losses.append(loss)
            bar.update()
            # Every process learns of a signal to one of them, and goes by the first one's clock.
            clock = earlier + time.perf_counter() - began if main else 0.0
            shared = torch.tensor([float(stopped.is_set), clock], dtype=torch.float64, device=accelerator.device)
            signals, elapsed = accelerator.reduce(shared, reduction="sum").tolist()
            stop, last = signals > 0, budget.spent(done, elapsed)
            if main and (done % 20 == 0 or last):
                mean = sum(losses) / len(losses)
                losses.clear()
                log.write(done, {"loss": mean, "learning_rate": rate, "epoch": done / per_epoch})
                bar.set_postfix(loss=f"{mean:.4f}", epoch=f"{done / per_epoch:.1f}")
            if main and (last or stop or done % config.checkpoint_every == 0):
                # Half precision is what ships; the checkpoint keeps what training goes on with.
                notes = {"training": json.dumps(trained_with(config, recipe, samples, done, elapsed))}
                save_weights(average.network, config.output / "weights.safetensors", half=True, notes=notes)
                save_checkpoint(checkpoint, network, average, optimizer, recipe, done, elapsed)
            if main and len(held_out) and not stop and (last or done % config.validate_every == 0):
                figures = validate(average.network, held_out, accelerator.device, recipe.precision)
                log.write(done, figures)
                bar.write(f"step {done}: " + ", ".join(f"{name} {value:.3f}" for name, value in figures.items()))
            if stop:
                say(f"stopped at step {done}; --resume continues")
                raise KeyboardInterrupt
            if last:
                break
    say(f"{done} steps, {done * recipe.batch_size} samples seen, {elapsed / 60:.1f} minutes")
    if main:
        draw_reconstructions(average.network, held_out if len(held_out) else samples.data, config.output)
        say(f"wrote {config.output / 'weights.safetensors'}")
        log.close()
    accelerator.end_training()
    return figures


def fast_bfloat16() -> bool:
    """Whether the processor multiplies in bfloat16 (AVX512-BF16 or AMX; other architectures: assumed)."""
    known = Path("/proc/cpuinfo")
    text = known.read_text() if known.exists() else ""
    return "flags" not in text or "avx512_bf16" in text or "amx_bf16" in text


def pieces_of(batch: Sample, count: int) -> list[Sample]:
    """A batch of tensors cut into `count` equal ones."""
    return [Sample(*piece) for piece in zip(*(value.chunk(count) for value in batch), strict=True)]


class NothingLeft(ValueError):
    """A run to go on with has reached its end."""


def _drawn(records: list, limit: int | None, seed: int) -> list:
    """`limit` of the records, in their order."""
    if limit is None or limit >= len(records):
        return records
    rows = np.random.default_rng([seed, 1]).permutation(len(records))[:limit]
    return [records[row] for row in sorted(rows)]


def budget_of(recipe: Recipe, per_epoch: int) -> Budget:
    """Steps or seconds, whichever the recipe has."""
    if recipe.minutes is not None:
        return Budget(None, 60 * recipe.minutes)
    return Budget(recipe.steps if recipe.steps is not None else recipe.epochs * per_epoch, None)


def described(model: AnyConfig) -> str:
    """What a network is called in messages."""
    return model.network if isinstance(model, ModelConfig) else architecture_of(model)


def trained_with(
    config: TrainConfig, recipe: Recipe, samples: TrainingSamples, steps: int, seconds: float
) -> dict[str, Any]:
    """What weights should tell of their training."""
    return {
        "shapes": len(samples.data),
        "categories": samples.data.categories,
        "recipe": config.recipe,
        "steps": steps,
        "samples": steps * recipe.batch_size,
        "minutes": round(seconds / 60, 2),
        "seed": config.seed,
        "init": config.init,
    }


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


def embedded_data(config: TrainConfig) -> Path:
    """Directory of the embedded procedural data set, built on first use."""
    from touchnet.data.factory import Parameters
    from touchnet.data.shapes import build_procedural

    root = config.cache or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "touchnet"
    directory = root / f"procedural-{config.shapes}"
    jobs = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    build_procedural(directory, shapes=config.shapes, parameters=Parameters(trajectories=1), jobs=jobs)
    return directory


def draw_reconstructions(network: nn.Module, data: TouchDataset, output: Path, *, rows: int = 6) -> None:
    """Writes `reconstructions.png`: touches, reconstruction and truth of some shapes; says which went wrong and why."""
    from touchnet.figures import save_gallery

    objective, pictures = objective_of(network), []
    for index in np.unique(np.linspace(0, len(data) - 1, rows).round().astype(int)):
        shape = data.shape(int(index))
        name = data.records[int(index)].id
        stored = shape.array("touches")
        source = ("touches", "touch_normals") if len(stored) else ("surface", "surface_normals")
        touches, normals = (shape.array(part).reshape(-1, 3)[:2048].astype(np.float64) for part in source)
        result = None
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", UserWarning)
            try:
                result = objective.result(network, touches, normals)
            except ValueError as error:
                print(f"no reconstruction of {name}: {error}", file=sys.stderr)
        for warning in said:
            print(f"reconstruction of {name}: {warning.message}", file=sys.stderr)
        pictures.append((name, touches, result, shape.mesh()))
    save_gallery(output / "reconstructions.png", pictures)


def save_checkpoint(
    path: Path,
    network: nn.Module,
    average: Average,
    optimizer: torch.optim.Optimizer,
    recipe: Recipe,
    step: int,
    seconds: float,
) -> None:
    """Writes what `--resume` needs: plain tensors and numbers (torch.load's weights_only=True reads it)."""
    state = {
        "network": network.state_dict(),
        "average": average.network.state_dict(),
        "optimizer": optimizer.state_dict(),
        "model": dataclasses.asdict(recipe.model),
        "step": step,
        "seconds": seconds,
    }
    with outputs.atomic_output(path, force=True) as temporary:
        torch.save(state, temporary)


def load_checkpoint(
    path: Path,
    network: nn.Module,
    average: Average,
    optimizer: torch.optim.Optimizer,
    recipe: Recipe,
    device: torch.device,
) -> tuple[int, float]:
    """Restores what :func:`save_checkpoint` wrote; returns the step to go on from and the seconds until there."""
    state = torch.load(path, map_location=device, weights_only=True)
    if state["model"] != dataclasses.asdict(recipe.model):
        raise ValueError(
            f"resume: {path} holds the model {state['model']}, asked for {dataclasses.asdict(recipe.model)}"
        )
    network.load_state_dict(state["network"])
    average.network.load_state_dict(state["average"])
    optimizer.load_state_dict(state["optimizer"])
    return state["step"], state.get("seconds", 0.0)  # checkpoints of the first version have no clock


class Log:
    """Figures over steps: an event file for TensorBoard and one JSON object a line in metrics.jsonl."""

    def __init__(self, config: TrainConfig, recipe: Recipe, *, budget: Budget, start: int, shapes: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        config.output.mkdir(parents=True, exist_ok=True)
        described = {"recipe": dataclasses.asdict(recipe), "steps": budget.steps, "seed": config.seed, "shapes": shapes}
        with outputs.atomic_output(config.output / "config.json", force=True) as temporary:
            temporary.write_text(json.dumps(described, indent=2, default=str) + "\n")
        self.events = SummaryWriter(str(config.output), purge_step=start or None)
        lines = config.output / "metrics.jsonl"
        kept = lines.read_text().splitlines() if start and lines.exists() else []
        kept = [line for line in kept if json.loads(line)["step"] <= start]
        lines.write_text("".join(line + "\n" for line in kept))
        self.lines = lines.open("a")
        self.began = time.perf_counter()

    def write(self, step: int, values: dict[str, float]) -> None:
        for name, value in values.items():
            self.events.add_scalar(name, value, step)
        seconds = round(time.perf_counter() - self.began, 1)
        self.lines.write(json.dumps({"step": step, "seconds": seconds, **values}) + "\n")
        self.lines.flush()

    def close(self) -> None:
        self.events.close()
        self.lines.close()


class stop_requests:
    """Context in which Ctrl-C and SIGTERM ask the loop to stop after the step under way; `is_set` says one came."""

    def __init__(self) -> None:
        self.is_set = False

    def __enter__(self) -> stop_requests:
        def ask(signum: int, frame: object) -> None:
            if self.is_set:
                raise KeyboardInterrupt
            self.is_set = True

        self.before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self.before.items():
            signal.signal(number, handler)


def train_each(config: TrainConfig) -> None:
    """Trains one network for each category of the split `train`; with --resume those that are not finished."""
    if len(config.category) > 1:
        raise ValueError(f"category {EACH!r} stands alone, got {', '.join(config.category)}")
    data = config.data or embedded_data(config)
    for category in TouchDataset(data, "train", exclude_licences=config.exclude_licence).categories:
        output = config.output / category
        resume = config.resume and (output / "checkpoint.pt").exists()
        print(f"{category}:")
        try:
            train(dataclasses.replace(config, data=data, category=(category,), output=output, resume=resume))
        except NothingLeft as finished:
            print(finished)


@cli.command("touchnet train")
def main(argv: Sequence[str] | None = None) -> int:
    config = cli.parse(TrainConfig, argv, prog="touchnet train")
    if EACH in config.category:
        train_each(config)
    else:
        train(config)
    return 0


if __name__ == "__main__":
    sys.exit(main())
