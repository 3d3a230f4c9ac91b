"""From single results to means, bootstrap intervals and spreads."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchnet.evaluation.conditions import Condition

RESAMPLES = 1000
INTERVAL = 0.95
MEAN, SEEN, UNSEEN = "mean", "seen", "unseen"


class Setting(NamedTuple):
    """What a mean is taken for: a method under a condition."""

    method: str
    normals: bool
    contacts: int
    noise: float
    strategy: str
    orientation: str

    @property
    def condition(self) -> Condition:
        return Condition(*self[2:])


class Summary(NamedTuple):
    """A measure of a method: mean over the trajectories of a shape, then over shapes, then over categories."""

    setting: Setting
    category: str  # or a group, or "mean": over all categories, "seen", "unseen": over those (not) trained on
    measure: str
    value: float | None  # None: every result was empty and the measure infinite
    low: float | None  # bootstrap interval over shapes; None for a single shape
    high: float | None
    spread: float | None  # standard deviation over repetitions: trajectories and runs; None for a single one
    shapes: int
    results: int
    empty: int

    def columns(self) -> dict[str, Any]:
        """As one flat row."""
        return self.setting._asdict() | {name: getattr(self, name) for name in self._fields[1:]}


class _Cell(NamedTuple):
    """A measure in one category."""

    value: float
    resampled: NDArray[np.float64]  # (RESAMPLES,) means over shapes drawn again
    repeated: dict[tuple[int, int], float]  # mean over shapes of each repetition
    shapes: int
    results: int
    empty: int


def summarise(
    rows: Sequence[dict[str, Any]],
    measures: Iterable[str],
    *,
    seed: int,
    unseen: Collection[str] = (),
    groups: Iterable[str] = (),
) -> list[Summary]:
    """Means, bootstrap intervals over shapes and spreads, per category and over categories with equal weight.

    Infinite values (empty results) are left out of the means of distances; `empty` counts them. A measure that a method
    does not have (NaN in all of its rows) has no summary.

    Args:
        rows: single results.
        measures: names of their columns.
        seed: of the resampling.
        unseen: categories that no network was trained on; they and the others get means of their own.
        groups: categories joined by "+", whose shapes are pooled with equal weight, beside the categories.
    """
    by_setting: dict[Setting, list[dict[str, Any]]] = {}
    for row in rows:
        by_setting.setdefault(Setting(*(row[name] for name in Setting._fields)), []).append(row)
    summaries = []
    for setting, chosen in by_setting.items():
        categories = sorted({row["category"] for row in chosen})
        pools = {group: [row for row in chosen if row["category"] in group.split("+")] for group in groups}
        parts = {MEAN: categories}
        if 0 < len(set(categories) & set(unseen)) < len(categories):
            parts[SEEN] = [category for category in categories if category not in unseen]
            parts[UNSEEN] = [category for category in categories if category in unseen]
        for measure in measures:
            if all(math.isnan(row[measure]) for row in chosen):
                continue
            # The same resamples for every method and measure, so their intervals can be compared.
            generator = np.random.default_rng(seed)
            cells = {
                category: _cell([row for row in chosen if row["category"] == category], measure, generator)
                for category in categories
            }
            pooled = {group: _cell(members, measure, generator) for group, members in pools.items() if members}
            summaries += [_joined(setting, name, measure, [cell]) for name, cell in (cells | pooled).items()]
            for name, members in parts.items():
                summaries.append(_joined(setting, name, measure, [cells[category] for category in members]))
    return summaries


def _cell(rows: list[dict[str, Any]], measure: str, generator: np.random.Generator) -> _Cell:
    by_shape: dict[str, list[float]] = {}
    by_repetition: dict[tuple[int, int], list[float]] = {}
    for row in rows:
        by_shape.setdefault(row["shape"], []).append(row[measure])
        by_repetition.setdefault((row["run"], row["trajectory"]), []).append(row[measure])
    means = np.array([_finite_mean(np.array(measured)) for measured in by_shape.values()])
    resampled = _finite_mean(means[generator.integers(len(means), size=(RESAMPLES, len(means)))])
    repeated = {key: float(_finite_mean(np.array(values))) for key, values in by_repetition.items()}
    empty_key = "paper_empty" if measure.startswith("paper_") else "empty"
    empty = sum(int(row.get(empty_key, 0)) for row in rows)
    return _Cell(float(_finite_mean(means)), resampled, repeated, len(means), len(rows), empty)


def _joined(setting: Setting, name: str, measure: str, cells: list[_Cell]) -> Summary:
    """The mean over categories with equal weight."""
    shapes = sum(cell.shapes for cell in cells)
    # One shape a category has no spread to resample.
    low, high = _interval(
        _finite_mean(np.stack([cell.resampled for cell in cells], axis=1)), shapes if shapes > len(cells) else 1
    )
    repetitions = sorted({key for cell in cells for key in cell.repeated})
    means = np.array(
        [_finite_mean(np.array([cell.repeated.get(key, np.nan) for cell in cells])) for key in repetitions]
    )
    means = means[np.isfinite(means)]
    return Summary(
        setting,
        name,
        measure,
        _or_none(float(_finite_mean(np.array([cell.value for cell in cells])))),
        low,
        high,
        float(means.std(ddof=1)) if len(means) > 1 else None,
        shapes,
        sum(cell.results for cell in cells),
        sum(cell.empty for cell in cells),
    )


def _finite_mean(values: NDArray[np.float64]) -> Any:
    """Mean over the last axis of what is finite; NaN where nothing is."""
    finite = np.isfinite(values)
    count = finite.sum(axis=-1)
    return np.where(count, np.where(finite, values, 0).sum(axis=-1) / np.maximum(count, 1), np.nan)


def _interval(means: NDArray[np.float64], shapes: int) -> tuple[float | None, float | None]:
    means = means[np.isfinite(means)]
    if shapes < 2 or not len(means):
        return None, None
    low, high = np.quantile(means, [(1 - INTERVAL) / 2, (1 + INTERVAL) / 2])
    return float(low), float(high)


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
