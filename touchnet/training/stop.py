"""Stopping a run between two steps."""

from __future__ import annotations

import signal


class stop_requests:
    """Context in which Ctrl-C and SIGTERM ask the loop to stop after the step under way; `is_set` says one came."""

    def __init__(self) -> None:
        self.is_set = False

    def __enter__(self) -> stop_requests:
        def ask(signum: int, frame: object) -> None:
            if self.is_set:
                raise KeyboardInterrupt
            self.is_set = True

        self.before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self.before.items():
            signal.signal(number, handler)
