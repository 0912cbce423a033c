"""How many photos find their place where neighbours are 33 to 47 degrees apart?

    python benchmarks/wide_sets.py FOLDER... --size 512

Each folder holds photos and a cameras.json with intrinsics and poses. A set is a row of four
photos, each 33 to 47 degrees from the one before and farther from those before that one; sets begin
at photos spread evenly over the folder, `--sets` of them. Each set is matched as it is and with
tilted images, with the lens known and unknown. A placed photo is wrong where its turn relative to
photo 0 is off by more than 5 degrees. Printed for every set: placed, wrong, largest error [degrees]
and processor seconds.
"""

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from harness import Row, run_benchmark
from scenes import for_tuning

import edit3r
from edit3r.contract.errors import MatchingError
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.kit.photos.cameras import CAMERA_FILES, PosedCamera
from edit3r.kit.photos.posed_folder import read_posed_folder

STEP = (33.0, 47.0)  # between neighbours [degrees]
PHOTOS = 4
WRONG = 5.0
ASSUMED_FOV = 60.0


def turn_between(a: PosedCamera, b: PosedCamera) -> float:
    return degrees_of(a.c2w[:3, :3].T @ b.c2w[:3, :3])


def degrees_of(rotation: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(cv2.Rodrigues(rotation)[0])))


def row_from(cameras: Sequence[PosedCamera], start: int) -> list[int] | None:
    """A row of photos that begins with `start`; None where the folder has none."""
    row = [start]
    while len(row) < PHOTOS:
        last, middle = cameras[row[-1]], sum(STEP) / 2
        fitting = [
            (abs(turn_between(last, camera) - middle), index)
            for index, camera in enumerate(cameras)
            if STEP[0] <= turn_between(last, camera) <= STEP[1]
            and all(turn_between(cameras[i], camera) > STEP[1] for i in row[:-1])
        ]
        if not fitting:
            return None
        row.append(min(fitting)[1])
    return row


def of_unknown_lens(views: edit3r.Views) -> torch.Tensor:
    """What is assumed where nobody knows the lens."""
    height, width = views.image_size
    half = math.tan(math.radians(ASSUMED_FOV) / 2) * width / max(height, width)
    one = intrinsics_from_fov(2 * math.atan(half), views.image_size)
    return one.to(views.intrinsics).expand_as(views.intrinsics)


def result_of(
    folder: Path, row: list[int], size: int, known: bool, tilted: bool
) -> str:
    """One cell of the table: placed, wrong, largest error and seconds."""
    cameras = read_posed_folder(folder).cameras
    chosen = [cameras[index] for index in row]
    files = [folder / camera.file for camera in chosen]
    found = [folder / name for name in CAMERA_FILES if (folder / name).is_file()]
    views = edit3r.load_views(files, cameras=found[0], size=size)
    intrinsics = views.intrinsics if known else of_unknown_lens(views)
    views = edit3r.Views(
        views.images, intrinsics, views.names, assumed=(not known,) * PHOTOS
    )
    began = time.process_time()
    try:
        geometry = edit3r.build("matcher", "classical", tilted=tilted).match(views)
    except MatchingError:
        return f"refused, {time.process_time() - began:.0f} s"
    placed = torch.nonzero(geometry.registered[0]).flatten().tolist()
    errors = []
    for view in placed[1:]:
        true = chosen[0].c2w[:3, :3].T @ chosen[view].c2w[:3, :3]
        own = geometry.c2w[0, view, :3, :3].double().numpy()
        errors.append(degrees_of(own.T @ true))
    wrong = sum(error > WRONG for error in errors)
    seconds = time.process_time() - began
    return f"{len(placed)}, {wrong}, {max(errors, default=0):.1f}°, {seconds:.0f} s"


def main(folders: Sequence[Path], *, size: int = 512, sets: int = 3) -> Iterator[Row]:
    for folder in for_tuning(folders):
        cameras = read_posed_folder(folder).cameras
        rows = [row_from(cameras, start) for start in range(len(cameras))]
        rows = [row for row in rows if row]
        picked = np.unique(np.linspace(0, len(rows) - 1, sets).round().astype(int))
        for row in [rows[index] for index in picked] if rows else []:
            for known in (True, False):
                yield {
                    "photos": f"{folder.name} {', '.join(map(str, row))}",
                    "lens": "known" if known else "unknown",
                    "as they are": result_of(folder, row, size, known, False),
                    "with tilted images": result_of(folder, row, size, known, True),
                }


if __name__ == "__main__":
    run_benchmark(main)
