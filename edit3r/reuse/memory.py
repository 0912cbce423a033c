"""What stages answered in this run and in the one before it, by fingerprint."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from edit3r.reporting import note
from edit3r.reuse.store import Entry, load_entry, read_key, save_entry

Answer = TypeVar("Answer")
SUFFIX = ".safetensors"


class Memory:
    """Answers of an earlier run, if there is one, and those of this run that the next may want.

    Which stages were `reused` and which `computed` stands under `reuse.*` of the run's notes.
    """

    def __init__(self, folder: Path | None = None) -> None:
        files = sorted(folder.glob(f"*-*{SUFFIX}")) if folder is not None else []
        self._files = {read_key(file)[1]: file for file in files}
        self._entries: dict[str, Entry] = {}
        self.reused: list[str] = []
        self.computed: list[str] = []

    def recall(
        self,
        stage: str,
        key: str,
        compute: Callable[[], Answer],
        pack: Callable[[Answer], tuple[dict, Any]],
        unpack: Callable[[dict, Any], Answer],
    ) -> Answer:
        """What `compute` answers, from memory where `key` is known; `pack` makes tensors and JSON data of it."""
        known = self._entries.get(key)
        if known is None and key in self._files:
            known = self._entries[key] = load_entry(self._files[key])
            self._count(self.reused, stage)
        if known is not None:
            return unpack(known.tensors, known.facts)
        answer = compute()
        self._count(self.computed, stage)
        tensors, facts = pack(answer)
        self._entries[key] = Entry(stage, key, tensors, facts)
        return answer

    def save(self, folder: Path) -> None:
        """Write everything that this run asked for; what an earlier run wrote is copied."""
        for key, entry in self._entries.items():
            file = folder / f"{entry.stage}-{key[:16]}{SUFFIX}"
            if key in self._files:
                shutil.copyfile(self._files[key], file)
            else:
                save_entry(file, entry)

    def _count(self, stages: list[str], stage: str) -> None:
        stages.append(stage)
        note("reuse.reused", list(self.reused))
        note("reuse.computed", list(self.computed))
