"""Training logs: one JSON object a line, and TensorBoard when it is installed."""

import json
import time
from collections.abc import Mapping
from pathlib import Path

from edit3r.errors import RunError


class Journal:
    """Appends to `log.jsonl` in a folder; on resuming, lines beyond the resumed step are taken out."""

    def __init__(self, folder: Path, step: int = 0) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / "log.jsonl"
        self._start = time.time()
        self._forget_after(step)
        self._board = _tensorboard(folder)

    def write(self, step: int, values: Mapping[str, float], kind: str = "train") -> None:
        """Record `values` of a step; `kind` is 'train' or 'validation'."""
        line = {"kind": kind, "step": step, "seconds": round(time.time() - self._start, 2)}
        line |= {name: round(float(value), 6) for name, value in values.items()}
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise RunError(f"{self.path}: the log could not be written ({error}); free some disk space.") from error
        if self._board is not None:
            for name, value in values.items():
                self._board.add_scalar(f"{kind}/{name}", value, step)

    def _forget_after(self, step: int) -> None:
        if self.path.is_file():
            lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)
            kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= step]
            self.path.write_text("".join(kept), encoding="utf-8")


def _tensorboard(folder: Path):
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:  # an extra; the JSON lines hold the same numbers
        return None
    return SummaryWriter(str(folder / "tensorboard"))
