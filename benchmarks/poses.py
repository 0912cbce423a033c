"""Geometry against what is known: poses, lenses and depths; and an index of pairs by overlap.

python benchmarks/poses.py pairs|lenses|depths|index --help
"""

import argparse
import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from edit3r_geometry.calibration import calibrate
from edit3r_geometry.cameras import (
    CalibratedImage,
    Pose,
    project,
    rays_through,
    triangulate,
)
from edit3r_geometry.features import (
    FeatureSettings,
    Keypoints,
    detect,
    find_features,
    match,
)
from edit3r_geometry.registration import register
from edit3r_measure.novel_view import views_of as views_with_poses
from edit3r_measure.protocol import CLASSES as OVERLAPS, IndexEntry
from edit3r_model.edited_views import find_correspondences
from edit3r_training.procedural_scenes import (
    look_at,
    random_cameras,
    random_scene,
    texture_bank,
)
from edit3r_training.raycaster import cast
from harness import Row as TableRow, for_tuning, run_benchmark
from jaxtyping import Float

import edit3r
from edit3r import build, default_registry
from edit3r.contract.errors import Edit3rError, MatchingError
from edit3r.contract.interfaces import Geometry, Matcher
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Views
from edit3r.kit.geometry.cameras import field_of_view, intrinsics_from_fov
from edit3r.kit.geometry.rotations import rotation_angle
from edit3r.kit.photos.camera_files import PosedCamera
from edit3r.kit.photos.images import evenly
from edit3r.kit.photos.intrinsics import DEFAULT_FOV
from edit3r.kit.photos.posed_folder import PosedFolder, PosedPhoto, read_posed_folder
from edit3r.kit.photos.triples import photos_between, rotation_degrees
from edit3r.running.geometry import default_matcher

# ---- pairs ----

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


