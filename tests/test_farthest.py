"""Farthest points against their definition."""

import pytest
import torch
from scipy.spatial.distance import cdist

from touchnet.farthest import farthest_point_sample


def points(*rows: tuple[float, float, float]) -> torch.Tensor:
    return torch.tensor(rows, dtype=torch.float64).reshape(-1, 3)


def random_points(seed: int, *shape: int) -> torch.Tensor:
    return torch.rand(*shape, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


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
