"""The command, in this process with a stand-in for the network."""

import json

import numpy as np
import pytest

from tests.test_explorer import UnitBall, most
from touchnet.__main__ import main as touchnet_main
from touchnet.data.files import read_points
from touchnet.explore import COLUMNS, main
from touchnet.explorer import Explorer


@pytest.fixture
def ball(monkeypatch):
    model = UnitBall()
    monkeypatch.setattr("touchnet.weights.load_model", lambda name, device: model)
    return model


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savetxt("ball.xyz", most())
    return tmp_path


def one_line(capsys):
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("touchnet explore: error: ")
    return err


def test_table_csv_and_json_say_what_the_session_says(here, ball, capsys):
    expected = Explorer(most(), weights=UnitBall(), resolution=32).next(3)
    assert touchnet_main(["explore", "ball.xyz", "-k", "3", "--resolution", "32", "-o", "next.csv"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    first, head, *rows = out.splitlines()
    assert first.startswith(f"ball.xyz: {len(most())} contacts; the surface is expected ")
    assert head.split() == ["position", "direction", "gain", "may", "be", "off", "free", "path"]
    assert len(rows) == 3
    assert [float(x) for x in rows[0].split()[:3]] == pytest.approx(expected.positions[0], abs=1e-5)

    lines = (here / "next.csv").read_text().splitlines()
    assert tuple(lines[0].split(",")) == COLUMNS
    table = np.array([[float(x) for x in line.split(",")] for line in lines[1:]])
    assert table == pytest.approx(np.column_stack(expected))
    assert read_points("next.csv").points == pytest.approx(expected.positions)

    assert main(["ball.xyz", "-k", "3", "--resolution", "32", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["contacts"] == len(most())
    assert not said["normals"]
    assert 0 < said["confidence"] < 1
    for i, suggestion in enumerate(said["suggestions"]):
        assert suggestion["position"] == pytest.approx(expected.positions[i])
        assert suggestion["direction"] == pytest.approx(expected.directions[i])
        assert suggestion["gain"] == pytest.approx(expected.gains[i])


def test_where_the_robot_can_go_and_where_it_missed(here, ball, capsys):
    np.savetxt("missed.xyz", [[1.0, 0, 0]])
    options = ["--up", "z", "--floor", "-0.2", "--approach", "0", "0", "1", "--cone", "80", "--missed", "missed.xyz"]
    assert main(["ball.xyz", "--resolution", "32", "--json", "-k", "5", *options]) == 0
    for suggestion in json.loads(capsys.readouterr().out)["suggestions"]:
        assert suggestion["position"][2] > -0.2
        assert suggestion["direction"][2] < 0
        assert np.linalg.norm(np.subtract(suggestion["position"], [1, 0, 0])) > 0.1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["missing.xyz"], "missing.xyz: No such file"),
        (["ball.xyz", "-k", "0"], "-k should be at least 1, got 0"),
        (["ball.xyz", "--floor", "0"], 'floor needs up="x", "y" or "z"'),
        (["ball.xyz", "--cone", "200"], "cone should be a half angle"),
        (["ball.xyz", "--resolution", "4"], "--resolution should lie between 8 and 8192, got 4"),
        (["ball.xyz", "-o", "ball.xyz"], "ball.xyz exists; --force overwrites it"),
        (["ball.xyz", "-o", "nowhere/a.csv"], "the folder nowhere does not exist"),
        (["ball.xyz", "--missed", "none.xyz"], "none.xyz: No such file"),
        (["few.xyz"], "few.xyz: expected at least 4 distinct contacts, got 2"),
    ],
)
def test_bad_input_is_one_line_and_status_2(here, ball, capsys, arguments, said):
    np.savetxt("few.xyz", np.eye(3)[:2])
    assert main(arguments) == 2
    assert said in one_line(capsys)
