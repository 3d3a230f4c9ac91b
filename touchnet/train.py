"""`python -m touchnet.train`: trains a network on a data set directory, or without one on the embedded shapes.

The loop is `train` below. It runs unchanged under `torchrun` and `accelerate launch`: each process takes its share of
every batch, and what a sample looks like depends on (seed, epoch, item) alone.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import time
import warnings
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import torch
from accelerate import Accelerator
from torch import Tensor, nn
from torch.utils.data import DataLoader
from tqdm import tqdm

from touchnet import cli
from touchnet.allocator import tune_allocator
from touchnet.data.dataset import TouchDataset
from touchnet.data.samples import NO_SHAPES, Sample, TrainingSamples
from touchnet.losses import Loss
from touchnet.models import build_model
from touchnet.objectives import objective_of, validate
from touchnet.training.average import Average
from touchnet.training.batches import StepBatches, pieces_of, steps_per_epoch
from touchnet.training.checkpoints import load_checkpoint, save_checkpoint
from touchnet.training.log import Log, draw_reconstructions, trained_with
from touchnet.training.options import Recipe, TrainConfig, described, resolve_recipe
from touchnet.training.schedule import ENDLESS, budget_of, learning_rate
from touchnet.training.stop import stop_requests
from touchnet.weights import load_model, save_weights

EACH = "each"  # in place of a category
COMPILER = "inductor"  # of torch.compile


class Step(nn.Module):
    """The network together with its loss, so that one forward call is what processes are synchronised around."""

    def __init__(self, network: nn.Module, loss: Loss) -> None:
        super().__init__()
        self.network, self.kind, self.objective = network, loss, objective_of(network)

    def forward(self, *batch: Tensor) -> Tensor:
        return self.objective.loss(self.network, Sample(*batch), self.kind)


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
    accelerator = accelerator_of(config, recipe)
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

    data = data_of(config, accelerator)
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
        start, earlier = load_checkpoint(checkpoint, network, average, optimizer, recipe)
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
    return figures


def accelerator_of(config: TrainConfig, recipe: Recipe) -> Accelerator:
    """What the processes of this run share; they are one group until `main` ends."""
    return Accelerator(
        cpu=config.device == "cpu",
        mixed_precision=recipe.precision,
        step_scheduler_with_optimizer=False,
        dynamo_backend=COMPILER if config.compile else None,
    )


def fast_bfloat16() -> bool:
    """Whether the processor multiplies in bfloat16 (AVX512-BF16 or AMX; other architectures: assumed)."""
    known = Path("/proc/cpuinfo")
    text = known.read_text() if known.exists() else ""
    return "flags" not in text or "avx512_bf16" in text or "amx_bf16" in text


class NothingLeft(ValueError):
    """A run to go on with has reached its end."""


def _drawn(records: list, limit: int | None, seed: int) -> list:
    """`limit` of the records, in their order."""
    if limit is None or limit >= len(records):
        return records
    rows = np.random.default_rng([seed, 1]).permutation(len(records))[:limit]
    return [records[row] for row in sorted(rows)]


def data_of(config: TrainConfig, accelerator: Accelerator) -> Path:
    """Directory of the data set; the embedded one is built by one process."""
    if config.data is not None:
        return config.data
    with accelerator.main_process_first():
        return embedded_data(config)


def embedded_data(config: TrainConfig) -> Path:
    """Directory of the embedded procedural data set, built on first use."""
    from touchnet.data.factory import Parameters
    from touchnet.data.shapes import build_procedural

    root = config.cache or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "touchnet"
    directory = root / f"procedural-{config.shapes}"
    jobs = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    build_procedural(directory, shapes=config.shapes, parameters=Parameters(trajectories=1), jobs=jobs)
    return directory


def train_each(config: TrainConfig) -> None:
    """Trains one network for each category of the split `train`; with --resume those that are not finished."""
    if len(config.category) > 1:
        raise ValueError(f"category {EACH!r} stands alone, got {', '.join(config.category)}")
    accelerator = accelerator_of(config, resolve_recipe(config))
    data = data_of(config, accelerator)
    categories = TouchDataset(data, "train", exclude_licences=config.exclude_licence).categories
    if not categories:
        raise ValueError(NO_SHAPES)
    for category in categories:
        output = config.output / category
        resume = config.resume and (output / "checkpoint.pt").exists()
        accelerator.print(f"{category}:")
        try:
            train(dataclasses.replace(config, data=data, category=(category,), output=output, resume=resume))
        except NothingLeft as finished:
            accelerator.print(finished)


@cli.command("touchnet train")
def main(argv: Sequence[str] | None = None) -> int:
    config = cli.parse(TrainConfig, argv, prog="touchnet train")
    if EACH in config.category:
        train_each(config)
    else:
        train(config)
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()
    return 0


if __name__ == "__main__":
    sys.exit(main())
