import contextlib
import functools
import hashlib
import json
import os
import signal
import subprocess
import sys
import time

import joblib
import numpy as np
import pytest
import trimesh

from touchnet.data import factory
from touchnet.data.dataset import TouchDataset, read_index, verify
from touchnet.data.factory import MeshSource, Parameters, build, shape_id
from touchnet.data.importers import find_meshes

SMALL = Parameters(trajectories=2, touches=24, near=301, box=200, surface=50, resolution=1000)


def box(size, *, drop=0):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation((5, 0, 0))
    return trimesh.Trimesh(mesh.vertices, mesh.faces[drop:], process=False)


def nothing():
    raise ValueError("no faces\nat all")


def source(identity, split="train", size=(2, 1, 1), drop=0):
    return MeshSource(identity, split, functools.partial(box, size, drop=drop), f"{size} {drop}", "test", "CC0")


SOURCES = [
    source("box/long", "train", (4, 1, 1)),
    source("box/flat", "val", (1, 0.1, 1)),
    source("box/open", "test", (2, 0.6, 0.8), drop=1),
    source("cube/one", "train", (3, 3, 3)),
]


def digests(directory):
    files = sorted(path for path in directory.rglob("*") if path.is_file())
    return {path.relative_to(directory).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    directory = tmp_path_factory.mktemp("made")
    build(SOURCES, directory, SMALL, progress=False)
    return directory


def test_shapes_have_the_promised_tensors(made):
    data = TouchDataset(made)
    assert [record.id for record in data.records] == ["box/flat", "box/long", "box/open", "cube/one"]
    assert verify(made) == []
    for i, record in enumerate(data.records):
        shape = data.shape(i)
        assert record.file == f"shapes/{record.id}.safetensors"
        assert shape.array("touches").shape == shape.array("touch_normals").shape == (2, 24, 3)
        assert shape.array("strokes").shape == shape.array("variance").shape == (2, 24)
        assert shape.array("near").shape == (301, 3)
        assert shape.array("near_inside").shape == (38,)
        assert shape.array("box").shape == (200, 3)
        assert shape.array("surface").shape == shape.array("surface_normals").shape == (50, 3)
        mesh = shape.mesh()
        assert mesh.is_watertight
        assert mesh.volume > 0
        np.testing.assert_allclose(mesh.extents.max(), 1, atol=1e-6)
        np.testing.assert_allclose(mesh.bounds.mean(0), 0, atol=1e-6)
        touches = shape.array("touches").reshape(-1, 3)
        assert (trimesh.proximity.closest_point_naive(mesh, touches)[1] < 1e-5).all() or len(mesh.faces) > 100
        said = shape.metadata
        assert said["id"] == record.id
        assert said["category"] == record.category
        assert int(said["near_inside"]) == shape.inside("near").sum()
        assert int(said["box_inside"]) == shape.inside("box").sum()


def test_unit_coordinates_are_undone_by_centre_and_scale(made):
    shape = TouchDataset(made, categories=["cube"]).shape(0)
    said = shape.metadata
    original = shape.mesh().vertices * said["scale"] + said["centre"]
    np.testing.assert_allclose([original.min(0), original.max(0)], [[3.5, -1.5, -1.5], [6.5, 1.5, 1.5]], atol=1e-6)
    assert said["closed_by"] == "closed already"


def test_labels_are_those_of_the_stored_mesh(made):
    shape = TouchDataset(made, "train", categories=["box"]).shape(0)
    for name in ("near", "box"):
        points = shape.array(name).astype(float)
        inside = (np.abs(points) < [0.5, 0.125, 0.125]).all(1)
        boundary = np.isclose(np.abs(points), [0.5, 0.125, 0.125], rtol=0, atol=1e-6).any(1)
        np.testing.assert_array_equal(shape.inside(name)[~boundary], inside[~boundary])


def test_jobs_do_not_change_a_byte(made, tmp_path):
    build(SOURCES[::-1], tmp_path, SMALL, jobs=2, progress=False)
    assert digests(tmp_path) == digests(made)


def test_a_joblib_backend_may_take_over(made, tmp_path):
    with joblib.parallel_config(backend="threading", n_jobs=2):
        build(SOURCES, tmp_path, SMALL, progress=False)
    assert digests(tmp_path) == digests(made)


def noted_box(folder, size, drop):
    """The box, and a file that names the process it was made in."""
    (folder / str(os.getpid())).touch()
    return box(size, drop=drop)


@pytest.mark.slow
def test_dask_gives_the_same_bytes(made, tmp_path):
    distributed = pytest.importorskip("distributed", reason="needs dask and distributed (touchnet[dev])")
    notes = tmp_path / "processes"
    notes.mkdir()
    sources = [
        one._replace(load=functools.partial(noted_box, notes, *one.load.args, **one.load.keywords)) for one in SOURCES
    ]
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
        joblib.parallel_config(backend="dask"),
    ):
        client.upload_file(__file__)  # the workers import `noted_box` from here
        workers = {str(pid) for pid in client.run(os.getpid).values()}
        build(sources, tmp_path / "set", SMALL, progress=False)
    seen = {path.name for path in notes.iterdir()}
    assert seen and seen <= workers and str(os.getpid()) not in seen
    assert digests(tmp_path / "set") == digests(made)


