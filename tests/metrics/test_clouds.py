"""Measures of point sets against hand-computed cases and scipy."""

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from touchnet.metrics import chamfer_distance, f_score, hausdorff_95, normal_consistency


def points(*rows: tuple[float, float, float]) -> torch.Tensor:
    return torch.tensor(rows, dtype=torch.float64).reshape(-1, 3)


def random_points(seed: int, *shape: int) -> torch.Tensor:
    return torch.rand(*shape, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


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
