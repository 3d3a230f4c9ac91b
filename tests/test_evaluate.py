"""The evaluation of a small data set of balls and boxes, whose right answers are known."""

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from tests.browser import open_page
from tests.solids import TOUCHES, write_solids
from touchnet import evaluate as command
from touchnet.baselines import convex_hull
from touchnet.config import MODELS, PointNet2Config
from touchnet.evaluate import evaluate, main
from touchnet.evaluation import measure, methods, progress
from touchnet.evaluation.conditions import TRUTH
from touchnet.evaluation.measure import result_keys
from touchnet.evaluation.methods import Method
from touchnet.evaluation.options import EvaluateConfig
from touchnet.evaluation.pictures import TILE
from touchnet.evaluation.tables import as_text
from touchnet.models import PointNet2, TouchNet
from touchnet.weights import save_weights


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return write_solids(tmp_path_factory.mktemp("data"))


def config(data: Path, output: Path, **changes: object) -> EvaluateConfig:
    small = EvaluateConfig(
        data=data, output=output, methods=("convex_hull",), contacts=(32, TOUCHES), samples=1500, gallery=0
    )
    return dataclasses.replace(small, **changes)


def results(output: Path) -> list[dict[str, str]]:
    """results.csv without the costs, which are never the same."""
    with (output / "results.csv").open(newline="") as file:
        return [
            {name: value for name, value in row.items() if name not in ("seconds", "memory")}
            for row in csv.DictReader(file)
        ]


@pytest.fixture
def calls(monkeypatch) -> list[tuple[int, bool]]:
    """Puts a method in the model's place that gives the hull, or nothing for few contacts; notes how it was called."""
    seen = []

    def run(touches, normals, config, weights):
        seen.append((len(touches), normals is not None))
        if len(touches) < 50:
            raise ValueError("no surface at level 0.5")
        return convex_hull(touches)

    def method(name, files, categories):
        return Method(name, run, (True, False), files=(files,))

    monkeypatch.setattr(methods, "network_method", method)
    monkeypatch.setattr(progress, "weights_digest", lambda weights: weights)
    monkeypatch.setattr(measure, "_try_once", lambda *arguments: None)
    monkeypatch.setattr(command, "training_shapes", lambda methods, category: {})
    return seen


def test_the_command_writes_and_prints_everything(data: Path, tmp_path: Path, capsys) -> None:
    output = tmp_path / "report"
    arguments = ["--methods", "convex_hull", "--contacts", "32", "96", "--samples", "1500", "--gallery", "1"]
    assert main([str(data), "-o", str(output), *arguments]) == 0
    said = capsys.readouterr().out
    assert "IoU by category (protocol surface)" in said and "F-score at 1 % by category (protocol paper)" in said
    assert "convex hull" in said and TRUTH in said
    assert "(eq. 9)" in said and "longest side" in said and "strictly nearer" in said and "4 shapes" in said

    rows = results(output)
    assert len(rows) == 4 * (1 + 2 * 2)  # the truth, and two trajectories with two numbers of contacts
    hulls = [row for row in rows if row["method"] == "convex_hull" and row["contacts"] == "96"]
    assert all(0.75 < float(row["iou"]) < 1 and row["watertight"] == "1.0" and row["empty"] == "0.0" for row in hulls)
    truth = [row for row in rows if row["method"] == TRUTH]
    assert all(float(row["iou"]) > 1 - 1e-9 and float(row["f_score_0.005"]) == 1 for row in truth)
    assert all(0 < float(row["paper_f_score"]) <= 1 for row in truth)

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    report = json.loads((output / "report.json").read_text(), parse_constant=refuse)
    assert report["command"].startswith("touchnet evaluate") and "--contacts 32 96" in report["command"]
    assert report["versions"]["torch"] and report["settings"]["seed"] == 0 and len(report["results"]) == len(rows)
    assert any("eq. 9" in line for line in report["definitions"])
    mean = next(
        s for s in report["summary"] if s["category"] == "mean" and s["measure"] == "iou" and s["contacts"] == 96
    )
    assert mean["low"] <= mean["value"] <= mean["high"] and mean["shapes"] == 4 and mean["results"] == 8
    picture = np.asarray(Image.open(output / "gallery.png"))
    assert picture.shape[1] > 3 * TILE and picture.shape[0] > 2 * TILE
    assert not list(output.rglob("*.part*"))


def test_more_contacts_are_better_and_two_processes_change_nothing(data: Path, tmp_path: Path) -> None:
    done = evaluate(config(data, tmp_path / "one"))
    means = [s for s in done.summaries if s.category == "mean" and s.measure == "iou"]
    iou = {s.setting.contacts: s.value for s in means}
    assert iou[TOUCHES] > iou[32] + 0.05
    evaluate(config(data, tmp_path / "two", jobs=2))
    assert results(tmp_path / "one") == results(tmp_path / "two")


