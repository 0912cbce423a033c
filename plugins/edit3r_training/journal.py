"""The log of a training: JSON lines, and TensorBoard when it is installed."""

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edit3r.contract.errors import RunError

LOG = "log.jsonl"


class Journal:
    """One JSON object a line in `log.jsonl`. On resuming, lines beyond the resumed step go."""

    def __init__(self, folder: Path, step: int = 0) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / LOG
        self._start = time.time()
        self._forget_after(step)
        self._board = _tensorboard(folder)

    def write(
        self, step: int, values: Mapping[str, float], kind: str = "train"
    ) -> None:
        """Record `values` of a step; `kind` is 'train' or 'validation'."""
        numbers = {name: round(float(value), 6) for name, value in values.items()}
        self._add(kind, step, numbers)
        if self._board is not None:
            for name, value in values.items():
                self._board.add_scalar(f"{kind}/{name}", value, step)

    def tell_changes(self, step: int, changes: Sequence[str]) -> None:
        """Record that a training went on after a step with other settings."""
        self._add("resumed", step, {"changes": list(changes)})

    def _add(self, kind: str, step: int, values: Mapping[str, Any]) -> None:
        seconds = round(time.time() - self._start, 2)
        line = {"kind": kind, "step": step, "seconds": seconds, **values}
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise RunError(
                f"{self.path}: the log could not be written ({error}); free some disk space."
            ) from error

    def _forget_after(self, step: int) -> None:
        if not self.path.is_file():
            return
        text = self.path.read_text(encoding="utf-8", errors="replace")
        lines = text.splitlines(keepends=True)
        kept = [
            line for line in lines if line.endswith("\n") and _step_of(line) <= step
        ]
        self.path.write_text("".join(kept), encoding="utf-8")


def _step_of(line: str) -> float:
    """The step of a line of the log; infinite for what is no such line, so that it is taken out."""
    try:
        return float(json.loads(line)["step"])
    except (ValueError, KeyError, TypeError):
        return float("inf")


def _tensorboard(folder: Path):
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:  # an extra; the JSON lines hold the same numbers
        return None
    return SummaryWriter(str(folder / "tensorboard"))
