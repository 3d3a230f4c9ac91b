"""Coverage of lattice points by triangles."""

import numpy as np
from scipy.spatial import Delaunay

from touchnet import raster
from touchnet.raster import cover


def test_points_of_one_triangle_by_hand() -> None:
    uv = np.array([[-0.5, -0.5], [2.6, -0.4], [-0.4, 2.7]])
    (part,) = cover(uv, np.array([[0, 1, 2]]))
    assert sorted(zip(part.i.tolist(), part.j.tolist(), strict=True)) == [
        (0, 0),
        (0, 1),
        (0, 2),
        (1, 0),
        (1, 1),
        (2, 0),
    ]
    assert part.left.all()
    np.testing.assert_allclose(part.weights.sum(axis=1), 1)
    np.testing.assert_allclose(part.weights @ uv, np.stack([part.i, part.j], axis=1), atol=1e-12)
    (turned,) = cover(uv, np.array([[0, 2, 1]]))
    assert not turned.left.any() and len(turned.i) == 6


def test_a_window_cuts_off_and_nothing_gives_nothing() -> None:
    uv = np.array([[-5.1, -5.2], [20.3, -5.4], [-5.7, 20.9]])
    (part,) = cover(uv, np.array([[0, 1, 2]]), low=(0, 0), high=(2, 3))
    assert sorted(zip(part.i.tolist(), part.j.tolist(), strict=True)) == [(i, j) for i in range(2) for j in range(3)]
    assert list(cover(uv, np.zeros((0, 3), dtype=int))) == []
    assert list(cover(uv / 100 + 0.5, np.array([[0, 1, 2]]))) == []


def test_neighbours_share_no_point_and_leave_none(monkeypatch) -> None:
    """Every lattice point under a triangulated square is covered once, in however many portions it is computed."""
    generator = np.random.default_rng(0)
    corners = np.array([[-0.5, -0.5], [40.5, -0.5], [40.5, 30.5], [-0.5, 30.5]])
    uv = np.concatenate([corners, generator.uniform((0, 0), (40, 30), (300, 2))])
    faces = Delaunay(uv).simplices
    faces[::2] = faces[::2, ::-1]  # orientation must not matter
    monkeypatch.setattr(raster, "PAIRS_AT_ONCE", 500)
    parts = list(cover(uv, faces))
    assert len(parts) > 3
    times = np.zeros((41, 31), dtype=int)
    for part in parts:
        np.add.at(times, (part.i, part.j), 1)
    assert (times == 1).all()
    order = np.concatenate([part.face for part in parts])
    assert (np.diff(order) >= 0).all()
