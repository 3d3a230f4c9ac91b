import json

import numpy as np
import pytest
import trimesh

from touchnet.data.factory import Parameters, build
from touchnet.data.files import read_points
from touchnet.data.importers import find_meshes, load_mesh, shapenet_touch_items

BOX = trimesh.creation.box((1, 2, 1))

# A ShapeNet OBJ as they are: a missing material library, two groups, a face with repeated corners, a line, quads.
BROKEN_OBJ = """\
mtllib ../../missing.mtl
g body
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
vt 0 0
vn 0 0 1
usemtl red
f 4/1/1 3/1/1 2/1/1 1/1/1
f 5//1 6//1 7//1 8//1
l 1 2
g lid
usemtl none
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
f 1 1 1
"""


def put(path, mesh=BOX):
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)


def test_shapenet_v1_and_v2(tmp_path):
    v1, v2 = tmp_path / "v1", tmp_path / "v2"
    (v1 / "02691156" / "10155655850468db").mkdir(parents=True)
    (v1 / "02691156" / "10155655850468db" / "model.obj").write_text(BROKEN_OBJ)
    (v1 / "02691156" / "empty").mkdir()
    (v1 / "taxonomy.json").write_text("[]")
    put(v2 / "02876657" / "a1" / "models" / "model_normalized.obj")
    put(v2 / "02958343" / "b2" / "models" / "model_normalized.obj")
    put(v2 / "02958343" / "b2" / "models" / "model_normalized.solid.obj")
    (first,) = find_meshes([v1])
    assert first.id == "airplane/10155655850468db"
    assert first.source == "ShapeNetCore"
    assert [one.id for one in find_meshes([v2])] == ["bottle/a1", "car/b2"]
    assert first.load().extents == pytest.approx([1, 1, 1])
    data = build([first], tmp_path / "set", Parameters(1, 16, 50, 50, 20, resolution=1000), progress=False)
    assert data.failures == []
    assert data.shape(0).mesh().volume == pytest.approx(1, abs=0.03)


def test_modelnet(tmp_path):
    for name, split in (("chair_0001", "train"), ("chair_0002", "train"), ("chair_0890", "test")):
        put(tmp_path / "chair" / split / f"{name}.off")
    # Some ModelNet files have the counts on the first line.
    glued = (tmp_path / "chair" / "train" / "chair_0001.off").read_text().replace("OFF\n", "OFF", 1)
    (tmp_path / "chair" / "train" / "chair_0001.off").write_text(glued)
    found = find_meshes([tmp_path], shares=(0.0, 0.5))
    assert [(one.id, one.split) for one in found] == [
        ("chair/chair_0001", "train"),
        ("chair/chair_0002", "train"),
        ("chair/chair_0890", "test"),
    ]
    assert all(one.load().volume == pytest.approx(2) for one in found)
    assert {one.split for one in find_meshes([tmp_path], shares=(1.0, 0.0))} == {"val", "test"}


def pcd(points):
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA ascii\n"
    )
    return header + "\n".join(" ".join(f"{x:.6f}" for x in point) for point in points) + "\n"


@pytest.mark.parametrize("above", [False, True])
def test_the_papers_layout(tmp_path, above):
    lists = [
        {"taxonomy_id": "02876657", "taxonomy_name": "bottle", "train": ["a", "b"], "test": ["c"], "val": ["d"]},
        {"taxonomy_id": "02691156", "taxonomy_name": "airplane", "train": ["e"], "test": [], "val": []},
    ]
    (tmp_path / "ShapeNetTouch.json").write_text(json.dumps(lists))
    touches = np.random.default_rng(0).random((2048, 3))
    for synset, split, model in (
        ("02876657", "train", "a"),
        ("02876657", "test", "c"),
        ("02876657", "val", "d"),
        ("02691156", "train", "e"),
    ):
        level = [split] if above else []
        put(tmp_path.joinpath("complete", *level, synset, model, "model.obj" if model == "c" else f"{model}.obj"))
        for k in range(4):
            path = tmp_path.joinpath("partial", *level, synset, model, f"path2048_{k:02d}.pcd")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(pcd(touches))
    found = find_meshes([tmp_path])
    assert [(one.id, one.split, one.source) for one in found] == [
        ("bottle/a", "train", "ShapeNetTouch"),
        ("bottle/d", "val", "ShapeNetTouch"),
        ("bottle/c", "test", "ShapeNetTouch"),
        ("airplane/e", "train", "ShapeNetTouch"),
    ]
    items = {model: partial for _, _, model, _, partial in shapenet_touch_items(tmp_path)}
    assert [path.name for path in items["a"]] == [f"path2048_{k:02d}.pcd" for k in range(4)]
    assert items["b"] == []  # listed, but not there
    np.testing.assert_allclose(read_points(items["a"][0]).points, touches, atol=1e-6)