def test_another_seed_gives_other_samples_of_the_same_mesh(made, tmp_path):
    build(SOURCES[:1], tmp_path, SMALL, seed=1, progress=False)
    ours, theirs = TouchDataset(tmp_path).shape(0), TouchDataset(made, "train", categories=["box"]).shape(0)
    np.testing.assert_array_equal(ours.array("vertices"), theirs.array("vertices"))
    for name in ("touches", "near", "box", "surface"):
        assert not np.array_equal(ours.array(name), theirs.array(name))


def test_finished_shapes_are_kept_and_broken_ones_redone(made, tmp_path):
    build(SOURCES, tmp_path, SMALL, progress=False)
    files = {name: tmp_path / f"shapes/{name}.safetensors" for name in ("box/flat", "box/long", "box/open", "cube/one")}
    files["box/flat"].unlink()
    files["box/long"].write_bytes(files["box/long"].read_bytes()[:-7])
    before = {name: path.stat().st_mtime_ns for name, path in files.items() if path.exists()}
    build(SOURCES, tmp_path, SMALL, progress=False)
    assert digests(tmp_path) == digests(made)
    after = {name: path.stat().st_mtime_ns for name, path in files.items()}
    assert [name for name in before if before[name] == after[name]] == ["box/open", "cube/one"]


def test_a_changed_mesh_is_made_again(tmp_path):
    build([source("box/a", size=(1, 1, 1))], tmp_path, SMALL, progress=False)
    build([source("box/a", size=(2, 1, 1))], tmp_path, SMALL, progress=False)
    assert TouchDataset(tmp_path).shape(0).mesh().volume == pytest.approx(0.25)


def test_more_meshes_are_added(made, tmp_path):
    build(SOURCES[:2], tmp_path, SMALL, progress=False)
    build(SOURCES[2:], tmp_path, SMALL, progress=False)
    assert digests(tmp_path) == digests(made)


def test_missing_trajectories_are_added(made, tmp_path):
    without = Parameters(**{**SMALL.as_json(), "sigmas": SMALL.sigmas, "trajectories": 0})
    build(SOURCES, tmp_path, without, progress=False)
    shape = TouchDataset(tmp_path).shape(0)
    assert shape.array("touches").shape == (0, 24, 3)
    assert shape.array("surface").shape == (50, 3)

    reads = []
    watched = [one._replace(load=functools.partial(_watched, one.load, reads)) for one in SOURCES]
    build(watched, tmp_path, SMALL, progress=False)
    assert digests(tmp_path) == digests(made)
    assert reads == []


def test_shapes_that_lack_trajectories_stay_listed(made, tmp_path, monkeypatch):
    fewer = Parameters(**{**SMALL.as_json(), "sigmas": SMALL.sigmas, "trajectories": 1})
    build(SOURCES, tmp_path, fewer, progress=False)
    listed = []
    touch = factory._touch

    def spying(*arguments):
        data = TouchDataset(tmp_path)
        listed.append([len(data.shape(i).array("touches")) for i in range(len(data))])
        assert [line for line in verify(tmp_path) if "checksum" not in line] == []
        return touch(*arguments)

    monkeypatch.setattr(factory, "_touch", spying)
    build(SOURCES, tmp_path, SMALL, progress=False)
    assert [sorted(counts) for counts in listed] == [[1, 1, 1, 1], [1, 1, 1, 2], [1, 1, 2, 2], [1, 2, 2, 2]]
    assert digests(tmp_path) == digests(made)


def _watched(load, reads):
    reads.append(load)
    return load()


def test_other_parameters_need_overwrite(tmp_path):
    build(SOURCES[:1], tmp_path, SMALL, progress=False)
    other = Parameters(**{**SMALL.as_json(), "sigmas": (0.02,), "near": 100})
    with pytest.raises(ValueError, match=r"made with near 301, not 100; sigmas \[0.01, 0.05\], not \[0.02\]"):
        build(SOURCES[:1], tmp_path, other, progress=False)
    with pytest.raises(ValueError, match="made with seed 0, not 3"):
        build(SOURCES[:1], tmp_path, SMALL, seed=3, progress=False)
    build(SOURCES[1:2], tmp_path, other, overwrite=True, progress=False)
    assert read_index(tmp_path).parameters["near"] == 100
    assert [record.id for record in TouchDataset(tmp_path).records] == ["box/flat"]
    assert verify(tmp_path) == []  # no file of the set that was replaced stays behind


