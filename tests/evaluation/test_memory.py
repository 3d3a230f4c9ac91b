"""The memory of a piece of work."""

import math
import sys

import numpy as np
import pytest

from touchnet.evaluation import memory
from touchnet.evaluation.memory import measured_memory


@pytest.mark.skipif(sys.platform != "linux", reason="measured through /proc")
def test_the_peak_counts_although_it_is_given_back() -> None:
    found: dict[str, float] = {}
    with measured_memory(found):
        np.ones(8 << 20).sum()  # 64 MiB of float64, freed at once
    if math.isnan(found["memory"]):
        pytest.skip("/proc/self/clear_refs cannot be written here")
    assert 55 < found["memory"] < 100
    with measured_memory(found):
        pass
    assert found["memory"] < 8


def test_unknown_where_the_system_does_not_tell(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(memory, "_PROCESS", tmp_path / "nothing")
    found: dict[str, float] = {}
    with measured_memory(found):
        pass
    assert math.isnan(found["memory"])
