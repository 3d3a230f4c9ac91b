import numpy as np
import pytest
import trimesh

from benchmarks.closed_loop import Truth


@pytest.fixture(scope="module")
def truth():
    return Truth(trimesh.creation.icosphere(subdivisions=4, radius=2.0))


def test_a_finger_stops_where_it_meets_the_surface_and_not_inside(truth):
    positions = np.array([[2.0, 0, 0], [1.5, 0, 0], [0, 5.0, 0], [0, 0, 0]])
    directions = np.array([[-1.0, 0, 0], [-1, 0, 0], [1, 0, 0], [0, 0, 1]])
    contacts, met = truth.poke(positions, directions, np.array([1.0, 2.0, 1.0, 0.5]))
    assert met.tolist() == [True, True, False, False]
    assert contacts.points == pytest.approx(np.array([[2.0, 0, 0], [2, 0, 0]]), abs=0.01)
    assert contacts.normals[:, 0] == pytest.approx(1, abs=0.05)


def test_how_far_a_finger_goes_on(truth):
    behind = np.array([[3.0, 0, 0]]), np.array([[-1.0, 0, 0]]), np.array([0.5])
    assert truth.poke(*behind)[1].all()
    assert not truth.poke(*behind, beyond=0.9)[1].any()


def test_random_pokes_lie_on_the_surface_all_round(truth):
    contacts, tries = truth.random(100, seed=1)
    assert contacts.points.shape == contacts.normals.shape == (100, 3)
    assert np.linalg.norm(contacts.points, axis=1) == pytest.approx(2, abs=0.02)
    assert np.abs(contacts.points.mean(axis=0)).max() < 0.5
    assert (np.diff(tries) > 0).all()
    assert 100 <= tries[-1] < 200
