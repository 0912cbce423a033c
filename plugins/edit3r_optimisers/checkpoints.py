"""Checkpoints of fits: written whole or not at all, found again by what they were made from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from edit3r.cache import fingerprint
from edit3r.errors import InputError
from edit3r.reporting import note
from edit3r.training.checkpoint import whole_file


@dataclass(frozen=True)
class CheckpointFile:
    """The checkpoint of one fit."""

    path: Path
    every: int  # steps

    def load(self) -> dict[str, Any] | None:
        """Return what was saved last, or None; raises InputError for a file that is no checkpoint."""
        if not self.path.is_file():
            return None
        try:
            content = torch.load(self.path, weights_only=True)
            note("refit.resumed_from", {"file": self.path.name, "step": int(content["step"])})
        except Exception as error:
            reason = " ".join(str(error).split())[:200]
            raise InputError(f"{self.path}: not a checkpoint of a fit ({reason}); delete it to begin anew.") from None
        return content

    def save(self, content: Mapping[str, Any]) -> None:
        """Replace the file; raises RunError when it cannot be written."""
        with whole_file(self.path, "the checkpoint") as partial:
            torch.save(dict(content), partial)


@dataclass
class Checkpoints:
    """The checkpoint files of one scene's fits."""

    folder: Path | None  # None: none are kept
    every: int  # steps
    _used: list[Path] = field(default_factory=list)

    def file(self, name: str, *made_from: Any) -> CheckpointFile | None:
        """Return the checkpoint file of the fit `name` with these inputs; None where none are kept."""
        if self.folder is None:
            return None
        path = self.folder / f"{name}-{fingerprint(*made_from)}.pt"
        self._used.append(path)
        return CheckpointFile(path, self.every)

    def discard(self) -> None:
        """Delete the files that were used, because the work is done."""
        for path in self._used:
            path.unlink(missing_ok=True)
