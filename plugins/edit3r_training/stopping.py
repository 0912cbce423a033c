"""Signals that ask a training to stop, and what must be done whole before it does."""

import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType


class StopRequest(ExitStack):
    """Context manager; `asked` turns True at SIGINT or SIGTERM. A second signal acts as it would
    have before.

    With `at_once`, SIGINT raises KeyboardInterrupt too, but not inside `held()`.
    """

    asked = False  # by any signal
    interrupted = False  # by SIGINT

    def __init__(self, at_once: bool = False) -> None:
        super().__init__()
        self.at_once = at_once

    def __enter__(self) -> "StopRequest":
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self.callback(signal.signal, number, signal.signal(number, self._ask))
        return self

    @contextmanager
    def held(self) -> Iterator[None]:
        """What must be done whole: SIGINT raises after it."""
        before, self.at_once = self.at_once, False
        try:
            yield
        finally:
            self.at_once = before
        if before and self.interrupted:
            self.at_once = False  # once is enough
            raise KeyboardInterrupt

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        self.interrupted |= number == signal.SIGINT
        self.close()  # the handlers that were there before
        if self.interrupted and self.at_once:
            self.at_once = False
            raise KeyboardInterrupt
