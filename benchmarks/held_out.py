"""Scenes that no setting may be chosen by, and what the default run makes of them.

    python benchmarks/held_out.py photos/

The folder holds the photo sets of the benchmarks. Every two photos of a held-out scene are
reconstructed by the default run without their poses. A row each: the verdict, the agreement (PSNR
of each photo against the other's Gaussians, before refining), the PSNR of the input views, and, for
scenes with known cameras, of the photo that stands between the two. The other benchmarks refuse
these scenes.
"""

import argparse
import json
from itertools import combinations
from pathlib import Path

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.kit.photos.images import find_photos

HELD_OUT = ("berlin", "leuven_pair")
"""Of the sets at our disposal those that the notes name least: one pair of `berlin` was one of 28
that judged matchers (docs/notes/classical.md), `leuven_pair` was never used. Chosen 2026-11-23."""
SIZE = 256


def for_tuning(folders: list[str]) -> list[str]:
    """The folders (or names of data sets) as they are; ends the program where one is held out."""
    kept_apart = [name for name in folders if Path(name).name in HELD_OUT]
    if kept_apart:
        raise SystemExit(
            f"{', '.join(kept_apart)}: held out, no setting may be chosen by it; see "
            "benchmarks/held_out.py, which reports it apart"
        )
    return folders


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="folder of photo sets")
    data = parser.parse_args().data
    print(
        "| held-out photos | verdict | agreement, dB | input views, dB | photo between, dB |\n"
        "| --- | --- | --: | --: | --: |"
    )
    for scene in HELD_OUT:
        count = len(find_photos(data / scene / "images"))
        for pair in combinations(range(count), 2):
            print(f"| {scene} {pair[0]}, {pair[1]} | {figures(data / scene, pair)} |")


def figures(folder: Path, pair: tuple[int, int]) -> str:
    """The cells of one row after its first."""
    row = posed(folder, pair) if is_posed(folder) else unposed(folder, pair)
    if row["label"] == "refused":
        return "refused | – | – | –"
    agreement, shown, between = (
        ", ".join(f"{value:.1f}" for value in row[name]) or "–"
        for name in ("agreement", "input_psnr", "held_out")
    )
    return f"{row['label']} | {agreement} | {shown} | {between}"


def is_posed(folder: Path) -> bool:
    cameras = json.loads((folder / "cameras.json").read_text(encoding="utf-8"))
    return all(camera["c2w"] is not None for camera in cameras)


def posed(folder: Path, pair: tuple[int, int]) -> dict:
    """As `benchmarks/verdict.py` measures a set."""
    from verdict import measure  # which imports this module

    return measure(folder, list(pair), SIZE, pairs=False, unseen=[])


def unposed(folder: Path, pair: tuple[int, int]) -> dict:
    """The same without a photo between."""
    photos = [find_photos(folder)[index] for index in pair]
    try:
        verdict = edit3r.run(photos, editor="none", size=SIZE, outputs=[]).verdict
    except Edit3rError:
        return {"label": "refused"}
    return {
        "label": verdict.label,
        "agreement": verdict.agreement,
        "input_psnr": verdict.input_psnr,
        "held_out": [],
    }


if __name__ == "__main__":
    main()
