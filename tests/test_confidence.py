import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree
from scipy.stats import spearmanr

from tests.test_reconstruction import Ball, sphere
from touchnet.confidence import DEFAULT, Calibration, expected_error, vertex_normals, within
from touchnet.data.files import read_mesh, write_mesh
from touchnet.reconstruction import reconstruct_mesh

POINTS = 0.5 * sphere(50)


def blurred(width, radius=0.5, level=0.5):
    """The ball whose occupancy falls from 0.73 to 0.27 within `width` around its surface."""
    shift = np.log(level / (1 - level))
    return lambda points: torch.sigmoid(2 * (radius - points.norm(dim=1)) / width + shift)


def error_of(field, contacts=POINTS, **options):
    return expected_error(field, POINTS, 2 * POINTS, contacts, **options)


def test_a_blurred_surface_is_less_sure():
    errors = [error_of(blurred(width)).mean() for width in (0.01, 0.03, 0.1, 0.3)]
    assert (np.diff(errors) > 0).all()
    assert errors[-1] > 2 * errors[0]


def test_far_from_all_contacts_is_less_sure():
    one_side = POINTS[POINTS[:, 0] > 0.2]
    error = error_of(blurred(0.05), one_side)
    near, far = POINTS[:, 0] > 0.2, POINTS[:, 0] < -0.2
    assert error[far].min() > error[near].max()


def test_a_surface_that_passes_by_its_contacts_is_less_sure():
    assert (error_of(blurred(0.05), 1.1 * POINTS) > 1.5 * error_of(blurred(0.05))).all()


def test_another_level_is_not_another_error():
    assert error_of(blurred(0.05, level=0.3), level=0.3) == pytest.approx(error_of(blurred(0.05)), rel=1e-3)


def test_saturated_and_flat_fields_stay_finite():
    for field in (blurred(1e-9), blurred(1e9), lambda points: (points.norm(dim=1) < 0.5).float()):
        error = error_of(field)
        assert np.isfinite(error).all()
        assert (error > 0).all()


def test_coefficients_let_nothing_lower_the_error_that_raises_a_feature():
    assert min(DEFAULT.coefficients[1:]) >= 0


@pytest.mark.parametrize("shape", [0.7, 1.0, 1.6])
def test_within_is_the_share_of_errors_of_that_mean(shape):
    errors = np.random.default_rng(0).weibull(shape, 200_000)
    errors *= 3.0 / errors.mean()
    for tolerance in (0.5, 3.0, 9.0):
        share = (errors <= tolerance).mean()
        assert within(3.0, tolerance, calibration=Calibration(DEFAULT.coefficients, shape)) == pytest.approx(
            share, abs=0.005
        )


def test_within_falls_with_the_expected_error():
    confidence = within(np.geomspace(1e-6, 1e3, 50), 1.0)
    assert (np.diff(confidence) <= 0).all()
    assert confidence[0] == pytest.approx(1)
    assert 0 <= confidence[-1] < 0.05


def test_vertex_normals_point_outwards_at_unit_length():
    ball = trimesh.creation.icosphere(subdivisions=3)
    normals = vertex_normals(ball.vertices, ball.faces)
    assert (normals * ball.vertices).sum(axis=1).min() > 0.999
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1)


# with a reconstruction.


def test_a_reconstruction_says_how_far_to_trust_it_in_its_own_unit():
    points = sphere(300)
    metres = reconstruct_mesh(points, weights=Ball(), resolution=32)
    millimetres = reconstruct_mesh(1000 * points + 5000, weights=Ball(), resolution=32)
    a, b = metres.vertex_attributes, millimetres.vertex_attributes
    assert a["expected_error"].shape == a["confidence"].shape == (len(metres.vertices),)
    assert 1000 * a["expected_error"].mean() == pytest.approx(b["expected_error"].mean(), rel=1e-3)
    assert a["confidence"].mean() == pytest.approx(b["confidence"].mean(), rel=1e-3)
    assert metres.metadata["tolerance"] == pytest.approx(0.01 * np.ptp(points, axis=0).max())
    assert a["confidence"] == pytest.approx(within(a["expected_error"], metres.metadata["tolerance"]), abs=1e-5)


def test_the_tolerance_is_the_callers():
    strict, lax = (reconstruct_mesh(sphere(300), weights=Ball(), resolution=32, tolerance=t) for t in (0.001, 0.1))
    assert lax.vertex_attributes["confidence"].min() > strict.vertex_attributes["confidence"].max()
    for wrong in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="tolerance should be a length above 0"):
            reconstruct_mesh(sphere(300), weights=Ball(), tolerance=wrong)


@pytest.mark.filterwarnings("ignore:half of the contacts")
@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_what_nobody_touched_is_the_least_sure(up):
    points = sphere(400)
    points = points[points[:, "xyz".index(up)] < 0.5]
    mesh = reconstruct_mesh(points, weights=Ball(), resolution=32, up=up)
    distance = cKDTree(points).query(mesh.vertices)[0]
    assert spearmanr(mesh.vertex_attributes["expected_error"], distance)[0] > 0.8


def test_ply_keeps_it_and_other_formats_lack_it(tmp_path):
    mesh = reconstruct_mesh(sphere(300), weights=Ball(), resolution=32)
    expected = mesh.vertex_attributes["expected_error"]
    for suffix in ("ply", "obj", "stl", "glb"):
        write_mesh(tmp_path / f"m.{suffix}", mesh)
        again = read_mesh(tmp_path / f"m.{suffix}")
        assert len(again.faces) == len(mesh.faces)
        assert set(again.vertex_attributes) == ({"expected_error", "confidence"} if suffix == "ply" else set())
    ours = read_mesh(tmp_path / "m.ply")
    assert (ours.vertices == mesh.vertices).all()
    assert (ours.vertex_attributes["expected_error"] == expected).all()
    theirs = trimesh.load(tmp_path / "m.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    assert (theirs["expected_error"] == expected).all()
    assert (theirs["confidence"] == mesh.vertex_attributes["confidence"]).all()


def test_attributes_that_are_not_one_float_a_vertex_are_not_written(tmp_path):
    mesh = trimesh.creation.icosphere(subdivisions=1)
    count = len(mesh.vertices)
    mesh.vertex_attributes["height"] = mesh.vertices[:, 2].copy()
    mesh.vertex_attributes["colour"] = np.zeros((count, 3))
    mesh.vertex_attributes["two words"] = np.zeros(count)
    mesh.vertex_attributes["label"] = np.zeros(count, dtype=np.int64)
    write_mesh(tmp_path / "m.ply", mesh)
    again = read_mesh(tmp_path / "m.ply")
    assert set(again.vertex_attributes) == {"height"}
    assert (again.vertex_attributes["height"] == mesh.vertices[:, 2]).all()


def test_vertices_that_lie_close_together_are_asked_about_once():
    asked = []

    def field(points):
        asked.append(len(points))
        return blurred(0.05)(points)

    vertices = np.concatenate([POINTS, POINTS * (1 + 1e-9)])
    error = expected_error(field, vertices, 2 * vertices, POINTS)
    assert len(asked) == 2  # below the surface and above it
    assert max(asked) <= 50
    assert error.shape == (100,)
    assert error[:50] == pytest.approx(error[50:])
