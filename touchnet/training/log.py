"""What a run tells of itself: figures over steps, how the weights came about, pictures of some results."""

from __future__ import annotations

import dataclasses
import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from torch import nn

from touchnet import outputs
from touchnet.data.dataset import TouchDataset
from touchnet.data.samples import TrainingSamples
from touchnet.objectives import objective_of
from touchnet.training.options import Recipe, TrainConfig
from touchnet.training.schedule import Budget


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
