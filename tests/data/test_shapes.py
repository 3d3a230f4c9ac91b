import numpy as np
import pytest

from touchnet.data.dataset import TouchDataset
from touchnet.data.factory import Parameters
from touchnet.data.shapes import CATEGORIES, build_procedural, procedural_mesh, procedural_sources
from touchnet.data.shapes.fields import tube
from touchnet.data.watertight import inspect_mesh

SMALL = Parameters(trajectories=1, touches=16, near=200, box=200, surface=20)


@pytest.mark.parametrize("category", CATEGORIES)
def test_shapes_are_closed_solids_in_one_piece(category):
    for seed in range(12):
        mesh = procedural_mesh(category, seed, resolution=96)
        report = inspect_mesh(mesh)
        assert report.closed, seed
        assert report.simple, seed
        assert 0.0003 < report.volume < (1 if category in ("solid", "part") else 0.6), seed
        assert mesh.body_count == 1, seed
        np.testing.assert_allclose(mesh.bounds.mean(0), 0, atol=1e-9)
        assert mesh.extents.max() == pytest.approx(1)


@pytest.mark.parametrize("category", CATEGORIES)
def test_no_two_are_alike(category):
    signatures = []
    for seed in range(40):
        mesh = procedural_mesh(category, seed, resolution=48)
        signatures.append([*mesh.extents, mesh.volume, mesh.area])
    signatures = np.array(signatures)
    apart = np.linalg.norm(signatures[:, None] - signatures[None], axis=2) + 9 * np.eye(len(signatures))
    assert apart.min() > 1e-3
    assert (np.ptp(signatures, axis=0)[2:] > [0.02, 0.002, 0.1]).all()  # the longest side is 1


def test_shapes_stand_upright():
    for seed in range(6):
        assert procedural_mesh("bottle", seed, resolution=48).extents.argmax() == 1 or seed
        car, airplane = (procedural_mesh(kind, seed, resolution=48).extents for kind in ("car", "airplane"))
        assert car.argmax() == 0
        assert car[1] < 0.7
        assert airplane[1] < 0.6 * airplane.max()


def test_some_bottles_have_an_inside():
    hollow = 0
    for seed in range(40):
        mesh = procedural_mesh("bottle", seed, resolution=64)
        hollow += mesh.volume < 0.5 * mesh.convex_hull.volume
    assert 3 <= hollow <= 30


@pytest.mark.parametrize(("category", "handles"), [("cup", {0}), ("mug", {1}), ("vase", {0, 1, 2})])
@pytest.mark.parametrize("resolution", [48, 96])
def test_vessels_are_open_and_their_walls_whole(category, handles, resolution):
    """A hole in a wall would count as a handle more."""
    hollow = 0
    for seed in range(24):
        mesh = procedural_mesh(category, seed, resolution=resolution)
        assert 1 - mesh.euler_number / 2 in handles, seed
        hollow += mesh.volume < 0.6 * mesh.convex_hull.volume
    assert 8 <= hollow < 24, "filled ones are needed too"


def test_parts_are_drilled_hollow_or_neither():
    meshes = [procedural_mesh("part", seed, resolution=64) for seed in range(40)]
    drilled = sum(mesh.euler_number < 2 for mesh in meshes)
    filled = sum(mesh.volume > 0.85 * mesh.convex_hull.volume for mesh in meshes)
    assert 10 <= drilled <= 30
    assert 8 <= filled <= 30


def test_furniture_is_mostly_air_and_tools_lie_along_x():
    for seed in range(12):
        chair = procedural_mesh("furniture", seed, resolution=64)
        assert chair.volume < 0.8 * chair.convex_hull.volume, seed
        upright = procedural_mesh("tool", seed, resolution=64).extents
        assert upright[2] < 0.8 * upright.max(), seed


def test_tubes_change_their_radius_along_the_way():
    field, low, high = tube([(0, 0, 0), (1, 0, 0), (1, 1, 0)], [0.1, 0.2, 0.4])
    assert (low <= np.float32([-0.1, -0.2, -0.4])).all()
    assert (high >= np.float32([1.4, 1.4, 0.4])).all()
    at = [(0.0, 0.0, 0.1), (0.5, -0.15, 0.0), (1.3, 0.5, 0.0)]
    np.testing.assert_allclose([field(*np.float32(point)) for point in at], [0, 0, 0], atol=1e-6)


def test_same_seed_same_bytes():
    a, b = (procedural_mesh("airplane", 5, resolution=64) for _ in range(2))
    assert a.vertices.tobytes() == b.vertices.tobytes()
    assert a.faces.tobytes() == b.faces.tobytes()


def test_arguments_are_named():
    with pytest.raises(ValueError, match=r"category should be one of airplane, .*, figure, got 'boat'"):
        procedural_mesh("boat", 0)
    with pytest.raises(ValueError, match="resolution should be ≥ 48"):
        procedural_mesh("car", 0, resolution=10)
    with pytest.raises(ValueError, match="shapes should be ≥ 0"):
        procedural_sources(-1)
    with pytest.raises(ValueError, match="shapes should be ≥ 1"):
        build_procedural("nowhere", shapes=0)


def test_every_category_is_split():
    sources = procedural_sources(221)
    assert len({source.id for source in sources}) == 221
    for category in CATEGORIES:
        splits = [source.split for source in sources if source.category == category]
        assert len(splits) in (20, 21)
        assert 2 <= splits.count("val") <= 3
        assert 2 <= splits.count("test") <= 3
    assert {source.id for source in procedural_sources(6, seed=1)}.isdisjoint(source.id for source in sources)
    assert procedural_sources(0) == []


def test_the_set_is_built_once(tmp_path):
    first = build_procedural(tmp_path, shapes=len(CATEGORIES), parameters=SMALL, progress=False)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.safetensors")}
    second = build_procedural(tmp_path, shapes=len(CATEGORIES), parameters=SMALL, progress=False)
    assert [r.id for r in first.records] == [r.id for r in second.records]
    assert {r.category for r in first.records} == set(CATEGORIES)
    assert times == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.safetensors")}
    shape = TouchDataset(tmp_path).shape(0)
    assert shape.metadata["closed_by"] == "closed already"
    assert shape.array("touches").shape == (1, 16, 3)
