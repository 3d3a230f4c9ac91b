"""Metrics against hand-computed cases, scipy, and libigl's winding numbers."""

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from touchnet import metrics
from touchnet.metrics import (
    DEFINITIONS,
    PaperTruth,
    SurfaceTruth,
    chamfer_distance,
    f_score,
    farthest_point_sample,
    hausdorff_95,
    inside_mesh,
    is_closed,
    normal_consistency,
    point_to_mesh,
    sample_surface,
    surface_keys,
    volumetric_iou,
)


def points(*rows: tuple[float, float, float]) -> torch.Tensor:
    return torch.tensor(rows, dtype=torch.float64).reshape(-1, 3)


def random_points(seed: int, *shape: int) -> torch.Tensor:
    return torch.rand(*shape, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def sphere(radius: float, *, centre: tuple[float, float, float] = (0, 0, 0), subdivisions: int = 4) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    mesh.apply_translation(centre)
    return mesh


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])


# ---- point sets


def test_chamfer_of_two_points_follows_equation_9() -> None:
    assert chamfer_distance(points((0, 0, 0)), points((0.3, 0, 0))).item() == pytest.approx(0.18, abs=1e-15)


def test_a_point_at_the_origin_counts() -> None:
    assert chamfer_distance(points((0, 0, 0)), points((0, 0, 0), (1, 0, 0))).item() == pytest.approx(0.5)


def test_chamfer_is_zero_for_the_same_set_in_another_order() -> None:
    a = random_points(0, 50)
    assert chamfer_distance(a, a.flip(0)).item() == 0


def test_chamfer_agrees_with_all_pairs_and_batches() -> None:
    a, b = random_points(1, 3, 40), random_points(2, 3, 70)
    expected = []
    for x, y in zip(a.numpy(), b.numpy(), strict=True):
        squared = cdist(x, y, "sqeuclidean")
        expected.append(squared.min(1).mean() + squared.min(0).mean())
    np.testing.assert_allclose(chamfer_distance(a, b), expected, rtol=1e-12)
    assert chamfer_distance(a[0], b[0]).shape == ()


def test_chamfer_gradient() -> None:
    a, b = random_points(3, 2, 6).requires_grad_(), random_points(4, 2, 5).requires_grad_()
    assert torch.autograd.gradcheck(chamfer_distance, (a, b))


@pytest.mark.parametrize(("n", "m"), [(0, 100), (100, 0), (0, 0)])
def test_an_empty_set_has_infinite_distance_and_no_score(n: int, m: int) -> None:
    a, b = random_points(5, n), random_points(6, m)
    assert chamfer_distance(a, b).item() == np.inf
    assert hausdorff_95(a, b).item() == np.inf
    assert f_score(a, b, threshold=0.01).item() == 0
    assert normal_consistency(a, a, b, b).item() == 0


def test_f_score_counts_precision_and_recall() -> None:
    prediction = points((0, 0, 0), (1, 0, 0), (5, 0, 0), (9, 0, 0))  # 2 of 4 near the truth
    truth = points((0.1, 0, 0), (1, 0, 0), (2, 0, 0))  # 2 of 3 near the prediction
    expected = 2 * (2 / 4) * (2 / 3) / (2 / 4 + 2 / 3)
    assert f_score(prediction, truth, threshold=0.5).item() == pytest.approx(expected, abs=1e-15)
    # Both ways have the same F; with one point less the roles differ.
    assert f_score(prediction[:1], truth, threshold=0.5).item() == pytest.approx(2 * 1 * (1 / 3) / (1 + 1 / 3))


def test_f_score_is_strict_at_the_threshold() -> None:
    a, b = points((0, 0, 0)), points((0.25, 0, 0))
    assert f_score(a, b, threshold=0.25).item() == 0
    assert f_score(a, b, threshold=0.2500001).item() == 1


def test_f_score_asks_for_a_named_positive_threshold() -> None:
    a = points((0, 0, 0))
    with pytest.raises(TypeError):
        f_score(a, a, 0.01)  # type: ignore[misc]
    with pytest.raises(ValueError, match="threshold must be a positive distance, got 0"):
        f_score(a, a, threshold=0)


def test_hausdorff_95_agrees_with_scipy() -> None:
    a, b = random_points(7, 200), random_points(8, 300)
    there, back = cKDTree(b).query(a)[0], cKDTree(a).query(b)[0]
    expected = max(np.quantile(there, 0.95), np.quantile(back, 0.95))
    assert hausdorff_95(a, b).item() == pytest.approx(expected, rel=1e-12)


def test_normal_consistency_ignores_sign_and_length() -> None:
    a, b = points((0, 0, 0), (1, 0, 0)), points((0, 0, 0.1), (1, 0, 0.1))
    up, tilted = points((0, 0, 1), (0, 0, 1)), points((0, 0, -3), (0, 1, 1))
    assert normal_consistency(a, up, b, tilted).item() == pytest.approx((1 + 0.5**0.5) / 2)
    with pytest.raises(ValueError, match=r"b_normals must have the shape of its points \(2, 3\), got \(1, 3\)"):
        normal_consistency(a, up, b, tilted[:1])


