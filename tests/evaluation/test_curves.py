"""Which points lie on which curve."""

import functools
import re
from pathlib import Path

import pytest
import torch

from touchnet.evaluation.curves import Curve, Point, colours_of, curves_of, draw_curve, training_shapes
from touchnet.evaluation.methods import Method, label_of
from touchnet.evaluation.options import EvaluateConfig
from touchnet.evaluation.summary import Setting, Summary
from touchnet.models import TouchNet
from touchnet.weights import save_weights

METHODS = {
    name: Method(name, lambda *arguments: None, (False,), files=(name,)) for name in ("hull", "fi@10", "fi@30", "other")
}
LABEL = functools.partial(label_of, METHODS)
CONFIG = EvaluateConfig(data=Path(), contacts=(8, 16), curve_contacts=16, curves=("all",))


def summary(method: str, value: float | None, contacts: int, noise=0.0, strategy="stored", orientation="given"):
    setting = Setting(method, False, contacts, noise, strategy, orientation)
    return Summary(setting, "mean", "iou", value, None, None, None, 1, 1, 0)


def lines(summaries, shapes=None):
    curves = curves_of(summaries, CONFIG, METHODS, LABEL, shapes or {})
    return {curve.name: {k: [(p.x, p.value) for p in line] for k, line in curve.lines.items()} for curve in curves}


@pytest.mark.parametrize(
    ("note", "found"),
    [('{"shapes": 30}', {"net": 30}), ("{}", {}), ("none", {}), ("[1]", {}), ('{"shapes": "many"}', {})],
)
def test_a_note_of_the_training_that_says_nothing_is_no_reason_to_fail(tmp_path: Path, note: str, found: dict) -> None:
    torch.manual_seed(0)
    save_weights(TouchNet("tiny"), tmp_path / "net.safetensors", notes={"training": note})
    methods = {"net": Method("net", lambda *arguments: None, (True,), files=(str(tmp_path / "net.safetensors"),))}
    assert training_shapes(methods, "cup") == found


def test_each_curve_varies_one_thing() -> None:
    found = lines([
        summary("hull", 0.8, 16), summary("hull", 0.5, 8), summary("hull", 0.7, 16, noise=0.02),
        summary("hull", 0.75, 16, noise=0.01), summary("hull", 0.6, 16, strategy="uniform"),
        summary("hull", 0.65, 16, orientation="up"), summary("hull", 0.1, 32, noise=0.5),
        summary("hull", 0.3, 16, orientation="free"),
    ])  # fmt: skip
    assert found["contacts"] == {"hull": [(8, 0.5), (16, 0.8)]}
    assert found["noise"] == {"hull": [(0.0, 0.8), (1.0, 0.75), (2.0, 0.7)]}
    assert found["strategy"] == {"hull": [("stored", 0.8), ("uniform", 0.6)]}
    assert found["orientation"] == {"hull": [("given", 0.8), ("up", 0.65), ("free", 0.3)]}
    assert "training shapes" not in found


def test_networks_of_one_family_make_a_curve_over_training_shapes() -> None:
    summaries = [summary("fi@30", 0.6, 16), summary("fi@10", 0.4, 16), summary("other", 0.9, 16)]
    found = lines(summaries, {"fi@10": 10, "fi@30": 30, "other": 50})
    assert found == {"training shapes": {"fi": [(10, 0.4), (30, 0.6)]}}


def test_what_was_not_varied_is_no_curve_and_empty_results_leave_a_gap() -> None:
    assert lines([summary("hull", 0.8, 16)]) == {}
    found = lines([summary("hull", 0.8, 16), summary("hull", 0.9, 32), summary("hull", None, 8)])
    assert found["contacts"] == {"hull": [(16, 0.8), (32, 0.9)]}


def test_a_drawing_is_the_same_svg_every_time() -> None:
    curves = curves_of([summary("hull", 0.8, 16), summary("hull", 0.5, 8)], CONFIG, METHODS, LABEL, {})
    colours = colours_of(curves)
    assert set(colours) == {"hull"}
    first = draw_curve(curves[0], colours)
    assert first.startswith(b"<?xml") and first == draw_curve(curves[0], colours)


def test_twenty_lines_can_be_told_apart_and_their_names_stand_beside_them() -> None:
    names = [f"method {k}" for k in range(20)]
    points = [Point(8, 0.5, 0.4, 0.6), Point(16, 0.8, 0.7, 0.9)]
    curve = Curve("contacts", "contacts", "iou", "mean", dict.fromkeys(names, points))
    colours = colours_of([curve])
    assert len(set(colours.values())) == 20
    text = draw_curve(curve, colours).decode()
    width = float(re.search(r'viewBox="0 0 ([0-9.]+)', text)[1])
    name_at = [float(x) for x in re.findall(r'x="([0-9.]+)"[^>]*>method', text)]
    axes_end = max(float(x) for x in re.findall(r'x="([0-9.]+)"[^>]*>16<', text))
    assert len(name_at) == 20
    assert axes_end + 20 < min(name_at) < width
