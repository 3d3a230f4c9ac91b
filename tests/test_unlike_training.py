import sys

import pytest
import trimesh

from benchmarks import unlike_training


def test_each_body_is_written_once(tmp_path, monkeypatch, capsys):
    source, output = tmp_path / "pybullet_data", tmp_path / "meshes"

    def write(name, extents):
        path = source / name
        path.parent.mkdir(parents=True, exist_ok=True)
        trimesh.creation.box(extents).export(path)

    write("a1/meshes/hip.stl", (1, 2, 3))
    write("a1/meshes/hip_mirror.stl", (1, 2, 3.5))  # by its name the same
    write("laikago/chassis.obj", (2, 4, 6))  # the same but for its size
    write("laikago/chassis_vhacd.obj", (1, 5, 9))
    write("laikago/leg.obj", (1, 1, 9))
    write("laikago/leg.stl", (1, 1, 8))  # the same in another format
    write("stone.obj", (1, 2, 3))  # of another kind
    for n in range(30):
        write(f"random_urdfs/{n:03}/{n:03}.obj", (1, 1, 2 + n))
    monkeypatch.setattr(unlike_training, "TOYS", ("stone.obj",))
    monkeypatch.setattr(sys, "argv", ["unlike_training", str(source), str(output)])
    unlike_training.main()
    written = sorted(str(path.relative_to(output)) for path in output.rglob("*.*"))
    assert written == [
        "random/random_urdfs_000_000.ply",
        "random/random_urdfs_025_025.ply",
        "robot/a1_meshes_hip.ply",
        "robot/laikago_leg.ply",
        "toy/stone.ply",
    ]
    assert "5 meshes" in capsys.readouterr().out

    monkeypatch.setattr(sys, "argv", ["unlike_training", str(tmp_path), str(output)])
    with pytest.raises(SystemExit):
        unlike_training.main()
    assert "should hold random_urdfs" in capsys.readouterr().err
