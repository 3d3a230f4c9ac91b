"""The kernels in DataLoader workers, forked after use in the parent and spawned."""

import pytest
import torch
from torch.utils.data import DataLoader, Dataset

from touchnet import ops


class Volumes(Dataset):
    """Grids enough points that the kernels would start threads."""

    def __len__(self) -> int:
        return 4

    def __getitem__(self, index: int) -> torch.Tensor:
        points = torch.rand(1, 50_000, 3, generator=torch.Generator().manual_seed(index)) * 2 - 1
        torch.set_num_threads(2)  # DataLoader workers start with one
        volume = ops.gridding(points, 16)
        samples = ops.trilinear_sample(volume, points)
        torch.set_num_threads(1)  # torch's own loops hang here: OpenMP does not survive the fork
        return torch.cat([volume.flatten(), samples.flatten()])


@pytest.mark.parametrize("context", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_workers_after_use_in_the_parent(context):
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        data = Volumes()
        expected = torch.stack([data[i] for i in range(len(data))])
        loader = DataLoader(data, batch_size=4, num_workers=2, multiprocessing_context=context, timeout=60)
        (got,) = list(loader)
    finally:
        torch.set_num_threads(before)
    assert torch.equal(got, expected)
