"""Volumes in common against solids that are known, and libigl's winding numbers."""

import numpy as np
import pytest
import torch
import trimesh

from tests.solids import box, sphere
from touchnet.metrics import inside_mesh, volumetric_iou


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