def test_the_papers_list_is_checked(tmp_path):
    (tmp_path / "ShapeNetTouch.json").write_text('{"train": []}')
    with pytest.raises(ValueError, match=r"ShapeNetTouch\.json: not a list of categories"):
        find_meshes([tmp_path])


def test_index(tmp_path):
    put(tmp_path / "can" / "soda.ply")
    put(tmp_path / "can" / "beans.ply")
    (tmp_path / "INDEX.csv").write_text(
        "category,split,file,source,licence\ncan,test,can/soda.ply,me,CC0\ncan,,can/beans.ply,,\n"
    )
    soda, beans = find_meshes([tmp_path], shares=(0, 0))
    assert (soda.id, soda.split, soda.source, soda.licence) == ("can/soda", "test", "me", "CC0")
    assert (beans.split, beans.source, beans.licence) == ("train", "unknown", "unknown")
    (tmp_path / "INDEX.csv").write_text("category,split,file\ncan,test,can/none.ply\n")
    with pytest.raises(FileNotFoundError, match=r"line 2: can/none\.ply is missing"):
        find_meshes([tmp_path])
    (tmp_path / "INDEX.csv").write_text("category,split,file\ncan,dev,can/soda.ply\n")
    with pytest.raises(ValueError, match="split 'dev' is not known"):
        find_meshes([tmp_path])
    (tmp_path / "INDEX.csv").write_text("split,file\n")
    with pytest.raises(ValueError, match="no column category"):
        find_meshes([tmp_path])


def test_plain_files_and_folders(tmp_path):
    put(tmp_path / "things" / "can" / "a.ply")
    put(tmp_path / "things" / "can" / "deep" / "b.stl")
    put(tmp_path / "things" / "c.obj")
    (tmp_path / "things" / "notes.txt").write_text("no mesh")
    assert sorted(one.id for one in find_meshes([tmp_path / "things"])) == ["can/a", "can/deep-b", "things/c"]
    (one,) = find_meshes([tmp_path / "things" / "can" / "a.ply"])
    assert one.id == "can/a"


def test_hashed_splits_have_about_the_right_shares(tmp_path):
    for i in range(200):
        (tmp_path / f"{i}.ply").write_bytes(b"")
    found = find_meshes([tmp_path], shares=(0.2, 0.3))
    counts = {split: sum(one.split == split for one in found) for split in ("train", "val", "test")}
    assert counts["val"] == pytest.approx(40, abs=18)
    assert counts["test"] == pytest.approx(60, abs=20)
    assert [one.split for one in find_meshes([tmp_path], shares=(0.2, 0.3))] == [one.split for one in found]


def test_what_cannot_be_found_is_said(tmp_path):
    with pytest.raises(FileNotFoundError, match="none: no such file or folder"):
        find_meshes([tmp_path / "none"])
    with pytest.raises(ValueError, match="no meshes found"):
        find_meshes([tmp_path])
    put(tmp_path / "a.ply")
    with pytest.raises(ValueError, match="no meshes found in the layout modelnet"):
        find_meshes([tmp_path], layout="modelnet")
    with pytest.raises(ValueError, match="layout should be one of"):
        find_meshes([tmp_path], layout="scannet")
    with pytest.raises(ValueError, match="shares of val and test"):
        find_meshes([tmp_path], shares=(0.7, 0.7))


def test_scenes_are_joined(tmp_path):
    other = BOX.copy()
    other.apply_translation((3, 0, 0))
    trimesh.Scene([BOX, other]).export(tmp_path / "two.glb")
    mesh = load_mesh(tmp_path / "two.glb")
    assert mesh.volume == pytest.approx(4)
    assert mesh.extents == pytest.approx([4, 2, 1])


def test_unreadable_files_name_themselves(tmp_path):
    for name in ("a.ply", "a.obj", "a.3mf", "a.vtk"):
        (tmp_path / name).write_bytes(b"this is no mesh\n")
        with pytest.raises(ValueError, match=name.replace(".", r"\.")):
            load_mesh(tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"missing\.3mf"):
        load_mesh(tmp_path / "missing.3mf")
