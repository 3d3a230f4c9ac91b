"""The command, in this process with a stand-in for the network, and from a shell with a real (untrained) one."""

import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from touchnet.data.files import read_mesh
from touchnet.meshes import check_closed
from touchnet.models import TouchNet
from touchnet.reconstruct import main
from touchnet.weights import save_weights


class Ball(torch.nn.Module):
    """Stands in for a trained network: the ball around the mean of the contacts, or nothing at all."""

    empty = False

    def encode(self, touches, normals=None):
        centre = touches[0].mean(dim=0)
        return centre, (touches[0] - centre).norm(dim=1).mean()

    def decode(self, features, queries):
        centre, radius = features
        inside = torch.sigmoid(20 * (radius - (queries - centre).norm(dim=2)))
        return torch.full_like(inside, 0.02) if self.empty else inside


@pytest.fixture
def ball(monkeypatch):
    model = Ball()
    monkeypatch.setattr("touchnet.weights.load_model", lambda name, device: model)
    return model


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def sphere(count, seed=0):
    """Opposite points in pairs, so that their mean is the centre."""
    points = np.random.default_rng(seed).normal(size=(count // 2, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return np.vstack([points, -points])


def touches(path, points):
    np.savetxt(path, points)
    return str(path)


def one_line(capsys):
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert err.startswith("touchnet reconstruct: error: ")
    return err


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb"])
def test_one_file(here, ball, capsys, suffix):
    assert main([touches("ball.xyz", sphere(200) * 48 + 100), "-o", f"ball.{suffix}", "--resolution", "32"]) == 0
    mesh = read_mesh(f"ball.{suffix}")
    check_closed(mesh)
    assert np.abs(mesh.bounds - [[52] * 3, [148] * 3]).max() < 8
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith(f"ball.xyz -> ball.{suffix}: 200 contacts, closed mesh of {len(mesh.faces)} faces")
    assert "MiB at most" in out or sys.platform == "win32"
    assert sorted(p.name for p in here.iterdir()) == [f"ball.{suffix}", "ball.xyz"]


def test_f17_through_the_command(here, ball, shared_data):
    assert main([str(shared_data / "cases/F17_millimetres_offset.xyz"), "-o", "m.ply", "--resolution", "64"]) == 0
    mesh = trimesh.load("m.ply")
    assert mesh.is_watertight
    assert np.abs(mesh.bounds.mean(axis=0) - [61, -22.5, 403.25]).max() < 4


def test_dropped_rows_are_counted(here, ball, shared_data, capsys):
    Path("t.xyz").write_text("nan 0 0\n" + "".join(f"{x} {y} {z}\n" for x, y, z in sphere(50)))
    assert main(["t.xyz", "-o", "m.ply", "--resolution", "32"]) == 0
    out, err = capsys.readouterr()
    assert "50 contacts (1 rows dropped)" in out
    assert err == (
        "touchnet reconstruct: warning: t.xyz: dropped 1 of 51 rows with a coordinate that is not a finite number "
        "(first: line 1)\n"
    )
    assert main(["t.xyz", "-o", "n.ply", "--strict"]) == 2
    assert "t.xyz: expected finite coordinates" in one_line(capsys)
    assert not Path("n.ply").exists()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "t.xyz: no points in an empty file"),
        ("nan nan nan\n" * 9, "t.xyz: no finite points"),
        ("0.1 -0.2 0.3\n", "t.xyz: expected at least 4 distinct contacts, got 1"),
        (
            "".join(f"{i} {i} {i}\n" for i in range(30)),
            "t.xyz: expected contacts around a solid, got 30 distinct contacts on",
        ),
        ("garbage", "t.xyz: no points in this file"),
        ("\0\1\2", "found a binary file with the suffix '.xyz'"),
    ],
)
def test_garbage_is_one_line_status_2_and_no_file(here, ball, capsys, content, said):
    Path("t.xyz").write_text(content)
    assert main(["t.xyz", "-o", "m.ply"]) == 2
    assert said in one_line(capsys)
    assert [p.name for p in here.iterdir()] == ["t.xyz"]


