"""One training step (forward, loss, backward, optimiser) of each network, each way in a process of its own.

The allocator cannot be set back within a process, and its state decides much of a step on a CPU.
"""

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import torch
from torch import nn

import touchnet
from benchmarks.cases import Case, benchmark
from touchnet.models.touchnet import TouchNet

BATCH = 4
QUERIES = {"paper": 4000, "base": 8192}  # a sample, as the recipes have them


@dataclass
class Way:
    """How a step is run. The defaults are those of `touchnet train`."""

    allocator: bool = True
    channels_last: bool = True
    fused: bool = True
    bfloat16: bool = False


PLAIN = Way(allocator=False, channels_last=False, fused=False)


def make_step(size: str, way: Way):
    """The action of one step on random contacts and labels."""
    if way.allocator:
        touchnet.tune_allocator()
    generator = torch.Generator().manual_seed(0)
    network = TouchNet(size).train()
    if not way.channels_last:
        network.to(memory_format=torch.contiguous_format)
        network.unet.register_forward_pre_hook(lambda _, inputs: tuple(x.contiguous() for x in inputs))
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-4, fused=way.fused)
    touches, queries = (torch.rand(BATCH, n, 3, generator=generator) * 1.8 - 0.9 for n in (2048, QUERIES[size]))
    normals = nn.functional.normalize(touches, dim=2) if size == "base" else None
    labels = (torch.rand(BATCH, QUERIES[size], generator=generator) > 0.5).float()

    def step() -> None:
        with torch.autocast("cpu", torch.bfloat16, enabled=way.bfloat16):
            logits = network.logits(touches, queries, normals).float()
        loss = nn.functional.mse_loss(logits.sigmoid(), labels)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()

    return step


def seconds_apart(size: str, way: Way, steps: int) -> float:
    """Median seconds of a step in a fresh process, after two that are not counted."""
    command = [sys.executable, "-m", "benchmarks.training", size, json.dumps(asdict(way)), str(steps)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


@benchmark
def training_step() -> Iterator[Case]:
    ways = {
        "plain": PLAIN,
        "channels last, fused Adam": Way(allocator=False),
        "and the allocator": Way(),
    }
    if torch.ops.mkldnn._is_mkldnn_bf16_supported():  # elsewhere a step takes twenty times as long
        ways["and bfloat16"] = Way(bfloat16=True)
    for size, targets in (("paper", (None, None, 1.8, 3)), ("base", (None,) * 4)):
        found = {name: seconds_apart(size, way, 7) for name, way in ways.items()}
        for (name, seconds), target in zip(found.items(), targets, strict=False):
            yield Case(
                f"{size} network, batch {BATCH}: {name}",
                ours=seconds,
                peer=found["plain"],
                peer_name="plain",
                target=target,
                limit=0.35 if size == "base" else None,
                limit_name="of 0.35 s",
            )


def main(size: str, way: str, steps: str) -> None:
    step = make_step(size, Way(**json.loads(way)))
    times = []
    for _ in range(int(steps) + 2):
        start = time.perf_counter()
        step()
        times.append(time.perf_counter() - start)
    print(statistics.median(times[2:]))


if __name__ == "__main__":
    main(*sys.argv[1:])
