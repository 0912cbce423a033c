"""Scenes with a known answer, laid out on disk as a user's photos are: some photos in, one real picture to predict.

A scene folder holds `photos/` and `cameras.json` (intrinsics only; a run has to find the poses itself), `target.png`,
`truth.json` (the true poses), and where the true edit is known `edited/` and `edited_target.png`.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from edit3r.errors import InputError
from edit3r.interfaces import SceneSample
from edit3r.io.cameras import PosedCamera, write_cameras
from edit3r.io.images import find_photos, read_image, save_image
from edit3r.io.posed_folder import Photo, PosedFolder, read_posed_folder
from edit3r.registry import Registry
from edit3r_measure.evaluation.pairs import Triple, choose_triples, rotation_degrees

TRUTH = "truth.json"


@dataclass(frozen=True)
class MeasuredScene:
    """A scene folder that has been written."""

    path: Path
    name: str
    kind: str  # "photos", or the data set's name

    @property
    def photos(self) -> list[Path]:
        """The input photos in order; the first and the last are the farthest apart."""
        return find_photos(self.path / "photos")

    @property
    def cameras(self) -> Path:
        return self.path / "cameras.json"

    @property
    def edited(self) -> Path | None:
        """Folder of the photos after the true edit."""
        return self.path / "edited" if (self.path / "edited").is_dir() else None

    def truth(self, edited: bool = False) -> tuple[list[Photo], Photo]:
        """The input photos and the target with their true cameras; `edited`: as the true edit makes the target."""
        poses = json.loads((self.path / TRUTH).read_text(encoding="utf-8"))
        files = [*self.photos, self.path / ("edited_target.png" if edited else "target.png")]
        matrices = zip(files, poses["intrinsics"], poses["c2w"])
        *inputs, target = (Photo(_read(file), np.array(k), np.array(c2w)) for file, k, c2w in matrices)
        return inputs, target

    def fingerprint(self) -> str:
        """Of everything in the folder; two scenes with the same pictures and poses share it."""
        digest = hashlib.sha256()
        for file in sorted(path for path in self.path.rglob("*") if path.is_file()):
            digest.update(file.relative_to(self.path).as_posix().encode() + b"\0" + file.read_bytes())
        return digest.hexdigest()[:16]


def open_scene(path: str | Path) -> MeasuredScene:
    truth = json.loads((Path(path) / TRUTH).read_text(encoding="utf-8"))
    return MeasuredScene(Path(path), truth["name"], truth["kind"])


def write_scenes(
    data: Sequence[str],
    root: Path,
    registry: Registry,
    datasets: Mapping[str, Mapping[str, Any]],
    count: int,
    side: int,
) -> list[MeasuredScene]:
    """`count` scenes of each of `data`: folders of posed photos, or names of data sets with settings in `datasets`."""
    written = []
    for source in data:
        if Path(source).is_dir():
            scenes = _from_folder(read_posed_folder(source), count, side)
        else:
            scenes = _from_dataset(source, registry, datasets.get(source, {}), count)
        for name, write in scenes:
            folder = root / name
            if not (folder / TRUTH).is_file():
                write(folder)
            written.append(open_scene(folder))
    return written


def _from_folder(folder: PosedFolder, count: int, side: int) -> Iterator[tuple[str, Any]]:
    triples = choose_triples(folder.cameras, count)
    if not triples:
        raise InputError(f"{folder.path}: no two photos are 5 to 30 degrees apart with a third between them.")
    for triple in triples:
        middle = _another_between(folder, triple)
        indices = [triple.first, *([] if middle is None else [middle]), triple.second, triple.target]
        yield f"{folder.name}-{side}-{triple.first}-{triple.second}", _folder_writer(folder, indices, side)


def _folder_writer(folder: PosedFolder, indices: Sequence[int], side: int):
    def write(path: Path) -> None:
        stored = folder.cameras[indices[0]]
        photos = [folder.load(index, min(side, stored.width, stored.height)) for index in indices]
        pictures = [torch.from_numpy(photo.image).permute(2, 0, 1) for photo in photos]
        intrinsics, c2w = ([getattr(photo, name) for photo in photos] for name in ("intrinsics", "c2w"))
        _write(path, "photos", pictures, intrinsics, c2w)

    return write


def _another_between(folder: PosedFolder, triple: Triple) -> int | None:
    """A photo between the two inputs besides the target: that whose larger angle to them is least."""
    poses = [camera.c2w[:3, :3] for camera in folder.cameras]
    far = {
        index: max(rotation_degrees(pose, poses[end]) for end in (triple.first, triple.second))
        for index, pose in enumerate(poses)
        if index not in (triple.first, triple.second, triple.target)
    }
    nearest = min(far, key=far.__getitem__, default=None)
    return nearest if nearest is not None and far[nearest] < triple.degrees else None


def _from_dataset(name: str, registry: Registry, settings: Mapping[str, Any], count: int) -> Iterator[tuple[str, Any]]:
    dataset = registry.build("dataset", name, **settings)
    mark = hashlib.sha256(json.dumps(dict(settings), sort_keys=True).encode()).hexdigest()[:6]
    for index in range(min(count, len(dataset))):
        yield f"{name}-{mark}-{index}", lambda path, index=index: _write_sample(path, name, dataset[index])


def _write_sample(path: Path, kind: str, sample: SceneSample) -> None:
    """The context views, the first target, and the edited truth if the sample knows it."""
    cameras = [sample.context_cameras, sample.target_cameras.select([0])]
    c2w, k = (torch.cat([getattr(c, key)[0] for c in cameras]).numpy() for key in ("c2w", "intrinsics"))
    edited = None
    if sample.edited_context is not None and sample.edited_target is not None:
        edited = [*sample.edited_context, sample.edited_target[0]]
    _write(path, kind, [*sample.context, sample.target[0]], k, c2w, edited)


def _write(
    path: Path,
    kind: str,
    pictures: Sequence[Tensor],
    intrinsics: Sequence[np.ndarray],
    c2w: Sequence[np.ndarray],
    edited: Sequence[Tensor] | None = None,
) -> None:
    """Pictures are the inputs' and, last, the target's. The truth comes last, so that half a scene is not taken."""
    names = [f"{index}.png" for index in range(len(pictures) - 1)]
    for folder, shown in (("photos", pictures), ("edited", edited or ())):
        for name, picture in zip(names, shown[:-1]):
            (path / folder).mkdir(parents=True, exist_ok=True)
            save_image(picture, path / folder / name)
    for name, shown in (("target.png", pictures), ("edited_target.png", edited or ())):
        for picture in shown[-1:]:
            save_image(picture, path / name)
    height, width = pictures[0].shape[-2:]
    scale = np.array([[width], [height], [1.0]])
    files = [f"photos/{name}" for name in names]
    write_cameras(
        path / "cameras.json", [PosedCamera(f, width, height, k * scale, None) for f, k in zip(files, intrinsics)]
    )
    truth = {
        "name": path.name,
        "kind": kind,
        "intrinsics": np.asarray(intrinsics).tolist(),
        "c2w": np.asarray(c2w).tolist(),
    }
    (path / TRUTH).write_text(json.dumps(truth), encoding="utf-8")


def _read(file: Path) -> np.ndarray:
    """Picture `[height, width, 3]`, sRGB in [0, 1], float32."""
    return np.asarray(read_image(file), np.float32) / 255
