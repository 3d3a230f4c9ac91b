"""What a benchmark is, and how one is measured.

A module of this package registers functions with @benchmark; each yields Case objects, built when it is their turn.
"""

import gc
import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass

Action = Callable[[], object]


@dataclass
class Case:
    """One comparison: `ours` and `peer` do the same work. Either may be seconds that were measured elsewhere."""

    name: str
    ours: Action | float
    peer: Action | float | None = None
    peer_name: str = ""
    target: float | None = None  # least ratio peer / ours asked for
    limit: Action | float | None = None  # what cannot be beaten: work to time, or seconds
    limit_name: str = ""
    repeats: int = 20  # timed runs of each side, at least


@dataclass
class Result:
    """Medians in seconds."""

    name: str
    ours: float
    peer: float | None
    peer_name: str
    limit: float | None
    limit_name: str
    target: float | None
    repeats: int

    @property
    def ratio(self) -> float | None:
        return None if self.peer is None else self.peer / self.ours

    @property
    def met(self) -> bool | None:
        return None if self.target is None or self.ratio is None else self.ratio >= self.target

    def record(self) -> dict:
        return {**asdict(self), "ratio": self.ratio, "met": self.met}


REGISTRY: dict[str, Callable[[], Iterable[Case]]] = {}


def benchmark(function: Callable[[], Iterable[Case]]) -> Callable[[], Iterable[Case]]:
    """Register a function that yields cases, under its name."""
    if function.__name__ in REGISTRY:
        raise ValueError(f"benchmark {function.__name__} is registered twice")
    REGISTRY[function.__name__] = function
    return function


ROUND = 5  # runs of one side before it is the other's turn
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


def measure(case: Case, clock: str = "wall") -> Result:
    """Time the sides in turn, a few runs each, so that both see the same machine and each its own warm cache.

    The clock "cpu" counts the processor time of all threads: fair on a busy machine, blind to what threads gain.
    """
    now = CLOCKS[clock]
    sides = [side for side in (case.ours, case.peer, case.limit) if callable(side)]
    for side in sides:
        for _ in range(3):
            side()
    times: dict[Action, list[float]] = {side: [] for side in sides}
    gc.collect()
    gc.disable()
    try:
        for _ in range(-(-case.repeats // ROUND)):
            for side in sides:
                for _ in range(ROUND):
                    start = now()
                    side()
                    times[side].append(now() - start)
    finally:
        gc.enable()

    def seconds(side: Action | float | None) -> float | None:
        return statistics.median(times[side]) if callable(side) else side

    return Result(
        name=case.name,
        ours=seconds(case.ours),
        peer=seconds(case.peer),
        peer_name=case.peer_name,
        limit=seconds(case.limit),
        limit_name=case.limit_name,
        target=case.target,
        repeats=case.repeats,
    )


def milliseconds(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds * 1e3:.3f}" if seconds < 0.1 else f"{seconds * 1e3:.0f}"


def row(result: Result) -> list[str]:
    """Cells of the table: case, ours, peer, ratio, target, times the limit."""
    ratio = "-" if result.ratio is None else f"{result.ratio:.1f}x"
    target = "" if result.target is None else f">= {result.target:g} {'met' if result.met else 'MISSED'}"
    over = "" if result.limit is None else f"{result.ours / result.limit:.1f}x {result.limit_name}"
    peer = milliseconds(result.peer) + (f" {result.peer_name}" if result.peer_name else "")
    return [result.name, milliseconds(result.ours), peer, ratio, target, over]


HEADER = ["case", "ours ms", "peer ms", "ratio", "target", "limit"]
