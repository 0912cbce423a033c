"""Is the verdict of a run right? Sets of real photos with known cameras: input views against views
between them.

    python benchmarks/verdict.py FOLDER... --size 256 --write results.jsonl --rows ROWS.jsonl
    edit3r judge --fit ROWS.jsonl [--write]
    python benchmarks/verdict.py FOLDER --photos 0,7,14,21,28,35 --unseen 31,32,33,34

Each folder holds photos and a cameras.json. Sets of 2, 3, 4 and 6 photos, evenly spaced at several
distances, are reconstructed without their poses. Views between two placed neighbours, which the run
has not seen, are then rendered from their true poses (relative to the nearer neighbour, in the unit
that the neighbours are apart) and compared with their photos. One JSON line a set, and a table: for
each label, how many sets it was given and their held-out PSNR.
"""

import argparse
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from harness import for_tuning
from likeness import Likeness, likeness, mean

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.kit.photos.posed_folder import read_posed_folder

BROKEN, SHARP = 0.15, 0.1  # LPIPS of views that are broken, and of those that are good
# photos, distance
SETS = (
    (2, 2),
    (2, 4),
    (2, 8),
    (3, 2),
    (3, 4),
    (4, 2),
    (4, 5),
    (6, 2),
    (6, 3),
    (6, 7),
)


