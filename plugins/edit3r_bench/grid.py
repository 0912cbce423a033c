"""`edit3r bench grid`: every installed editor with every reconstructor on the same edits, one
table.

What cannot run here is a row with the reason; nothing is downloaded, and no service is asked that
was not named.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from edit3r import Registry
from edit3r.contract.errors import SettingsError
from edit3r.kit.command.results import write_text
from edit3r_bench.method import Method
from edit3r_bench.options import RunOptions
from edit3r_bench.oracle import ORACLE
from edit3r_bench.report import (
    CPU,
    MEASURES,
    Column,
    mean_of,
    read_columns,
    timing,
    title,
)

# Measures of the table; the folders of the pairs hold all
SHOWN = (
    "score",
    "psnr-in-edit",
    "psnr-in-background",
    "edit-uptake-2d",
    "consistency-2d",
    "consistency-warped",
)


@dataclass(frozen=True)
class GridPair:
    """An editor with a reconstructor."""

    method: Method
    skipped: str = ""  # why it is not tried


def pairs_of(
    registry: Registry,
    options: RunOptions,
    settings: Mapping[str, Mapping[str, Any]],
) -> list[GridPair]:
    """Return pairs of the editors and reconstructors that are asked for, with commas between (none:
    all); `settings` are those of components by kind and name.
    """
    names = {}
    for kind in ("editor", "reconstructor"):
        installed = [offer.component.name for offer in registry.offers(kind)]
        names[kind] = [ORACLE, *installed] if kind == "editor" else installed
        if asked := getattr(options, kind):
            names[kind] = [name.strip() for name in asked.split(",")]
    for kind, own in settings.items():
        for name in own:
            if name not in names.get(kind, ()):
                raise SettingsError(
                    f"--set {kind}.{name}: expected KIND.NAME.SETTING of an editor or "
                    "reconstructor in the grid."
                )
    components = [offer.component for offer in registry.offers("editor")]
    services = [own.name for own in components if own.needs_network and not own.weights]
    pairs = []
    for parts in product(*names.values()):
        chosen = {"rasterizer": options.rasterizer or "auto"}
        for kind, name in zip(names, parts):
            chosen[kind] = {"name": name, **settings.get(kind, {}).get(name, {})}
        skipped = ""
        if parts[0] in services and not options.editor:
            skipped = (
                f"{parts[0]} reaches out to the network, to a service that costs money, say; name "
                "it to include it."
            )
        pairs.append(GridPair(Method(**chosen), skipped))
    return pairs


def write_grid(out: Path, pairs: Sequence[GridPair]) -> str:
    """Write grid.md and return its table; the pairs' folders lie in `out`."""
    ran = [out / pair.method.label for pair in pairs if not pair.skipped]
    columns = read_columns(ran) if ran else []
    worked = [own for own in columns if len(own.failures) < len(own.results)]
    others = [own for own in columns if own not in worked]
    dashes = " - |" * len(SHOWN)
    titles = " | ".join(map(title, SHOWN))
    lines = [
        f"| editor + reconstructor | edits | scenes | failed | {titles} | [s CPU] | what to know |",
        f"| --- | --: | --: | --: |{dashes.replace('-', '--:')} --: | --- |",
        *map(_line, worked),  # those that gave something come first
        *map(_line, others),
    ]
    for pair in pairs:
        if pair.skipped:
            lines.append(
                f"| {pair.method.label} | - | - | - |{dashes} - | {pair.skipped} |"
            )
    table = "\n".join(lines)
    text = (
        f"# Grid of {len(pairs)} pairs\n\n{len(worked)} gave something; others say why not. "
        f"Means over scenes. Only `oracle` has a truth to meet.\n\n{table}\n"
    )
    write_text(out / "grid.md", text)
    return table


def _line(column: Column) -> str:
    results = column.results.values()
    cells = []
    for name in SHOWN:
        mean = mean_of(column, name)
        cells.append(f"{mean.mean:{MEASURES[name].form}}" if mean else "-")
    times = timing(column)
    seconds = times["warm"] or times["cold"]
    cells.append(f"{sum(seconds[part] for part in CPU):.3g}" if seconds else "-")
    said = Counter(own.failure or own.remark.partition(":")[0] for own in results)
    said.pop("", None)
    notes = [f"{count} x {sentence}" for sentence, count in said.most_common()]
    return (
        f"| {column.label} | {len(results)} | {len(column.scenes)} | {len(column.failures)} "
        f"| {' | '.join(cells)} | {' '.join(notes).replace('|', '/')} |"
    )
