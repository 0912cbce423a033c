"""The tables of a report in Markdown: one column a method, one row a measure, with 95 % intervals over scenes."""

from collections.abc import Callable, Iterable, Sequence

from edit3r_measure.bench.manifest import EDIT_TYPES
from edit3r_measure.bench.summary import Column, difference, mean_of, metric_names, timing
from edit3r_measure.evaluation.bootstrap import Interval

__all__ = ["ARROWS", "differences_table", "failures_list", "main_table", "notes_list", "time_table", "types_table"]

UP, DOWN = "↑", "↓"
ARROWS = {
    "score": UP,
    "psnr": UP,
    "psnr-in-edit": UP,
    "ssim": UP,
    "lpips": DOWN,
    "edit-uptake": UP,
    "edit-uptake-2d": UP,
    "edit-strength": "",
    "edit-strength-2d": "",
    "change-outside": DOWN,
    "consistency-warped": DOWN,
    "consistency-held-back": DOWN,
    "clip-t2i": UP,
    "clip-direction": UP,
    "c-fid": DOWN,
    "c-kid": DOWN,
    "c-fid-effnet": DOWN,
    "c-kid-effnet": DOWN,
}
"""Which way is better; strength is neither, it says what the edit was like."""


def main_table(columns: Sequence[Column]) -> str:
    """All measures of all methods."""
    rows = [
        [f"{name} {ARROWS[name]}".strip(), *(_cell(mean_of(c, name), name) for c in columns)]
        for name in metric_names(columns)
    ]
    counts = [
        ["edits", *(str(len(column.results)) for column in columns)],
        ["failed", *(str(len(column.failures)) for column in columns)],
    ]
    return _table(["", *(column.label for column in columns)], [*counts, *rows])


def differences_table(columns: Sequence[Column]) -> str:
    """The first method minus each other one, edit by edit."""
    first, others = columns[0], columns[1:]
    rows = [
        [f"{name} {ARROWS[name]}".strip(), *(_cell(difference(first, other, name), name, "+") for other in others)]
        for name in metric_names(columns)
    ]
    return _table(["", *(f"{first.label} - {other.label}" for other in others)], rows)


def types_table(columns: Sequence[Column], name: str) -> str:
    """One measure by type of edit."""
    kinds = [kind for kind in EDIT_TYPES if columns[0].of_type(kind).results]
    rows = [[kind, *(_cell(mean_of(column.of_type(kind), name), name) for column in columns)] for kind in kinds]
    return _table([f"{name} {ARROWS[name]}".strip(), *(column.label for column in columns)], rows)


def time_table(columns: Sequence[Column]) -> str:
    """Seconds an edit of a scene (all its views), warm medians by part, and the whole of the cold first one."""
    times = [timing(column) for column in columns]

    def row(title: str, value: Callable[[dict], float | None]) -> list[str]:
        found = [value(time) for time in times]
        return [title, *("-" if v is None else f"{v:.3g}" for v in found)]

    def warm(names: Iterable[str]) -> Callable[[dict], float | None]:
        chosen = tuple(names)
        return lambda time: time["warm"] and sum(time["warm"][name] for name in chosen)

    cpu = ("editor_cpu", "network_cpu", "rendering_cpu")
    rows = [
        row("editor, warm [s CPU]", warm(cpu[:1])),
        row("reconstruction, warm [s CPU]", warm(cpu[1:2])),
        row("rendering, warm [s CPU]", warm(cpu[2:])),
        row("all three, warm [s CPU]", warm(cpu)),
        row("all three, warm [s wall]", warm(("editor", "network", "rendering"))),
        row("all three, cold [s CPU]", lambda time: time["cold"] and sum(time["cold"][name] for name in cpu)),
        row("warm edits", lambda time: time["warm_edits"]),
    ]
    return _table(["", *(column.label for column in columns)], rows)


def failures_list(columns: Sequence[Column]) -> str:
    """Every failure with its sentence."""
    lines = [f"- {column.label}, {result.id}: {result.failure}" for column in columns for result in column.failures]
    return "\n".join(lines) + "\n" if lines else "None.\n"


def notes_list(columns: Sequence[Column]) -> str:
    """What was run under each label."""
    lines = []
    for column in columns:
        method = column.run["method"]
        parts = [_choice(method[key]) for key in ("editor", "reconstructor")]
        note = f"; {method['note']}" if method["note"] else ""
        lines.append(f"- **{column.label}**: editor {parts[0]}, reconstructor {parts[1]}{note}")
    return "\n".join(lines) + "\n"


def _choice(choice: dict) -> str:
    settings = ", ".join(f"{key}={value}" for key, value in choice["settings"].items())
    return f"`{choice['name']}`" + (f" ({settings})" if settings else "")


def _cell(interval: Interval | None, name: str, sign: str = "") -> str:
    if interval is None:
        return "-"
    form = sign + {"psnr": ".2f", "psnr-in-edit": ".2f", "c-fid": ".1f", "c-fid-effnet": ".0f"}.get(name, ".3f")
    text = format(interval.mean, form)
    return text if interval.scenes < 2 else f"{text} ({format(interval.low, form)}, {format(interval.high, form)})"


def _table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [titles, ["---"] + ["--:"] * (len(titles) - 1), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n"