def sets_of(count: int) -> list[list[int]]:
    """Indices of the photos of each set."""
    found = [
        [start + gap * k for k in range(photos)]
        for photos, gap in SETS
        for start in (0, count // 2)
    ]
    return [chosen for chosen in found if chosen[-1] < count]


def between(centres: np.ndarray, chosen: list[int]) -> list[int | None]:
    """For each two neighbours of a set the other photo most nearly half-way between them; None:
    none lies between.
    """
    free, found = [i for i in range(len(centres)) if i not in chosen], []
    for a, b in pairwise(chosen):
        distance = np.linalg.norm(centres[free, None] - centres[[a, b]], axis=-1).max(1)
        nearest = int(distance.argmin())
        found.append(
            free[nearest]
            if distance[nearest] <= np.linalg.norm(centres[a] - centres[b])
            else None
        )
    return found


def measure(folder: Path, chosen: list[int], size: int, unseen: list[int]) -> dict:
    """Reconstruct one set; the verdict, and how alike the held-out views whose two neighbours were
    placed are: PSNR [dB], SSIM and LPIPS.
    """
    cameras = read_posed_folder(folder).cameras
    targets = between(np.stack([camera.c2w[:3, 3] for camera in cameras]), chosen)
    files = [
        folder / cameras[i].file
        for i in (*chosen, *(t for t in targets if t is not None), *unseen)
    ]
    views, count = edit3r.load_views(files, size=size), len(chosen)
    numbers = iter(range(count, views.count))
    asked = [
        (k, next(numbers)) for k, target in enumerate(targets) if target is not None
    ]
    row = {"scene": folder.name, "photos": chosen, "between": targets}
    try:
        result = edit3r.run(
            replace(views.select(range(count)), c2w=None), editor="none", size=size
        )
    except Edit3rError as error:
        return {**row, "label": "refused", "reason": str(error)[:200], "held_out": []}
    placed = [i for i, there in enumerate(result.verdict.placed) if there]
    asked = [(k, target) for k, target in asked if {k, k + 1} <= set(placed)]
    verdict = result.verdict
    for name in ("label", "input_psnr", "agreement", "placed", "guessed_between"):
        row[name] = getattr(verdict, name)
    alike = [
        _held_out(result, views, (k, k + 1), placed.index(k), target)
        for k, target in asked
    ]
    row["held_out"] = [one.psnr for one in alike]
    if alike:
        row["deserved"] = deserved(mean(alike))
    last = range(views.count - len(unseen), views.count)
    row["unseen"] = dict(
        zip(unseen, (_unseen(result, views, placed, target) for target in last))
    )
    row["cpu_s"] = sum(stage.cpu_seconds for stage in result.report.stages)
    return row


def _held_out(
    result: edit3r.RunResult,
    views: edit3r.Views,
    pair: tuple[int, int],
    first: int,
    target: int,
) -> Likeness:
    """How alike view `target` is; the `pair` of its neighbours are cameras `first` and `first` + 1
    of the result.
    """
    true, found = views.c2w[0].double(), result.cameras.c2w[0].double()
    length = float((found[first, :3, 3] - found[first + 1, :3, 3]).norm())
    unit = length / float((true[pair[0], :3, 3] - true[pair[1], :3, 3]).norm())
    nearer = min(
        (0, 1),
        key=lambda side: float((true[pair[side], :3, 3] - true[target, :3, 3]).norm()),
    )
    near = pair[nearer], first + nearer
    return _alike(result, views, _camera(result, views, near, target, unit), target)


def _unseen(
    result: edit3r.RunResult, views: edit3r.Views, placed: list[int], target: int
) -> float:
    """PSNR [dB] of view `target`, placed relative to the nearest of the `placed` views."""
    camera = unseen_camera(result, views, placed, target)
    return _alike(result, views, camera, target).psnr


def unseen_camera(
    result: edit3r.RunResult, views: edit3r.Views, placed: list[int], target: int
) -> edit3r.Cameras:
    """Where view `target` stands in the result, relative to the nearest of the `placed` views."""
    true, found = (
        views.c2w[0, :, :3, 3].double(),
        result.cameras.c2w[0, :, :3, 3].double(),
    )
    unit = float(torch.pdist(found).sum() / torch.pdist(true[placed]).sum())
    nearest = int((true[placed] - true[target]).norm(dim=1).argmin())
    return _camera(result, views, (placed[nearest], nearest), target, unit)


def _camera(
    result: edit3r.RunResult,
    views: edit3r.Views,
    near: tuple[int, int],
    target: int,
    unit: float,
) -> edit3r.Cameras:
    """View `target` from where it stands beside a view, whose numbers in `views` and result are
    `near`.
    """
    step = (
        torch.linalg.inv(views.c2w[0, near[0]].double()) @ views.c2w[0, target].double()
    )
    step[:3, 3] *= unit
    pose = (result.cameras.c2w[0, near[1]].double() @ step).float()
    return edit3r.Cameras(
        pose[None, None], views.intrinsics[:, [target]], views.image_size
    )


def _alike(
    result: edit3r.RunResult, views: edit3r.Views, camera: edit3r.Cameras, target: int
) -> Likeness:
    """How alike view `target` and what `camera` shows are."""
    shown = result.rasterizer.render(result.gaussians, camera).images[0, 0].clamp(0, 1)
    pictures = (
        one.permute(1, 2, 0).numpy() for one in (shown, views.images[0, target])
    )
    return likeness(*pictures)


def deserved(alike: Likeness) -> str:
    """The label that views between deserve: LPIPS decides where PSNR or SSIM agrees.

    Chosen by looking at 48 of them: poses that are off by a pixel cost PSNR, and nobody sees it.
    """
    if alike.lpips > BROKEN and (alike.psnr < 18 or alike.ssim < 0.55):
        return "poor"
    return "good" if alike.lpips < SHARP and alike.psnr >= 20 else "fair"


def for_fitting(row: dict) -> dict:
    """A row for `edit3r judge --fit`."""
    pairs = zip(row["agreement"], row["input_psnr"])
    figures = {
        "agreement": min(min(pair) for pair in pairs if None not in pair),
        "guessed": max(one for one in row["guessed_between"] if one is not None),
    }
    return {"place": row["scene"], "label": row["deserved"], "figures": figures}


def table(rows: list[dict]) -> str:
    """Markdown: sets of each label, and the mean and least held-out PSNR of a set."""
    lines = [
        "| verdict | sets | held-out PSNR, mean [dB] | lowest set | sets under 18 dB |",
        "| --- | --: | --: | --: | --: |",
    ]
    for label in ("good", "fair", "poor", "failed", "refused"):
        own = [row for row in rows if row["label"] == label]
        means = [
            sum(row["held_out"]) / len(row["held_out"])
            for row in own
            if row["held_out"]
        ]
        low = sum(mean < 18 for mean in means)
        shown = (
            f"{sum(means) / len(means):.1f} | {min(means):.1f} | {low} of {len(means)}"
            if means
            else "– | – | –"
        )
        lines.append(f"| {label} | {len(own)} | {shown} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument(
        "--photos",
        action="append",
        help="a set, such as 0,2,4, instead of the sets above; repeatable",
    )
    parser.add_argument(
        "--unseen", default="", help="photos to render besides, such as 31,33"
    )
    parser.add_argument(
        "--rows", type=Path, help="write rows for `edit3r judge --fit` into this file"
    )
    parser.add_argument(
        "--write",
        type=Path,
        help="append one JSON line a set to this file; sets in it are not repeated",
    )
    args = parser.parse_args()
    rows = (
        [json.loads(line) for line in args.write.read_text().splitlines()]
        if args.write and args.write.is_file()
        else []
    )
    done = {(row["scene"], tuple(row["photos"])) for row in rows}
    for folder in for_tuning(args.folders):
        asked = [
            [int(number) for number in text.split(",")] for text in args.photos or []
        ]
        unseen = [int(number) for number in args.unseen.split(",") if number]
        for chosen in asked or sets_of(len(read_posed_folder(folder).cameras)):
            if (folder.name, tuple(chosen)) not in done:
                rows.append(measure(folder, chosen, args.size, unseen))
                if args.write:
                    with args.write.open("a") as file:
                        file.write(json.dumps(rows[-1]) + "\n")
    if rows:
        print(table(rows))
    if args.rows:
        known = (for_fitting(row) for row in rows if "deserved" in row)
        args.rows.write_text("".join(json.dumps(row) + "\n" for row in known))
    for row in rows:
        if row.get("unseen"):
            shown = ", ".join(
                f"{photo} {value:.1f}" for photo, value in row["unseen"].items()
            )
            print(f"{row['scene']} {row['photos']}, {row['label']}: {shown} dB")


if __name__ == "__main__":
    main()
