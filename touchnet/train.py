"""`python -m touchnet.train`: trains a network on a data set directory, or without one on the embedded shapes.

The loop is `train` below. It runs unchanged under `torchrun` and `accelerate launch`: each process takes its share of
every batch, and what a sample looks like depends on (seed, epoch, item) alone.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import signal
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import torch
import tyro
from accelerate import Accelerator
from torch import Tensor, nn
from torch.utils.data import DataLoader, Sampler, default_collate
from tqdm import tqdm

from touchnet import cli, outputs
from touchnet.allocator import tune_allocator
from touchnet.config import MODELS, PAPER_SAMPLES, ModelConfig, SampleConfig
from touchnet.data.dataset import TouchDataset
from touchnet.data.samples import Sample, TrainingSamples, validation_sample
from touchnet.losses import Loss, occupancy_loss
from touchnet.metrics import volumetric_iou
from touchnet.models import TouchNet
from touchnet.weights import save_weights

VALIDATION = ((2048, True), (512, True), (128, True), (2048, False), (512, False), (128, False))


@dataclass(frozen=True)
class Recipe:
    """What `--recipe` stands for."""

    model: ModelConfig
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


@dataclass(frozen=True)
class TrainConfig:
    """Train a network that turns touches into occupancy."""

    data: Path | None = None
    """Data set directory (see `touchnet simulate`). Without it the embedded procedural data set is built and used."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("runs/touchnet")
    """Folder for the checkpoint, the weights, the log (TensorBoard) and the picture."""
    recipe: Literal["default", "paper"] = "default"
    """Defaults of the options below that are not given; `paper` is the ACCV 2022 paper's training."""
    model: Literal["base", "paper", "tiny"] | None = None
    """Size of the network (recipe default: base; paper: paper); tiny is for trying things out."""
    sampling: Literal["trilinear", "addition"] | None = None
    """How features are read at a query: interpolated (FI) or added (FA). Default: trilinear."""
    steps: int | None = None
    """Optimizer steps in all (recipe default: 3000)."""
    epochs: int | None = None
    """Passes over the data in all, instead of --steps (recipe paper: 200)."""
    batch_size: int | None = None
    """Samples of a step over all processes (both recipes: 4)."""
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
    category: tuple[str, ...] = ()
    """Train on these categories only."""
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

    def __init__(self, network: TouchNet, loss: Loss) -> None:
        super().__init__()
        self.network, self.loss = network, loss

    def forward(self, touches: Tensor, normals: Tensor, queries: Tensor, inside: Tensor) -> Tensor:
        return occupancy_loss(self.network.logits(touches, queries, normals), inside, self.loss)


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


