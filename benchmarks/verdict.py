"""Is the verdict of a run right? Sets of real photos with known cameras: input views against views between them.

    python benchmarks/verdict.py FOLDER... --size 384 --write results.jsonl

Each folder holds photos and a cameras.json. Sets of 2, 3, 4 and 6 photos, evenly spaced at several distances, are
reconstructed without their poses. Views between two placed neighbours, which the run has not seen, are then rendered
from their true poses (scaled as the found ones are) and compared with their photos. One JSON line a set, and a table:
for each label, how many sets it was given and their held-out PSNR.
"""

import argparse
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import torch

import edit3r
from edit3r.errors import Edit3rError
from edit3r.geometry.cameras import median_scale, scale_poses
from edit3r.io.posed_folder import read_posed_folder

SETS = ((2, 2), (2, 4), (2, 8), (3, 2), (3, 4), (4, 2), (4, 5), (6, 2), (6, 3), (6, 7))  # photos, distance


def sets_of(count: int) -> list[tuple[list[int], list[int]]]:
    """Indices of the photos of each set, and of the photos half-way between neighbours."""
    found = []
    for photos, gap in SETS:
        for start in (0, count // 2):
            chosen = [start + gap * k for k in range(photos)]
            if chosen[-1] < count:
                found.append((chosen, [(a + b) // 2 for a, b in pairwise(chosen)]))
    return found


def measure(folder: Path, chosen: list[int], between: list[int], size: int) -> dict:
    """Reconstruct one set; the verdict, and the PSNR [dB] of the held-out views whose two neighbours were placed."""
    cameras = read_posed_folder(folder).cameras
    views = edit3r.load_views([folder / cameras[i].file for i in (*chosen, *between)], size=size)
    own = views.select(range(len(chosen)))
    row = {"scene": folder.name, "photos": chosen}
    try:
        result = edit3r.run(replace(own, c2w=None), editor="none", size=size)
    except Edit3rError as error:
        return {**row, "label": "refused", "reason": str(error)[:200], "held_out": []}
    placed = [i for i, there in enumerate(result.verdict.placed) if there]
    usable = [
        k for k in range(len(between)) if {k, k + 1} <= set(placed) and _lies_between(views.c2w[0], k, len(chosen))
    ]
    verdict = {name: getattr(result.verdict, name) for name in ("label", "input_psnr", "agreement", "placed", "filled")}
    return {**row, **verdict, "held_out": _held_out(result, views, placed, [len(chosen) + k for k in usable])}


def _lies_between(c2w: torch.Tensor, k: int, photos: int) -> bool:
    """Whether held-out view `k` is no farther from either neighbour than they are apart; c2w [view 4 4]."""
    a, b, target = (c2w[i, :3, 3] for i in (k, k + 1, photos + k))
    return bool(max((target - a).norm(), (target - b).norm()) <= (a - b).norm())


def _held_out(result: edit3r.RunResult, views: edit3r.Views, placed: list[int], targets: list[int]) -> list[float]:
    if not targets:
        return []
    true = torch.linalg.inv(views.c2w[:, :1].double()) @ views.c2w.double()
    found = result.cameras.c2w[0, 1:, :3, 3].double()
    poses = scale_poses(true[:, targets], median_scale(true[0, placed[1:], :3, 3], found)).float()
    cameras = edit3r.Cameras(poses, views.intrinsics[:, targets], views.image_size)
    images = result.rasterizer.render(result.gaussians, cameras).images.clamp(0, 1)
    error = (images - views.images[:, targets]).square().mean((0, 2, 3, 4))
    return (-10 * torch.log10(error)).tolist()


def table(rows: list[dict]) -> str:
    """Markdown: sets of each label, and the mean and least held-out PSNR of a set."""
    lines = [
        "| verdict | sets | held-out PSNR, mean [dB] | lowest set | sets under 18 dB |",
        "| --- | --: | --: | --: | --: |",
    ]
    for label in ("good", "fair", "poor", "failed", "refused"):
        own = [row for row in rows if row["label"] == label]
        means = [sum(row["held_out"]) / len(row["held_out"]) for row in own if row["held_out"]]
        low = sum(mean < 18 for mean in means)
        shown = f"{sum(means) / len(means):.1f} | {min(means):.1f} | {low} of {len(means)}" if means else "– | – | –"
        lines.append(f"| {label} | {len(own)} | {shown} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument(
        "--write", type=Path, help="append one JSON line a set to this file; sets in it are not repeated"
    )
    args = parser.parse_args()
    rows = (
        [json.loads(line) for line in args.write.read_text().splitlines()]
        if args.write and args.write.is_file()
        else []
    )
    done = {(row["scene"], tuple(row["photos"])) for row in rows}
    for folder in args.folders:
        for chosen, between in sets_of(len(read_posed_folder(folder).cameras)):
            if (folder.name, tuple(chosen)) not in done:
                rows.append(measure(folder, chosen, between, args.size))
                if args.write:
                    with args.write.open("a") as file:
                        file.write(json.dumps(rows[-1]) + "\n")
    print(table(rows))


if __name__ == "__main__":
    main()