def test_a_method_without_a_surface_counts_as_empty(data: Path, tmp_path: Path, calls) -> None:
    done = evaluate(config(data, tmp_path, methods=("model",), trajectories=1, normals="with", gallery=1))
    assert sorted(set(calls)) == [(32, True), (TOUCHES, True)]
    failed = [row for row in results(tmp_path) if row["method"] == "model" and row["contacts"] == "32"]
    assert len(failed) == 4
    for row in failed:
        assert row["note"] == "no surface at level 0.5" and row["empty"] == "1.0" and row["paper_empty"] == "1.0"
        assert float(row["iou"]) == 0 and row["chamfer"] == "inf" and float(row["paper_f_score"]) == 0
    few = {s.measure: s for s in done.summaries if s.setting.contacts == 32 and s.category == "mean"}
    assert few["chamfer"].value is None and few["chamfer"].low is None and few["iou"].value == 0
    assert few["iou"].empty == few["iou"].results == few["paper_f_score"].empty == 4
    assert "4/4" in "".join(map(as_text, done.tables))


def test_resume_goes_on_after_a_kill(data: Path, tmp_path: Path, calls) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    evaluate(config(data, whole, methods=("model",)))
    assert len(calls) == 4 * 2 * 2 * 2
    evaluate(config(data, broken, methods=("model",), limit=1))
    progress = broken / "progress.jsonl"
    progress.write_text(progress.read_text()[:-40])  # killed while writing the last line
    calls.clear()
    evaluate(config(data, broken, methods=("model",), resume=True))
    assert len(calls) == 2 * 2 * 2 * 2 + 1
    assert results(whole) == results(broken)
    calls.clear()
    both = ("model", "convex_hull")
    evaluate(config(data, broken, methods=both, resume=True))  # only the new method runs
    assert calls == [] and {row["method"] for row in results(broken)} == {TRUTH, *both}
    evaluate(config(data, broken, methods=("model",), weights="others", resume=True))  # other weights: all anew
    assert len(calls) == 4 * 2 * 2 * 2


