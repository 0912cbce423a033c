"""What a part brings: the figure that it claims, with it and without it.

    python benchmarks/without.py rim background-layer --data photos/
    python benchmarks/without.py rim --script "scenes.py dial photos/ --presets default"

A part is taken out by settings of the run, or by one name of one module, and the script that makes
its figure runs in two processes, with and without; `--script` takes that script's place. A row for
each column of the script's table: means over its rows, with the part, without it, and what it
brings. The parts are those of `PARTS`.
"""

import functools
import importlib
import json
import re
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from harness import Row, run_benchmark

HERE = Path(__file__).parent
PAIRS = (
    "scenes.py default-run {data}/monstree:4,6 {data}/bear:20,22 {data}/bear:30,32 "
    "{data}/7scenes_rgbd:12,14 --settings 384"
)


@dataclass(frozen=True)
class Part:
    """How a part is taken out, and the script whose figure it claims."""

    claims: str
    figure: str = PAIRS
    settings: Mapping[str, Any] = field(default_factory=dict)  # of `edit3r.run`
    place: str = ""  # "module:name" that is replaced by what does nothing
    nothing: Any = None


PARTS = {
    "rim": Part(
        "views beside the photos", settings={"recon": {"name": "edit3r", "rim": 0}}
    ),
    "background-layer": Part(
        "views between photos",
        settings={"recon": {"name": "edit3r", "background_layer": 0}},
    ),
    "sky": Part(
        "branches before the sky",
        settings={"matcher": {"name": "classical", "sky": False}},
    ),
    "one-light": Part("photos of other exposure", settings={"exposure": "own"}),
    "simplify": Part("Gaussians, seconds", settings={"gaussians": "all"}),
    "refine": Part("sharpness", settings={"refine": 0}),
    "main-plane": Part(
        "ground and walls beyond the overlap",
        place="edit3r_geometry.completion:main_plane",
        nothing=lambda inverse, measured: (
            np.full_like(
                inverse, np.median(inverse[measured] if measured.any() else inverse)
            ),
            (float(inverse.min()), float(inverse.max())),
        ),
    ),
    "speckles": Part(
        "depths that agree by chance",
        place="edit3r_geometry.depth_maps:without_speckles",
        nothing=lambda agrees, raw: agrees,
    ),
    "standing": Part(
        "screens, frames, watermarks",
        place="edit3r_geometry.features:without_standing",
        nothing=lambda keypoints, pairs, images: pairs,
    ),
    "lens-prior": Part(
        "the lens where nobody knows it",
        "poses.py lenses --repeats 1",
        place="edit3r_geometry.calibration:_FocalSearch._penalty",
        nothing=lambda self, log_focal: 0.0,
    ),
}


def take_out(name: str) -> None:
    """Take a part out of this process."""
    part = PARTS[name]
    if part.place:
        module, _, path = part.place.partition(":")
        *owners, name = path.split(".")
        owner = functools.reduce(getattr, owners, importlib.import_module(module))
        getattr(owner, name)  # an error where it is gone
        setattr(owner, name, part.nothing)
    if part.settings:
        import edit3r

        whole = edit3r.run
        edit3r.run = lambda *photos, **asked: whole(
            *photos, **{**part.settings, **asked}
        )


@functools.cache
def figures(words: tuple[str, ...], without: str = "") -> dict[str, float]:
    """Means of each column of the script's table, made in a process of its own."""
    with tempfile.TemporaryDirectory() as place:
        record = Path(place) / "rows.json"
        command = [sys.executable, __file__, "--child", without or "-", *words]
        done = subprocess.run([*command, "--json", str(record)], stdout=sys.stderr)
        if done.returncode:
            raise SystemExit(f"{' '.join(words)} ended with {done.returncode}")
        rows = json.loads(record.read_text())["rows"]
    columns: dict[str, list[float]] = {}
    for row in rows:
        for title, cell in row.items():
            text = str(cell)
            if re.fullmatch(r"[-\d., e+]+", text):
                for number, value in enumerate(text.split(",")):
                    name = title if "," not in text else f"{title} ({number + 1})"
                    columns.setdefault(name, []).append(float(value))
    return {title: float(np.mean(values)) for title, values in columns.items()}


def main(
    parts: Sequence[str], *, data: Path = Path("photos"), script: str = ""
) -> Iterator[Row]:
    for name in parts:
        if name not in PARTS:
            raise SystemExit(f"{name}: no such part. Parts: {', '.join(PARTS)}")
        words = tuple((script or PARTS[name].figure.format(data=data)).split())
        whole, less = figures(words), figures(words, name)
        for title, value in whole.items():
            other = less.get(title, float("nan"))
            yield {
                "part": name,
                "claims": PARTS[name].claims,
                "figure": title,
                "with": (value, ".3f"),
                "without": (other, ".3f"),
                "brings": (value - other, "+.3f"),
            }


def measure_here(without: str, script: str, *words: str) -> None:
    """Run a script in this process, without a part where one is named."""
    if without != "-":
        take_out(without)
    sys.argv = [script, *words]
    runpy.run_path(str(HERE / script), run_name="__main__")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        measure_here(*sys.argv[2:])
    else:
        run_benchmark(main)