def pairs() -> None:
    """How exact are the poses of two photos? Real pairs with known cameras, by the angle between
    them.

        python benchmarks/poses.py pairs FOLDER... --size 512 --matches sift

    Each folder holds photos and a cameras.json with intrinsics and poses. For each class of angles,
    pairs evenly spread over all that are so far apart are registered with the lens known, or
    (`--lens unknown`) with one that is read from the photos. Printed: how many were refused, how
    many of the accepted are wrong (rotation or direction off by more than 10 degrees), the area
    under the curve of the larger of both errors up to 5, 10 and 20 degrees, and median and 90 % of
    both errors over the right ones; processor seconds a pair, features and matches included.
    """
    parser = argparse.ArgumentParser(
        description=pairs.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
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


# ---- lenses ----

WIDE, NARROW = (90, 100, 110, 120), (40, 55, 70)
COUNTS = (3, 4, 6)
SIZE = (288, 384)  # of the generated photos


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
    report, matcher = Report(), default_matcher(default_registry())
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


def lenses(
    *, folders: Sequence[Path] = (), size: int = 384, repeats: int = 4, show: int = 0
) -> Iterator[TableRow]:
    """Is the lens read from the photos the true one, and does the run say where it is not sure?

        python benchmarks/poses.py lenses
        python benchmarks/poses.py lenses --folders FOLDER... --show 2

    Without folders: rooms of the data set `procedural`, seen by lenses of 90 to 120 degrees (across
    the longer side) and by narrow ones, `--repeats` sets of 3, 4 and 6 photos of each. With
    folders: photos with a cameras.json, whose lens is kept from the run; sets of 3, 4 and 6 at two
    distances. A row a set: the true field of view, the one that was read and how far off it is,
    whether the run said that it is unsure, and processor seconds. `--show N`: for every N-th set,
    the PSNR of photos between that were not given, by the default run with the true lens and with
    the one read.
    """
    sets = [set_ for f in for_tuning(folders) for set_ in from_folder(f, size)]
    for number, photos in enumerate(sets or generated(repeats)):
        fov, unsure, seconds = read(photos)
        psnr = ""
        if show and fov is not None and number % show == 0:
            psnr = ", ".join(f"{shown(photos, lens):.1f}" for lens in (photos.fov, fov))
        yield {
            "photos": photos.name,
            "n": (photos.given, "d"),
            "true": (photos.fov, ".1f"),
            "read": "refused" if fov is None else (fov, ".1f"),
            "off": "refused" if fov is None else (abs(fov - photos.fov), ".1f"),
            "unsure": "unsure" if unsure else "",
            "CPU s": (seconds, ".1f"),
            "not given, true, read lens, dB": psnr,
        }


# ---- depths ----

"""Angles between the two photos [degrees]."""
PARTNERS, SUPPORT = 10, 2
"""Photos that a photo's features are triangulated with, and how many of them must agree."""
WITHIN = (0.03, 0.10)
LEAST_POINTS = 30
"""True points below which a photo is left out."""


class Truth:
    """Points of each photo with their true depth, found once."""

    def __init__(self, folder: PosedFolder, detail: int = 512) -> None:
        self.folder, self.detail = folder, detail
        self.poses = [
            Pose.from_matrix(np.linalg.inv(camera.c2w)) for camera in folder.cameras
        ]
        self._photos: dict[int, PosedPhoto] = {}
        self._keys: dict[int, Keypoints] = {}
        self._points: dict[int, np.ndarray] = {}

    def photo(self, index: int) -> PosedPhoto:
        if index not in self._photos:
            self._photos[index] = self.folder.load(index, self.detail)
        return self._photos[index]

    def points(self, index: int) -> np.ndarray:
        """[point, 3]: x, y in shares of the square photo, and camera z."""
        if index not in self._points:
            self._points[index] = (
                self._given(index) if self._has_depth() else self._triangulated(index)
            )
        return self._points[index]

    def _has_depth(self) -> bool:
        return (self.folder.path / "disparity_left.npz").is_file() or (
            self.folder.path / "depth"
        ).is_dir()

    def _given(self, index: int) -> np.ndarray:
        """The folder's own depth, on a grid; of a stereo pair only the first photo's."""
        if (self.folder.path / "depth").is_dir():
            entry = json.loads((self.folder.path / "cameras.json").read_text())[index]
            depth = (
                cv2.imread(
                    str(self.folder.path / entry["depth_file"]), cv2.IMREAD_UNCHANGED
                )
                * entry["depth_scale"]
            )
        elif index == 0:
            depth = stereo_depth(self.folder)
        else:
            return np.zeros((0, 3))
        height, width = depth.shape
        side = min(height, width)
        x, y = (
            axis.ravel() for axis in np.meshgrid(*[np.linspace(0.02, 0.98, 64)] * 2)
        )
        rows, columns = (height - side) / 2 + y * side, (width - side) / 2 + x * side
        z = depth[rows.astype(int), columns.astype(int)]
        return np.stack([x, y, z], 1)[z > 0]

    def _found(self, index: int) -> Keypoints:
        if index not in self._keys:
            self._keys[index] = detect(self.photo(index).image, 3000, 640)
        return self._keys[index]

    def _triangulated(self, index: int) -> np.ndarray:
        keys, depths = self._found(index), [[] for _ in self._found(index).points]
        intrinsics = in_pixels(self.photo(index), self.detail)
        for other in self._partners(index):
            pairs = match(keys, self._found(other), 0.8)
            theirs = in_pixels(self.photo(other), self.detail)
            rays = rays_through(keys.points[pairs[:, 0]], intrinsics)
            rays_b = rays_through(self._found(other).points[pairs[:, 1]], theirs)
            pose = self.poses[other].after(self.poses[index].inverse())
            depth, behind = triangulate(rays, rays_b, pose)
            again = project(pose.apply(rays * depth[:, None]), theirs)
            error = np.linalg.norm(
                again - self._found(other).points[pairs[:, 1]], axis=1
            )
            for (own, _), value, good in zip(
                pairs, depth, (depth > 0) & (behind > 0) & (error < 1.0)
            ):
                if good:
                    depths[own].append(value)
        rows = []
        for (x, y), found in zip(keys.points / self.detail, depths):
            middle = np.median(found) if found else 0
            if (
                sum(abs(value / middle - 1) < 0.015 for value in found)
                >= min(SUPPORT, len(self.poses) - 1)
                and found
            ):
                rows.append((x, y, middle))
        return np.array(rows).reshape(-1, 3)

    def _partners(self, index: int) -> list[int]:
        """Photos 4 to 35 degrees away, evenly."""
        near = [
            i
            for i in range(len(self.poses))
            if i != index and 4 < angle_of_depths(self.folder, index, i) < 35
        ]
        near.sort(key=lambda i: angle_of_depths(self.folder, index, i))
        return (
            evenly(near, PARTNERS)
            or [i for i in range(len(self.poses)) if i != index][:PARTNERS]
        )


def stereo_depth(folder: PosedFolder) -> np.ndarray:
    """Camera z of the first photo of a rectified pair, in the unit of its poses; 0 unknown."""
    disparity = np.load(folder.path / "disparity_left.npz")["disparity"].astype(float)
    left, right = (camera.K for camera in folder.cameras)
    baseline = np.linalg.norm(
        folder.cameras[1].c2w[:3, 3] - folder.cameras[0].c2w[:3, 3]
    )
    shift = disparity + right[0, 2] - left[0, 2]
    known = np.isfinite(disparity) & (disparity > 0) & (shift > 0)
    return np.where(known, left[0, 0] * baseline / np.where(known, shift, 1), 0)


def angle_of_depths(folder: PosedFolder, a: int, b: int) -> float:
    """Between the two cameras [degrees]."""
    turns = (torch.from_numpy(folder.cameras[i].c2w[:3, :3]) for i in (a, b))
    return float(torch.rad2deg(rotation_angle(*turns)))


def in_pixels(photo: PosedPhoto, size: int) -> np.ndarray:
    return photo.intrinsics * np.array([[size], [size], [1.0]])


def pairs_of_of_depths(
    folder: PosedFolder, truth: Truth, count: int
) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """At most `count` pairs a class that share true points."""
    found = {}
    for low, high in CLASSES:
        every = [
            p
            for p in combinations(range(len(folder.cameras)), 2)
            if low <= angle_of_depths(folder, *p) < high
        ]
        if len(folder.cameras) == 2 and low == CLASSES[0][0]:
            every = [(0, 1)]
        good = []
        for pair in evenly(every, 4 * count):
            if (
                min(shared(truth, folder, *pair), shared(truth, folder, *pair[::-1]))
                >= 0.35
            ):
                good.append(pair)
        found[low, high] = evenly(good, count)
    return found


def shared(truth: Truth, folder: PosedFolder, a: int, b: int) -> float:
    """Share of a's true points that fall into b's image."""
    points = truth.points(a)
    if len(points) < LEAST_POINTS:
        return 1.0 if len(folder.cameras) == 2 else 0.0
    inside, _ = seen_in(truth, a, b)
    return float(inside.mean())


def seen_in(truth: Truth, a: int, b: int) -> tuple[np.ndarray, np.ndarray]:
    """Which of a's points project into b, and where [shares of the photo]."""
    points = truth.points(a)
    rays = rays_through(points[:, :2], truth.photo(a).intrinsics)
    there = truth.poses[b].after(truth.poses[a].inverse()).apply(rays * points[:, 2:])
    xy = project(there, truth.photo(b).intrinsics)
    return (there[:, 2] > 0) & (xy > 0).all(1) & (xy < 1).all(1), xy


def views_of(photos: Sequence[PosedPhoto], posed: bool) -> Views:
    images = torch.from_numpy(np.stack([photo.image for photo in photos])).permute(
        0, 3, 1, 2
    )[None]
    intrinsics = torch.from_numpy(
        np.stack([photo.intrinsics for photo in photos])
    ).float()[None]
    c2w = (
        torch.from_numpy(np.stack([photo.c2w for photo in photos])).float()[None]
        if posed
        else None
    )
    return Views(images, intrinsics, c2w=c2w)


def measured(
    truth: Truth, pair: tuple[int, int], geometry: Geometry
) -> dict[str, float]:
    """Shares of right points of both photos, of all and of those in the other photo; and of exact
    matches.
    """
    size, true, depths, exact, seen = geometry.depths.shape[-1], [], [], [], []
    for view, (index, other) in enumerate((pair, pair[::-1])):
        points = truth.points(index)
        if len(points) < LEAST_POINTS:
            continue
        columns, rows = (points[:, :2] * size).astype(int).clip(0, size - 1).T
        inside, there = seen_in(truth, index, other)
        rays = (
            rays_through(points[:, :2], truth.photo(index).intrinsics),
            rays_through(there, truth.photo(other).intrinsics),
        )
        poses = [
            Pose.from_matrix(np.linalg.inv(matrix))
            for matrix in geometry.c2w[0].double().numpy()
        ]
        exact.append(
            triangulate(*rays, poses[1 - view].after(poses[view].inverse()))[0]
        )
        depths.append(geometry.depths[0, view].double().numpy()[rows, columns])
        true.append(points[:, 2])
        seen.append(inside)
    true, depths, exact, seen = map(np.concatenate, (true, depths, exact, seen))
    scale = np.median((exact / true)[seen])
    found = {
        "all": depths / true,
        "seen": (depths / true)[seen],
        "exact": (exact / true)[seen],
    }
    return {
        f"{name}_{100 * w:.0f}": float((abs(r / scale - 1) < w).mean())
        for name, r in found.items()
        for w in WITHIN
    }


def built(description: str, posed: bool):
    """A matcher from `NAME key=value ...`; with true poses the matcher `posed` with the same depth
    settings.
    """
    name, *settings = description.split()
    values = {
        key: json.loads(value) if value[0] in "0123456789[{tf" else value
        for key, value in (s.split("=", 1) for s in settings)
    }
    return edit3r.build("matcher", "posed" if posed else name, **values)


def curve(log: Path, picture: Path) -> None:
    """Held-out quality against the hours of a training."""
    import matplotlib.pyplot as plt

    rows = [
        row
        for row in map(json.loads, log.read_text().splitlines())
        if row["kind"] == "validation"
    ]
    hours = [row["seconds"] / 3600 for row in rows]
    figure, axes = plt.subplots(figsize=(6, 3.2))
    for limit, colour in (("3", "tab:blue"), ("10", "tab:orange")):
        axes.plot(
            hours,
            [100 * row[f"within_{limit}"] for row in rows],
            color=colour,
            label=f"within {limit} %",
        )
        axes.axhline(
            100 * rows[0][f"classical_within_{limit}"],
            color=colour,
            linestyle=":",
            label="without the network",
        )
    axes.set(xlabel="hours", ylabel="held-out pixels [%]", ylim=(10, 80))
    axes.legend(ncols=2, fontsize=8, loc="lower center")
    figure.savefig(picture, dpi=110, bbox_inches="tight")


def depths() -> None:
    """How often dense depth is right on real pairs, with true poses and with those that
    registration finds.

        python benchmarks/poses.py depths FOLDER... --matcher classical
    --matcher "classical depth=network" --write results.jsonl

    Each folder holds photos and a cameras.json. Truth: features of a photo that agree with the true
    cameras in at least two other photos, triangulated; or the folder's own depth. Pairs are drawn
    evenly from three classes of angle. A point is right when its depth is within 3 % (10 %) of the
    true one: `all` points, and those `seen` by the other photo, too. `exact` are the true matches
    of the latter triangulated with the same poses, whose median gives the unit of length: no depth
    from these poses can do better.
    """
    parser = argparse.ArgumentParser(description=depths.__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--matcher", action="append", default=[])
    parser.add_argument("--pairs", type=int, default=4, help="most a class and folder")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--write", type=Path)
    parser.add_argument(
        "--curve",
        nargs=2,
        type=Path,
        metavar=("LOG", "PNG"),
        help="plot a training's log.jsonl",
    )
    args = parser.parse_args()
    if args.curve:
        curve(*args.curve)
        return
    rows = []
    for path in args.folders:
        folder = read_posed_folder(path)
        truth = Truth(folder)
        for limits, pairs in pairs_of_of_depths(folder, truth, args.pairs).items():
            for pair in pairs:
                rows += measure_pair(folder, truth, limits, pair, args)
                if args.write:
                    args.write.write_text("\n".join(map(json.dumps, rows)) + "\n")
    print(table(rows))


def measure_pair(folder, truth, limits, pair, args) -> list[dict]:
    photos = [folder.load(i, args.size) for i in pair]
    base = {
        "scene": folder.name,
        "class": "{}-{}".format(*limits),
        "pair": pair,
        "angle": angle_of_depths(folder, *pair),
    }
    rows = []
    for posed in (True, False):
        for description in args.matcher or ["classical"]:
            row = {**base, "poses": "true" if posed else "own", "matcher": description}
            try:
                geometry = built(description, posed).match(views_of(photos, posed))
            except Edit3rError as error:
                rows.append({**row, "failed": str(error)[:80]})
                continue
            rows.append(
                {
                    **row,
                    **measured(truth, pair, geometry),
                    "filled": 1 - float(geometry.confidence.mean()),
                }
            )
    for row in rows:
        print(
            {k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()},
            flush=True,
        )
    return rows


def table(rows: list[dict]) -> str:
    """Means [%] by class and by scene: all points within 3 and 10 %, those in both photos, those
    matched exactly.
    """
    columns = [
        f"{name}_{100 * limit:.0f}"
        for name in ("all", "seen", "exact")
        for limit in WITHIN
    ]
    lines = [" | ".join(["", "poses", "matcher", "pairs", *columns])]
    for by in ("class", "scene"):
        for group in dict.fromkeys(row[by] for row in rows):
            for poses, matcher in dict.fromkeys(
                (row["poses"], row["matcher"]) for row in rows
            ):
                key = (group, poses, matcher)
                chosen = [
                    r
                    for r in rows
                    if (r[by], r["poses"], r["matcher"]) == key and "failed" not in r
                ]
                if chosen:
                    means = [
                        f"{100 * np.mean([row[name] for row in chosen]):.1f}"
                        for name in columns
                    ]
                    lines.append(" | ".join([*key, str(len(chosen)), *means]))
    return "\n".join(lines)


# ---- index ----

TARGETS, MOST_PHOTOS = 3, 16
MOST_DEGREES = 60.0  # from farther round, a floor that both photos show looks another
# relative difference of depth below which two photos show one place
SAME_SURFACE = 0.05


def make_index(places: Sequence[str], per_class: int, size: int) -> dict[str, Any]:
    """Return the content of an index file: at most so many pairs of each class and folder, with
    photos between them.
    """
    matcher, index = build("matcher", "posed"), {}
    for folder in map(read_posed_folder, places):
        pairs = {name: [] for name in OVERLAPS}
        for first, second, overlap in _overlaps(folder, matcher, size):
            poses = [camera.c2w for camera in folder.cameras]
            between = photos_between(poses, first, second)[:TARGETS]
            entry = IndexEntry(
                context=(first, second),
                target=tuple(sorted(between)),
                overlap=round(overlap, 3),
            )
            if between and entry.overlap_class in pairs:
                pairs[entry.overlap_class].append(entry.model_dump(mode="json"))
        index[folder.name] = [
            entry for own in pairs.values() for entry in evenly(own, per_class)
        ]
    return index


def _overlaps(
    folder: PosedFolder, matcher: Matcher, size: int
) -> Iterator[tuple[int, int, float]]:
    """Yield every two of the chosen photos with the mean of the shares of either that the other
    shows too.
    """
    depths: dict[int, Float[np.ndarray, "height width"]] = {}
    photos: dict[int, PosedPhoto] = {}
    for index in evenly(range(len(folder.cameras)), MOST_PHOTOS):
        trio = [folder.load(i, size) for i in (index, *_nearest(folder, index))]
        try:
            depths[index] = matcher.match(_posed_views(trio)).depths[0, 0].numpy()
            photos[index] = trio[0]
        except MatchingError:
            continue  # nothing is known of what it shows
    for pair in combinations(photos, 2):
        if (
            rotation_degrees(*(photos[index].c2w[:3, :3] for index in pair))
            <= MOST_DEGREES
        ):
            yield (
                *pair,
                overlap(*([own[index] for index in pair] for own in (photos, depths))),
            )


def overlap(
    photos: Sequence[PosedPhoto], depths: Sequence[Float[np.ndarray, "height width"]]
) -> float:
    """Return the mean share in [0, 1] of two photos' pixels whose surface the other shows too;
    `depths` camera z.
    """
    views, maps = _posed_views(photos), torch.from_numpy(np.stack(depths)).float()[None]
    found = find_correspondences(maps, views.intrinsics, views.c2w)
    shared = (found.inside > 0) & ((found.depth_ratio.exp() - 1).abs() < SAME_SURFACE)
    return float(shared.float().mean())


def _posed_views(photos: Sequence[PosedPhoto]) -> Views:
    return replace(
        views_with_poses(photos),
        c2w=torch.from_numpy(np.stack([photo.c2w for photo in photos])).float()[None],
    )


def _nearest(folder: PosedFolder, index: int) -> list[int]:
    """Return the two photos that look most alike: by angle, those at the same place left out."""
    poses = [camera.c2w for camera in folder.cameras]
    others = [
        i
        for i in range(len(poses))
        if np.linalg.norm(poses[i][:3, 3] - poses[index][:3, 3]) > 1e-9
    ]
    return sorted(
        others, key=lambda i: rotation_degrees(poses[i][:3, :3], poses[index][:3, :3])
    )[:2]


def index() -> None:
    """An evaluation index of folders of posed photos, as pixelSplat and NoPoSplat have them: pairs
    by how much they share.

        python benchmarks/poses.py index DATA/fern DATA/fox --pairs 1 --size 128 --out index.json
        edit3r evaluate DATA --index index.json

    Depths are measured for at most 16 photos of a folder, each with its two neighbours, by plane
    sweep from the known poses (matcher `posed`). Two photos at most 60 degrees apart overlap by the
    mean share of either's pixels whose surface the other shows too; targets are up to three photos
    between them.
    """
    parser = argparse.ArgumentParser(
        description=index.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+")
    parser.add_argument(
        "--pairs", type=int, default=1, help="of each folder and class, evenly chosen"
    )
    parser.add_argument(
        "--size",
        type=int,
        default=128,
        help="side of the squares that depths are measured at",
    )
    parser.add_argument("--out", type=Path, default=Path("index.json"))
    args = parser.parse_args()
    args.out.write_text(
        json.dumps(make_index(args.folders, args.pairs, args.size), indent=1)
    )


if __name__ == "__main__":
    run_benchmark(pairs, lenses, depths, index)
