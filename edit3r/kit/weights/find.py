"""Learned weights that components can use: where the files lie on this machine.

A component names its weights in `Component.weights`. `edit3r weights get NAME` puts them into
`folder()`; nothing else does, and nothing is downloaded by `find`. Imports no torch and no foreign
library.
"""

import os
from contextlib import suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.contract.weights import Weights
from edit3r.kit.files.names import expanded, user_cache
from edit3r.kit.files.text import read_json

VARIABLE = "EDIT3R_WEIGHTS"
"""Environment variable that names the folder of all weights."""

RECORD = "source.json"
"""In the folder of fetched weights: where they came from, at which revision, and every file's
SHA-256.
"""


def folder(chosen: str | Path | None = None) -> Path:
    """The folder of all weights: `chosen`, else $EDIT3R_WEIGHTS, else edit3r/weights in the user's
    cache. Raises InputError for a user who has none.
    """
    named = chosen or os.environ.get(VARIABLE)
    cache = user_cache()
    if named:
        return expanded(named).absolute()
    if cache is None:
        raise InputError(
            "no place for weights: this user has no home folder; name a folder in the environment "
            f"variable {VARIABLE}."
        )
    return cache / "edit3r" / "weights"


def find(weights: Weights, chosen: str | Path | None = None) -> Path:
    """The file of these weights, or their folder where they are several; never downloads.

    Raises MissingDependencyError with licence and the command that fetches them, where they are not
    at hand.
    """
    place = at_hand(weights, chosen)
    if place is None:
        raise MissingDependencyError(
            f"the weights {weights.name!r} ({weights.purpose}) are not on this machine; fetch them "
            f"with: {weights.get} ({weights.terms})"
        )
    return place


def at_hand(weights: Weights, chosen: str | Path | None = None) -> Path | None:
    """Where these weights lie, as `find` returns it; None where they do not.

    They are looked for in `folder` and, for those of the hub, in the cache that its own client
    keeps.
    """
    home = None
    with suppress(InputError):  # without a home there is no such folder
        home = folder(chosen) / weights.name
    for place in (home, _in_hub_cache(weights)):
        stored = [weights.stored(path) for path, _ in weights.files]
        if place is None:
            continue
        fetched = record_of(place).get("revision", weights.revision)
        if weights.revision not in ("", fetched):
            continue
        if all(any(place.glob(path)) for path in stored):
            single = len(stored) == 1 and not set("*?[") & set(stored[0])
            return place / stored[0] if single else place
    return None


def matches(path: str, pattern: str) -> bool:
    """Whether a file of the source is meant by a pattern; `*` stays within one folder."""
    return path.count("/") == pattern.count("/") and fnmatchcase(path, pattern)


def record_of(place: Path) -> dict[str, Any]:
    """What was noted beside fetched weights (see RECORD); nothing for others."""
    with suppress(OSError, ValueError):
        record = read_json(place / RECORD)
        return record if isinstance(record, dict) else {}
    return {}


def _in_hub_cache(weights: Weights) -> Path | None:
    """The folder of the declared revision in the hub client's cache, found without the client."""
    if not weights.source.startswith("hub:"):
        return None
    home = os.environ.get("HF_HOME") or (user_cache() or Path()) / "huggingface"
    cache = Path(
        os.path.expanduser(os.environ.get("HF_HUB_CACHE") or Path(home, "hub"))
    )
    if not cache.is_absolute() and user_cache() is None:
        return None
    model = cache / f"models--{weights.source.removeprefix('hub:').replace('/', '--')}"
    revision = weights.revision
    with suppress(OSError):
        revision = (
            revision or (model / "refs" / "main").read_text(encoding="utf-8").strip()
        )
    return model / "snapshots" / revision if revision else None
