"""How much memory a piece of work takes beyond what the process held before."""

import contextlib
import ctypes
import math
import sys
from collections.abc import Iterator
from pathlib import Path

_PROCESS = Path("/proc/self")


@contextlib.contextmanager
def measured_memory(into: dict[str, float]) -> Iterator[None]:
    """Context that sets into["memory"]: the peak of the resident memory inside, less what was resident at the start,
    in MiB. NaN where the system does not tell (it needs Linux's /proc with a writable clear_refs).
    """
    into["memory"] = math.nan
    try:
        # What earlier work freed goes back to the system, or work that reuses it would seem to need nothing.
        if sys.platform == "linux":
            ctypes.CDLL(None).malloc_trim(0)
        (_PROCESS / "clear_refs").write_text("5")  # the peak starts anew
        before = _status("VmRSS")
    except (OSError, AttributeError, KeyError):
        yield
        return
    yield
    into["memory"] = max(0.0, (_status("VmHWM") - before) / 1024)


def _status(name: str) -> int:
    """A line of /proc/self/status, in KiB."""
    lines = (_PROCESS / "status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))
