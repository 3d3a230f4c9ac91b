"""Handles of bottles, mugs and vases."""

from collections.abc import Callable

import numpy as np

from touchnet.data.shapes.fields import Array, Solid, tube


def add_handle(
    rng: np.random.Generator,
    solid: Solid,
    profile: Callable[[Array], Array],
    high: float,
    low: float,
    beside: float,
    *,
    two: float = 0.12,
) -> None:
    """A bow between the heights low and high of a body of radius profile(y), no further out than `beside`; a second
    one opposite with probability `two`."""
    thick = rng.uniform(0.018, 0.035)
    r0, r1 = (float(profile(np.float32(y))) for y in (low, high))
    out = min(max(r0, r1) + rng.uniform(0.09, 0.2), beside - thick - 0.01)
    turns = np.linspace(0, np.pi, 9)
    square = rng.uniform(0.5, 1.0)  # 1: half an ellipse, less: flatter
    lift = np.sign(np.cos(turns)) * np.abs(np.cos(turns)) ** square
    y = (low + high) / 2 - lift * (high - low) / 2
    inner = r0 + (r1 - r0) * (y - low) / (high - low) - 0.5 * thick
    x = inner + (out - inner) * np.sin(turns) ** square
    sides = (1, -1) if rng.random() < two else (1,)
    for side in sides:
        field, box_low, box_high = tube([(side * a, b, 0) for a, b in zip(x, y, strict=True)], thick)
        solid.add(field, box_low, box_high, blend=0.01)
