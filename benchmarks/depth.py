"""How often dense depth is right on real pairs, with true poses and with those that registration
finds.

    python benchmarks/depth.py FOLDER... --matcher classical --matcher "classical depth=network"
--write results.jsonl

Each folder holds photos and a cameras.json. Truth: features of a photo that agree with the true
cameras in at least two other photos, triangulated; or the folder's own depth. Pairs are drawn
evenly from three classes of angle. A point is right when its depth is within 3 % (10 %) of the true
one: `all` points, and those `seen` by the other photo, too. `exact` are the true matches of the
latter triangulated with the same poses, whose median gives the unit of length: no depth from these
poses can do better.
"""

import argparse
import json
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import torch
from edit3r_geometry.cameras import Pose, project, rays_through, triangulate
from edit3r_geometry.features import Keypoints, detect, match

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Views
from edit3r.kit.geometry.rotations import rotation_angle
from edit3r.kit.photos.images import evenly
from edit3r.kit.photos.posed_folder import PosedFolder, PosedPhoto, read_posed_folder

CLASSES = ((5, 15), (15, 30), (30, 60))
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
            if i != index and 4 < angle(self.folder, index, i) < 35
        ]
        near.sort(key=lambda i: angle(self.folder, index, i))
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


def angle(folder: PosedFolder, a: int, b: int) -> float:
    """Between the two cameras [degrees]."""
    turns = (torch.from_numpy(folder.cameras[i].c2w[:3, :3]) for i in (a, b))
    return float(torch.rad2deg(rotation_angle(*turns)))


def in_pixels(photo: PosedPhoto, size: int) -> np.ndarray:
    return photo.intrinsics * np.array([[size], [size], [1.0]])


def pairs_of(
    folder: PosedFolder, truth: Truth, count: int
) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """At most `count` pairs a class that share true points."""
    found = {}
    for low, high in CLASSES:
        every = [
            p
            for p in combinations(range(len(folder.cameras)), 2)
            if low <= angle(folder, *p) < high
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
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
        for limits, pairs in pairs_of(folder, truth, args.pairs).items():
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
        "angle": angle(folder, *pair),
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


if __name__ == "__main__":
    main()
