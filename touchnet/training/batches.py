"""Which samples make up the batch of a step, on which process."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from torch.utils.data import Sampler

from touchnet.data.samples import Sample


class StepBatches(Sampler[list[tuple[int, int]]]):
    """The (epoch, item) keys of each step's batch from step `start` to `steps`, this process's share of them.

    Every epoch is a permutation keyed by (seed, epoch), or with `weights` (items,) as many draws in proportion to them.
    Its last batch is filled from its beginning, so that all have one size (batch norm never meets a single sample).
    """

    def __init__(
        self,
        items: int,
        batch_size: int,
        *,
        seed: int,
        start: int,
        steps: int,
        rank: int,
        world: int,
        weights: np.ndarray | None = None,
    ) -> None:
        if batch_size % world:
            raise ValueError(f"batch_size should be a multiple of the {world} processes, got {batch_size}")
        self.items, self.batch_size, self.seed = items, batch_size, seed
        self.start, self.steps, self.rank, self.world = start, steps, rank, world
        self.shares = None if weights is None else weights / weights.sum()

    def __len__(self) -> int:
        return self.steps - self.start

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        per_epoch = steps_per_epoch(self.items, self.batch_size)
        for step in range(self.start, self.steps):
            epoch, batch = divmod(step, per_epoch)
            rng = np.random.default_rng([self.seed, epoch])
            if self.shares is None:
                order = rng.permutation(self.items)
            else:
                order = rng.choice(self.items, size=self.items, p=self.shares)
            order = np.resize(order, per_epoch * self.batch_size)
            rows = order[batch * self.batch_size : (batch + 1) * self.batch_size]
            yield [(epoch, int(item)) for item in rows[self.rank :: self.world]]


def steps_per_epoch(items: int, batch_size: int) -> int:
    return -(-items // batch_size)


def pieces_of(batch: Sample, count: int) -> list[Sample]:
    """A batch of tensors cut into `count` equal ones."""
    return [Sample(*piece) for piece in zip(*(value.chunk(count) for value in batch), strict=True)]
