"""Scenes with a known answer: folders of posed photos, and data sets with truth.

Both give an `EvaluationScene`: some photos to reconstruct from, and what is known beside them (a
real image between them, the photos after a true edit).
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r import Registry
from edit3r.contract.errors import InputError, UnknownComponentError
from edit3r.contract.interfaces import SceneSample
from edit3r.contract.types import Cameras
from edit3r.kit.geometry.rotations import rotation_angle
from edit3r.kit.photos.images import evenly
from edit3r.kit.photos.posed_folder import PosedFolder, PosedPhoto, read_posed_folder

Pose = Float[np.ndarray, "4 4"]  # camera to world

PHOTOS = "photos"
# How far a photo between two others may be from the middle [baselines]
MAX_OFF_MIDDLE = 0.4


@dataclass(frozen=True)
class EvaluationScene:
    """Posed photos of one scene and what is known beside them."""

    source: str  # name of the folder or data set
    kind: str  # PHOTOS or the data set's name
    files: tuple[str, ...]  # names of the inputs and of the targets
    inputs: tuple[PosedPhoto, ...]  # the first and the last are the farthest apart
    targets: tuple[PosedPhoto, ...]  # images that are not among the inputs
    # inputs and targets after the true edit, where it is known
    edited: tuple[PosedPhoto, ...] = ()
    overlap: str = ""  # class of the inputs' overlap, where an index file tells it

    @property
    def target(self) -> PosedPhoto:
        return self.targets[0]


@dataclass(frozen=True)
class SceneSource:
    """A scene that has not been loaded yet."""

    name: str  # unique among the scenes of a measurement
    kind: str  # as in `EvaluationScene`
    load: Callable[[], EvaluationScene]


@dataclass(frozen=True)
class SceneOptions:
    """Which scenes are taken from each source, and how large."""

    count: int  # most pairs of a folder, scenes of a data set
    size: int  # side of the square photos [pixels]
    # settings of data sets by name
    datasets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


# ---- pairs of photos and the photo between them ----


def rotation_degrees(a: Float[np.ndarray, "n n"], b: Float[np.ndarray, "n n"]) -> float:
    """Return the angle between two rotation matrices or poses [degrees], accurate for small
    angles.
    """
    rotations = (torch.from_numpy(matrix[:3, :3]) for matrix in (a, b))
    return float(torch.rad2deg(rotation_angle(*rotations)))


def choose_triples(
    poses: Sequence[Pose], count: int, degrees: tuple[float, float] = (5.0, 30.0)
) -> list[tuple[int, int, int]]:
    """Return at most `count` triples (first, second, a photo between them), spread evenly over all
    pairs that are `degrees` apart.
    """
    triples = []
    for first, second in combinations(range(len(poses)), 2):
        if degrees[0] <= rotation_degrees(poses[first], poses[second]) <= degrees[1]:
            for target in photos_between(poses, first, second)[:1]:
                triples.append((first, second, target))
    return evenly(triples, count)


def photos_between(poses: Sequence[Pose], first: int, second: int) -> list[int]:
    """Return the photos near the middle of the baseline that look the same way, nearest to it
    first.
    """
    ends = [poses[first], poses[second]]
    angle = rotation_degrees(*ends)
    start, end = (pose[:3, 3] for pose in ends)
    limit = MAX_OFF_MIDDLE * max(np.linalg.norm(end - start), 1e-12)
    distances = {}
    for index, pose in enumerate(poses):
        turn = max(rotation_degrees(pose, other) for other in ends)
        distance = np.linalg.norm(pose[:3, 3] - (start + end) / 2)
        if index not in (first, second) and turn <= angle and distance < limit:
            distances[index] = distance
    return sorted(distances, key=distances.__getitem__)


# ---- the two sources ----


def find_scenes(
    source: str, options: SceneOptions, registry: Registry
) -> list[SceneSource]:
    """Return the scenes of a folder of posed photos or of a data set.

    Raises InputError for what is neither, and for a folder without any.
    """
    if Path(source).is_dir():
        return _photographed(read_posed_folder(source), options)
    settings = options.datasets.get(source, {})
    try:
        dataset = registry.build("dataset", source, **settings)
    except UnknownComponentError as error:
        raise InputError(f"{source}: no such folder of photos, and {error}") from None
    mark = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()
    scenes = []
    for index in range(min(options.count, len(dataset))):
        load = partial(sample_scene, source, index, dataset)
        scenes.append(SceneSource(f"{source}-{mark[:6]}-{index}", source, load))
    return scenes


def _photographed(folder: PosedFolder, options: SceneOptions) -> list[SceneSource]:
    poses = [camera.c2w for camera in folder.cameras]
    scenes = []
    for triple in choose_triples(poses, options.count):
        first, second, _ = triple
        name = f"{folder.name}-{options.size}-{first}-{second}"
        load = partial(photo_scene, folder, triple, options.size)
        scenes.append(SceneSource(name, PHOTOS, load))
    if not scenes:
        raise InputError(
            f"{folder.path}: no two photos are 5 to 30 degrees apart with a third between them."
        )
    return scenes


def photo_scene(
    folder: PosedFolder, indices: Sequence[int], size: int
) -> EvaluationScene:
    """Load the photos at `indices`, the last of them as target, as squares of `size` pixels."""
    *inputs, target = (folder.load(index, size) for index in indices)
    files = tuple(folder.cameras[index].file for index in indices)
    return EvaluationScene(folder.name, PHOTOS, files, tuple(inputs), (target,))


def sample_scene(
    name: str, index: int, samples: Sequence[SceneSample]
) -> EvaluationScene:
    """Return a sample of the data set called `name` as a scene: context views, first target, the
    true edit if known.
    """
    sample = samples[index]
    between = sample.target_cameras.select([0])
    inputs = _photos(sample.context, sample.context_cameras)
    targets = _photos(sample.target[:1], between)
    edited: tuple[PosedPhoto, ...] = ()
    if sample.edited_context is not None and sample.edited_target is not None:
        edited = _photos(sample.edited_context, sample.context_cameras)
        edited += _photos(sample.edited_target[:1], between)
    files = (*(f"{index}/{view}" for view in range(len(inputs))), f"{index}/target")
    return EvaluationScene(name, name, files, inputs, targets, edited)


def _photos(
    images: Float[Tensor, "view 3 height width"], cameras: Cameras
) -> tuple[PosedPhoto, ...]:
    channels_last = images.permute(0, 2, 3, 1).contiguous().numpy()
    intrinsics = cameras.intrinsics[0].double().numpy()
    c2w = cameras.c2w[0].double().numpy()
    return tuple(map(PosedPhoto, channels_last, intrinsics, c2w))
