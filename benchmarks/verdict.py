"""Is the verdict of a run right? Sets of real photos with known cameras: input views against views
between them.

    python benchmarks/verdict.py FOLDER... --size 384 --write results.jsonl
    python benchmarks/verdict.py FOLDER --photos 0,2,4,6,8,10 --pairs
    python benchmarks/verdict.py FOLDER --photos 0,7,14,21,28,35 --unseen 31,32,33,34
    python benchmarks/verdict.py FOLDER --photos 0,3,6,9,12,15 --growing

Each folder holds photos and a cameras.json. Sets of 2, 3, 4 and 6 photos, evenly spaced at several
distances, are reconstructed without their poses. Views between two placed neighbours, which the run
has not seen, are then rendered from their true poses (relative to the nearer neighbour, in the unit
that the neighbours are apart) and compared with their photos. With `--pairs` each two neighbours
are also reconstructed alone and compared in the same view: do more photos make it worse? One JSON
line a set, and a table: for each label, how many sets it was given and their held-out PSNR; with
`--pairs` a line a set.
"""

import argparse
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from harness import for_tuning

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.kit.photos.posed_folder import read_posed_folder

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


def measure(
    folder: Path, chosen: list[int], size: int, pairs: bool, unseen: list[int]
) -> dict:
    """Reconstruct one set; the verdict, and the PSNR [dB] of the held-out views whose two
    neighbours were placed.
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
    for name in ("label", "input_psnr", "agreement", "placed", "filled"):
        row[name] = getattr(result.verdict, name)
    row["held_out"] = [
        _held_out(result, views, (k, k + 1), placed.index(k), target)
        for k, target in asked
    ]
    last = range(views.count - len(unseen), views.count)
    row["unseen"] = dict(
        zip(unseen, (_unseen(result, views, placed, target) for target in last))
    )
    row["cpu_s"] = sum(stage.cpu_seconds for stage in result.report.stages)
    if pairs:
        row["pairs"] = [_of_pair(views, k, target, size) for k, target in asked]
    return row


def growing(folder: Path, chosen: list[int], size: int) -> list[float]:
    """PSNR [dB] of the photo nearest to the first two from the first two, three, ... of `chosen`;
    NaN: not placed.
    """
    cameras = read_posed_folder(folder).cameras
    centres, found = np.stack([camera.c2w[:3, 3] for camera in cameras]), []
    free = [i for i in range(len(centres)) if i not in chosen]
    target = free[
        int(
            np.linalg.norm(centres[free, None] - centres[chosen[:2]], axis=-1)
            .max(1)
            .argmin()
        )
    ]
    for count in range(2, len(chosen) + 1):
        views = edit3r.load_views(
            [folder / cameras[i].file for i in (*chosen[:count], target)], size=size
        )
        result = edit3r.run(
            replace(views.select(range(count)), c2w=None), editor="none", size=size
        )
        placed = [i for i, there in enumerate(result.verdict.placed) if there]
        shown = {0, 1} <= set(placed)
        found.append(
            _held_out(result, views, (0, 1), placed.index(0), count)
            if shown
            else float("nan")
        )
    return found


def _of_pair(views: edit3r.Views, k: int, target: int, size: int) -> float | None:
    """PSNR [dB] of view `target` from views `k` and `k` + 1 alone; None where they are refused."""
    try:
        result = edit3r.run(
            replace(views.select([k, k + 1]), c2w=None), editor="none", size=size
        )
    except Edit3rError:
        return None
    return _held_out(result, views, (k, k + 1), 0, target)


def _held_out(
    result: edit3r.RunResult,
    views: edit3r.Views,
    pair: tuple[int, int],
    first: int,
    target: int,
) -> float:
    """PSNR [dB] of view `target`; the `pair` of its neighbours are cameras `first` and `first` + 1
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
    return _psnr(result, views, _camera(result, views, near, target, unit), target)


def _unseen(
    result: edit3r.RunResult, views: edit3r.Views, placed: list[int], target: int
) -> float:
    """PSNR [dB] of view `target`, placed relative to the nearest of the `placed` views."""
    camera = unseen_camera(result, views, placed, target)
    return _psnr(result, views, camera, target)


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


def _psnr(
    result: edit3r.RunResult, views: edit3r.Views, camera: edit3r.Cameras, target: int
) -> float:
    """PSNR [dB] of view `target` as `camera` shows it."""
    shown = result.rasterizer.render(result.gaussians, camera).images[0, 0].clamp(0, 1)
    return float(-10 * torch.log10((shown - views.images[0, target]).square().mean()))


def pairs_table(rows: list[dict]) -> str:
    """Markdown: a line a set, the mean held-out PSNR of all its photos and of the two neighbours
    alone.
    """
    lines = [
        "| photos | all, dB | two alone, dB | difference |",
        "| --- | --: | --: | --: |",
    ]
    for row in rows:
        both = [
            (own, pair)
            for own, pair in zip(row["held_out"], row.get("pairs", []))
            if pair is not None
        ]
        if both:
            own, pair = (sum(values) / len(both) for values in zip(*both))
            photos = f"{row['scene']} {', '.join(map(str, row['photos']))}"
            lines.append(f"| {photos} | {own:.1f} | {pair:.1f} | {own - pair:+.1f} |")
    return "\n".join(lines)


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
        "--growing",
        action="store_true",
        help="from the first two photos of --photos, three and so on",
    )
    parser.add_argument(
        "--pairs",
        action="store_true",
        help="reconstruct each two neighbours of a set alone as well",
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
        for chosen in asked if args.growing else ():
            print(
                folder.name,
                chosen,
                *(f"{value:.2f}" for value in growing(folder, chosen, args.size)),
                flush=True,
            )
        if args.growing:
            continue
        unseen = [int(number) for number in args.unseen.split(",") if number]
        for chosen in asked or sets_of(len(read_posed_folder(folder).cameras)):
            if (folder.name, tuple(chosen)) not in done:
                rows.append(measure(folder, chosen, args.size, args.pairs, unseen))
                if args.write:
                    with args.write.open("a") as file:
                        file.write(json.dumps(rows[-1]) + "\n")
    if rows:
        print(pairs_table(rows) if args.pairs else table(rows))
    for row in rows:
        if row.get("unseen"):
            shown = ", ".join(
                f"{photo} {value:.1f}" for photo, value in row["unseen"].items()
            )
            print(f"{row['scene']} {row['photos']}, {row['label']}: {shown} dB")


if __name__ == "__main__":
    main()
