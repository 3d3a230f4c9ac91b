"""`touchnet evaluate`: reconstructions from the touches of a data set against its true shapes, beside baselines."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import shutil
import sys
import time
from collections.abc import Sequence
from typing import NamedTuple

from touchnet import cli
from touchnet.data.dataset import INDEX, TouchDataset
from touchnet.evaluation.conditions import conditions_of, unseen_categories
from touchnet.evaluation.curves import curves_of, training_shapes
from touchnet.evaluation.files import versions, write_files
from touchnet.evaluation.measure import open_data, result_keys
from touchnet.evaluation.methods import CLASSICAL, label_of, methods_of
from touchnet.evaluation.options import EvaluateConfig
from touchnet.evaluation.page import write_page
from touchnet.evaluation.pictures import read_strips, save_rows, save_trajectory
from touchnet.evaluation.progress import collect
from touchnet.evaluation.published import read_published
from touchnet.evaluation.summary import Summary, summarise
from touchnet.evaluation.tables import COLUMNS, Table, as_text, definitions, tables_of


class Evaluation(NamedTuple):
    """What came out, beside the files."""

    summaries: list[Summary]
    tables: list[Table]


def evaluate(config: EvaluateConfig, *, command: str = "") -> Evaluation:
    """Runs the whole evaluation that `config` describes and writes its files."""
    _check(config)
    data = open_data(config)
    if len(data) == 0:
        raise ValueError(f"{config.data} has no shape in split {config.split!r}")
    for group in config.groups:
        if not set(group.split("+")) <= set(data.categories):
            raise ValueError(f"groups should join categories out of {', '.join(data.categories)} by +, got {group}")
    settings = {
        "data": hashlib.sha256((config.data / INDEX).read_bytes()).hexdigest()[:16],
        "resolution": config.resolution,
        "samples": config.samples,
        "seed": config.seed,
        "take": config.take,
        "protocols": list(config.protocols),
    }
    published = [] if config.published is None else [read_published(config.published)]
    progress = config.output / "progress.jsonl"
    if progress.exists() and not (config.resume or config.force):
        raise ValueError(f"{config.output} holds results; --resume goes on with them, --force replaces them")
    methods = methods_of(config, data.categories)
    if not config.resume:
        shutil.rmtree(config.output / "gallery", ignore_errors=True)
    config.output.mkdir(parents=True, exist_ok=True)
    if config.gallery:
        (config.output / "gallery").mkdir(exist_ok=True)
    rows = collect(config, methods, settings, progress)
    measures = [name for name in result_keys(config) if name in COLUMNS]
    unseen = unseen_categories(TouchDataset(config.data).records)
    summaries = summarise(rows, measures, seed=config.seed, unseen=unseen, groups=config.groups)
    label = functools.partial(label_of, methods)
    curves = curves_of(summaries, config, methods, label, training_shapes(methods, data.categories[0]))
    tables = tables_of(summaries, config, label) + published
    write_files(config, settings, rows, summaries, curves, published, command)
    pictures = read_strips(config.output, dict.fromkeys(row["shape"] for row in rows))
    save_rows(config.output, pictures)
    if pictures:
        ids = [record.id for record in data.records]
        save_trajectory(config.output, data, ids.index(pictures[0].shape))
    shapes = len({row["shape"] for row in rows})
    write_page(
        config.output / "report.html",
        title="Reconstruction from touches",
        facts={
            "command": command,
            "shapes": f"{shapes} of split {config.split}, {len(rows)} results",
            "categories never trained on": ", ".join(unseen) or "none known",
            "seed": str(config.seed),
            "versions": ", ".join(f"{name} {version}" for name, version in versions().items()),
        },
        tables=tables,
        curves=curves,
        rows=pictures,
        exploration=config.output / "exploration.png" if pictures else None,
        definitions=definitions(config),
    )
    return Evaluation(summaries, tables)


def _check(config: EvaluateConfig) -> None:
    for name in ("contacts", "protocols"):
        if not getattr(config, name):
            raise ValueError(f"{name} must name at least one, got none")
    if not (config.methods or config.models):
        raise ValueError("methods must name at least one, got none")
    for name in ("limit", "trajectories", "resolution", "samples", "jobs"):
        value = getattr(config, name)
        if value is not None and value < 1:
            raise ValueError(f"{name} must be at least 1, got {value}")
    fewest = min(condition.contacts for condition in conditions_of(config))
    if fewest < 1:
        raise ValueError(f"contacts must be at least 1, got {fewest}")
    for noise in config.noises:
        if not 0 <= noise < 1:
            raise ValueError(f"noises must be shares of the longest side in [0, 1), got {noise:g}")
    asked = set(CLASSICAL) if {"all", "classical"} & set(config.methods) else set(config.methods) & set(CLASSICAL)
    for name in sorted(asked):
        module = CLASSICAL[name].needs
        if module is not None and importlib.util.find_spec(module) is None:
            raise ImportError(f"method {name} needs {module}: pip install 'touchnet[baselines]'")


@cli.command("touchnet evaluate")
def main(argv: Sequence[str] | None = None) -> None:
    """The command."""
    config = cli.parse(EvaluateConfig, argv, prog="touchnet evaluate")
    arguments = sys.argv[1:] if argv is None else argv
    start = time.monotonic()
    done = evaluate(config, command=" ".join(["touchnet evaluate", *arguments]))
    print("\n\n".join(map(as_text, done.tables)))
    print()
    print("\n".join(definitions(config)))
    shapes = max(summary.shapes for summary in done.summaries)
    print(f"\n{shapes} shapes, {time.monotonic() - start:.0f} s; results in {config.output}")


if __name__ == "__main__":
    sys.exit(main())
