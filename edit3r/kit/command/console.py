"""What a run says while it works: a line per finished stage, a progress bar inside one, warnings as
they come.
"""

import json
import sys
import time
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)


class StageConsole:
    """Listener for `Report.on_event`; use as a context manager around the run."""

    def __init__(self, quiet: bool = False) -> None:
        self.console = Console(stderr=True, quiet=quiet, highlight=False)
        columns = (
            TextColumn("  {task.description}"),
            BarColumn(bar_width=24),
            TimeElapsedColumn(),
        )
        self.progress = Progress(
            *columns,
            console=self.console,
            transient=True,
            disable=not (sys.stderr.isatty() or self.console.is_jupyter),
        )
        self.tasks: dict[str, TaskID] = {}
        self.started: dict[str, float] = {}

    def __enter__(self) -> "StageConsole":
        self.progress.start()
        return self

    def __exit__(
        self,
        kind: type | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.progress.stop()

    def __call__(self, event: str, text: str, done: int, total: int) -> None:
        text = printable(text)
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