class Average:
    """Exponential moving average of a network's weights; what is validated and saved. A decay of 0 is the network."""

    def __init__(self, network: TouchNet, decay: float) -> None:
        self.network, self.decay = TouchNet(network.config).eval().requires_grad_(False), decay
        self.network.load_state_dict(network.state_dict())
        self.network.to(next(network.parameters()).device)

    @torch.no_grad()
    def update(self, network: TouchNet, step: int) -> None:
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
        cpu=config.device == "cpu", mixed_precision=recipe.precision, step_scheduler_with_optimizer=False
    )
    if config.device == "cuda" and accelerator.device.type != "cuda":
        raise ValueError("device: cuda was asked for, but this torch sees no CUDA device")
    main = accelerator.is_main_process

    data = config.data
    if data is None:
        with accelerator.main_process_first():
            data = embedded_data(config)
    options = {"categories": config.category or None, "exclude_licences": config.exclude_licence}
    samples = TrainingSamples(TouchDataset(data, "train", **options), recipe.samples, seed=config.seed)
    held_out = TouchDataset(data, "val", **options)
    per_epoch = steps_per_epoch(len(samples), recipe.batch_size)
    steps = recipe.steps if recipe.steps is not None else recipe.epochs * per_epoch

    torch.manual_seed(config.seed)
    network = TouchNet(recipe.model)
    fused = accelerator.device.type in ("cpu", "cuda")
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay, fused=fused
    )
    model, optimizer = accelerator.prepare(Step(network, recipe.loss), optimizer)
    average = Average(network, recipe.average)
    start = 0
    if config.resume:
        start = load_checkpoint(checkpoint, network, average, optimizer, recipe, accelerator.device)
        if start >= steps:
            raise ValueError(f"resume: {checkpoint} is at step {start}, nothing is left of {steps} steps (see --steps)")
    batches = StepBatches(
        len(samples), recipe.batch_size, seed=config.seed, start=start, steps=steps,
        rank=accelerator.process_index, world=accelerator.num_processes,
        weights=samples.weights(recipe.balance) if recipe.balance else None,
    )  # fmt: skip
    loader = DataLoader(samples, batch_sampler=batches, num_workers=config.workers)
    log = Log(config, recipe, steps=steps, start=start, shapes=len(samples.data)) if main else None
    say = accelerator.print
    say(
        f"{len(samples.data)} shapes ({len(samples)} trajectories), {len(held_out)} held out; {recipe.model.network} "
        f"network, {sum(p.numel() for p in network.parameters()):,} parameters; steps {start}..{steps} of "
        f"{recipe.batch_size} samples on {accelerator.num_processes} process(es), {accelerator.device}"
    )

    figures: dict[str, float] = {}
    losses: list[float] = []
    model.train()
    with stop_requests() as stopped, tqdm(total=steps, initial=start, disable=not main, unit="step") as bar:
        for step, batch in enumerate(map(lambda rows: Sample(*rows), loader), start):
            batch = Sample(*(value.to(accelerator.device) for value in batch))
            rate = learning_rate(step, steps, per_epoch, recipe.learning_rate, recipe.schedule)
            for group in optimizer.param_groups:
                group["lr"] = rate
            loss = model(batch.touches, batch.normals, batch.queries, batch.inside)
            if not torch.isfinite(loss):
                names = ", ".join(samples.data.records[int(i)].id for i in batch.index)
                raise ValueError(
                    f"the loss is {loss.item()} at step {step}; the batch holds {names}. Nothing was updated."
                )
            accelerator.backward(loss)
            accelerator.clip_grad_norm_(model.parameters(), 1.0)
            optimizer.step()
            optimizer.zero_grad()
            average.update(network, step)

            done = step + 1
            losses.append(loss.item())
            bar.update()
            stop = accelerator.reduce(torch.tensor(float(stopped.is_set), device=accelerator.device)).item() > 0
            if main and (done % 20 == 0 or done == steps):
                mean = sum(losses) / len(losses)
                losses.clear()
                log.write(done, {"loss": mean, "learning_rate": rate, "epoch": done / per_epoch})
                bar.set_postfix(loss=f"{mean:.4f}", epoch=f"{done / per_epoch:.1f}")
            if main and (done == steps or stop or done % config.checkpoint_every == 0):
                # Half precision is what ships; the checkpoint keeps what training goes on with.
                save_weights(average.network, config.output / "weights.safetensors", half=True)
                save_checkpoint(checkpoint, network, average, optimizer, recipe, done)
            if main and len(held_out) and not stop and (done == steps or done % config.validate_every == 0):
                figures = validate(average.network, held_out, accelerator.device, recipe.precision)
                log.write(done, figures)
                bar.write(f"step {done}: " + ", ".join(f"{name} {value:.3f}" for name, value in figures.items()))
            if stop:
                say(f"stopped at step {done}; --resume continues")
                raise KeyboardInterrupt
    if main:
        draw_reconstructions(average.network, held_out if len(held_out) else samples.data, config.output)
        say(f"wrote {config.output / 'weights.safetensors'}")
        log.close()
    accelerator.end_training()
    return figures


def resolve_recipe(config: TrainConfig) -> Recipe:
    """The recipe with the options that were given in place of its defaults."""
    recipe = RECIPES[config.recipe]
    names = ("batch_size", "learning_rate", "schedule", "loss", "balance", "precision")
    given = {name: getattr(config, name) for name in names if getattr(config, name) is not None}
    usual = vars(SampleConfig())
    changed = {name: value for name, value in vars(config.samples).items() if value != usual[name]}
    given["samples"] = dataclasses.replace(recipe.samples, **changed)
    if config.model is not None:
        given["model"] = MODELS[config.model]
    if config.sampling is not None:
        given["model"] = dataclasses.replace(given.get("model", recipe.model), sampling=config.sampling)
    if config.steps is not None and config.epochs is not None:
        raise ValueError("steps and epochs were both given; expected one of them")
    if config.steps is not None or config.epochs is not None:
        given |= {"steps": config.steps, "epochs": config.epochs}
    recipe = dataclasses.replace(recipe, **given)
    for name in ("steps", "epochs", "batch_size", "learning_rate"):
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


