"""How long training goes on, and at which learning rate."""

from __future__ import annotations

import math
from typing import NamedTuple

from touchnet.training.options import Recipe

UNKNOWN_STEPS = 2000  # before the first step has told how long one takes
ENDLESS = 1 << 40  # more steps than any time allows


def learning_rate(step: int, steps: int, per_epoch: int, peak: float, schedule: str) -> float:
    """Learning rate of step `step` (counted from 0) of `steps`."""
    if schedule == "constant":
        return peak
    if schedule == "multistep":
        return peak * 0.5 ** (step // per_epoch // 50)
    warm_up = min(200, steps // 10)
    if step < warm_up:
        return peak * (step + 1) / warm_up
    return peak * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * (step - warm_up) / max(1, steps - warm_up))))


class Budget(NamedTuple):
    """When training ends: at a step, or when the time is up."""

    steps: int | None
    seconds: float | None

    def planned(self, step: int, elapsed: float) -> int:
        """How many steps there will be in all, as far as `step` steps in `elapsed` seconds tell."""
        if self.seconds is None:
            return self.steps
        if step == 0:
            return UNKNOWN_STEPS
        return max(step + 1, round(step * self.seconds / elapsed))

    def spent(self, done: int, elapsed: float) -> bool:
        """Whether step `done` was the last."""
        return done >= self.steps if self.seconds is None else elapsed >= self.seconds


def budget_of(recipe: Recipe, per_epoch: int) -> Budget:
    """Steps or seconds, whichever the recipe has."""
    if recipe.minutes is not None:
        return Budget(None, 60 * recipe.minutes)
    return Budget(recipe.steps if recipe.steps is not None else recipe.epochs * per_epoch, None)
