"""The figures of docs/results.md: methods on four edits of generated scenes, whose truth is known.

    python benchmarks/results.py "AMD EPYC, one thread"                          ours
    python benchmarks/results.py "RTX 4090" --config mine.yaml --plugin mine.py  yours

Each method of the configuration has its file in docs/results, which says its name, link and what
it is; figures and picture come from here. Each runs in a process of its own, so that the peak of
memory is its own, and does one edit before those that count.
"""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from datetime import date
from pathlib import Path

from edit3r_bench.generated import GeneratedSettings, build_generated
from edit3r_bench.manifest import Manifest, write_bench_manifest
from edit3r_bench.method import read_methods
from edit3r_bench.report import read_columns
from edit3r_bench.results import (
    MethodResults,
    figures_of,
    write_method_results,
)
from harness import Row, run_benchmark
from PIL import Image

from edit3r import default_registry
from edit3r.contract.settings import make_settings
from edit3r.kit.command.results import make_folder
from edit3r.kit.compute.lpips import lpips_weights
from edit3r.kit.files.configs import read_config, read_yaml

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs/results"
BODIES = str(ROOT / "benchmarks/implicit_scenes.py")
SIZE, SEED = 96, 31  # [pixels]; the first seed that was tried
# dataset, and the edits of its two scenes; the very first is the one that does not count
SCENES = {
    "rooms": ("procedural", (("modify", "add"), ("remove",))),
    "bodies": ("implicit", (("modify",), ("global",))),
}
PICTURE = 560  # width of a method's picture [pixels]


def results(
    hardware: str,
    *,
    config: str = "bench/results",
    plugin: Sequence[str] = (),
    clip: str = "",
    out: Path = ROOT / "runs/results",
) -> Iterator[Row]:
    plugins = [word for file in (BODIES, *plugin) for word in ("--plugin", file)]
    labels = [one.label for one in read_methods(read_config(config, True), {})]
    files = {label: RESULTS / f"{label}.yaml" for label in labels}
    known = {label: read_yaml(file) for label, file in files.items()}
    manifest = make_folder(out) / "bench.json"
    if not manifest.is_file():
        write_bench_manifest(manifest, edits())
    for label in labels:
        command = [*("edit3r", "bench", "run"), str(manifest), "--config", config]
        command += ["--only", label, "--out", str(out), "--no-effnet", *plugins]
        command += ["--lpips"] * bool(lpips_weights())
        command += ["--clip", clip] * bool(clip)
        subprocess.run([sys.executable, "-m", *command], check=True)
        (column,) = read_columns([out / label])
        rows = [one.model_dump(exclude_none=True) for one in figures_of(column)]
        found = {"hardware": hardware, "measured": date.today(), "missing": ""}
        content = make_settings(
            MethodResults, known[label] | found | {"rows": rows}, label
        )
        write_method_results(files[label], content)
        sheet = Image.open(out / label / "pictures/rooms-1-add.webp")
        sheet.thumbnail((PICTURE, PICTURE))
        sheet.save(files[label].with_suffix(".webp"), quality=60)
        yield {"method": label, "edits": str(len(rows)), "file": files[label].name}


def edits() -> Manifest:
    """The edits of two rooms and two groups of bodies."""
    registry = default_registry((BODIES,))
    scenes, items = [], []
    for name, (dataset, asked) in SCENES.items():
        drawn = GeneratedSettings(dataset=dataset, seed=SEED, image_size=SIZE)
        built = build_generated(len(asked), drawn, registry)
        for number, (scene, kinds) in enumerate(zip(built.scenes, asked), 1):
            called = {"scene": f"{name}-{number}"}
            scenes.append(scene.model_copy(update={"id": called["scene"]}))
            own = {item.id.removeprefix(f"{scene.id}-"): item for item in built.items}
            items += [
                own[kind].model_copy(update={**called, "id": f"{name}-{number}-{kind}"})
                for kind in kinds
            ]
    return Manifest(
        name="results", image_size=SIZE, scenes=tuple(scenes), items=tuple(items)
    )


if __name__ == "__main__":
    run_benchmark(results)
