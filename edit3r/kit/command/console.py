"""What a run says while it works: a line per finished stage, a progress bar inside one, warnings as
they come.
"""

import json
import sys
import threading
import time
from collections.abc import Mapping
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

EVERY = 15.0  # seconds between lines where no bar can be drawn
_TOLD_FROM = 0.1  # share of a run from which its first part tells how long all takes


class StageConsole:
    """Listener for `Report.on_event`; use as a context manager around the run.

    `shares` are those of a run's usual time that its steps take, in their order; see `_WholeRun`.
    """

    def __init__(
        self, quiet: bool = False, shares: Mapping[str, float] | None = None
    ) -> None:
        self.console = Console(
            stderr=True, quiet=quiet, highlight=False, soft_wrap=True
        )
        columns = (
            TextColumn("  {task.description}"),
            BarColumn(bar_width=24),
            TimeElapsedColumn(),
            TimeRemainingColumn(elapsed_when_finished=False),
        )
        # closed for programs that services start, and for those without a window
        is_terminal = sys.stderr is not None and sys.stderr.isatty()
        has_bars = is_terminal or self.console.is_jupyter
        self.progress = Progress(
            *columns, console=self.console, transient=True, disable=not has_bars
        )
        self.lines = (
            None if has_bars or quiet else ProgressLines(self.console, shares or {})
        )
        self.tasks: dict[str, TaskID] = {}
        self.started: dict[str, float] = {}

    def __enter__(self) -> "StageConsole":
        self.progress.start()
        if self.lines is not None:
            self.lines.start()
        return self

    def __exit__(
        self,
        kind: type | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.progress.stop()
        if self.lines is not None:
            self.lines.stop()

    def __call__(self, event: str, text: str, done: int, total: int) -> None:
        text = printable(text)
        if self.lines is not None:
            self.lines.hear(event, text, done, total)
        if event == "start":
            self.started[text] = time.perf_counter()
            self.tasks[text] = self.progress.add_task(text, total=None)
        elif event == "end":
            self._clear()
            seconds = time.perf_counter() - self.started.pop(text)
            self.console.print(f"  {text:<44}{seconds:7.2f} s", markup=False)
        elif event == "say":
            self.console.print(f"  {text}", style="dim", markup=False)
        elif event == "warn":
            self.console.print(f"  warning: {text}", style="yellow", markup=False)
        elif event == "progress":
            if text not in self.tasks:
                self.tasks[text] = self.progress.add_task(text, total=total)
            self.progress.update(self.tasks[text], completed=done, total=total)

    def _clear(self) -> None:
        """Drop the bars of the stage that ended, its inner ones included."""
        for task in self.tasks.values():
            self.progress.remove_task(task)
        self.tasks.clear()


class ProgressLines:
    """What is being done, as a line every `EVERY` seconds, for outputs that are no terminal."""

    def __init__(
        self,
        console: Console,
        shares: Mapping[str, float],
        every: float = EVERY,
    ) -> None:
        self.console = console
        self.every = every
        self.whole = _WholeRun(shares)
        self.doing: dict[str, float] = {}  # when stages began; the inner ones come last
        # text, done, total, begun
        self.counted: tuple[str, int, int, float] | None = None
        self.over = threading.Event()
        self.thread = threading.Thread(target=self._speak, daemon=True)

    def start(self) -> None:
        self.thread.start()

    def stop(self) -> None:
        self.over.set()
        self.thread.join()

    def hear(self, event: str, text: str, done: int, total: int) -> None:
        self.whole.hear(event, text, done, total)
        if event == "start":
            self.doing[text] = time.perf_counter()
        elif event == "end":
            self.doing.pop(text, None)
            self.counted = None
        elif event == "progress":
            known = self.counted
            is_same = known is not None and known[0] == text and known[1] <= done
            begun = known[3] if known and is_same else time.perf_counter()
            self.counted = (text, done, total, begun)

    def line(self) -> str:
        """What to say now; "" where nothing is being done."""
        told, left = self._doing()
        whole = self.whole.left()
        if told and whole is not None:
            return f"{told}, about {duration(whole)} left for all"
        return told if left is None else f"{told}, about {duration(left)} left"

    def _doing(self) -> tuple[str, float | None]:
        """What is being done, "" where nothing is, and the seconds that it still takes."""
        counted = self.counted
        if counted is None or counted[1] >= counted[2]:
            doing = list(self.doing.items())  # at once: the run goes on meanwhile
            if not doing:
                return "", None
            stage, begun = doing[-1]
            return f"{stage}: {duration(time.perf_counter() - begun)} so far", None
        text, done, total, begun = counted
        told = f"{text}: {done} of {total}"
        if not done:
            return told, None
        return told, (time.perf_counter() - begun) / done * (total - done)

    def _speak(self) -> None:
        while not self.over.wait(self.every):
            line = self.line()
            if line:
                self.console.print(f"  {line}", style="dim", markup=False)


class _WholeRun:
    """How long a run still takes, by the shares of its time that its steps usually take.

    Steps are stages, without what stands in brackets, and what counts within them, in their order:
    what begins has all before it done, or left out. Other stages, such as edits, tell nothing of
    what follows, nor does what is counted once more or only now and then: their time does not
    count. A step that is well under way tells itself how long it takes.
    """

    def __init__(self, shares: Mapping[str, float]) -> None:
        self.shares = dict(shares)
        self.ends: dict[str, float] = {}
        over = 0.0
        for name, share in self.shares.items():
            over += share
            self.ends[name] = over
        self.total = over
        # share of the time that is over, when that was, and how long it took until then [s]
        self.over, self.at, self.spent = 0.0, 0.0, 0.0
        self.step = ""  # the one that runs or waits; "": none that is known
        self.begun = 0.0  # when it began
        self.waits = False  # for what is not known

    def hear(self, event: str, text: str, done: int, total: int) -> None:
        name = text.partition(" (")[0]
        known = name in self.shares and self.ends[name] > self.over
        if event == "start" and not known:
            self._reach(self.over, "")
        elif known and event in ("start", "end", "progress"):
            part = {"start": 0.0, "end": 1.0}.get(event, done / max(total, 1))
            begin = self.ends[name] - self.shares[name]
            self._reach(max(self.over, begin + part * self.shares[name]), name)
        elif event == "progress" and name != self.step:
            self._reach(self.over, self.step, waits=True)

    def _reach(self, over: float, step: str, waits: bool = False) -> None:
        now = time.perf_counter()
        if self.step and not self.waits:
            self.spent += now - self.at
        if step != self.step:
            self.begun = now
        self.over, self.at, self.step, self.waits = over, now, step, waits

    def left(self) -> float | None:
        """Seconds; None before a tenth of the run, and while nothing known is done."""
        if not self.step or self.over < _TOLD_FROM * self.total:
            return None
        pace = self.spent / self.over
        if self.waits:
            return pace * (self.total - self.over)
        end, share = self.ends[self.step], self.shares[self.step]
        part = 1 - (end - self.over) / share
        own = pace * (end - self.over)
        if _TOLD_FROM < part < 1:
            own = (self.at - self.begun) * (1 - part) / part
        since = time.perf_counter() - self.at
        return pace * (self.total - end) + max(0.0, own - since)


def duration(seconds: float) -> str:
    """A time as people say it, such as "40 s" or "3 min"."""
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def print_json(event: str, text: str, done: int, total: int) -> None:
    """Listener that writes each event as one line of JSON to standard error, for programs that
    watch a run.

    Keys: event (start, end, say, warn or progress), text, done, total, and at [seconds since 1970].
    """
    line = {
        "event": event,
        "text": text,
        "done": done,
        "total": total,
        "at": round(time.time(), 3),
    }
    print(json.dumps(line), file=sys.stderr, flush=True)


def printable(text: str) -> str:
    """The text for a terminal: names in it may be no UTF-8, or hold commands for the terminal."""
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)
