import hashlib
import json
import re

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file

from touchnet.data.dataset import (
    TENSORS,
    Index,
    ShapeFile,
    ShapeRecord,
    TouchDataset,
    read_index,
    verify,
    write_index,
    write_shape,
)

METADATA = {
    "id": "can/a",
    "category": "can",
    "centre": "[1.0, 2.0, 3.5]",
    "scale": "0.25",
    "closed_by": "manifold 20000",
}


def tensors(trajectories=2, touches=5, near=13, box=8):
    rng = np.random.default_rng(0)
    return {
        "vertices": np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        "faces": np.int32([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
        "touches": rng.random((trajectories, touches, 3), dtype=np.float32),
        "touch_normals": rng.random((trajectories, touches, 3)).astype(np.float16),
        "strokes": np.arange(trajectories * touches, dtype=np.int16).reshape(trajectories, touches),
        "variance": rng.random((trajectories, touches), dtype=np.float32),
        "near": rng.random((near, 3)).astype(np.float16),
        "near_inside": np.packbits(np.arange(near) % 3 == 0),
        "box": rng.random((box, 3)).astype(np.float16),
        "box_inside": np.packbits(np.arange(box) % 2 == 0),
        "surface": rng.random((7, 3), dtype=np.float32),
        "surface_normals": rng.random((7, 3)).astype(np.float16),
    }


def record(identity, split="train", licence="MIT", checksum="0"):
    category = identity.split("/")[0]
    return ShapeRecord(identity, category, split, "test", licence, f"shapes/{identity}.safetensors", checksum)


@pytest.fixture
def small_set(tmp_path):
    records = []
    for identity, split, licence in (
        ("can/a", "train", "MIT"),
        ("can/b", "val", "GPL-2"),
        ("mug/c", "train", "GPL-3.0"),
        ("mug/d", "test", "CC0"),
    ):
        metadata = {**METADATA, "id": identity, "category": identity[:3]}
        checksum = write_shape(tmp_path / f"shapes/{identity}.safetensors", tensors(), metadata)
        records.append(record(identity, split, licence, checksum))
    write_index(tmp_path, Index(7, {"sigmas": [0.01]}, records[::-1], [{"id": "can/x", "reason": "no faces"}]))
    return tmp_path


def test_every_tensor_comes_back(tmp_path):
    written = tensors()
    write_shape(tmp_path / "a.safetensors", written, METADATA)
    shape = ShapeFile(tmp_path / "a.safetensors")
    assert set(shape.names) == set(TENSORS) == set(written)
    for name, array in written.items():
        found = shape.array(name)
        assert found.dtype == array.dtype
        np.testing.assert_array_equal(found, array)
        assert shape.shape(name) == array.shape


def test_the_safetensors_library_agrees(tmp_path):
    write_shape(tmp_path / "a.safetensors", tensors(), METADATA)
    for name, array in load_file(tmp_path / "a.safetensors").items():
        np.testing.assert_array_equal(array, tensors()[name])
    with safe_open(tmp_path / "a.safetensors", framework="numpy") as file:
        assert file.metadata() == METADATA


def test_same_contents_same_bytes_and_aligned(tmp_path):
    first = write_shape(tmp_path / "a.safetensors", tensors(), METADATA)
    second = write_shape(
        tmp_path / "b.safetensors", dict(reversed(tensors().items())), dict(reversed(METADATA.items()))
    )
    data = (tmp_path / "a.safetensors").read_bytes()
    assert data == (tmp_path / "b.safetensors").read_bytes()
    assert first == second == hashlib.sha256(data).hexdigest()
    size = int.from_bytes(data[:8], "little")
    assert size % 8 == 0
    for name, entry in json.loads(data[8 : 8 + size]).items():
        if name != "__metadata__":
            assert entry["data_offsets"][0] % tensors()[name].itemsize == 0
    assert [path.name for path in tmp_path.iterdir()] == ["a.safetensors", "b.safetensors"] or len(
        list(tmp_path.iterdir())
    ) == 2


def test_rows_clip_like_slices(tmp_path):
    write_shape(tmp_path / "a.safetensors", tensors(), METADATA)
    shape = ShapeFile(tmp_path / "a.safetensors")
    near = tensors()["near"]
    for start, stop in ((0, 3), (5, 13), (10, 99), (13, 20), (4, 4), (9, 2)):
        found = shape.rows("near", start, stop)
        np.testing.assert_array_equal(found, near[start:stop])
        assert found.dtype == np.float16
        assert found.shape[1:] == (3,)


def test_labels_have_the_length_of_the_points(tmp_path):
    write_shape(tmp_path / "a.safetensors", tensors(near=13), METADATA)
    shape = ShapeFile(tmp_path / "a.safetensors")
    np.testing.assert_array_equal(shape.inside("near"), np.arange(13) % 3 == 0)
    np.testing.assert_array_equal(shape.inside("box"), np.arange(8) % 2 == 0)
    with pytest.raises(ValueError, match="no tensor 'surface_inside'"):
        shape.inside("surface")


def test_metadata_and_mesh(tmp_path):
    write_shape(tmp_path / "a.safetensors", tensors(), METADATA)
    shape = ShapeFile(tmp_path / "a.safetensors")
    assert shape.metadata["id"] == "can/a"
    assert shape.metadata["scale"] == 0.25
    np.testing.assert_array_equal(shape.metadata["centre"], [1, 2, 3.5])
    mesh = shape.mesh()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(1 / 6)


@pytest.mark.parametrize("trajectories", [0, 1])
def test_few_trajectories(tmp_path, trajectories):
    write_shape(tmp_path / "a.safetensors", tensors(trajectories=trajectories), METADATA)
    assert ShapeFile(tmp_path / "a.safetensors").array("touches").shape == (trajectories, 5, 3)


def test_wrong_tensors_are_named(tmp_path):
    wrong = tensors()
    del wrong["near"]
    with pytest.raises(ValueError, match="missing or unknown: near"):
        write_shape(tmp_path / "a.safetensors", wrong, METADATA)
    with pytest.raises(ValueError, match=r"near should be F16 .*, got float32"):
        write_shape(tmp_path / "a.safetensors", {**tensors(), "near": np.zeros((3, 3), np.float32)}, METADATA)
    with pytest.raises(ValueError, match=re.escape("got float16 (3, 2)")):
        write_shape(tmp_path / "a.safetensors", {**tensors(), "near": np.zeros((3, 2), np.float16)}, METADATA)
    assert not list(tmp_path.iterdir())


def test_unknown_tensor_and_broken_file_are_one_line(tmp_path):
    write_shape(tmp_path / "a.safetensors", tensors(), METADATA)
    with pytest.raises(ValueError, match=r"a\.safetensors: no tensor 'nearby', there are"):
        ShapeFile(tmp_path / "a.safetensors").array("nearby")
    data = (tmp_path / "a.safetensors").read_bytes()
    (tmp_path / "a.safetensors").write_bytes(data[:-5])
    with pytest.raises(ValueError, match="not a shape file"):
        ShapeFile(tmp_path / "a.safetensors").array("near")
    with pytest.raises(FileNotFoundError):
        ShapeFile(tmp_path / "b.safetensors").array("near")


def test_dataset_filters(small_set):
    assert [r.id for r in TouchDataset(small_set).records] == ["can/a", "can/b", "mug/c", "mug/d"]
    assert [r.id for r in TouchDataset(small_set, "train").records] == ["can/a", "mug/c"]
    assert [r.id for r in TouchDataset(small_set, categories=["mug"]).records] == ["mug/c", "mug/d"]
    assert [r.id for r in TouchDataset(small_set, exclude_licences=["GPL"]).records] == ["can/a", "mug/d"]
    assert len(TouchDataset(small_set, "val", categories=["mug"])) == 0
    data = TouchDataset(small_set, "test")
    assert len(data) == 1
    assert data.categories == ["mug"]
    assert data.seed == 7
    assert data.parameters == {"sigmas": [0.01]}
    assert data.failures == [{"id": "can/x", "reason": "no faces"}]
    assert data.shape(0).metadata["id"] == "mug/d"


def test_dataset_refuses_what_it_does_not_know(small_set):
    with pytest.raises(ValueError, match="split should be one of train, val, test, got 'dev'"):
        TouchDataset(small_set, "dev")
    with pytest.raises(ValueError, match="categories should be out of can, mug, got pot"):
        TouchDataset(small_set, categories=["can", "pot"])
    with pytest.raises(FileNotFoundError, match="is not a data set"):
        TouchDataset(small_set / "shapes")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda said: said.update(version=2), "version should be 1, got 2"),
        (lambda said: said.update(format="other"), "format should be 'touchnet-dataset'"),
        (lambda said: said["shapes"][0].pop("licence"), "an entry is missing or unknown"),
        (lambda said: said.pop("seed"), "an entry is missing or unknown"),
    ],
)
def test_other_indices_are_refused(small_set, change, words):
    said = json.loads((small_set / "dataset.json").read_text())
    change(said)
    (small_set / "dataset.json").write_text(json.dumps(said))
    with pytest.raises(ValueError, match=words):
        read_index(small_set)
    (small_set / "dataset.json").write_text("{")
    with pytest.raises(ValueError, match="not JSON"):
        read_index(small_set)


def test_index_is_sorted_and_counted(small_set):
    said = json.loads((small_set / "dataset.json").read_text())
    assert [shape["id"] for shape in said["shapes"]] == ["can/a", "can/b", "mug/c", "mug/d"]
    assert said["counts"] == {"can": {"train": 1, "val": 1, "test": 0}, "mug": {"train": 1, "val": 0, "test": 1}}
    assert list(said) == ["format", "version", "seed", "parameters", "shapes", "failures", "counts"]


def test_verify_finds_every_kind_of_damage(small_set):
    assert verify(small_set) == []
    broken = small_set / "shapes/can/a.safetensors"
    data = bytearray(broken.read_bytes())
    data[-1] ^= 1
    broken.write_bytes(data)
    (small_set / "shapes/can/b.safetensors").unlink()
    (small_set / "shapes/mug/z.safetensors").write_bytes(b"")
    index = read_index(small_set)
    write_index(small_set, index._replace(shapes=[*index.shapes, index.shapes[-1]]))
    assert verify(small_set) == [
        "can/a: shapes/can/a.safetensors does not match its checksum",
        "can/b: shapes/can/b.safetensors is missing",
        "mug/d: listed more than once",
        "shapes/mug/z.safetensors: not in dataset.json",
    ]
