"""Means, intervals and spreads, computed by hand."""

import numpy as np
import pytest

from touchnet.evaluation.summary import summarise


def row(shape: str, trajectory: int, iou: float, chamfer: float) -> dict[str, object]:
    category = shape.split("/")[0]
    return {
        "shape": shape, "category": category, "method": "m", "run": 0, "trajectory": trajectory, "contacts": 8,
        "normals": True, "noise": 0.0,
        "strategy": "stored", "orientation": "given", "iou": iou, "chamfer": chamfer, "empty": float(np.isinf(chamfer)),
    }  # fmt: skip


def test_means_and_intervals_by_hand() -> None:
    rows = [
        row("a/1", 0, 0.2, 1.0),
        row("a/1", 1, 0.4, 3.0),  # shape a/1: 0.3, 2
        row("a/2", 0, 0.9, np.inf),  # empty
        row("b/1", 0, 0.5, 4.0),
    ]
    found = {(s.category, s.measure): s for s in summarise(rows, ["iou", "chamfer"], seed=0)}
    assert found["a", "iou"].value == pytest.approx(0.6)
    assert found["mean", "iou"].value == pytest.approx((0.6 + 0.5) / 2)
    assert (found["a", "iou"].low, found["a", "iou"].high) == pytest.approx((0.3, 0.9))
    assert found["b", "iou"].low is None  # a single shape has no spread
    assert (found["mean", "iou"].low, found["mean", "iou"].high) == pytest.approx((0.4, 0.7))
    assert found["a", "chamfer"].value == pytest.approx(2) and found["mean", "chamfer"].value == pytest.approx(3)
    assert (found["a", "chamfer"].shapes, found["a", "chamfer"].results, found["a", "chamfer"].empty) == (2, 3, 1)
    assert found["mean", "chamfer"].empty == 1 and found["mean", "chamfer"].shapes == 3
    assert all(s.low is None for s in summarise([rows[0], rows[3]], ["iou"], seed=0))


def test_spread_is_over_repetitions_of_the_whole_mean() -> None:
    rows = [row("a/1", 0, 0.2, 1.0), row("a/2", 0, 0.4, 1.0), row("b/1", 0, 0.5, 1.0)]  # (0.3 + 0.5) / 2
    again = [row("a/1", 1, 0.4, 1.0), row("a/2", 1, 0.6, 1.0), row("b/1", 1, 0.3, 1.0)]  # (0.5 + 0.3) / 2
    found = {s.category: s for s in summarise(rows + again, ["iou"], seed=0)}
    assert found["a"].spread == pytest.approx(np.std([0.3, 0.5], ddof=1))
    assert found["mean"].spread == pytest.approx(0, abs=1e-12)
    assert all(s.spread is None for s in summarise(rows, ["iou"], seed=0))
    other_run = [{**one, "run": 1} for one in rows]
    assert {s.spread for s in summarise(rows + other_run, ["iou"], seed=0)} == {0.0}


def test_seen_and_unseen_categories_apart() -> None:
    rows = [row("a/1", 0, 0.2, 1.0), row("b/1", 0, 0.4, 1.0), row("c/1", 0, 0.9, 1.0)]
    found = {s.category: s.value for s in summarise(rows, ["iou"], seed=0, unseen=["c", "d"])}
    assert found == pytest.approx({"a": 0.2, "b": 0.4, "c": 0.9, "mean": 0.5, "seen": 0.3, "unseen": 0.9})
    assert {s.category for s in summarise(rows, ["iou"], seed=0, unseen=["d"])} == {"a", "b", "c", "mean"}


def test_groups_pool_the_shapes_of_their_categories() -> None:
    rows = [row("a/1", 0, 0.2, 1.0), row("a/2", 0, 0.4, 1.0), row("b/1", 0, 0.9, 1.0), row("c/1", 0, 0.1, 1.0)]
    found = {s.category: s for s in summarise(rows, ["iou"], seed=0, groups=["a+b", "c+z", "z"])}
    assert list(found) == ["a", "b", "c", "a+b", "c+z", "mean"]
    assert found["a+b"].value == pytest.approx(0.5) and found["a+b"].shapes == 3  # each shape counts the same
    assert 0.2 <= found["a+b"].low < 0.5 < found["a+b"].high <= 0.9
    assert found["c+z"].value == found["c"].value and found["mean"].value == pytest.approx((0.3 + 0.9 + 0.1) / 3)


def test_a_measure_that_a_method_does_not_have_is_left_out() -> None:
    points = [{**row("a/1", 0, np.nan, 2.0), "method": "points"}]
    found = {
        (s.setting.method, s.measure) for s in summarise([row("a/1", 0, 0.5, 1.0), *points], ["iou", "chamfer"], seed=0)
    }
    assert found == {("m", "iou"), ("m", "chamfer"), ("points", "chamfer")}
