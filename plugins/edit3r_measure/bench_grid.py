"""`edit3r bench grid`: every installed editor with every reconstructor on the same edits, one table, one page.

What cannot run here is a row with the reason; nothing is downloaded, and no service is asked that was not named.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from edit3r.errors import Edit3rError, SettingsError
from edit3r.plugins import Offer
from edit3r.registry import Registry
from edit3r.weights import find
from edit3r_measure.bench_item import Method
from edit3r_measure.bench_page import write_page
from edit3r_measure.bench_report import CPU, FORMS, Column, mean_of, read_columns, timing, title
from edit3r_measure.oracle import ORACLE
from edit3r_measure.report import format_or_dash, make_folder, markdown_table, write_text

SHOWN = (
    "score",
    "psnr-in-edit",
    "psnr-in-background",
    "edit-uptake-2d",
    "consistency-2d",
    "consistency-warped",
    "sharpness",
)
"""Measures of the table; the folders of the pairs hold all."""

Pairs = Sequence[tuple[Method, str]]
"""Methods, and why they cannot run here; "" when they can."""


def pairs_of(
    registry: Registry, asked: Mapping[str, Sequence[str]], common: Mapping[str, Any], settings: Mapping[str, Any]
) -> Pairs:
    """Return every pair of the editors and reconstructors that are `asked` for by name, of all installed without names.

    `common` are fields that all methods share; `settings` are those of components, by kind and name.
    """
    known = {kind: [offer.component.name for offer in registry.offers(kind)] for kind in ("editor", "reconstructor")}
    names = {kind: list(asked.get(kind) or known[kind]) for kind in known}
    if not asked.get("editor"):
        names["editor"].insert(0, ORACLE)
    for kind, unknown in ((kind, set(settings.get(kind, {})) - set(names[kind])) for kind in names):
        if unknown:
            raise SettingsError(f"--set {kind}.{min(unknown)}: expected {kind}.NAME.SETTING of one in the grid.")
    own = {(kind, name): settings.get(kind, {}).get(name, {}) for kind in names for name in names[kind]}
    reasons = {
        (kind, name): ""
        if name == ORACLE
        else _reason(registry, registry.find(kind, name), values, bool(asked.get(kind)))
        for (kind, name), values in own.items()
    }
    pairs = []
    for editor in names["editor"]:
        for reconstructor in names["reconstructor"]:
            parts = {"editor": editor, "reconstructor": reconstructor}
            chosen = {kind: {"name": name, **own[kind, name]} for kind, name in parts.items()}
            reason = " ".join(dict.fromkeys(filter(None, (reasons[part] for part in parts.items()))))
            pairs.append((Method(**chosen, **common), reason))
    return pairs


def _reason(registry: Registry, offer: Offer, settings: Mapping[str, Any], named: bool) -> str:
    """Return why a component cannot be built here, in a sentence; "" when it can."""
    component = offer.component
    if component.needs_network and not component.weights and not named:
        return f"{component.name} reaches out to the network (a service that costs money, say); name it to include it."
    if component.needs_gpu and not torch.cuda.is_available():
        return f"{component.name} needs a GPU, and there is none here."
    parts = {"editor": registry.build("editor", "none")} if "editor" in component.parts else {}
    try:
        for weights in component.weights if component.needs_network else ():
            find(weights)
        registry.build(offer.kind, component.name, parts, **settings)
    except Edit3rError as error:
        return f"{component.name}: {error}"
    return ""


def write_grid(out: Path, pairs: Pairs, pictures: int) -> str:
    """Write grid.md and index.html, and return the table; the pairs' folders lie in `out`."""
    make_folder(out)
    ran = {method.label for method, reason in pairs if not reason}
    columns = {column.label: column for column in read_columns([out])} if ran else {}
    shown = [columns[method.label] for method, reason in pairs if not reason]
    in_order = sorted(pairs, key=lambda pair: bool(pair[1]))  # first those that ran
    rows = [_row(method.label, reason, columns.get(method.label)) for method, reason in in_order]
    head = ["editor + reconstructor", "edits", "failed", *map(title, SHOWN), "[s CPU]", "what to know"]
    table = markdown_table(head, rows)
    scenes = {result.scene for column in shown[:1] for result in column.results.values()}
    text = (
        f"# Grid of {len(pairs)} pairs\n\n{len(ran)} ran, on {len(shown[0].results) if shown else 0} edits of "
        f"{len(scenes)} scenes; the others say why not. Means over scenes. Only `oracle` has a truth to meet.\n\n"
        f"{table}\n"
    )
    write_text(out / "grid.md", text)
    write_page(out / "index.html", text, shown, pictures)
    return table


def _row(label: str, reason: str, column: Column | None) -> list[str]:
    if column is None:
        return [label, "0", "-", *("-" for _ in SHOWN), "-", reason]
    said = Counter(result.failure or result.remark.partition(":")[0] for result in column.results.values())
    said.pop("", None)
    notes = " ".join(f"{count} x {sentence}" for sentence, count in said.most_common())
    times = timing(column)
    times = times["warm"] or times["cold"]
    means = [format_or_dash(mean and mean.mean, FORMS[name][1]) for name in SHOWN for mean in [mean_of(column, name)]]
    seconds = format_or_dash(times and sum(times[name] for name in CPU), ".3g")
    return [label, str(len(column.results)), str(len(column.failures)), *means, seconds, notes.replace("|", "/")]
