"""What a run says while it works: a line per finished stage, a progress bar inside one, warnings as
they come; and tables.
"""

import json
import sys
import threading
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from edit3r.kit.files.text import printable

if TYPE_CHECKING:
    from rich.console import Console

LONGEST = 400  # characters of a cell: texts of plugins are strangers'
PIPED_WIDTH = 400  # piped output is not wrapped, so that grep finds what it looks for
EVERY = 15.0  # seconds between lines where no bar can be drawn; no figure kept


class StageConsole:
    """Listener for `Report.on_event`; use as a context manager around the run."""

    def __init__(self, quiet: bool = False) -> None:
        # rich takes a fifth of a second to import
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            Progress,
            TaskID,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

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
        self.lines = None if has_bars or quiet else ProgressLines(self.console)
        self.tasks: dict[str, TaskID] = {}
        self.started: dict[str, float] = {}

    def __enter__(self) -> "StageConsole":
        self.progress.start()
        if self.lines is not None:
            self.lines.start()
        return self

    def __exit__(self, *error: object) -> None:
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

    def __init__(self, console: "Console", every: float = EVERY) -> None:
        self.console = console
        self.every = every
        self.stages: dict[str, float] = {}  # when they began; the inner ones come last
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
        if event == "start":
            self.stages[text] = time.perf_counter()
        elif event == "end":
            self.stages.pop(text, None)
            self.counted = None
        elif event == "progress":
            known = self.counted
            is_same = known is not None and known[0] == text and known[1] <= done
            begun = known[3] if known and is_same else time.perf_counter()
            self.counted = (text, done, total, begun)

    def line(self) -> str:
        """What to say now; "" where nothing is being done."""
        now, counted = time.perf_counter(), self.counted
        if counted is None or counted[1] >= counted[2]:
            stages = list(self.stages.items())  # at once: the run goes on meanwhile
            if not stages:
                return ""
            stage, begun = stages[-1]
            return f"{stage}: {_duration(now - begun)} so far"
        text, done, total, begun = counted
        line = f"{text}: {done} of {total}"
        if not done:
            return line
        return f"{line}, about {_duration((now - begun) / done * (total - done))} left"

    def _speak(self) -> None:
        while not self.over.wait(self.every):
            line = self.line()
            if line:
                self.console.print(f"  {line}", style="dim", markup=False)


def _duration(seconds: float) -> str:
    """A time as people say it, such as "40 s" or "3 min"."""
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def print_json(event: str, text: str, done: int, total: int) -> None:
    """Listener that writes each event as one line of JSON to standard error.

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


def print_table(
    columns: Sequence[str], rows: Sequence[Sequence[str]], whole: Sequence[str] = ()
) -> None:
    """Print a table; columns in `whole` are not wrapped, and nothing is where output is piped."""
    from rich.console import Console
    from rich.table import Table

    console = Console(
        highlight=False, width=None if sys.stdout.isatty() else PIPED_WIDTH
    )
    shown = Table(box=None, header_style="bold", pad_edge=False)
    for column in columns:
        shown.add_column(column, overflow="fold", no_wrap=column in whole)
    for row in rows:
        shown.add_row(*(printable(cell)[:LONGEST] for cell in row))
    console.print(shown, markup=False)
