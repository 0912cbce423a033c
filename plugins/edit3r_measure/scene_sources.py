"""Scenes with a known answer: folders of posed photos, and data sets with truth.

Both give the same `Scene`: some photos to reconstruct from, and what is known beside them (a real
image between them, the photos after a true edit). A scene can be written to a folder and laid out
there as a user's photos are, so that `edit3r run` itself can be measured on it.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import SceneSample
from edit3r.contract.types import Cameras
from edit3r.errors import InputError, UnknownComponentError
from edit3r.geometry.rotations import rotation_angle
from edit3r.io.cameras import PosedCamera, write_cameras
from edit3r.io.images import evenly, find_photos, read_image, save_image
from edit3r.io.posed_folder import Photo, PosedFolder, read_posed_folder
from edit3r.plugins.registry import Registry

PHOTOS = "photos"
TRUTH_FILE = "truth.json"
FARTHEST_BETWEEN = (
    0.4  # how far a photo between two others may be from the middle [baselines]
)

NO_TRIPLES = "no two photos are 5 to 30 degrees apart with a third between them"


@dataclass(frozen=True)
class Scene:
    """Posed photos of one scene and what is known beside them."""

    source: str  # name of the folder or data set
    kind: str  # PHOTOS or the data set's name
    files: tuple[str, ...]  # names of the inputs and of the target
    inputs: tuple[Photo, ...]  # the first and the last are the farthest apart
    target: Photo  # an image that is not among the inputs
    edited: tuple[
        Photo, ...
    ] = ()  # inputs and target after the true edit, where it is known


@dataclass(frozen=True)
class SceneSource:
    """A scene that has not been loaded yet."""

    name: str  # unique among the scenes of a measurement
    kind: str  # as in `Scene`
    load: Callable[[], Scene]


@dataclass(frozen=True)
class SceneOptions:
    """Which scenes are taken from each source, and how large."""

    count: int  # most pairs of a folder, scenes of a data set
    size: int  # side of the square photos [pixels]
    datasets: Mapping[str, Mapping[str, Any]] = field(
        default_factory=dict
    )  # name to settings
    # from folders also a third photo between the two, never larger than the photos are
    more_inputs: bool = False


# Pairs of photos and the photo between them.


@dataclass(frozen=True)
class Triple:
    """Indices of two input photos and of the photo between them."""

    first: int
    second: int
    target: int
    degrees: float  # angle between the two input cameras


def rotation_degrees(a: Float[np.ndarray, "3 3"], b: Float[np.ndarray, "3 3"]) -> float:
    """Return the angle between two rotation matrices [degrees], accurate for small angles."""
    return float(
        torch.rad2deg(rotation_angle(torch.from_numpy(a), torch.from_numpy(b)))
    )


def choose_triples(
    cameras: Sequence[PosedCamera],
    count: int,
    degrees: tuple[float, float] = (5.0, 30.0),
) -> list[Triple]:
    """Return at most `count` triples, spread evenly over all pairs `degrees` apart which have a
    photo between them.
    """
    poses = [camera.c2w for camera in cameras]
    triples = []
    for first, second in combinations(range(len(poses)), 2):
        angle = rotation_degrees(poses[first][:3, :3], poses[second][:3, :3])
        if degrees[0] <= angle <= degrees[1]:
            triples += [
                Triple(first, second, target, angle)
                for target in photos_between(poses, first, second)[:1]
            ]
    return evenly(triples, count)


def photos_between(
    poses: Sequence[Float[np.ndarray, "4 4"]], first: int, second: int
) -> list[int]:
    """Return the photos near the middle of the baseline that look the same way, nearest to it
    first.
    """
    angle = rotation_degrees(poses[first][:3, :3], poses[second][:3, :3])
    start, end = poses[first][:3, 3], poses[second][:3, 3]
    near = FARTHEST_BETWEEN * max(np.linalg.norm(end - start), 1e-12)
    distances = {
        index: np.linalg.norm(poses[index][:3, 3] - (start + end) / 2)
        for index, turn in _turns(poses, first, second).items()
        if turn <= angle
    }
    return sorted(
        (index for index in distances if distances[index] < near),
        key=distances.__getitem__,
    )


def _turns(
    poses: Sequence[Float[np.ndarray, "4 4"]], first: int, second: int
) -> dict[int, float]:
    """Return the larger angle [degrees] to the two photos of each other one, by index."""
    ends = (first, second)
    others = [index for index in range(len(poses)) if index not in ends]
    return {
        i: max(rotation_degrees(poses[i][:3, :3], poses[end][:3, :3]) for end in ends)
        for i in others
    }


def _another_between(folder: PosedFolder, triple: Triple) -> list[int]:
    """Return a photo between the two inputs besides the target, that whose larger angle to them is
    least, or none.
    """
    turns = _turns(
        [camera.c2w for camera in folder.cameras], triple.first, triple.second
    )
    turns = {
        index: turn
        for index, turn in turns.items()
        if index != triple.target and turn < triple.degrees
    }
    return sorted(turns, key=turns.__getitem__)[:1]


# The two sources.


def find_scenes(
    source: str, options: SceneOptions, registry: Registry
) -> list[SceneSource]:
    """Return the scenes of a folder of posed photos or of a data set, perhaps none; InputError for
    what is neither.
    """
    if Path(source).is_dir():
        return list(_photographed(read_posed_folder(source), options))
    try:
        return list(_generated(source, registry, options))
    except UnknownComponentError as error:
        raise InputError(f"{source}: no such folder of photos, and {error}") from None


def _photographed(folder: PosedFolder, options: SceneOptions) -> Iterator[SceneSource]:
    size = options.size
    for triple in choose_triples(folder.cameras, options.count):
        inputs = [triple.first, triple.second]
        if options.more_inputs:
            inputs[1:1] = _another_between(folder, triple)
            first = folder.cameras[triple.first]
            size = min(options.size, first.width, first.height)
        name = f"{folder.name}-{options.size}-{triple.first}-{triple.second}"
        indices = (*inputs, triple.target)
        yield SceneSource(name, PHOTOS, partial(photo_scene, folder, indices, size))


def photo_scene(folder: PosedFolder, indices: Sequence[int], size: int) -> Scene:
    """Load the photos at `indices`, the last of them as target, as squares of `size` pixels."""
    *inputs, target = (folder.load(index, size) for index in indices)
    files = tuple(folder.cameras[index].file for index in indices)
    return Scene(folder.name, PHOTOS, files, tuple(inputs), target)


def _generated(
    name: str, registry: Registry, options: SceneOptions
) -> Iterator[SceneSource]:
    settings = dict(options.datasets.get(name, {}))
    dataset = registry.build("dataset", name, **settings)
    mark = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:6]
    for index in range(min(options.count, len(dataset))):
        yield SceneSource(
            f"{name}-{mark}-{index}", name, partial(sample_scene, name, index, dataset)
        )


def sample_scene(name: str, index: int, samples: Sequence[SceneSample]) -> Scene:
    """Return a sample of the data set called `name` as a scene: context views, first target, the
    true edit if known.
    """
    sample = samples[index]
    between = sample.target_cameras.select([0])
    inputs, (target,) = (
        _photos(sample.context, sample.context_cameras),
        _photos(sample.target[:1], between),
    )
    edited: tuple[Photo, ...] = ()
    if sample.edited_context is not None and sample.edited_target is not None:
        edited = _photos(sample.edited_context, sample.context_cameras) + _photos(
            sample.edited_target[:1], between
        )
    files = (*(f"{index}/{view}" for view in range(len(inputs))), f"{index}/target")
    return Scene(name, name, files, inputs, target, edited)


def _photos(
    images: Float[Tensor, "view 3 height width"], cameras: Cameras
) -> tuple[Photo, ...]:
    channels_last = images.permute(0, 2, 3, 1).contiguous().numpy()
    return tuple(
        map(
            Photo,
            channels_last,
            cameras.intrinsics[0].double().numpy(),
            cameras.c2w[0].double().numpy(),
        )
    )


# Scenes on disk, for measuring `edit3r run` itself.


@dataclass(frozen=True)
class SceneFolder:
    """A written scene: `photos/` with `cameras.json` (no poses: a run has to find them), targets
    and `truth.json`.
    """

    path: Path
    name: str
    kind: str

    @staticmethod
    def open(path: str | Path) -> "SceneFolder":
        """Open what `write_scene` wrote."""
        truth = json.loads((Path(path) / TRUTH_FILE).read_text(encoding="utf-8"))
        return SceneFolder(Path(path), truth["name"], truth["kind"])

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
        """Return the input photos and the target with true cameras; `edited`: as the true edit
        makes the target.
        """
        poses = json.loads((self.path / TRUTH_FILE).read_text(encoding="utf-8"))
        files = [
            *self.photos,
            self.path / ("edited_target.png" if edited else "target.png"),
        ]
        images = (np.asarray(read_image(file), np.float32) / 255 for file in files)
        *inputs, target = map(
            Photo,
            images,
            map(np.array, poses["intrinsics"]),
            map(np.array, poses["c2w"]),
        )
        return inputs, target

    def fingerprint(self) -> str:
        """Return a hash of everything in the folder; two scenes with the same images and poses
        share it.
        """
        digest = hashlib.sha256()
        for file in sorted(path for path in self.path.rglob("*") if path.is_file()):
            digest.update(
                file.relative_to(self.path).as_posix().encode()
                + b"\0"
                + file.read_bytes()
            )
        return digest.hexdigest()[:16]


def write_scenes(
    sources: Sequence[str], options: SceneOptions, root: Path, registry: Registry
) -> list[SceneFolder]:
    """Write the scenes of each source that have a target. Raises InputError for a source without
    any.
    """
    written = []
    for source in sources:
        scenes = find_scenes(source, options, registry)
        if not scenes:
            raise InputError(f"{source}: {NO_TRIPLES}.")
        written += [write_scene(scene, root) for scene in scenes]
    return written


def write_scene(source: SceneSource, root: Path) -> SceneFolder:
    """Write a scene below `root`, unless it is there already; the truth comes last, so no half is
    taken for whole.
    """
    path = root / source.name
    if not (path / TRUTH_FILE).is_file():
        scene = source.load()
        photos, count = [*scene.inputs, scene.target], len(scene.inputs)
        _save_images(photos, path / "photos", path / "target.png")
        _save_images(scene.edited, path / "edited", path / "edited_target.png")
        height, width = photos[0].image.shape[:2]
        in_pixels = [
            photo.intrinsics * np.array([[width], [height], [1.0]])
            for photo in scene.inputs
        ]
        cameras = [
            PosedCamera(f"photos/{i}.png", width, height, in_pixels[i], None)
            for i in range(count)
        ]
        write_cameras(path / "cameras.json", cameras)
        matrices = {
            name: [getattr(photo, name).tolist() for photo in photos]
            for name in ("intrinsics", "c2w")
        }
        truth = {"name": path.name, "kind": scene.kind, **matrices}
        (path / TRUTH_FILE).write_text(json.dumps(truth), encoding="utf-8")
    return SceneFolder.open(path)


def _save_images(photos: Sequence[Photo], inputs: Path, target: Path) -> None:
    """Write the inputs to a folder and the last photo to a file; nothing for no photos."""
    files = [*(inputs / f"{index}.png" for index in range(len(photos) - 1)), target]
    for photo, file in zip(photos, files):
        file.parent.mkdir(parents=True, exist_ok=True)
        save_image(torch.from_numpy(photo.image).permute(2, 0, 1), file)
