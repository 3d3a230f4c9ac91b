"""The curves: a measure against one thing that was varied, for every method, as numbers and as drawings."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from touchnet.evaluation.conditions import GIVEN, ORIENTATIONS, STORED, STRATEGIES, TRUTH, Condition
from touchnet.evaluation.methods import Method
from touchnet.evaluation.options import EvaluateConfig
from touchnet.evaluation.summary import MEAN, SEEN, UNSEEN, Summary
from touchnet.evaluation.tables import COLUMNS

MEASURES = ("iou", "chamfer_l1", "paper_f_score")
TITLES = {
    "iou": "volumetric IoU",
    "chamfer_l1": "Chamfer L1, % of the longest side",
    "paper_f_score": "F-score at 1 %, protocol paper",
}
# Colours that differ in lightness too, and marks, so that lines can be told apart in grey.
COLOURS = ("#0b5cad", "#d1495b", "#2e8b57", "#8c564b", "#7b4fb0", "#c77c11", "#4a4e57", "#148f9c", "#b0388f")
MARKS = "osD^vP*Xh"


class Point(NamedTuple):
    """A mean with its bootstrap interval (None: a single shape), at a place along the curve."""

    x: float | str
    value: float
    low: float | None
    high: float | None


class Curve(NamedTuple):
    """A measure against what was varied."""

    name: str  # contacts, noise, strategy, orientation, training shapes
    axis: str
    measure: str
    categories: str  # "mean", "seen" or "unseen"
    lines: dict[str, list[Point]]  # by the method's label


def curves_of(
    summaries: Sequence[Summary],
    config: EvaluateConfig,
    methods: Mapping[str, Method],
    label: Callable[[str, bool], str],
    shapes: Mapping[str, int],
) -> list[Curve]:
    """Every curve with at least two places on it.

    Args:
        methods: those that were tried.
        label: name of a method with or without normals.
        shapes: number of training shapes of the methods whose weights tell it.
    """
    cell = {(s.setting, s.category, s.measure): s for s in summaries}
    settings = sorted({s.setting for s in summaries if s.setting.method != TRUTH})
    parts = [name for name in (MEAN, SEEN, UNSEEN) if any(s.category == name for s in summaries)]
    usual = Condition(config.curve_contacts)
    curves = []
    for name, axis, place in _VARIED:
        for measure in MEASURES:
            for part in parts:
                lines: dict[str, list[Point]] = {}
                for setting in settings:
                    x = place(setting.condition, usual, config)
                    if x is not None:
                        _add(lines, label(setting.method, setting.normals), x, cell.get((setting, part, measure)))
                curves.append(Curve(name, axis, measure, part, lines))
    for measure in MEASURES:
        for part in parts:
            trained: dict[str, list[Point]] = {}
            for setting in settings:
                if setting.method in shapes and setting.condition == Condition(max(config.contacts)):
                    family = _family(setting.method, methods)
                    if family:
                        line = label(setting.method, setting.normals).replace(setting.method.replace("_", " "), family)
                        _add(trained, line, shapes[setting.method], cell.get((setting, part, measure)))
            curves.append(Curve("training shapes", "training shapes", measure, part, trained))
    for curve in curves:
        for points in curve.lines.values():
            points.sort(key=lambda point: _order(point.x))
    return [curve for curve in curves if any(len(points) > 1 for points in curve.lines.values())]


def _add(lines: dict[str, list[Point]], line: str, x: float | str, summary: Summary | None) -> None:
    if summary is not None and summary.value is not None:
        lines.setdefault(line, []).append(Point(x, summary.value, summary.low, summary.high))


def _along_contacts(condition: Condition, usual: Condition, config: EvaluateConfig) -> float | None:
    return condition.contacts if condition == Condition(condition.contacts) else None


def _along_noise(condition: Condition, usual: Condition, config: EvaluateConfig) -> float | None:
    return 100 * condition.noise if condition == usual._replace(noise=condition.noise) else None


def _along_strategy(condition: Condition, usual: Condition, config: EvaluateConfig) -> str | None:
    return condition.strategy if condition == usual._replace(strategy=condition.strategy) else None


def _along_orientation(condition: Condition, usual: Condition, config: EvaluateConfig) -> str | None:
    return condition.orientation if condition == usual._replace(orientation=condition.orientation) else None


_VARIED = (
    ("contacts", "contacts", _along_contacts),
    ("noise", "noise of positions, % of the longest side", _along_noise),
    ("strategy", "exploration", _along_strategy),
    ("orientation", "orientation", _along_orientation),
)


def _family(method: str, methods: Mapping[str, Method]) -> str | None:
    """What networks trained on different numbers of shapes have in common: their name up to the last "@"."""
    family, at, _ = method.rpartition("@")
    return family if at and method in methods else None


def _order(x: float | str) -> float:
    """Where a place comes: named ones from what is usual on."""
    return (STORED, GIVEN, "gp", *STRATEGIES, *ORIENTATIONS).index(x) if isinstance(x, str) else x


def training_shapes(methods: Mapping[str, Method], category: str) -> dict[str, int]:
    """How many shapes the networks were trained on, where the headers of their weights tell."""
    from touchnet.weights import read_notes

    found = {}
    for name, method in methods.items():
        note = read_notes(method.weights(0, category)).get("training", "{}") if method.files else "{}"
        try:
            training = json.loads(note)
        except json.JSONDecodeError:  # weights of others say what they like there
            continue
        if isinstance(training, dict) and isinstance(training.get("shapes"), int):
            found[name] = training["shapes"]
    return found


def draw_curve(curve: Curve, colours: Mapping[str, tuple[str, str]]) -> bytes:
    """The curve as SVG, with bootstrap intervals where no more than nine lines share the drawing.

    Args:
        colours: colour and mark of each label, the same in all drawings.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    column = COLUMNS[curve.measure]
    crowded = len(curve.lines) > len(COLOURS)  # the names then stand beside the lines
    figure = Figure(figsize=(7.4, 4.8) if crowded else (5.2, 3.6), layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.add_subplot()
    places = list(dict.fromkeys(point.x for points in curve.lines.values() for point in points))
    named = any(isinstance(place, str) for place in places)
    places.sort(key=_order)
    for label, points in curve.lines.items():
        colour, mark = colours[label]
        x = [places.index(point.x) if named else point.x for point in points]
        y = [point.value * column.factor for point in points]
        axes.plot(x, y, color=colour, marker=mark, markersize=4, linewidth=1.6, label=label)
        if not crowded and all(point.low is not None for point in points):
            low, high = ([getattr(point, end) * column.factor for point in points] for end in ("low", "high"))
            axes.fill_between(x, low, high, color=colour, alpha=0.12, linewidth=0)
    if named:
        axes.set_xticks(range(len(places)), [str(place).replace("_", " ") for place in places])
    elif curve.name in ("contacts", "training shapes"):
        axes.set_xscale("log", base=2)
        axes.set_xticks(places, [f"{place:g}" for place in places])
        axes.minorticks_off()
    axes.set_xlabel(curve.axis)
    axes.set_ylabel(TITLES[curve.measure])
    if column.better > 0:
        axes.set_ylim(0, 1)
    else:
        axes.set_ylim(bottom=0)
    axes.grid(color="#e4e7ec", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    if crowded:
        figure.legend(fontsize=7, frameon=False, loc="outside right upper")
    else:
        axes.legend(fontsize=7, frameon=False)
    written = io.BytesIO()
    with rc_context({"svg.hashsalt": "touchnet", "svg.fonttype": "none"}):  # the same bytes every time, text as text
        figure.savefig(written, format="svg", metadata={"Date": None})
    return written.getvalue()


def colours_of(curves: Sequence[Curve]) -> dict[str, tuple[str, str]]:
    """A colour and a mark for every label, no pair twice among 81."""
    labels = sorted({label for curve in curves for label in curve.lines})
    n = len(COLOURS)
    return {label: (COLOURS[k % n], MARKS[(k + k // n) % n]) for k, label in enumerate(labels)}