def test_farthest_points_by_hand() -> None:
    line = points((0, 0, 0), (1, 0, 0), (2, 0, 0), (10, 0, 0), (6, 0, 0))
    assert farthest_point_sample(line, 4).tolist() == [0, 3, 4, 2]
    assert farthest_point_sample(line, 2, start=-2).tolist() == [3, 0]
    assert farthest_point_sample(line, 0).tolist() == []


def test_farthest_points_of_duplicates_are_all_different() -> None:
    same = torch.ones(4, 3)
    assert sorted(farthest_point_sample(same, 4).tolist()) == [0, 1, 2, 3]


def test_farthest_points_agree_with_the_definition_and_batch() -> None:
    cloud = random_points(9, 2, 60)
    chosen = farthest_point_sample(cloud.float(), 20)
    for b in range(2):
        distance = cdist(cloud[b], cloud[b])
        expected = [0]
        while len(expected) < 20:
            expected.append(int(distance[expected].min(0).argmax()))
        assert chosen[b].tolist() == expected


@pytest.mark.parametrize(("count", "start", "words"), [(6, 0, "count must be between 0 .* 5, got 6"), (2, 5, "start")])
def test_farthest_points_refuse_what_is_not_there(count: int, start: int, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        farthest_point_sample(torch.zeros(5, 3), count, start=start)


@pytest.mark.parametrize(
    ("a", "b", "error", "words"),
    [
        (torch.zeros(3), torch.zeros(1, 3), ValueError, r"a must have shape \(N, 3\) or \(B, N, 3\), got \(3,\)"),
        (torch.zeros(1, 3), torch.zeros(4, 2), ValueError, r"b must have shape .* got \(4, 2\)"),
        (torch.zeros(1, 3), torch.zeros(1, 3).double(), TypeError, "one type, got torch.float32 and torch.float64"),
        (torch.zeros(1, 3).int(), torch.zeros(1, 3), TypeError, "a must be float32 or float64, got torch.int32"),
        (np.zeros((1, 3)), torch.zeros(1, 3), TypeError, "a must be a torch.Tensor, got ndarray"),
        (torch.zeros(2, 1, 3), torch.zeros(3, 1, 3), ValueError, "same batch"),
        (torch.zeros(1, 3), torch.full((1, 3), torch.nan), ValueError, "b must be finite"),
    ],
)
def test_point_sets_that_do_not_fit_are_named(a: object, b: object, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        chamfer_distance(a, b)  # type: ignore[arg-type]


# ---- volumes


def test_iou_of_labels() -> None:
    a = np.array([[1, 1, 1, 0], [0, 0, 0, 0], [1, 0, 0, 0]], dtype=bool)
    b = np.array([[0, 1, 1, 1], [0, 0, 0, 0], [0, 0, 0, 1]], dtype=bool)
    np.testing.assert_allclose(volumetric_iou(a, b), [0.5, 1, 0])
    as_tensors = volumetric_iou(torch.from_numpy(a), torch.from_numpy(b))
    assert isinstance(as_tensors, torch.Tensor) and as_tensors.tolist() == [0.5, 1, 0]
    assert volumetric_iou(a[0], b[0]) == 0.5


def test_iou_refuses_probabilities_and_other_shapes() -> None:
    with pytest.raises(TypeError, match="a must be a boolean array or tensor, or both closed meshes, got float64"):
        volumetric_iou(np.zeros(3), np.zeros(3, dtype=bool))
    with pytest.raises(ValueError, match=r"one shape \(N,\) or \(B, N\), got \(3,\) and \(4,\)"):
        volumetric_iou(np.zeros(3, dtype=bool), np.zeros(4, dtype=bool))


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (sphere(0.4), sphere(0.3), (0.3 / 0.4) ** 3),  # same polyhedron, scaled: the ratio is exact
        (box((0, 0, 0), (1, 1, 1)), box((0.5, 0, 0), (1.5, 1, 1)), 1 / 3),
        (box((0, 0, 0), (1, 1, 1)), box((0, 0.5, 0), (1, 1.5, 1)), 1 / 3),
        (box((0, 0, 0), (1, 1, 1)), box((0, 0, 0.75), (1, 1, 1.75)), 0.25 / 1.75),
        (box((0, 0, 0), (1, 1, 1)), box((2, 0, 0), (3, 1, 1)), 0.0),
        (box((0, 0, 0), (1, 1, 0.01)), box((0, 0, 0.002), (1, 1, 0.012)), 0.008 / 0.012),  # a thin plate
        (box((0, 0, 0), (1, 1, 1)), box((0, 0, 0), (1, 1, 1)), 1.0),
    ],
)
def test_iou_of_known_solids(a: trimesh.Trimesh, b: trimesh.Trimesh, expected: float) -> None:
    assert volumetric_iou(a, b) == pytest.approx(expected, abs=2e-3)


