"""What a second edit of the same photos costs, against the first; regenerates the table in the docs.

    python benchmarks/second_edit.py --scene "opera house=photos/" "make the sails red" "make the sails blue"

The packaged motorcycle is measured always. Every command runs in a process of its own, in turn, `--rounds` times; its
stages are those of `run.json`, in wall seconds, the least of the rounds; ratios are of these, with the least and the
greatest of a round. What "in Python" means: `edit3r.pipeline.run` in one process that has loaded all it needs, without
drawing frames or writing files. Masks are what the first edit changed, grown by two pixels. Let nothing else run.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from edit3r.reuse.memory import Memory
from PIL import Image

from edit3r.io.atomic import write_between
from edit3r.io.images import load_photos, packaged_pair
from edit3r.io.masks import load_masks
from edit3r.pipeline import run

MOTORCYCLE = ("motorcycle=", "paint the motorcycle blue", "paint the motorcycle green")
STAGES = {
    "edit": ("read photos", "load components", "edit"),
    "reconstruct": ("reconstruct",),
    "render": ("render",),
    "write files": ("write files",),
}
START, END = "<!-- second edit: written by benchmarks/second_edit.py -->", "<!-- end of second edit -->"


@dataclass(frozen=True)
class Scene:
    """Photos, two prompts, and a folder for what they become."""

    name: str
    photos: list[str]
    cameras: Path | None
    prompts: tuple[str, str]
    work: Path

    @property
    def masks(self) -> list[str]:
        return sorted(str(file) for file in (self.work / "masks").glob("*.png"))


@dataclass(frozen=True)
class Case:
    """One command, and the one whose cost it is held against."""

    name: str
    text: str
    masked: bool
    after: str = ""  # name of the case it continues; of the first edit it is compared with
    photos: bool = True  # given again


CASES = (
    Case("first", "first edit", False),
    Case("again", "photos and `--from`", False, "first"),
    Case("further", "`--from` alone", False, "first", photos=False),
    Case("first masked", "first edit, masks", True),
    Case("again masked", "photos, `--from` and masks", True, "first masked"),
    Case("further masked", "`--from` and masks", True, "first masked", photos=False),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    scene = {"nargs": 3, "action": "append", "default": [], "metavar": ("NAME=FOLDER", "PROMPT", "PROMPT")}
    parser.add_argument("--scene", help="more photos, and two edits of them", **scene)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--write", type=Path, help="Markdown file whose table to replace")
    args = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as work:
        for named, *prompts in [MOTORCYCLE, *args.scene]:
            name, _, folder = named.partition("=")
            photos, cameras = ([folder], None) if folder else packaged_pair()
            rows += measured(Scene(name, photos, cameras, tuple(prompts), Path(work) / name), args.rounds)
    table = HEAD + "\n".join(rows)
    print(table)
    if args.write:
        write_between(args.write, START, END, f"{table}\n")


HEAD = (
    "| | edit | reconstruct | render | write files | all | of the first | in Python | of the first |\n"
    "| --- | --: | --: | --: | --: | --: | --: | --: | --: |\n"
)


def measured(scene: Scene, rounds: int) -> list[str]:
    """A row of the table for each case."""
    scene.work.mkdir()
    command(scene, CASES[0])  # once for the masks, and for what a first run compiles
    make_masks(scene)
    stages: dict[str, list[dict[str, float]]] = {case.name: [] for case in CASES}
    inside: dict[str, list[float]] = {case.name: [] for case in CASES}
    for _ in range(rounds):
        for case in CASES:
            stages[case.name].append(command(scene, case))
        for name, seconds in in_python(scene).items():
            inside[name].append(seconds)
    return rows_of(scene, stages, inside)


def command(scene: Scene, case: Case) -> dict[str, float]:
    """Seconds of each group of stages of `edit3r run` in a new process."""
    out, first = scene.work / case.name, scene.work / (case.after or case.name)
    shutil.rmtree(out, ignore_errors=True)
    words = [sys.executable, "-m", "edit3r.cli.main", "run", "--quiet", "--out", str(out)]
    words += ["--prompt", scene.prompts[bool(case.after)]]
    words += scene.photos if case.photos else []
    words += ["--cameras", str(scene.cameras)] if scene.cameras and case.photos else []
    words += ["--from", str(first)] if case.after else []
    words += ["--mask", *scene.masks] if case.masked else []
    subprocess.run(words, check=True)
    records = json.loads((out / "run.json").read_text(encoding="utf-8"))["stages"]
    return {group: sum(r["seconds"] for r in records if r["name"].startswith(names)) for group, names in STAGES.items()}


def make_masks(scene: Scene) -> None:
    """What the first edit changed, a little grown, as files."""
    (scene.work / "masks").mkdir()
    for file in sorted((scene.work / "first" / "inputs").glob("*.png")):
        photo, edited = (
            np.array(Image.open(folder / file.name)) for folder in (file.parent, file.parents[1] / "edited")
        )
        changed = (photo != edited).any(-1).astype(np.uint8) * 255
        cv2.imwrite(str(scene.work / "masks" / file.name), cv2.dilate(changed, np.ones((5, 5))))


def in_python(scene: Scene) -> dict[str, float]:
    """Seconds to the Gaussians of each case that starts from photos."""
    photos = load_photos(scene.photos, cameras=scene.cameras)
    masks = load_masks(scene.masks, photos)
    small = load_photos(scene.photos, cameras=scene.cameras, size=96)
    run(small.views, scene.prompts[0], masks=load_masks(scene.masks, small))  # loads all that will be needed
    seconds = {}
    for given, names in ((None, ("first", "again")), (masks, ("first masked", "again masked"))):
        memory = Memory()
        for name, prompt in zip(names, scene.prompts, strict=True):
            start = time.perf_counter()
            run(photos.views, prompt, masks=given, memory=memory)
            seconds[name] = time.perf_counter() - start
    return seconds


def rows_of(scene: Scene, stages: dict[str, list[dict[str, float]]], inside: dict[str, list[float]]) -> list[str]:
    """The lines of the table."""
    rows = []
    for case in CASES:
        groups = [f"{min(run[group] for run in stages[case.name]):.1f}" for group in STAGES]
        wholes = {name: [sum(run.values()) for run in runs] for name, runs in stages.items()}
        cells = [*groups, *against_first(wholes, case), *against_first(inside, case)]
        rows.append(f"| {scene.name}: {case.text} | {' | '.join(cells)} |")
    return rows


def against_first(seconds: dict[str, list[float]], case: Case) -> tuple[str, str]:
    """The least of a case's seconds, and its ratio to that of the first edit; empty where not measured."""
    own, first = seconds[case.name], seconds.get(case.after, [])
    if not own:
        return "", ""
    if not first:
        return f"{min(own):.1f}", ""
    ratios = [a / b for a, b in zip(own, first, strict=True)]
    return f"{min(own):.1f}", f"{min(own) / min(first):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"


if __name__ == "__main__":
    main()
