"""`edit3r bench grid`: every installed editor with every reconstructor on the same edits, one
table, one page.

What cannot run here is a row with the reason; nothing is downloaded, and no service is asked that
was not named.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edit3r.errors import SettingsError
from edit3r.plugins.registry import Registry
from edit3r_measure.bench_item import Method
from edit3r_measure.bench_report import (
    CPU,
    FORMS,
    Column,
    mean_of,
    read_columns,
    timing,
    title,
    write_page,
)
from edit3r_measure.oracle import ORACLE
from edit3r_measure.report import format_or_dash, markdown_table, write_text

# Measures of the table; the folders of the pairs hold all
SHOWN = (
    "score",
    "psnr-in-edit",
    "psnr-in-background",
    "edit-uptake-2d",
    "consistency-2d",
    "consistency-warped",
)

REACHES_OUT = "reaches out to the network, to a service that costs money, say; name it to include it."


def pairs_of(
    registry: Registry,
    asked: Mapping[str, Sequence[str]],
    common: Mapping[str, Any],
    settings: Mapping[str, Any],
) -> dict[str, tuple[Method, str]]:
    """Return pairs of the editors and reconstructors `asked` for (none: all), by label, and why one
    is not tried.

    `common` are fields that all methods share, `settings` those of components by kind and name.
    """
    kinds = ("editor", "reconstructor")
    offers = {
        kind: {offer.component.name: offer.component for offer in registry.offers(kind)}
        for kind in kinds
    }
    names = {
        kind: list(
            asked.get(kind) or [*([ORACLE] if kind == "editor" else []), *offers[kind]]
        )
        for kind in offers
    }
    for kind, unknown in (
        (kind, set(settings.get(kind, {})) - set(names[kind])) for kind in names
    ):
        if unknown:
            raise SettingsError(
                f"--set {kind}.{min(unknown)}: expected {kind}.NAME.SETTING of one in the grid."
            )
    pairs = {}
    for editor in names["editor"]:
        component = offers["editor"].get(editor)
        service = (
            component is not None and component.needs_network and not component.weights
        )
        for reconstructor in names["reconstructor"]:
            parts = {"editor": editor, "reconstructor": reconstructor}
            own = {
                kind: {"name": name, **settings.get(kind, {}).get(name, {})}
                for kind, name in parts.items()
            }
            method = Method(**own, **common)
            pairs[method.label] = (
                method,
                f"{editor} {REACHES_OUT}"
                if service and not asked.get("editor")
                else "",
            )
    return pairs


def write_grid(
    out: Path, pairs: Mapping[str, tuple[Method, str]], pictures: int
) -> str:
    """Write grid.md and index.html, and return the table; the pairs' folders lie in `out`."""
    ran = [out / label for label, (_, skipped) in pairs.items() if not skipped]
    columns = {column.label: column for column in (read_columns(ran) if ran else ())}
    worked = [
        column
        for column in columns.values()
        if len(column.failures) < len(column.results)
    ]
    order = [
        *(column.label for column in worked),
        *pairs,
    ]  # those that gave something first
    rows = [
        _row(label, pairs[label][1], columns.get(label))
        for label in dict.fromkeys(order)
    ]
    head = [
        "editor + reconstructor",
        "edits",
        "failed",
        *map(title, SHOWN),
        "[s CPU]",
        "what to know",
    ]
    table = markdown_table(head, rows)
    scenes = {result.scene for column in worked for result in column.results.values()}
    text = (
        f"# Grid of {len(pairs)} pairs\n\n{len(worked)} gave something on {len(scenes)} scenes; "
        "others say why not. "
        f"Means over scenes. Only `oracle` has a truth to meet.\n\n{table}\n"
    )
    write_text(out / "grid.md", text)
    write_page(out / "index.html", text, worked, pictures)
    return table


def _row(label: str, skipped: str, column: Column | None) -> list[str]:
    if column is None:
        return [label, "0", "-", *("-" for _ in SHOWN), "-", skipped]
    said = Counter(
        result.failure or result.remark.partition(":")[0]
        for result in column.results.values()
    )
    said.pop("", None)
    notes = " ".join(f"{count} x {sentence}" for sentence, count in said.most_common())
    times = timing(column)
    times = times["warm"] or times["cold"]
    means = [
        format_or_dash(mean and mean.mean, FORMS[name][1])
        for name in SHOWN
        for mean in [mean_of(column, name)]
    ]
    seconds = format_or_dash(times and sum(times[name] for name in CPU), ".3g")
    return [
        label,
        str(len(column.results)),
        str(len(column.failures)),
        *means,
        seconds,
        notes.replace("|", "/"),
    ]
