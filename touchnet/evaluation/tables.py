"""The tables: which measures of which methods stand where, as rows of text for the terminal and the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from touchnet.evaluation.conditions import TRUTH, Condition
from touchnet.evaluation.measure import PAPER_COUNT, PAPER_SAMPLES, PAPER_THRESHOLD
from touchnet.evaluation.options import EvaluateConfig
from touchnet.evaluation.summary import INTERVAL, MEAN, RESAMPLES, SEEN, UNSEEN, Setting, Summary
from touchnet.metrics import DEFINITIONS

PROTOCOLS = {
    "surface": "the output mesh against the true mesh, by exact distances of surface samples to the other mesh and by "
    "volume; an output of points is compared as it is, and has no IoU, normals or edges",
    "paper": f"the points inside the output mesh against the points inside the true one, among common samples "
    f"({PAPER_SAMPLES} of each kind that the data set stores), thinned to {PAPER_COUNT} by farthest points; F-score at "
    f"{PAPER_THRESHOLD:g}; an output of points stands for its own points, thinned alike",
}


class Column(NamedTuple):
    """How a measure is printed."""

    heading: str
    factor: float
    digits: int
    better: int  # 1: more is better, -1: less is

    def text(self, value: float) -> str:
        return f"{value * self.factor:.{self.digits}f}"


COLUMNS = {
    "iou": Column("IoU", 1, 3, 1),
    "f_score_0.005": Column("F 0.5%", 1, 3, 1),
    "f_score_0.01": Column("F 1%", 1, 3, 1),
    "f_score_0.02": Column("F 2%", 1, 3, 1),
    "chamfer_l1": Column("CD-L1 %", 100, 3, -1),
    "chamfer": Column("CD x1e4", 1e4, 3, -1),
    "hausdorff_95": Column("H95 %", 100, 2, -1),
    "normal_consistency": Column("NC", 1, 3, 1),
    "watertight": Column("closed", 1, 3, 1),
    "seconds": Column("seconds", 1, 2, -1),
    "memory": Column("MiB", 1, 0, -1),
    "paper_f_score": Column("F 1%", 1, 3, 1),
    "paper_chamfer": Column("CD x1e4", 1e4, 2, -1),
}


class Table(NamedTuple):
    """Texts of a table; the second column is aligned to the left, the others to the right."""

    title: str
    header: list[str]
    lines: list[list[str]]


class Cells:
    """The summaries of the undisturbed settings, by setting, category and measure."""

    def __init__(self, summaries: Sequence[Summary], contacts: Sequence[int]) -> None:
        self.cell = {(s.setting, s.category, s.measure): s for s in summaries}
        settings = {s.setting for s in summaries}
        shown = {Condition(n) for n in (0, *contacts)}
        self.settings = sorted(
            (s for s in settings if s.condition in shown),
            key=lambda s: (s.contacts, s.method == TRUTH, s.method, not s.normals),
        )
        names = dict.fromkeys(s.category for s in summaries)
        last = [name for name in (SEEN, UNSEEN, MEAN) if name in names]
        self.categories = [name for name in names if name not in last] + last

    def text(self, setting: Setting, category: str, measure: str) -> str:
        """`n/a`: the method has no such measure; `-`: every result was empty."""
        summary = self.cell.get((setting, category, measure))
        if summary is None:
            return "n/a"
        return "-" if summary.value is None else COLUMNS[measure].text(summary.value)


def tables_of(summaries: Sequence[Summary], config: EvaluateConfig, label: Callable[[str, bool], str]) -> list[Table]:
    """IoU by category, the other measures averaged over categories, and the paper's protocol.

    Args:
        label: name of a method with or without normals.
    """
    cells = Cells(summaries, config.contacts)
    tables = []
    if "surface" in config.protocols:
        tables += [
            _by_category("IoU by category (protocol surface)", cells, "iou", label),
            _by_measure("protocol surface, mean over categories", cells, label),
        ]
    if "paper" in config.protocols:
        tables += [
            _by_category("F-score at 1 % by category (protocol paper)", cells, "paper_f_score", label),
            _by_category("Chamfer distance x 1e4 by category (protocol paper)", cells, "paper_chamfer", label),
        ]
    return tables


def _by_category(title: str, cells: Cells, measure: str, label: Callable[[str, bool], str]) -> Table:
    interval = f"{INTERVAL:.0%} interval"
    header = ["contacts", "method", *cells.categories, interval, "spread", "empty"]
    lines = []
    for setting in cells.settings:
        values = [cells.text(setting, category, measure) for category in cells.categories]
        lines.append([*_heads(setting, label), *values, *_certainty(cells, setting, measure)])
    return Table(title, header, lines)


def _certainty(cells: Cells, setting: Setting, measure: str) -> list[str]:
    mean = cells.cell.get((setting, MEAN, measure))
    if mean is None:
        return ["n/a"] * 3
    column = COLUMNS[measure]
    interval = "" if mean.low is None else f"{column.text(mean.low)}-{column.text(mean.high)}"
    return [interval, "" if mean.spread is None else column.text(mean.spread), f"{mean.empty}/{mean.results}"]


def _by_measure(title: str, cells: Cells, label: Callable[[str, bool], str]) -> Table:
    known = {measure for _, _, measure in cells.cell}
    measures = [name for name in COLUMNS if not name.startswith("paper_") and name in known]
    header = ["contacts", "method", *(COLUMNS[name].heading for name in measures), "empty"]
    lines = []
    for setting in cells.settings:
        values = [cells.text(setting, MEAN, name) for name in measures]
        counted = cells.cell.get((setting, MEAN, "chamfer_l1"))
        empty = "" if counted is None else f"{counted.empty}/{counted.results}"
        lines.append([*_heads(setting, label), *values, empty])
    return Table(title, header, lines)


def _heads(setting: Setting, label: Callable[[str, bool], str]) -> list[str]:
    return [str(setting.contacts or "-"), label(setting.method, setting.normals)]


def as_text(table: Table) -> str:
    """The table for a terminal."""
    widths = [max(len(line[k]) for line in [table.header, *table.lines]) for k in range(len(table.header))]

    def joined(line: list[str]) -> str:
        return "  ".join(
            text.ljust(width) if k == 1 else text.rjust(width)
            for k, (text, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()

    return "\n".join([table.title, joined(table.header), "-" * len(joined(table.header)), *map(joined, table.lines)])


def definitions(config: EvaluateConfig) -> list[str]:
    """What the numbers mean, one line each."""
    lines = ["distances and thresholds are in units of the longest side of the true shape's box"]
    lines += [f"protocol {name}: {PROTOCOLS[name]}" for name in config.protocols]
    if "surface" in config.protocols:
        lines.append(f"surface samples: {config.samples} on each mesh, stratified by area")
    lines += [f"{name}: {text}" for name, text in DEFINITIONS.items()]
    lines += [
        "seconds: wall-clock time of a reconstruction in a process that has loaded weights and libraries, on a machine "
        "that --jobs may be sharing",
        "MiB: peak resident memory during a reconstruction less what was resident just before",
        "mean: over the trajectories of a shape, then the shapes of a category, then categories with equal weight; "
        "seen and unseen: over the categories with and without shapes in the split train",
        "means of distances leave empty results out; the column empty counts them",
        f"interval: {INTERVAL:.0%} bootstrap over shapes ({RESAMPLES} resamples)",
        "spread: standard deviation of the mean over repetitions: trajectories from other starting points, and weights "
        "trained with other seeds where several were given",
        "n/a: the measure does not exist for this kind of output; -: every result was empty",
        f"{TRUTH}: the true mesh in place of a reconstruction, the ceiling that the sampling allows",
    ]
    return lines
