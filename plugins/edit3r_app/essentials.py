"""The small networks that make a CPU complete: which are missing, and how fetching them goes."""

import os
import subprocess
import threading
from collections.abc import Callable
from typing import Any

from edit3r.contract.weights import ESSENTIALS
from edit3r.kit.children import PYTHON
from edit3r.kit.weights.find import at_hand
from edit3r.loading import declared

GET_ESSENTIALS = (*PYTHON, "-m", "edit3r", "weights", "get", ESSENTIALS, "--yes")
NOT_FETCHED = "Not fetched, for the reason above. Press again to go on."


class Essentials:
    """Fetches them once asked to, in a process of its own."""

    def __init__(self, fetched: Callable[[], None]) -> None:
        self.fetched = fetched  # called when they are there
        self.lines: list[str] = []
        self._fetching = threading.Lock()

    def state(self) -> dict[str, Any]:
        """What is missing, with its licences, and what was said while fetching it."""
        needed = [one for one in declared(()).values() if one.bundle == ESSENTIALS]
        missing = [one for one in needed if at_hand(one) is None]
        return {
            "missing": [
                {
                    "name": one.name,
                    "purpose": one.purpose,
                    "terms": f"licence: {one.terms}; from {one.source}. {one.caution}",
                    "megabytes": round(one.size / 1e6),
                }
                for one in missing
            ],
            "fetching": self._fetching.locked(),
            "lines": self.lines[-200:],
        }

    def fetch(self) -> None:
        """Begin to fetch them, unless that goes on already."""
        if self._fetching.acquire(blocking=False):
            self.lines.clear()
            threading.Thread(target=self._fetch, daemon=True).start()

    def _fetch(self) -> None:
        try:
            with subprocess.Popen(
                GET_ESSENTIALS,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
                encoding="utf-8",
                errors="replace",
            ) as child:
                self.lines += (line.rstrip() for line in child.stdout or ())
            if child.returncode:
                self.lines.append(NOT_FETCHED)
                return
            self.fetched()
            self.lines.append("Done: the next click uses them.")
        finally:
            self._fetching.release()
