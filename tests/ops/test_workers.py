"""The kernels in DataLoader workers, forked after use in the parent and spawned."""

from pathlib import Path

import pytest
import torch
from torch.utils.data import DataLoader, Dataset

import touchnet
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


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted in /proc, which Linux has")
@pytest.mark.skipif(not touchnet.build_info()["openmp"], reason="this torch brings no GNU OpenMP")
def test_the_kernels_run_on_the_threads_of_torch():
    def threads() -> set[str]:
        return {task.name for task in Path("/proc/self/task").iterdir()}

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        torch.rand(1_000_000).exp_()
        torchs = threads()
        data = Volumes()
        data[0]
        assert threads() <= torchs  # those of earlier tests may end meanwhile
    finally:
        torch.set_num_threads(before)
