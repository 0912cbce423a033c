"""Is the lens read from the photos the true one, and does the run say where it is not sure?

    python benchmarks/lenses.py
    python benchmarks/lenses.py FOLDER... --show 2

Without folders: rooms of the data set `procedural`, seen by lenses of 90 to 120 degrees (across the
longer side) and by narrow ones, in sets of 3, 4 and 6 photos. With folders: photos with a
cameras.json, whose lens is kept from the run; sets of 3, 4 and 6 at two distances. A row a set: the
true field of view, the one that was read, whether the run said that it is unsure, and processor
seconds. `--show N`: for every N-th set, the PSNR of photos between that were not given, by the
default run with the true lens and with the one read. Below that how many sets are within 6 degrees,
and of the others how many were said to be unsure.
"""

import argparse
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from edit3r_training.procedural_scenes import (
    look_at,
    random_cameras,
    random_scene,
    texture_bank,
)
from edit3r_training.raycaster import cast
from scenes import for_tuning

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.geometry.cameras import field_of_view, intrinsics_from_fov
from edit3r.kit.photos.intrinsics import DEFAULT_FOV
from edit3r.kit.photos.posed_folder import read_posed_folder
from edit3r.running import DEFAULTS

WIDE, NARROW = (90, 100, 110, 120), (40, 55, 70)
COUNTS = (3, 4, 6)
SIZE = (288, 384)  # of the generated photos
MATCHER = {k: v for k, v in DEFAULTS["matcher"].items() if k != "name"}
"""The matcher of a run, as defaults.yaml has it."""
RIGHT = 6.0  # largest error of a lens that is read rightly [degrees]


@dataclass(frozen=True)
class PhotoSet:
    """Photos, and one or two that are not given, with their true cameras."""

    name: str
    views: edit3r.Views  # those that are given first
    given: int

    @property
    def fov(self) -> float:
        """Across the longer side [degrees]."""
        return field_of_view(self.views)

    def through(self, fov: float | None) -> edit3r.Views:
        """The given photos without poses, their lens said to be that; None: nobody knows it."""
        own = replace(self.views.select(range(self.given)), c2w=None)
        across = math.radians(DEFAULT_FOV if fov is None else fov)
        height, width = own.image_size
        across = 2 * math.atan(math.tan(across / 2) * width / max(height, width))
        lens = intrinsics_from_fov(across, own.image_size).to(own.intrinsics)
        assumed = (fov is None,) * self.given
        return replace(own, intrinsics=lens.expand_as(own.intrinsics), assumed=assumed)


def generated(repeats: int) -> Iterator[PhotoSet]:
    """Rooms from cameras that walk around their middle, or along a wall, looking across."""
    for fov in (*WIDE, *NARROW):
        for count in COUNTS:
            for index in range(repeats):
                rng = np.random.default_rng((fov, count, index))
                walks = bool(index % 2)
                poses = (
                    _walking(rng, count, 2)
                    if walks
                    else random_cameras(rng, count, 2, (8.0, 20.0))
                )
                scene = random_scene(
                    rng, int(rng.integers(8, 20)), 96, poses[:, :3, 3], outdoor=False
                )
                name = f"{'along a wall' if walks else 'around'} {index}, {fov}°"
                yield PhotoSet(name, _cast(scene, poses, fov), count)


def _walking(rng: np.random.Generator, count: int, targets: int) -> np.ndarray:
    """Poses a step apart, each looking 5 to 15 degrees beside the one before."""
    turn = math.radians(rng.uniform(5, 15)) * rng.choice([-1, 1])
    start = np.array([rng.uniform(-0.6, 0.0), rng.uniform(-0.2, 0.1), -1.1])
    step = rng.uniform(0.12, 0.3)
    places = (*range(count), *rng.uniform(0.2, count - 1.2, targets))
    poses = []
    for place in places:
        wobble = rng.normal(size=3) * 0.03
        position = start + wobble + [place * step, 0, 0.05 * place]
        heading = (place - count / 2) * turn
        ahead = np.array([math.sin(heading), rng.normal() * 0.04, math.cos(heading)])
        poses.append(look_at(position, position + ahead, roll=rng.normal() * 0.03))
    return np.stack(poses)


def _cast(scene, poses: np.ndarray, fov: float) -> edit3r.Views:
    lens = intrinsics_from_fov(math.radians(fov), SIZE)
    images = [
        cast(scene, texture_bank(96), p, lens.double().numpy(), SIZE).image
        for p in poses
    ]
    eight_bits = (
        torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).mul(255).round() / 255
    )
    k = lens.float().expand(1, len(poses), 3, 3)
    c2w = torch.from_numpy(poses)[None].float()
    return edit3r.Views(eight_bits[None], k, c2w=c2w)


