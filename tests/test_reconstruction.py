import warnings

import numpy as np
import pytest
import torch
import trimesh
from scipy.interpolate import RegularGridInterpolator

from touchnet.data.files import read_mesh, read_points, write_mesh
from touchnet.frames import Frame
from touchnet.meshes import check_closed
from touchnet.models import TouchNet
from touchnet.reconstruction import reconstruct_field, reconstruct_mesh


class Ball(torch.nn.Module):
    """Stands in for a trained network: the ball around the mean of the contacts, cut off above `top`."""

    def __init__(self, inflate=1.0, top=9.0):
        super().__init__()
        self.inflate, self.top = inflate, top
        self.encoded = []

    def encode(self, touches, normals=None):
        self.encoded.append((touches, normals))
        centre = touches[0].double().mean(dim=0)
        return centre, (touches[0].double() - centre).norm(dim=1).mean() * self.inflate

    def decode(self, features, queries):
        centre, radius = features
        away = radius - (queries.double() - centre).norm(dim=2)
        return torch.sigmoid(20 * torch.minimum(away, self.top * radius + centre[1] - queries[..., 1]))


def sphere(count, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def ball_field(frame, centre, radius):
    centre = torch.from_numpy(frame.to_cube(np.asarray(centre, dtype=np.float64)))
    return lambda queries: 0.5 + radius / frame.scale - (queries - centre).norm(dim=1)


@pytest.fixture(autouse=True)
def quiet_means_quiet():
    """A warning that a test does not expect is a failure."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


# a field.


def test_f17_comes_back_in_millimetres(shared_data):
    points = read_points(shared_data / "cases" / "F17_millimetres_offset.xyz").points
    centre = np.array([61, -22.5, 403.25])
    frame = Frame.fit(points)
    mesh = reconstruct_field(ball_field(frame, centre, 48.0), frame, resolution=64, seeds=points)
    check_closed(mesh)
    cell = mesh.metadata["cell"]
    assert cell == pytest.approx(2 / 64 * frame.scale)
    assert np.abs(mesh.bounds - [centre - 48, centre + 48]).max() < cell
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 48**3, rel=0.01)
    # No ground truth went in (D10): the frame is that of the contacts.
    model_mesh = reconstruct_mesh(points, weights=Ball(), resolution=64)
    assert np.abs(model_mesh.bounds - [centre - 48, centre + 48]).max() < 4 * cell


@pytest.mark.parametrize("resolution", [33, 50, 64, 65, 100])
def test_i13_any_resolution_keeps_volume_and_place(resolution):
    frame = Frame(np.array([5.0, -3.0, 1.0]), 2.0)
    mesh = reconstruct_field(ball_field(frame, frame.centre, 0.6 * frame.scale), frame, resolution=resolution)
    check_closed(mesh)
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * (0.6 * frame.scale) ** 3, rel=0.01)
    assert np.abs(mesh.center_mass - frame.centre).max() < 0.5 * mesh.metadata["cell"]


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb"])
def test_i17_written_meshes_are_closed_and_wound_outwards(tmp_path, suffix):
    frame = Frame(np.array([61, -22.5, 403.25]), 48.0)
    mesh = reconstruct_field(ball_field(frame, frame.centre, 40.0), frame, resolution=64)
    write_mesh(tmp_path / f"ball.{suffix}", mesh)
    for again in (read_mesh(tmp_path / f"ball.{suffix}"), trimesh.load(tmp_path / f"ball.{suffix}", force="mesh")):
        check_closed(again)
        assert again.volume == pytest.approx(mesh.volume, rel=1e-5)


def field_of(path):
    """The values of a case, trilinearly interpolated over the cube."""
    volume = np.load(path).astype(np.float64)
    axes = [np.linspace(-1, 1, n) for n in volume.shape]
    values = RegularGridInterpolator(axes, volume)
    return lambda queries: torch.from_numpy(values(queries.numpy())), [n - 1 for n in volume.shape]


UNIT = Frame(np.zeros(3), 1.0)


def test_i03_all_outside(shared_data):
    field, cells = field_of(shared_data / "cases" / "I03_all_outside.npy")
    with pytest.raises(ValueError, match=r"no surface.*level 0\.5.*minimum 0\.02, maximum 0\.02"):
        reconstruct_field(field, UNIT, resolution=cells)


@pytest.mark.parametrize("factor", [1, 4])
def test_i05_solid_that_meets_the_border(shared_data, factor):
    field, cells = field_of(shared_data / "cases" / "I05_solid_touches_boundary.npy")
    mesh = reconstruct_field(field, UNIT, resolution=[factor * n for n in cells])
    check_closed(mesh)
    assert mesh.metadata["meets_border"]


def test_i01_plateau_at_the_level(shared_data):
    field, cells = field_of(shared_data / "cases" / "I01_plateau_at_level_0.5.npy")
    mesh = reconstruct_field(field, UNIT, resolution=cells)
    check_closed(mesh)
    assert mesh.euler_number == 2


def test_i07_nan_in_the_field(shared_data):
    field, cells = field_of(shared_data / "cases" / "I07_one_nan_inside_level_0.npy")
    with pytest.raises(ValueError, match="NaN"):
        reconstruct_field(field, UNIT, resolution=cells, level=0.0, seeds=np.zeros((1, 3)))


def test_a_part_between_the_coarse_points_is_found_by_its_touches():
    small = np.array([0.34375, 0.03125, 0.03125])
    touches = small + 0.02 * sphere(20)

    def field(queries):
        body = 0.25 - (queries - torch.tensor([-0.1, 0, 0])).norm(dim=1)
        return 0.5 + torch.maximum(body, 0.02 - (queries - torch.from_numpy(small)).norm(dim=1))

    mesh = reconstruct_field(field, UNIT, resolution=128, seeds=touches)
    assert len(mesh.split(only_watertight=True)) == 2


@pytest.mark.parametrize("offset", [1e3, 1e6])
def test_far_from_the_origin(offset):
    points = sphere(200) + np.array([0, offset, -offset])
    mesh = reconstruct_mesh(points, weights=Ball(), resolution=64)
    check_closed(mesh)
    assert np.abs(mesh.bounds.mean(axis=0) - [0, offset, -offset]).max() < 0.1


def test_too_far_from_the_origin_for_float64():
    frame = Frame(np.array([1e12, 0, 0]), 1.0)
    with pytest.raises(
        ValueError, match=r"float64 steps of 0\.000122 at the coordinate 1e\+12 are too coarse for cells"
    ):
        reconstruct_field(ball_field(frame, frame.centre, 0.5), frame, resolution=64)


@pytest.mark.parametrize(("options", "message"), [({"up": "w"}, "up should be"), ({"resolution": 0}, "at least 1")])
def test_field_errors(options, message):
    with pytest.raises(ValueError, match=message):
        reconstruct_field(ball_field(UNIT, np.zeros(3), 0.5), UNIT, **options)


# contacts.


@pytest.mark.parametrize("up", ["x", "y", "z", None])
def test_up_is_y_in_the_cube_and_undone(up):
    points = sphere(400) * 3 + [100, 200, 300]
    axis = {"x": 0, "y": 1, "z": 2, None: 1}[up]
    mesh = reconstruct_mesh(points, up=up, weights=Ball(top=0.5), resolution=64)
    check_closed(mesh)
    expected = np.array([[-3.0] * 3, [3.0] * 3])
    expected[1, axis] = 1.5
    assert np.abs(mesh.bounds - [100, 200, 300] - expected).max() < 0.3


def test_normals_are_turned_with_the_contacts_and_made_unit():
    points = sphere(100)
    normals = 5 * points
    normals[0] = 0
    model = Ball()
    reconstruct_mesh(points, normals=normals, up="z", weights=model, resolution=32)
    touches, directions = model.encoded[0]
    assert directions.dtype == torch.float32
    lengths = directions[0].norm(dim=1)
    assert lengths[0] == 0
    assert np.allclose(lengths[1:], 1, atol=1e-6)
    centred = touches[0] - touches[0].mean(dim=0)
    assert torch.nn.functional.cosine_similarity(centred[1:], directions[0, 1:]).min() > 0.95


def test_order_does_not_matter():
    points = sphere(300)
    a = reconstruct_mesh(points, weights=Ball(), resolution=32)
    b = reconstruct_mesh(points[np.random.default_rng(1).permutation(300)], weights=Ball(), resolution=32)
    assert a.volume == pytest.approx(b.volume, rel=1e-5)


def test_outliers_are_left_out_with_a_warning():
    points = np.vstack([sphere(300), [[30.0, 0, 0]]])
    model = Ball()
    with pytest.warns(UserWarning, match=r"1 of 301 contacts lie far from all others .*contact 301 at 30, 0, 0"):
        mesh = reconstruct_mesh(points, weights=model, resolution=32)
    assert mesh.metadata["outliers"] == 1
    assert mesh.metadata["contacts"] == 300
    assert model.encoded[0][0].abs().max() <= 0.9 + 1e-6


def test_a_surface_that_meets_the_cube_is_fitted_again():
    with pytest.warns(UserWarning) as said:
        mesh = reconstruct_mesh(sphere(400), weights=Ball(inflate=1.15), resolution=64)
    expected = "the surface met the faces of the cube and was fitted again in one 1.25 times as large"
    assert expected in [str(w.message) for w in said]
    check_closed(mesh)
    assert mesh.metadata["refitted"]
    assert not mesh.metadata["meets_border"]
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 1.15**3, rel=0.05)


def test_a_surface_that_meets_every_cube_is_closed_there():
    with pytest.warns(UserWarning) as said:
        mesh = reconstruct_mesh(sphere(400), weights=Ball(inflate=1.6), resolution=64)
    assert any("meets the larger cube too and is cut off flat there" in str(w.message) for w in said)
    assert any("half of the contacts lie more than" in str(w.message) for w in said)
    check_closed(mesh)
    assert mesh.metadata["meets_border"]


def test_thousands_of_contacts_are_thinned():
    model = Ball()
    mesh = reconstruct_mesh(sphere(3000), weights=model, resolution=32, max_touches=500)
    assert 400 <= model.encoded[0][0].shape[1] <= 500
    assert mesh.metadata["contacts"] == model.encoded[0][0].shape[1]


def test_the_distance_of_the_contacts_does_not_depend_on_the_cells():
    contacts = np.concatenate([sphere(100), -sphere(100)])
    coarse, fine = (
        reconstruct_mesh(contacts, weights=Ball(inflate=1.02), resolution=cells).metadata["distance"]
        for cells in (32, 96)
    )
    assert fine == pytest.approx(0.02, rel=0.05)
    assert coarse == pytest.approx(fine, rel=0.1)


def test_contacts_far_from_the_surface_earn_a_warning():
    with pytest.warns(UserWarning, match="do not look like the surface of an object"):
        reconstruct_mesh(np.random.default_rng(0).uniform(-1, 1, size=(500, 3)), weights=Ball(), resolution=32)


def test_normals_that_point_inwards_earn_a_warning():
    points = sphere(300)
    reconstruct_mesh(points + 5, normals=points, weights=Ball(), resolution=32)
    with pytest.warns(UserWarning, match="seem to point into the object"):
        reconstruct_mesh(points + 5, normals=-points, weights=Ball(), resolution=32)
    with pytest.warns(UserWarning, match="seem to point into the object"):
        reconstruct_mesh(points + 5, normals=-points * (points[:, :1] > 0), weights=Ball(), resolution=32)


def test_contacts_in_a_plane_earn_a_warning():
    points = sphere(100) * [1, 1, 0] + [0, 0, 5]
    with pytest.warns(UserWarning) as said:
        reconstruct_mesh(points, weights=Ball(), resolution=32)
    assert any("all contacts lie in one plane" in str(w.message) for w in said)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((5, 2)), r"points should have shape \(N, 3\), got \(5, 2\)"),
        (np.full((5, 3), np.nan), "points should be finite, got 5 of 5 rows that are not"),
        (np.zeros((0, 3)), "at least 4 distinct contacts, got 0"),
        (np.array([[0.1, -0.2, 0.3]]), "at least 4 distinct contacts, got 1"),
        (np.tile(np.eye(3), (50, 1)), "at least 4 distinct contacts, got 3"),
        (np.linspace(0, 1, 50)[:, None] * [[1.0, 2, 3]], "got 50 distinct contacts on one line"),
    ],
)
def test_contacts_that_span_no_solid(points, message):
    with pytest.raises(ValueError, match=message):
        reconstruct_mesh(points, weights=Ball())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"normals": np.zeros((3, 3))}, r"normals should have the shape of points, \(50, 3\), got \(3, 3\)"),
        ({"normals": np.full((50, 3), np.inf)}, "normals should be finite"),
        ({"up": "Z"}, 'up should be "x", "y", "z" or None, got \'Z\''),
        ({"device": "tpu:7x"}, 'device should be "auto", "cpu" or "cuda"'),
        ({"level": 2.0}, r"no surface.*level 2"),
    ],
)
def test_options_that_do_not_fit(options, message):
    with pytest.raises(ValueError, match=message):
        reconstruct_mesh(sphere(50), **{"weights": Ball(), "resolution": 32, **options})


def test_a_real_network_gives_a_closed_mesh():
    torch.manual_seed(0)
    model = TouchNet("tiny")
    model.head[-1].bias.data += 0.3
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        mesh = reconstruct_mesh(sphere(200), normals=sphere(200), weights=model, resolution=32)
    check_closed(mesh)
    assert not model.training
