"""Telling the C allocator to keep the memory of large tensors instead of giving it back after every use."""

from __future__ import annotations

import ctypes
import sys

# From glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_MAX = -4


def tune_allocator() -> bool:
    """Makes glibc keep freed memory for the rest of the process; returns whether it did.

    By default every tensor above 32 MB is mapped afresh and each of its pages is faulted in on first use, at about
    4 GB/s, which costs up to half of a training step on a CPU. There is no way back within the process, so this is
    called by commands, never at import. Elsewhere than on glibc it does nothing and returns False.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
        ctypes.CDLL(None).gnu_get_libc_version  # noqa: B018  (musl has a mallopt that does nothing)
    except (OSError, AttributeError):
        return False
    return bool(mallopt(_M_MMAP_MAX, 0)) and bool(mallopt(_M_TRIM_THRESHOLD, 2**31 - 1))