@pytest.mark.parametrize("jobs", [1, 2])
def test_failures_are_listed_by_name_and_skipped(tmp_path, jobs):
    bad = MeshSource("box/bad", "train", nothing, "0")
    flat = MeshSource("box/point", "val", functools.partial(box, (0, 0, 0)), "0")
    data = build([SOURCES[0], bad, flat], tmp_path, SMALL, jobs=jobs, progress=False)
    assert [record.id for record in data.records] == ["box/long"]
    assert [failure["id"] for failure in data.failures] == ["box/bad", "box/point"]
    assert data.failures[0]["reason"] == "no faces at all"
    assert "extent" in data.failures[1]["reason"]
    assert verify(tmp_path) == []


def test_sources_are_checked_first(tmp_path):
    with pytest.raises(ValueError, match="two shapes would be called box/long and box/Long"):
        build([SOURCES[0], SOURCES[0]._replace(id="box/Long")], tmp_path, SMALL)
    with pytest.raises(ValueError, match="box/long: split should be one of train, val, test, got 'dev'"):
        build([SOURCES[0]._replace(split="dev")], tmp_path, SMALL)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"near": -1}, "near should be ≥ 0, got -1"),
        ({"touches": 0}, "touches should be between 1 and 32767, got 0"),
        ({"sigmas": ()}, "sigmas should be positive"),
        ({"offset": 0.5}, "offset should be between 0 and 0.1"),
        ({"resolution": 3}, "resolution should be ≥ 100"),
    ],
)
def test_parameters_are_checked(change, words):
    with pytest.raises(ValueError, match=words):
        Parameters(**change)


def test_ids_are_safe_file_names():
    assert shape_id("trash bin", "a:b*c?ü.v1") == "trash-bin/a-b-c-.v1"
    assert shape_id("can", "../../etc") == "can/etc"
    with pytest.raises(ValueError, match="category and a name"):
        shape_id("can", "???")


@pytest.mark.slow
def test_killed_at_any_moment_it_goes_on(tmp_path):
    meshes = tmp_path / "meshes" / "box"
    meshes.mkdir(parents=True)
    for i in range(5):
        box((1 + i, 1, 1)).export(meshes / f"{i}.ply")
    options = "--trajectories 1 --touches 256 --near 2000 --box 1000 --surface 100".split()

    def command(output):
        return [sys.executable, "-m", "touchnet.simulate", str(meshes), "-o", str(output), *options, "--jobs", "2"]

    whole, cut = tmp_path / "whole", tmp_path / "cut"
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    run = subprocess.run(command(whole), capture_output=True, text=True, timeout=300, env=environment)
    assert run.returncode == 0, run.stderr

    for awaited in ("dataset.json", "shapes/*/*", "shapes/*/[!.]*"):  # an index, a half-written shape, a finished one
        process = subprocess.Popen(
            command(cut), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True, env=environment
        )
        end = time.monotonic() + 200
        before = len(list(cut.glob(awaited)))
        while process.poll() is None and len(list(cut.glob(awaited))) == before and time.monotonic() < end:
            time.sleep(0.002)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    (cut / "shapes" / "box" / ".1.abcd.part.safetensors").write_bytes(b"half")
    (cut / ".dataset.abcd.part.json").write_bytes(b"half")

    run = subprocess.run(command(cut), capture_output=True, text=True, timeout=300, env=environment)
    assert run.returncode == 0, run.stderr
    assert digests(cut) == digests(whole)
    assert json.loads((cut / "dataset.json").read_text())["failures"] == []


def test_real_meshes_of_every_category(shared_data, tmp_path):
    found = find_meshes([shared_data / "data" / "meshes"])
    assert len(found) == 416
    assert sum(one.split == "train" for one in found) > 200
    names = ["mug/market__cup-tea", "airplane/crrcsim__apogee", "vase/sh3d-scopia__vase3"]
    chosen = [one for one in found if one.id in names]
    assert [one.licence for one in chosen if one.category == "airplane"] == ["GPL-2"]
    data = build(chosen, tmp_path, Parameters(1, 64, 2000, 2000, 100, resolution=5000), progress=False)
    assert len(data) == 3
    assert all(data.shape(i).metadata["simple"] == "true" for i in range(3))
    vase = next(data.shape(i) for i in range(3) if data.records[i].category == "vase")
    assert vase.metadata["closed_by"].startswith("closing")
    assert vase.inside("box").mean() > 0.2
