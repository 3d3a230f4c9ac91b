"""Files from elsewhere: they stay in their folder, nothing in them is run, and nothing opens a network connection."""

import json
import subprocess
import sys
import textwrap

import numpy as np
import pytest
import trimesh

from touchnet.data import find_meshes
from touchnet.data.dataset import Index, ShapeRecord, read_index, write_index

ESCAPES = ["../secret.safetensors", "/etc/passwd", "shapes/../../a", "C:\\a", "\\\\host\\a", "..\\a"]


@pytest.mark.parametrize("file", ESCAPES)
def test_a_data_set_cannot_name_files_outside_of_it(tmp_path, file):
    write_index(tmp_path, Index(0, {}, [ShapeRecord("can/a", "can", "train", "x", "CC0", "shapes/a", "0")], []))
    said = json.loads((tmp_path / "dataset.json").read_text())
    said["shapes"][0]["file"] = file
    (tmp_path / "dataset.json").write_text(json.dumps(said))
    with pytest.raises(ValueError, match="the file of can/a should lie in the data set, got"):
        read_index(tmp_path)


def test_an_index_of_meshes_cannot_name_files_outside_of_it(tmp_path):
    trimesh.creation.box().export(tmp_path / "secret.ply")
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "INDEX.csv").write_text("category,split,file\ncan,test,../secret.ply\n")
    with pytest.raises(ValueError, match=r"INDEX\.csv, line 2: '\.\./secret\.ply' leaves the folder"):
        find_meshes([tmp_path / "set"])


@pytest.mark.slow
def test_no_command_opens_a_connection(tmp_path):
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.ply")
    rng = np.random.default_rng(0).normal(size=(64, 3))
    np.savetxt(tmp_path / "touches.xyz", rng / np.linalg.norm(rng, axis=1, keepdims=True))
    # An audit hook cannot be taken away again, so this has a process of its own.
    script = """
        import sys
        seen = []

        def hook(event, arguments):
            if event in ("socket.connect", "socket.bind", "socket.getaddrinfo", "socket.sendto"):
                address = arguments[1] if event != "socket.getaddrinfo" else arguments[:2]
                if not isinstance(address, (str, bytes)):  # those are sockets of this machine's file system
                    seen.append((event, address))

        sys.addaudithook(hook)
        from touchnet.__main__ import main

        small = ["--device", "cpu"]
        sample = ["--samples.queries", "64", "--samples.min-contacts", "32", "--samples.max-contacts", "32"]
        for command in (
            ["reconstruct", "touches.xyz", "-o", "mesh.ply", "--resolution", "16", *small],
            ["explore", "touches.xyz", "-k", "2", "--resolution", "16", *small],
            ["view", "touches.xyz", "--save", "page.html", "--resolution", "16", "--steps", "1", *small],
            ["simulate", "ball.ply", "-o", "data", "--shares", "0", "0", "--touches", "32", "--trajectories", "1",
             "--near", "256", "--box", "256", "--surface", "256"],
            ["train", "--data", "data", "-o", "run", "--model", "tiny", "--steps", "1", "--workers", "0",
             *sample, *small],
            ["evaluate", "data", "--weights", "run/weights.safetensors", "--split", "train", "-o", "report",
             "--contacts", "32", "--resolution", "16", "--samples", "100", "--gallery", "0", *small],
        ):
            assert main(command) == 0, command
        assert seen == [], seen
        print("all ran")
    """
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], cwd=tmp_path, capture_output=True, text=True, timeout=600
    )
    assert run.stdout.endswith("all ran\n"), run.stderr[-2000:]