def test_i03_no_surface(here, ball, capsys):
    ball.empty = True
    assert main([touches("t.xyz", sphere(50)), "-o", "m.ply", "--resolution", "32"]) == 2
    assert "t.xyz: no surface" in (line := one_line(capsys))
    assert "minimum 0.02, maximum 0.02" in line
    assert not Path("m.ply").exists()


@pytest.mark.parametrize("case", ["F13_zero_points.pcd", "F15_one_point.xyz", "F22_transposed_3xN.npy"])
def test_cases_that_are_refused(here, ball, shared_data, capsys, case):
    assert main([str(shared_data / "cases" / case), "-o", "m.ply"]) == 2
    assert case in one_line(capsys)
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["absent.xyz", "-o", "m.ply"], "absent.xyz: No such file or directory"),
        (["t.xyz", "-o", "absent/m.ply"], "the folder absent does not exist"),
        (["t.xyz", "-o", "m.step"], "m.step: expected a name that ends in .ply, .obj, .stl or .glb"),
        (["t.xyz", "-o", "old.ply"], "old.ply exists; --force overwrites it"),
        (["-o", "m.ply"], "expected at least one file of touches"),
        (["t.xyz"], "-o PATH"),
        (["t.xyz", "-o", "m.ply", "--up", "w"], "--up"),
        (["t.xyz", "-o", "m.ply", "--level", "1.5"], "--level should lie between 0 and 1, got 1.5"),
        (["t.xyz", "-o", "m.ply", "--resolution", "2"], "--resolution should lie between 8 and 8192, got 2"),
        (["t.xyz", "-o", "m.ply", "--max-touches", "1"], "--max-touches should be at least 4, got 1"),
        (["t.xyz", "-o", "m.ply", "--device", "abacus"], "device should be"),
        (["t.xyz", "t.xyz", "-o", "d"], "two files of touches would become this mesh"),
        (["t.xyz", "old.ply", "-o", "-"], "standard output takes one mesh, got 2"),
        (["-", "-", "-o", "d"], "standard input (-) can be read once only"),
    ],
)
def test_usage_errors_are_one_line(here, ball, capsys, arguments, said):
    touches("t.xyz", sphere(50))
    Path("old.ply").write_text("old")
    assert main(arguments) == 2
    assert said in one_line(capsys)
    assert Path("old.ply").read_text() == "old"
    assert {p.name for p in here.iterdir()} <= {"t.xyz", "old.ply", "d"}


def test_force_overwrites(here, ball):
    Path("old.ply").write_text("old")
    assert main([touches("t.xyz", sphere(50)), "-o", "old.ply", "--resolution", "32", "--force"]) == 0
    check_closed(read_mesh("old.ply"))


@pytest.mark.parametrize("suffix", ["stl", "glb"])
def test_float32_is_refused_before_the_work(here, ball, capsys, suffix):
    assert main([touches("t.xyz", sphere(50) + 1e6), "-o", f"m.{suffix}"]) == 2
    assert f"t.xyz: {suffix.upper()} holds float32" in one_line(capsys)
    assert not Path(f"m.{suffix}").exists()
    assert main(["t.xyz", "-o", "m.ply", "--resolution", "32"]) == 0


def test_several_files(here, ball, capsys):
    names = [touches(f"{name}.xyz", sphere(60, seed)) for seed, name in enumerate("abc")]
    Path("b.xyz").write_text("broken")
    assert main([*names, "-o", "out/meshes", "--resolution", "32", "--format", "obj"]) == 2
    out, err = capsys.readouterr()
    assert sorted(p.name for p in Path("out/meshes").iterdir()) == ["a.obj", "c.obj"]
    assert "b.xyz: failed\n" in out
    assert "2 of 3 meshes written" in out
    assert err.count("\n") == 1
    assert "touchnet reconstruct: error: b.xyz: no points in this file" in err


