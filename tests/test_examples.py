"""Every script in examples/ runs, with settings that take seconds, and does what it says."""

import functools
import re
import runpy
from pathlib import Path

import pytest
import trimesh
from accelerate.state import AcceleratorState

from touchnet.data import read_mesh, read_points
from touchnet.data.factory import MeshSource, Parameters, build
from touchnet.meshes import check_closed

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """run(script, *arguments) -> what it printed; the current folder is an empty one."""
    monkeypatch.chdir(tmp_path)

    def run(script, *arguments):
        monkeypatch.setattr("sys.argv", [script, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / script), run_name="__main__")
        return capsys.readouterr().out

    yield run
    AcceleratorState._reset_state(reset_partial_state=True)


def ball(width):
    mesh = trimesh.creation.icosphere(subdivisions=2)
    return mesh.apply_scale([width, 1, 1])


def test_every_example_has_a_test():
    tested = set(re.findall(r'run\(\s*"(\w+\.py)"', Path(__file__).read_text()))
    assert {path.name for path in EXAMPLES.glob("*.py")} == tested


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_help_says_what_the_example_does(path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", [path.name, "--help"])
    with pytest.raises(SystemExit) as leave:
        runpy.run_path(str(path), run_name="__main__")
    assert not leave.value.code
    first = path.read_text().split('"""')[1].splitlines()[0]
    assert first in " ".join(capsys.readouterr().out.split())


def test_reconstruct_file(run, tmp_path):
    said = run("reconstruct_file.py", "--output", "bottle.obj", "--resolution", 48, "--up", "z")
    assert said.startswith("512 contacts, with normals, 0 rows dropped\n")
    mesh = read_mesh(tmp_path / "bottle.obj")
    check_closed(mesh)
    points = read_points(EXAMPLES / "touches.csv").points
    assert abs(mesh.bounds - [points.min(axis=0), points.max(axis=0)]).max() < 12, "in the frame of the contacts, mm"


def test_reconstruct_simulated(run, tmp_path):
    trimesh.creation.icosphere(radius=30).export(tmp_path / "ball.stl")
    said = run(
        "reconstruct_simulated.py", "ball.stl", "--contacts", 128, "--resolution", 32, "--output", "again.ply"
    )  # fmt: skip
    assert said.startswith("128 contacts in ")
    assert 0.8 < float(re.search(r"over union (.*)", said).group(1)) <= 1
    check_closed(read_mesh(tmp_path / "again.ply"))


def test_ops_in_my_network(run):
    said = run("ops_in_my_network.py", "--steps", 60, "--resolution", 16, "--size", 8)
    errors = [float(error) for error in re.findall(r"distance (\S+)", said)]
    assert errors[-1] < 0.5 * errors[0], "it learns"
    assert re.search(r"closed mesh of [1-9]\d* faces", said)


@pytest.mark.slow
def test_train_on_my_meshes(run, tmp_path):
    (tmp_path / "meshes" / "ball").mkdir(parents=True)
    for number in range(3):  # these names fall into the splits train, val and test
        ball(1 - 0.2 * number).export(tmp_path / "meshes" / "ball" / f"{number}.obj")
    said = run(
        "train_on_my_meshes.py", "meshes", "--output", "mine", "--steps", 2, "--contacts", 64, "--trajectories", 1,
        "--resolution", 24,
    )  # fmt: skip
    assert "python -m touchnet.evaluate" in said
    assert (tmp_path / "mine" / "model" / "weights.safetensors").is_file()
    assert (tmp_path / "mine" / "report" / "gallery.png").is_file()


@pytest.mark.slow
def test_demo(run, tmp_path, monkeypatch):
    """All of it, but on three balls in place of the embedded shapes, which take a minute to make."""

    def embedded_data(config):
        sources = [
            MeshSource(f"ball/{split}", split, functools.partial(ball, width), split)
            for split, width in (("train", 1), ("val", 0.8), ("test", 0.6))
        ]
        directory = config.cache / f"procedural-{config.shapes}"
        build(sources, directory, Parameters(trajectories=1, near=4096, box=4096, surface=1024), progress=False)
        return directory

    monkeypatch.setattr("touchnet.train.embedded_data", embedded_data)
    run("demo.py", "--shapes", 3, "--steps", 2, "--model", "tiny", "--output", "demo", "--resolution", 24)
    assert (tmp_path / "demo" / "demo.png").is_file()
    check_closed(read_mesh(tmp_path / "demo" / "mesh.ply"))


def test_stream_touches(run, tmp_path):
    ball(0.6).export(tmp_path / "ball.ply")
    said = run(
        "stream_touches.py", "ball.ply", "--first", 24, "--budget", 40, "--batch", 8, "--resolution", 24,
        "--output", "again.ply",
    )  # fmt: skip
    assert [int(count) for count in re.findall(r"(\d+) contacts:", said)] == [24, 32, 40]
    check_closed(read_mesh(tmp_path / "again.ply"))
