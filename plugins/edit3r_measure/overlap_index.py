"""Evaluation index files: which photos of a scene are given, which are predicted, and how much the given ones share.

The JSON of pixelSplat and NoPoSplat: {scene: {"context": [a, b], "target": [...], "overlap": 0.4} or null}, numbers of
frames; a list of such entries gives a scene several pairs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field

from edit3r.config import Settings, make_settings
from edit3r.errors import InputError, MatchingError
from edit3r.geometry.warping import find_correspondences
from edit3r.interfaces import Dataset, Matcher
from edit3r.io.images import evenly
from edit3r.io.posed_folder import Photo, PosedFolder, read_posed_folder
from edit3r.registry import Registry
from edit3r.reporting import track
from edit3r.types import Views
from edit3r_measure.novel_view import views_of
from edit3r_measure.report import read_json
from edit3r_measure.scene_sources import photos_between, rotation_degrees

CLASSES = {"small": (0.05, 0.3), "medium": (0.3, 0.55), "large": (0.55, 0.8)}
"""Overlap of two photos, as NoPoSplat's tables are divided; what is in none of them is left out there."""

TARGETS = 3
MOST_PHOTOS = 16
"""Photos of a folder that are tried against each other for an index, evenly chosen."""

MOST_DEGREES = 60.0
"""Angle up to which two photos make a pair of an index: from farther round, a floor that both show looks another."""

SAME_SURFACE = 0.05
"""Relative difference of depth below which two photos show one place."""


Frame = Annotated[int, Field(ge=0)]


class Entry(Settings):
    """One pair of an index file."""

    context: tuple[Frame, ...] = Field(min_length=2, description="frames that are given")
    target: tuple[Frame, ...] | Frame = Field(description="frames that are predicted")
    overlap: float | str | None = Field(None, description="share of one photo that the other shows, or a class")

    @property
    def targets(self) -> tuple[int, ...]:
        return (self.target,) if isinstance(self.target, int) else self.target

    @property
    def overlap_class(self) -> str:
        """Key of CLASSES; "not classed" for other overlaps and where none is told (the published placeholder is -1)."""
        if isinstance(self.overlap, float):
            return next((name for name, (low, high) in CLASSES.items() if low <= self.overlap <= high), "not classed")
        return self.overlap if self.overlap in CLASSES else "not classed"


def read_index(path: Path) -> list[tuple[str, Entry]]:
    """Return scenes and pairs of an index file, null ones left out. Raises InputError naming file and scene."""
    if not path.is_file():
        raise InputError(f"{path}: no such index file; edit3r evaluate FOLDER --make-index FILE makes one.")
    content = read_json(path)
    if not isinstance(content, Mapping):
        raise InputError(f'{path}: expected {{scene: {{"context": [a, b], "target": [...]}}}} as pixelSplat has it.')
    pairs = []
    for scene, own in content.items():
        for entry in own if isinstance(own, list) else [own]:
            if entry is not None:
                known = (
                    {key: entry[key] for key in Entry.model_fields if key in entry} if isinstance(entry, dict) else {}
                )
                pairs.append((scene, make_settings(Entry, known, where=f"{path.name}, {scene}")))
    return pairs


def photos_of(places: Sequence[str | Dataset], scene: str, indices: Sequence[int], size: int) -> list[Photo]:
    """Load frames of a scene: a folder of that name among the places or inside one, or a data set that has it.

    Raises InputError for a scene or frame that is not there.
    """
    for place in places:
        if isinstance(place, Dataset):
            if not hasattr(place, "photos"):
                raise InputError(f"{type(place).__name__} has no scenes by name, as re10k has; give folders of photos.")
            return place.photos(scene, indices)
        for folder in (Path(place), Path(place) / scene):
            if folder.resolve().name == scene and folder.is_dir():
                found = read_posed_folder(folder)
                if max(indices) >= len(found.cameras):
                    have = f"{len(found.cameras)} photos with known cameras"
                    raise InputError(f"{folder}: the index asks for frame {max(indices)}, it has {have}.")
                return [found.load(index, size) for index in indices]
    raise InputError(f"{scene}: a scene of the index that no folder given is or holds.")


def make_index(places: Sequence[str], per_class: int, size: int, registry: Registry) -> dict[str, Any]:
    """Return the content of an index file: at most so many pairs of each class and folder, with photos between them."""
    matcher, index = registry.build("matcher", "posed"), {}
    for folder in map(read_posed_folder, places):
        pairs = {name: [] for name in CLASSES}
        for first, second, overlap in _overlaps(folder, matcher, size):
            poses = [camera.c2w for camera in folder.cameras]
            between = photos_between(poses, first, second)[:TARGETS]
            entry = Entry(context=(first, second), target=tuple(sorted(between)), overlap=round(overlap, 3))
            if between and entry.overlap_class in pairs:
                pairs[entry.overlap_class].append(entry.model_dump(mode="json"))
        index[folder.name] = [entry for own in pairs.values() for entry in evenly(own, per_class)]
    return index


def _overlaps(folder: PosedFolder, matcher: Matcher, size: int) -> Iterator[tuple[int, int, float]]:
    """Yield every two of the chosen photos with the mean of the shares of either that the other shows too."""
    depths: dict[int, Float[np.ndarray, "height width"]] = {}
    photos: dict[int, Photo] = {}
    for index in track(evenly(range(len(folder.cameras)), MOST_PHOTOS), f"depths of {folder.name}"):
        trio = [folder.load(i, size) for i in (index, *_nearest(folder, index))]
        try:
            depths[index] = matcher.match(_posed_views(trio)).depths[0, 0].numpy()
            photos[index] = trio[0]
        except MatchingError:
            continue  # nothing is known of what it shows
    for pair in combinations(photos, 2):
        if rotation_degrees(*(photos[index].c2w[:3, :3] for index in pair)) <= MOST_DEGREES:
            yield *pair, overlap(*([own[index] for index in pair] for own in (photos, depths)))


def overlap(photos: Sequence[Photo], depths: Sequence[Float[np.ndarray, "height width"]]) -> float:
    """Return the mean share of two photos' pixels, in [0, 1], whose surface the other photo shows; `depths` camera z.

    NoPoSplat takes the share that a dense matcher (RoMa) finds in the other photo.
    """
    views, maps = _posed_views(photos), torch.from_numpy(np.stack(depths)).float()[None]
    found = find_correspondences(maps, views.intrinsics, views.c2w)
    shared = (found.inside > 0) & ((found.depth_ratio.exp() - 1).abs() < SAME_SURFACE)
    return float(shared.float().mean())


def _posed_views(photos: Sequence[Photo]) -> Views:
    return replace(views_of(photos), c2w=torch.from_numpy(np.stack([photo.c2w for photo in photos])).float()[None])


def _nearest(folder: PosedFolder, index: int) -> list[int]:
    """Return the two photos that look most alike: by angle, those at the same place left out."""
    poses = [camera.c2w for camera in folder.cameras]
    others = [i for i in range(len(poses)) if np.linalg.norm(poses[i][:3, 3] - poses[index][:3, 3]) > 1e-9]
    return sorted(others, key=lambda i: rotation_degrees(poses[i][:3, :3], poses[index][:3, :3]))[:2]