def test_iou_of_spheres_apart_by_their_radius() -> None:
    # Lens of two unit spheres at distance 1: 5 pi / 12; two balls: 8 pi / 3.
    a, b = sphere(1, subdivisions=5), sphere(1, centre=(0.6, 0, 0.8), subdivisions=5)
    assert volumetric_iou(a, b) == pytest.approx((5 / 12) / (8 / 3 - 5 / 12), abs=2e-3)


def test_iou_of_a_hollow_shape_leaves_the_hollow_out() -> None:
    outer, inner = sphere(0.5), sphere(0.4)
    inner.invert()
    hollow = trimesh.util.concatenate([outer, inner])
    assert volumetric_iou(hollow, sphere(0.5)) == pytest.approx(1 - 0.8**3, abs=2e-3)


def test_iou_counts_overlapping_parts_once() -> None:
    overlapping = trimesh.util.concatenate([box((0, 0, 0), (0.6, 1, 1)), box((0.4, 0, 0), (1, 1, 1))])
    assert volumetric_iou(overlapping, box((0, 0, 0), (1, 1, 1))) == pytest.approx(1, abs=1e-3)


def test_iou_of_an_inverted_mesh_is_nothing() -> None:
    inverted = sphere(0.4)
    inverted.invert()
    assert volumetric_iou(inverted, sphere(0.4)) == 0


def test_iou_of_an_open_mesh_is_refused() -> None:
    open_box = trimesh.Trimesh(*(lambda m: (m.vertices, m.faces[:-1]))(box((0, 0, 0), (1, 1, 1))), process=False)
    with pytest.raises(ValueError, match="b must be a closed mesh"):
        volumetric_iou(sphere(0.4), open_box)


def test_iou_agrees_with_libigl_winding_numbers_on_a_knot() -> None:
    igl = pytest.importorskip("igl", reason="libigl is a development dependency")
    knot = trimesh.creation.torus(0.3, 0.12)
    other = trimesh.creation.torus(0.3, 0.12)
    other.apply_transform(trimesh.transformations.rotation_matrix(0.5, [1, 0.3, 0]))
    samples = np.random.default_rng(0).uniform(-0.5, 0.5, (100_000, 3))
    labels = [
        igl.winding_number(np.asarray(m.vertices), np.asarray(m.faces, dtype=np.int64), samples) > 0.5
        for m in (knot, other)
    ]
    # 2 standard deviations of the counted share are 0.007.
    assert volumetric_iou(knot, other) == pytest.approx(float(volumetric_iou(*labels)), abs=0.01)
    np.testing.assert_array_equal(inside_mesh(samples[:20_000], knot), labels[0][:20_000])


# ---- meshes


def test_closed_means_two_faces_an_edge_in_opposite_directions() -> None:
    cube = box((0, 0, 0), (1, 1, 1))
    assert is_closed(cube.faces)
    assert not is_closed(cube.faces[1:])
    flipped = np.array(cube.faces)
    flipped[0] = flipped[0, ::-1]
    assert not is_closed(flipped)
    assert not is_closed(np.concatenate([cube.faces, cube.faces]))  # four faces an edge
    assert not is_closed([[0, 0, 1], [0, 1, 0]])
    assert is_closed(np.zeros((0, 3), dtype=int))


def test_distance_to_a_face_an_edge_and_a_corner() -> None:
    cube = box((0, 0, 0), (1, 1, 1))
    distance, face = point_to_mesh([(0.5, 0.5, 1.25), (2, 0.5, 2), (-1, -1, -1), (0.5, 0.5, 0.5)], cube)
    np.testing.assert_allclose(distance, [0.25, 2**0.5, 3**0.5, 0.5], atol=1e-12)
    assert np.abs(cube.face_normals[face[0]] @ [0, 0, 1]) == pytest.approx(1)
    assert point_to_mesh(np.zeros((0, 3)), cube)[0].shape == (0,)
    with pytest.raises(ValueError, match="mesh must have at least one face"):
        point_to_mesh([(0, 0, 0)], trimesh.Trimesh())
    with pytest.raises(ValueError, match=r"points must have shape \(N, 3\), got \(3,\)"):
        point_to_mesh((0, 0, 0), cube)


def test_surface_samples_are_even_by_area_and_on_their_face() -> None:
    plate = box((0, 0, 0), (1, 2, 0.5))  # areas 2+2, 1+1, 0.5+0.5 of 7
    samples, face = sample_surface(plate, 7000, generator=np.random.default_rng(0))
    share = np.bincount(face, minlength=len(plate.faces)) / 7000
    np.testing.assert_allclose(share, plate.area_faces / plate.area, atol=2e-3)
    assert point_to_mesh(samples, plate)[0].max() < 1e-12
    top = samples[np.abs(samples[:, 2] - 0.5) < 1e-12]
    np.testing.assert_allclose(top.mean(axis=0), [0.5, 1, 0.5], atol=0.02)
    again, _ = sample_surface(plate, 7000, generator=np.random.default_rng(0))
    np.testing.assert_array_equal(samples, again)
    with pytest.raises(ValueError, match="area above 0"):
        sample_surface(
            trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False), 5, generator=np.random.default_rng()
        )


# ---- protocols


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