def test_results_are_neither_mixed_nor_overwritten_unasked(data: Path, tmp_path: Path, capsys) -> None:
    evaluate(config(data, tmp_path, limit=1, contacts=(TOUCHES,), trajectories=1))
    before = (tmp_path / "progress.jsonl").read_bytes()
    capsys.readouterr()
    assert main([str(data), "-o", str(tmp_path), "--methods", "convex_hull"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "--resume goes on with them, --force replaces them" in error
    arguments = ["--methods", "convex_hull", "--contacts", "96", "--samples", "1700", "--resume"]
    assert main([str(data), "-o", str(tmp_path), *arguments]) == 2
    assert "was written with another samples; --force starts anew" in capsys.readouterr().err
    assert (tmp_path / "progress.jsonl").read_bytes() == before
    evaluate(config(data, tmp_path, limit=1, contacts=(32,), trajectories=1, force=True))
    assert {row["contacts"] for row in results(tmp_path)} == {"0", "32"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--contacts", "200"], "contacts must be at most 96, which the data set stores, got 200"),
        (["--contacts", "0"], "contacts must be at least 1, got 0"),
        (["--split", "val"], "has no shape in split 'val'"),
        (["--categories", "tree"], "categories should be out of ball, box, got tree"),
        (["--groups", "ball+tree"], "groups should join categories out of ball, box by +, got ball+tree"),
        (["--jobs", "0"], "jobs must be at least 1, got 0"),
        (["--methods", "magic"], "magic"),
        (["--methods", "model", "--weights", "missing.safetensors"], "missing.safetensors"),
    ],
)
def test_what_cannot_be_asked_is_one_line(data: Path, tmp_path: Path, capsys, arguments: list[str], words: str) -> None:
    assert main([str(data), "-o", str(tmp_path / "out"), "--methods", "convex_hull", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error and error.strip().count("\n") == 0 and "Traceback" not in error
    assert not (tmp_path / "out" / "results.csv").exists()


def test_a_folder_that_is_no_data_set_is_one_line(tmp_path: Path, capsys) -> None:
    assert main([str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert "is not a data set: no dataset.json in it" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_weights_from_a_file_are_evaluated(data: Path, tmp_path: Path) -> None:
    """An untrained network has no useful surface, but every row is there and its numbers are defined."""
    torch.manual_seed(0)
    file = tmp_path / "weights.safetensors"
    save_weights(TouchNet(MODELS["tiny"]).eval(), file)
    asked = config(
        data, tmp_path / "out", methods=("model",), weights=str(file), contacts=(TOUCHES,), trajectories=1, limit=1,
        resolution=16, device="cpu",
    )  # fmt: skip
    evaluate(asked)
    rows = [row for row in results(tmp_path / "out") if row["method"] == "model"]
    assert len(rows) == 4 and {row["normals"] for row in rows} == {"True", "False"}
    for row in rows:
        assert 0 <= float(row["iou"]) <= 1 and len(row["weights"]) == 16
        assert all(row[name] != "" for name in result_keys(asked) if name not in ("seconds", "memory"))


def test_a_picture_after_resume_shows_every_method(data: Path, tmp_path: Path, calls) -> None:
    one = config(data, tmp_path, contacts=(TOUCHES,), trajectories=1, limit=1, categories=("ball",), gallery=1)
    evaluate(one)
    width = Image.open(tmp_path / "gallery.png").width
    evaluate(dataclasses.replace(one, methods=("convex_hull", "model"), normals="with", resume=True))
    assert Image.open(tmp_path / "gallery.png").width > width + TILE
    assert [row["method"] for row in results(tmp_path)] == ["convex_hull", "model", TRUTH]
    lines = (tmp_path / "progress.jsonl").read_text().splitlines()
    assert len(lines) == 1 + 3  # the hull was computed again for the picture, and not written again


def test_points_are_scored_where_they_can_be(data: Path, tmp_path: Path) -> None:
    torch.manual_seed(0)
    small = PointNet2Config(points=64, copies=2, noise=4, width=8, centres=(16, 4), radii=(0.5, 1), neighbours=8)
    for seed in (0, 1):
        network = PointNet2(small).eval()
        torch.nn.init.normal_(network.displacement[-1].weight, std=0.002 * (seed + 1))  # points near the touches
        save_weights(network, tmp_path / f"{seed}-box.safetensors")
    files = ",".join(str(tmp_path / f"{seed}-{{category}}.safetensors") for seed in (0, 1))
    asked = config(
        data, tmp_path / "out", methods=(), models=(f"displaced={files}",), contacts=(TOUCHES,), trajectories=1,
        categories=("box",), gallery=1,
    )  # fmt: skip
    done = evaluate(asked)
    rows = [row for row in results(tmp_path / "out") if row["method"] == "displaced"]
    assert [row["run"] for row in rows] == ["0", "1"] * 2 and len({row["weights"] for row in rows}) == 2
    for row in rows:
        assert row["iou"] == row["normal_consistency"] == row["watertight"] == "" and row["faces"] == "0"
        assert row["empty"] == "0.0" and 0 < float(row["chamfer_l1"]) < 0.1 and float(row["paper_chamfer"]) > 0
    measured = next(table for table in done.tables if table.title.startswith("protocol surface"))
    assert "n/a" in next(line for line in measured.lines if line[1] == "displaced")
    spread = next(s for s in done.summaries if s.measure == "chamfer_l1" and s.category == "mean" and s.spread)
    assert spread.setting.method == "displaced"
    with pytest.raises(FileNotFoundError, match=r"0-ball.safetensors"):
        evaluate(dataclasses.replace(asked, categories=(), force=True))


def test_the_report_of_a_whole_run_opens_in_a_browser(data: Path, tmp_path: Path) -> None:
    published = tmp_path / "published.csv"
    published.write_text("source,method,category,measure,value\nA paper,hull <b>,bottle,F 1%,0.25\n")
    asked = config(
        data, tmp_path, contacts=(TOUCHES,), trajectories=1, limit=1, gallery=1, curves=("all",), curve_contacts=32,
        published=published,
        curve_counts=(16, 32, 64), noises=(0.0, 0.02), strategies=("uniform",), orientations=("free",),
    )  # fmt: skip
    evaluate(asked)
    report = json.loads((tmp_path / "report.json").read_text())
    assert {curve["name"] for curve in report["curves"]} == {"contacts", "noise", "strategy", "orientation"}
    turned = [s for s in report["summary"] if s["orientation"] == "free" and s["measure"] == "iou"]
    given = {s["category"]: s["value"] for s in report["summary"] if s["contacts"] == 32 and s["measure"] == "iou"
             and (s["noise"], s["strategy"], s["orientation"]) == (0.0, "stored", "given")}  # fmt: skip
    for s in turned:  # the hull does not care how the object lies
        assert s["value"] == pytest.approx(given[s["category"]], abs=1e-3)
    with open_page(tmp_path / "report.html") as page:
        page.check()
        # Four curves of three measures; truth, touches, labelled, hull of two shapes; the exploration.
        assert page.evaluate("document.images.length") == 4 * 3 + 2 * 4 + 1
        assert page.evaluate("document.querySelectorAll('table.figures').length") == 5
        last = page.evaluate("[...document.querySelectorAll('table.figures')].at(-1).innerText")
        assert last.split() == "source method category F 1% A paper hull <b> bottle 0.25".split()
    assert report["published"] == [{"source": "A paper", "method": "hull <b>", "category": "bottle", "F 1%": "0.25"}]