def test_json(here, ball, capsys):
    names = [touches("a.xyz", np.vstack([sphere(200), [[40, 0, 0]]])), touches("b.xyz", np.zeros((9, 3)))]
    assert main([*names, "-o", "out", "--resolution", "32", "--json"]) == 2
    summary = json.loads(capsys.readouterr().out)
    assert (summary["written"], summary["failed"]) == (1, 1)
    good, bad = summary["results"]
    assert (good["touches"], good["mesh"], good["error"]) == ("a.xyz", str(Path("out/a.ply")), None)
    assert (good["contacts"], good["outliers"], good["dropped"]) == (200, 1, 0)
    assert "1 of 201 contacts lie far from all others" in good["warnings"][0]
    assert good["volume"] == pytest.approx(4.19, rel=0.05)
    assert bad["mesh"] is None
    assert bad["error"] == "b.xyz: expected at least 4 distinct contacts, got 1"


def test_from_standard_input_to_standard_output(here, ball, capfdbinary, monkeypatch):
    text = "".join(f"{x} {y} {z}\n" for x, y, z in sphere(60))
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    assert main(["-", "-o", "-", "--resolution", "32", "--format", "stl"]) == 0
    out, err = capfdbinary.readouterr()
    Path("m.stl").write_bytes(out)
    check_closed(read_mesh("m.stl"))
    assert err.startswith(b"- -> -: 60 contacts")


def test_an_interrupt_leaves_no_file(here, ball, monkeypatch):
    def interrupted(path, mesh, kind):
        Path(path).write_text("half")
        raise KeyboardInterrupt

    monkeypatch.setattr("touchnet.data.files.write_mesh", interrupted)
    assert main([touches("t.xyz", sphere(50)), "-o", "m.ply", "--resolution", "32"]) == 130
    assert [p.name for p in here.iterdir()] == ["t.xyz"]


def test_a_mesh_that_breaks_the_promise_is_not_written(here, ball, capsys, monkeypatch):
    monkeypatch.setattr("touchnet.reconstruction.reconstruct_mesh", broken_mesh)
    assert main([touches("t.xyz", sphere(50)), "-o", "m.ply"]) == 2
    assert "t.xyz: the mesh is not closed" in one_line(capsys)
    assert not Path("m.ply").exists()


def broken_mesh(points, **options):
    mesh = trimesh.creation.icosphere()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.metadata.update(contacts=50, outliers=0, refitted=False, distance=0.0)
    return mesh


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A small network without training: what it says is noise, but it is the real trip."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_weights(TouchNet("tiny"), path)
    return str(path)


def shell(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-W", "error", "-m", "touchnet", "reconstruct", *arguments],
        capture_output=True,
        timeout=300,
        **options,
    )


def test_in_a_shell(here, weights):
    run = shell(touches("t.xyz", sphere(100)), "-o", "-", "--weights", weights, "--resolution", "24")
    # With warnings as errors, what an untrained network earns (a surface that meets the cube) ends in one line.
    if run.returncode == 2:
        assert run.stderr.count(b"\n") <= 3
        assert b"Traceback" not in run.stderr
    else:
        Path("m.ply").write_bytes(run.stdout)
        check_closed(read_mesh("m.ply"))


def test_in_a_shell_from_the_module(here, weights):
    command = [sys.executable, "-m", "touchnet.reconstruct", touches("t.xyz", sphere(100)), "-o", "m.obj"]
    run = subprocess.run([*command, "--weights", weights, "--resolution", "24"], capture_output=True, timeout=300)
    assert run.returncode == 0, run.stderr
    check_closed(read_mesh("m.obj"))
    assert b"Traceback" not in run.stderr


def test_help_in_a_shell_is_clean():
    run = subprocess.run([sys.executable, "-W", "error", "-m", "touchnet.reconstruct", "--help"], capture_output=True)
    assert (run.returncode, run.stderr) == (0, b"")
    assert b"--resolution" in run.stdout


def test_absent_weights_in_a_shell(here):
    run = shell(touches("t.xyz", sphere(50)), "-o", "m.ply", "--weights", "absent.safetensors")
    assert run.returncode == 2
    assert run.stderr.count(b"\n") == 1
    assert b"no such file absent.safetensors" in run.stderr