@torch.no_grad()
def validate(network: TouchNet, data: TouchDataset, device: torch.device, precision: str) -> dict[str, float]:
    """Volumetric IoU (mean over shapes) on uniform labelled points, for several numbers of contacts, with and without
    normals. The frame comes from the touches alone."""
    scores: dict[str, list[float]] = {}
    for index in range(len(data)):
        shape = data.shape(index)
        has_touches = shape.array("touches").shape[0] > 0
        for contacts, normals in VALIDATION if has_touches else ():
            sample = validation_sample(shape, contacts, normals=normals, index=index)
            touches, directions, queries, inside, _ = (value.to(device) for value in default_collate([sample]))
            with torch.autocast(device.type, dtype=torch.bfloat16, enabled=precision == "bf16"):
                occupancy = network(touches, queries, directions)
            name = f"iou/{contacts}" + ("+normals" if normals else "")
            scores.setdefault(name, []).append(float(volumetric_iou(occupancy[0] >= 0.5, inside[0] > 0.5)))
    return {name: float(np.mean(values)) for name, values in scores.items()}


def draw_reconstructions(network: TouchNet, data: TouchDataset, output: Path, *, rows: int = 6) -> None:
    """Writes `reconstructions.png`: touches, reconstruction and truth of some shapes; says which went wrong and why."""
    from touchnet.figures import save_gallery
    from touchnet.reconstruction import reconstruct_mesh

    pictures = []
    for index in np.unique(np.linspace(0, len(data) - 1, rows).round().astype(int)):
        shape = data.shape(int(index))
        name = data.records[int(index)].id
        stored = shape.array("touches")
        source = ("touches", "touch_normals") if len(stored) else ("surface", "surface_normals")
        touches, normals = (shape.array(part).reshape(-1, 3)[:2048].astype(np.float64) for part in source)
        mesh = None
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", UserWarning)
            try:
                mesh = reconstruct_mesh(touches, normals=normals, weights=network, resolution=128)
            except ValueError as error:
                print(f"no reconstruction of {name}: {error}", file=sys.stderr)
        for warning in said:
            print(f"reconstruction of {name}: {warning.message}", file=sys.stderr)
        pictures.append((name, touches, mesh, shape.mesh()))
    save_gallery(output / "reconstructions.png", pictures)


def save_checkpoint(
    path: Path, network: TouchNet, average: Average, optimizer: torch.optim.Optimizer, recipe: Recipe, step: int
) -> None:
    """Writes what `--resume` needs: plain tensors and numbers (torch.load's weights_only=True reads it)."""
    state = {
        "network": network.state_dict(),
        "average": average.network.state_dict(),
        "optimizer": optimizer.state_dict(),
        "model": dataclasses.asdict(recipe.model),
        "step": step,
    }
    with outputs.atomic_output(path, force=True) as temporary:
        torch.save(state, temporary)


def load_checkpoint(
    path: Path,
    network: TouchNet,
    average: Average,
    optimizer: torch.optim.Optimizer,
    recipe: Recipe,
    device: torch.device,
) -> int:
    """Restores what :func:`save_checkpoint` wrote; returns the step to go on from."""
    state = torch.load(path, map_location=device, weights_only=True)
    if state["model"] != dataclasses.asdict(recipe.model):
        raise ValueError(
            f"resume: {path} holds the model {state['model']}, asked for {dataclasses.asdict(recipe.model)}"
        )
    network.load_state_dict(state["network"])
    average.network.load_state_dict(state["average"])
    optimizer.load_state_dict(state["optimizer"])
    return state["step"]


class Log:
    """Figures over steps: an event file for TensorBoard and one JSON object a line in metrics.jsonl."""

    def __init__(self, config: TrainConfig, recipe: Recipe, *, steps: int, start: int, shapes: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        config.output.mkdir(parents=True, exist_ok=True)
        described = {"recipe": dataclasses.asdict(recipe), "steps": steps, "seed": config.seed, "shapes": shapes}
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


@cli.command("touchnet train")
def main(argv: Sequence[str] | None = None) -> int:
    train(cli.parse(TrainConfig, argv, prog="touchnet train"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
