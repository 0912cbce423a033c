"""How exact are the poses of two photos? Real pairs with known cameras, by the angle between them.

    python benchmarks/poses.py FOLDER... --size 512 --matches sift

Each folder holds photos and a cameras.json with intrinsics and poses. For each class of angles,
pairs evenly spread over all that are so far apart are registered with the lens known, or (`--lens
unknown`) with one that is read from the photos. Printed: how many were refused, how many of the
accepted are wrong (rotation or direction off by more than 10 degrees), the area under the curve of
the larger of both errors up to 5, 10 and 20 degrees, and median and 90 % of both errors over the
right ones; processor seconds a pair, features and matches included.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from edit3r_geometry.calibration import calibrate
from edit3r_geometry.cameras import CalibratedImage, Pose
from edit3r_geometry.features import FeatureSettings, find_features
from edit3r_geometry.registration import register
from scenes import for_tuning

from edit3r.contract.errors import MatchingError
from edit3r.kit.photos.cameras import PosedCamera
from edit3r.kit.photos.posed_folder import read_posed_folder

CLASSES = ((5, 15), (15, 30), (30, 60))
"""Angles between two cameras [degrees]."""
WRONG = 10.0
ASSUMED_FOV = 60.0


@dataclass(frozen=True)
class Row:
    """One pair; errors [degrees], None where the pair was refused."""

    rotation: float | None
    direction: float | None
    matches: int
    seconds: float

    @property
    def larger(self) -> float:
        return 180.0 if self.rotation is None else max(self.rotation, self.direction)


def angle(rotation: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(cv2.Rodrigues(rotation)[0])))


def pairs_of(
    cameras: Sequence[PosedCamera], degrees: tuple[float, float], count: int
) -> list[tuple[int, int]]:
    """At most `count` pairs so far apart, spread evenly over their angles."""
    turns = [camera.c2w[:3, :3] for camera in cameras]
    every = [
        (angle(turns[a].T @ turns[b]), a, b)
        for a in range(len(turns))
        for b in range(a + 1, len(turns))
    ]
    fitting = sorted(pair for pair in every if degrees[0] <= pair[0] < degrees[1])
    if not fitting:
        return []
    chosen = np.unique(np.linspace(0, len(fitting) - 1, count).round().astype(int))
    return [fitting[index][1:] for index in chosen]


def read_image(folder: Path, camera: PosedCamera, size: int) -> CalibratedImage:
    pixels = (
        cv2.cvtColor(cv2.imread(str(folder / camera.file)), cv2.COLOR_BGR2RGB).astype(
            np.float32
        )
        / 255
    )
    return CalibratedImage(pixels, camera.K).reduced(size)


def measure(
    folder: Path,
    pair: Sequence[PosedCamera],
    settings: FeatureSettings,
    args: argparse.Namespace,
) -> Row:
    """Register one pair and compare with its cameras."""
    images = [read_image(folder, camera, args.size) for camera in pair]
    began = time.process_time()
    if args.lens == "unknown":
        images = [image.with_fov(ASSUMED_FOV) for image in images]
    found = find_features(images, settings)
    if args.lens == "unknown":
        fov = calibrate(
            images, {(0, 1): found.matches(images, 0, 1)}, args.threshold, 0
        )
        if fov is not None:
            images = [image.with_fov(fov.fov) for image in images]
    try:
        registration = register(
            images, [camera.file for camera in pair], found, args.threshold, 0
        )
    except MatchingError:
        return Row(None, None, 0, time.process_time() - began)
    seconds = time.process_time() - began
    first, second = (Pose.from_matrix(camera.c2w).inverse() for camera in pair)
    true, own = second.after(first.inverse()), registration.poses[1]
    lengths = np.linalg.norm(true.translation) * np.linalg.norm(own.translation)
    cosine = np.clip(true.translation @ own.translation / lengths, -1, 1)
    turned = angle(own.rotation @ true.rotation.T)
    return Row(
        turned,
        float(np.degrees(np.arccos(cosine))),
        len(registration.pairs[0, 1].matches),
        seconds,
    )


def area(rows: Sequence[Row], limit: float) -> float:
    """Area under the curve of the share of pairs whose larger error is below an angle, up to
    `limit` [%].
    """
    return 100 * float(np.mean([max(0.0, 1 - row.larger / limit) for row in rows]))


def table_row(degrees: tuple[float, float], rows: Sequence[Row]) -> str:
    refused = sum(row.rotation is None for row in rows)
    right = [row for row in rows if row.larger <= WRONG]
    errors = [
        [getattr(row, name) for row in right] or [float("nan")]
        for name in ("rotation", "direction")
    ]
    shown = [
        f"{np.median(values):.2f}, {np.quantile(values, 0.9):.2f}" for values in errors
    ]
    areas = "/".join(f"{area(rows, limit):.0f}" for limit in (5, 10, 20))
    wrong = len(rows) - refused - len(right)
    seconds = np.mean([row.seconds for row in rows])
    counts = f"{degrees[0]}–{degrees[1]}° | {len(rows)} | {refused} | {wrong}"
    return f"| {counts} | {areas} | {' | '.join(shown)} | {seconds:.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--pairs", type=int, default=7, help="of each folder and class")
    parser.add_argument(
        "--matches", choices=("auto", "sift", "learned"), default="sift"
    )
    parser.add_argument("--detection-size", type=int, default=640)
    parser.add_argument("--lens", choices=("known", "unknown"), default="known")
    parser.add_argument("--threshold", type=float, default=1.0)
    args = parser.parse_args()
    settings = FeatureSettings(matches=args.matches, detection_size=args.detection_size)
    print(
        "| angle | pairs | refused | wrong | AUC@5/10/20 | rotation, median, 90 % [°] | "
        "direction | CPU s |"
    )
    print("| --- | --: | --: | --: | --: | --: | --: | --: |")
    for degrees in CLASSES:
        rows = []
        for folder in for_tuning(args.folders):
            cameras = read_posed_folder(folder).cameras
            for pair in pairs_of(cameras, degrees, args.pairs):
                rows.append(
                    measure(folder, [cameras[index] for index in pair], settings, args)
                )
        if rows:
            print(table_row(degrees, rows), flush=True)


if __name__ == "__main__":
    main()
