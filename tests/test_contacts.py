import numpy as np
import pytest

from tests.test_reconstruction import sphere
from touchnet.contacts import thin


def test_thin_keeps_everything_that_fits():
    assert thin(sphere(50), 50).tolist() == list(range(50))


@pytest.mark.parametrize("count", [1, 2, 10, 100, 999])
def test_thin_keeps_about_as_many_as_asked_for(count):
    kept = thin(sphere(1000), count)
    assert count / 4 <= len(kept) <= count
    assert (np.diff(kept) > 0).all()


def test_thin_spares_places_touched_once():
    crowd = np.random.default_rng(0).normal(size=(5000, 3)) * 0.01
    lonely = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    kept = thin(np.vstack([crowd, lonely]), 100)
    assert {5000, 5001, 5002} <= set(kept.tolist())


def test_thin_does_not_depend_on_the_order():
    points = sphere(2000)
    shuffle = np.random.default_rng(1).permutation(2000)
    assert set(shuffle[thin(points[shuffle], 300)]) == set(thin(points, 300))


def test_thin_of_equal_points():
    assert len(thin(np.ones((50, 3)), 10)) == 1
    with pytest.raises(ValueError, match="count should be at least 1, got 0"):
        thin(sphere(10), 0)
    with pytest.raises(ValueError, match=r"shape \(N, 3\)"):
        thin(np.zeros(3), 1)
