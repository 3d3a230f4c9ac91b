"""The report as files for programs: every result, every mean, and all that is needed to repeat the run."""

from __future__ import annotations

import csv
import dataclasses
import importlib.metadata
import json
import math
import os
import platform
from collections.abc import Sequence
from typing import Any

from touchnet import outputs
from touchnet.evaluation.conditions import Task
from touchnet.evaluation.curves import Curve
from touchnet.evaluation.measure import result_keys
from touchnet.evaluation.options import EvaluateConfig
from touchnet.evaluation.summary import Summary
from touchnet.evaluation.tables import Table, definitions


def write_files(
    config: EvaluateConfig,
    settings: dict[str, Any],
    rows: Sequence[dict[str, Any]],
    summaries: Sequence[Summary],
    curves: Sequence[Curve],
    published: Sequence[Table],
    command: str,
) -> None:
    """results.csv, summary.csv and report.json, each whole or not at all."""
    with outputs.atomic_output(config.output / "results.csv", force=True) as path, path.open("w", newline="") as file:
        columns = ["shape", "category", *Task._fields, *result_keys(config), "weights", "note"]
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows({name: _or_blank(value) for name, value in row.items()} for row in rows)
    means = [summary.columns() for summary in summaries]
    with outputs.atomic_output(config.output / "summary.csv", force=True) as path, path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(means[0]))
        writer.writeheader()
        writer.writerows(means)
    report = {
        "command": command,
        "options": json.loads(json.dumps(dataclasses.asdict(config), default=str)),
        "settings": settings,
        "versions": versions(),
        "definitions": definitions(config),
        "summary": means,
        "curves": [_as_json(curve) for curve in curves],
        "published": [dict(zip(table.header, line, strict=True)) for table in published for line in table.lines],
        "results": [{name: _jsonable(value) for name, value in row.items()} for row in rows],
    }
    with outputs.atomic_output(config.output / "report.json", force=True) as path:
        path.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _as_json(curve: Curve) -> dict[str, Any]:
    return {**curve._asdict(), "lines": {name: [one._asdict() for one in line] for name, line in curve.lines.items()}}


def _or_blank(value: Any) -> Any:
    """What does not exist (NaN) is blank; an empty result's infinite distance is `inf`."""
    return "" if isinstance(value, float) and math.isnan(value) else value


def _jsonable(value: Any) -> Any:
    # JSON has neither infinity nor NaN; the flag `empty` says why the number is missing.
    return None if isinstance(value, float) and not math.isfinite(value) else value


def versions() -> dict[str, str]:
    """Of Python, the machine's kind and the packages that made the numbers."""
    names = ("touchnet", "torch", "numpy", "scipy", "trimesh", "point-cloud-utils", "pymeshlab")
    found = {"python": platform.python_version(), "platform": platform.platform(), "processors": str(os.cpu_count())}
    for name in names:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found
