"""tune_allocator: page faults of fresh large tensors before and after."""

import os
import subprocess
import sys

import pytest

from touchnet import allocator

FAULTS = """
import resource, torch, touchnet
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    torch.empty(16_000_000).zero_()  # 64 MB, freed at once
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
faults()
mapped = faults()
tuned = touchnet.tune_allocator()
print(mapped, tuned, min(faults() for _ in range(30)))  # the first ones leave small pieces that glibc must fill first
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc only")
def test_freed_memory_is_kept():
    # Without transparent huge pages a fresh 64 MB tensor faults 15,625 times; with them at least every 2 MB.
    env = {**os.environ, "OMP_NUM_THREADS": "1"}
    result = subprocess.run([sys.executable, "-c", FAULTS], capture_output=True, text=True, env=env, timeout=120)
    assert result.returncode == 0, result.stderr
    mapped, tuned, kept = result.stdout.split()
    if tuned == "False":
        pytest.skip("not glibc")
    assert int(mapped) >= 30
    assert int(kept) <= int(mapped) // 10


def test_elsewhere_it_does_nothing(monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    assert allocator.tune_allocator() is False
