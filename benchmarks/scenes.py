"""Photo sets of the benchmarks, and those that no setting may be chosen by."""

from pathlib import Path

HELD_OUT = ("berlin", "leuven_pair")
"""Of the sets at our disposal those that the notes name least: one pair of `berlin` was one of 28
that judged matchers (docs/notes/classical.md), `leuven_pair` was never used. Chosen 2026-11-23."""


def for_tuning(folders: list[str]) -> list[str]:
    """The folders (or names of data sets) as they are; ends the program where one is held out."""
    kept_apart = [name for name in folders if Path(name).name in HELD_OUT]
    if kept_apart:
        raise SystemExit(
            f"{', '.join(kept_apart)}: held out, no setting may be chosen by it; see "
            "benchmarks/held_out.py, which reports it apart"
        )
    return folders
