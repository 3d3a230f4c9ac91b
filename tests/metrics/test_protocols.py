"""The two protocols against hand-computed cases and an independent library."""

import numpy as np
import pytest
import trimesh

from tests.solids import box, sphere
from touchnet import metrics
from touchnet.metrics import (
    DEFINITIONS,
    PaperTruth,
    SurfaceTruth,
    point_to_mesh,
    surface_keys,
)


def test_truth_against_itself_is_perfect() -> None:
    scores = SurfaceTruth(sphere(0.5), samples=5000).scores(sphere(0.5))
    assert scores["iou"] == pytest.approx(1, abs=1e-12)
    assert scores["chamfer"] < 1e-20 and scores["hausdorff_95"] < 1e-10
    assert scores["f_score_0.005"] == 1 and scores["watertight"] == 1 and scores["empty"] == 0
    assert scores["normal_consistency"] == pytest.approx(1, abs=1e-6)


def test_concentric_spheres_have_known_scores() -> None:
    truth = SurfaceTruth(sphere(0.5, subdivisions=5), samples=20_000)
    scores = truth.scores(sphere(0.485, subdivisions=5), thresholds=(0.01, 0.02))
    assert scores["iou"] == pytest.approx(0.97**3, abs=2e-3)
    assert scores["chamfer_l1"] == pytest.approx(0.015, abs=2e-4)
    assert scores["chamfer"] == pytest.approx(2 * 0.015**2, rel=0.02)
    assert scores["hausdorff_95"] == pytest.approx(0.015, abs=3e-4)
    assert (scores["f_score_0.01"], scores["f_score_0.02"]) == (0, 1)
    assert scores["normal_consistency"] > 0.999


def test_scores_see_each_direction() -> None:
    """A truth of two spheres, one of them missed: all that is predicted is right, half of the truth is not there."""
    both = trimesh.util.concatenate([sphere(0.1, centre=(-0.4, 0, 0)), sphere(0.1, centre=(0.4, 0, 0))])
    scores = SurfaceTruth(both, samples=4000).scores(sphere(0.1, centre=(-0.4, 0, 0)))
    assert scores["iou"] == pytest.approx(0.5, abs=2e-3)
    assert scores["f_score_0.01"] == pytest.approx(2 * 1 * 0.5 / 1.5, abs=2e-3)
    # Distances from the missed sphere to the other one run from 0.6 to 0.8.
    assert 0.3 < scores["chamfer_l1"] * 2 < 0.4 and 0.7 < scores["hausdorff_95"] < 0.8


@pytest.mark.parametrize(
    "nothing", [None, trimesh.Trimesh(), trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False)]
)
def test_an_empty_mesh_has_the_same_keys_and_a_flag(nothing: trimesh.Trimesh | None) -> None:
    scores = SurfaceTruth(sphere(0.5), samples=500).scores(nothing)
    assert tuple(scores) == surface_keys()
    assert scores["empty"] == 1 and scores["iou"] == 0 and scores["f_score_0.01"] == 0
    assert scores["chamfer"] == np.inf and scores["chamfer_l1"] == np.inf and scores["hausdorff_95"] == np.inf


def test_an_open_mesh_is_labelled_by_winding_numbers() -> None:
    truth = SurfaceTruth(sphere(0.5), samples=20_000)
    half = sphere(0.4)
    half.update_faces(half.triangles_center[:, 2] > 0)
    scores = truth.scores(half)
    assert scores["watertight"] == 0 and scores["empty"] == 0
    assert 0 < scores["chamfer"] < 0.5 and tuple(scores) == surface_keys()
    # A hemisphere's solid angle passes 2 pi above its rim's plane only: half of the ball counts as inside.
    assert scores["iou"] == pytest.approx(0.8**3 / 2, abs=0.02)


def test_distances_agree_with_an_independent_library() -> None:
    pcu = pytest.importorskip("point_cloud_utils")
    knot = trimesh.creation.torus(0.3, 0.12)
    samples = np.random.default_rng(0).uniform(-0.5, 0.5, (2000, 3))
    expected, _, _ = pcu.closest_points_on_mesh(samples, np.array(knot.vertices), np.array(knot.faces, dtype=np.int32))
    np.testing.assert_allclose(point_to_mesh(samples, knot)[0], expected, atol=1e-12)


def test_a_prediction_far_larger_than_the_truth_is_measured_on_wider_lines() -> None:
    truth = SurfaceTruth(box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)), samples=500)
    assert truth.scores(box((-5, -5, -5), (5, 5, 5)))["iou"] == pytest.approx(1e-3, rel=0.05)


def test_scores_refuse_vertices_that_are_not_finite() -> None:
    broken = sphere(0.4)
    vertices = np.array(broken.vertices)
    vertices[0, 0] = np.nan
    with pytest.raises(ValueError, match="mesh must have finite vertices"):
        SurfaceTruth(sphere(0.5), samples=500).scores(trimesh.Trimesh(vertices, broken.faces, process=False))
    with pytest.raises(ValueError, match="mesh must be closed"):
        SurfaceTruth(trimesh.Trimesh(sphere(0.5).vertices, sphere(0.5).faces[1:], process=False))


def test_paper_protocol_by_hand() -> None:
    samples = np.array([[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [2, 0, 0]], dtype=float)
    truth = PaperTruth(samples, np.array([True, True, True, False]), count=10, threshold=0.1)
    scores = truth.scores(np.array([False, True, True, True]))
    # Prediction 0.5, 1, 2 against truth 0, 0.5, 1: one of three a side is off, by 1 and by 0.5.
    assert scores["chamfer"] == pytest.approx((1 + 0.25) / 3)
    assert scores["f_score"] == pytest.approx(2 / 3) and scores["empty"] == 0
    assert truth.scores(None) == {"chamfer": np.inf, "f_score": 0, "empty": 1}
    assert truth.scores(np.zeros(4, dtype=bool)) == truth.scores(None)


def test_paper_protocol_shows_the_ceiling_of_thinned_samples() -> None:
    samples = np.random.default_rng(0).uniform(-0.5, 0.5, (20_000, 3))
    inside = np.linalg.norm(samples, axis=1) < 0.4
    scores = PaperTruth(samples, inside, count=512).scores(inside)
    assert 0 < scores["f_score"] < 0.6 and 0 < scores["chamfer"] < 0.01


def test_every_measure_is_defined_in_words() -> None:
    names = {
        name.removesuffix(f"_{d:g}") for name in surface_keys() for d in metrics.THRESHOLDS if name.endswith(f"_{d:g}")
    }
    names |= {name for name in surface_keys() if not name.startswith("f_score_")}
    assert names <= set(DEFINITIONS)