def from_folder(folder: Path, size: int) -> Iterator[PhotoSet]:
    """Sets of neighbours, a photo or two left out between each two."""
    cameras = read_posed_folder(folder).cameras
    for count in COUNTS:
        for gap in (2, 4):
            for start in (0, len(cameras) // 2):
                chosen = [start + gap * k for k in range(count)]
                if chosen[-1] >= len(cameras):
                    continue
                between = [chosen[0] + gap // 2, chosen[-2] + gap // 2]
                files = [folder / cameras[i].file for i in (*chosen, *between)]
                views = edit3r.load_views(files, size=size)
                name = f"{folder.name} {', '.join(map(str, chosen))}"
                yield PhotoSet(name, views, count)


def read(photos: PhotoSet) -> tuple[float | None, bool, float]:
    """The field of view that the photos tell, whether that is said to be unsure, and CPU s."""
    report, matcher = Report(), edit3r.build("matcher", "classical", **MATCHER)
    views, began = photos.through(None), time.process_time()
    try:
        with collecting(report):
            geometry = matcher.match(views)
    except Edit3rError:
        return None, False, time.process_time() - began
    seconds = time.process_time() - began
    found = replace(photos, views=geometry.calibrated(views))
    return found.fov, geometry.lenses is not None, seconds


def shown(photos: PhotoSet, fov: float) -> float:
    """Mean PSNR [dB] of the photos that were not given, through a lens of `fov`."""
    from verdict import _unseen

    result = edit3r.run(photos.through(fov), editor="none", outputs=[])
    placed = [i for i, there in enumerate(result.verdict.placed) if there]
    targets = range(photos.given, photos.views.count)
    return float(np.mean([_unseen(result, photos.views, placed, t) for t in targets]))


def summary(rows: Sequence[tuple[PhotoSet, float | None, bool]]) -> str:
    """How many sets of each kind are right, and of the others how many were said to be unsure."""
    lines = [
        "| sets | within 6° | else unsure | else refused | wrong, unsaid | right, yet unsure |"
    ]
    lines += ["| --- | --: | --: | --: | --: | --: |"]
    kinds = (
        ("90° and wider, of 3", lambda p: p.fov > 85 and p.given < 4),
        ("90° and wider, of 4 and 6", lambda p: p.fov > 85 and p.given >= 4),
        ("narrower, of 3", lambda p: p.fov <= 85 and p.given < 4),
        ("narrower, of 4 and 6", lambda p: p.fov <= 85 and p.given >= 4),
    )
    for kind, belongs in kinds:
        own = [row for row in rows if belongs(row[0])]
        right = [r for r in own if r[1] is not None and abs(r[1] - r[0].fov) <= RIGHT]
        refused = sum(r[1] is None for r in own)
        unsure = sum(r[2] for r in own if r not in right)
        wrong = len(own) - len(right) - refused - unsure
        doubted = sum(r[2] for r in right)
        lines.append(
            f"| {kind} | {len(right)} of {len(own)} | {unsure} | {refused} | {wrong} | {doubted} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument("--repeats", type=int, default=4, help="generated sets a kind")
    parser.add_argument("--show", type=int, default=0, metavar="N")
    args = parser.parse_args()
    folders = [
        set_ for f in for_tuning(args.folders) for set_ in from_folder(f, args.size)
    ]
    rows: list[tuple[PhotoSet, float | None, bool]] = []
    print(
        "| photos | n | true | read | unsure | CPU s | not given, true, read lens, dB |"
    )
    print("| --- | --: | --: | --: | --- | --: | --- |")
    for number, photos in enumerate(
        folders if args.folders else generated(args.repeats)
    ):
        fov, unsure, seconds = read(photos)
        rows.append((photos, fov, unsure))
        psnr = ""
        if args.show and fov is not None and number % args.show == 0:
            psnr = ", ".join(f"{shown(photos, lens):.1f}" for lens in (photos.fov, fov))
        told = "refused" if fov is None else f"{fov:.1f}"
        cells = (photos.name, photos.given, f"{photos.fov:.1f}", told)
        print(
            f"| {' | '.join(map(str, cells))} | {'unsure' if unsure else ''} | {seconds:.1f} "
            f"| {psnr} |",
            flush=True,
        )
    print(f"\n{summary(rows)}")


if __name__ == "__main__":
    main()
