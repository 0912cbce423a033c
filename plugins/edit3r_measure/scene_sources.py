"""Scenes with a known answer: folders of posed photos, and data sets with truth.

Both give an `EvaluationScene`: some photos to reconstruct from, and what is known beside them (a
real image between them, the photos after a true edit).
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from torch import Tensor

from edit3r import Registry
from edit3r.contract.errors import InputError, UnknownComponentError
from edit3r.contract.interfaces import SceneSample
from edit3r.contract.types import Cameras
from edit3r.kit.photos.posed_folder import PosedFolder, PosedPhoto, read_posed_folder
from edit3r.kit.photos.triples import choose_triples

Pose = Float[np.ndarray, "4 4"]  # camera to world

PHOTOS = "photos"


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
    load: Callable[[], EvaluationScene]


@dataclass(frozen=True)
class SceneOptions:
    """Which scenes are taken from each source, and how large."""

    count: int  # most pairs of a folder, scenes of a data set
    size: int  # side of the square photos [pixels]
    # settings of data sets by name
    datasets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


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
        scenes.append(SceneSource(f"{source}-{mark[:6]}-{index}", load))
    return scenes


def _photographed(folder: PosedFolder, options: SceneOptions) -> list[SceneSource]:
    scenes = []
    for triple in choose_triples(folder.poses, options.count):
        first, second, _ = triple
        name = f"{folder.name}-{options.size}-{first}-{second}"
        load = partial(photo_scene, folder, triple, options.size)
        scenes.append(SceneSource(name, load))
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
    """A sample of data set `name` as a scene: context, first target, the true edit if known."""
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
