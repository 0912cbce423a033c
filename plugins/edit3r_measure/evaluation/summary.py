"""The scores of many pairs as a table for people (Markdown) and as records for programs."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from edit3r_measure.evaluation.novel_view import NovelViewScore

__all__ = ["markdown_table", "records"]

Column = tuple[str, Callable[[Sequence[NovelViewScore]], str]]


def _mean(field: str, form: str) -> Callable[[Sequence[NovelViewScore]], str]:
    return lambda scores: format(np.mean([getattr(score, field) for score in scores]), form)


COLUMNS: tuple[Column, ...] = (
    ("PSNR", _mean("psnr", ".2f")),
    ("best-blurred photo", _mean("blurred_psnr", ".2f")),
    ("gain", _mean("psnr_gain", "+.2f")),
    ("gain, covered pixels", _mean("covered_gain", "+.2f")),
    ("SSIM gain", _mean("ssim_gain", "+.3f")),
    ("coverage", _mean("coverage", ".3f")),
    ("median rotation error", lambda scores: f"{np.median([s.rotation_error for s in scores]):.2f}°"),
    ("under 2°", lambda scores: f"{np.mean([s.rotation_error < 2 for s in scores]):.0%}"),
    ("CPU s a pair", _mean("seconds", ".1f")),
)
"""Means over the pairs that did not fail."""


def markdown_table(scores: Sequence[NovelViewScore]) -> str:
    """One row a scene and one for all pairs, then a line for each failure."""
    scenes = list(dict.fromkeys(score.scene for score in scores))
    groups = [(scene, [score for score in scores if score.scene == scene]) for scene in scenes]
    rows = [_row(name, group) for name, group in [*groups, ("all pairs", list(scores))]]
    titles = ["scene", "pairs", "failed", *(title for title, _ in COLUMNS)]
    lines = [_line(titles), _line(["---"] + ["--:"] * (len(titles) - 1)), *map(_line, rows)]
    failures = [f"- {s.scene}, {s.first} and {s.second}: {s.failure}" for s in scores if s.failure]
    return "\n".join([*lines, *([""] if failures else []), *failures]) + "\n"


def _row(name: str, group: Sequence[NovelViewScore]) -> list[str]:
    done = [score for score in group if not score.failure]
    cells = [cell(done) if done else "-" for _, cell in COLUMNS]
    return [name, str(len(group)), str(len(group) - len(done)), *cells]


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def records(scores: Iterable[NovelViewScore]) -> list[Mapping[str, Any]]:
    """JSON data, one mapping a pair; numbers that a failure left unknown are null."""
    return [
        {key: None if isinstance(value, float) and np.isnan(value) else value for key, value in asdict(score).items()}
        for score in scores
    ]
