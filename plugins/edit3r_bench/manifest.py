"""The manifest of a benchmark, and how one of its items becomes images, cameras and masks.

The manifest is one JSON file that says everything a benchmark run depends on, outside the method
under test. It names images by their hashes and generated scenes by their seeds, so that a photo
that was changed, or a generator that draws something else, is noticed.
"""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r import Registry
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneSample
from edit3r.contract.settings import Settings, make_settings
from edit3r.contract.types import Cameras, Views
from edit3r.kit.command.results import read_json, write_json
from edit3r.kit.files.atomic import sha256_of
from edit3r.kit.files.names import is_plain_name
from edit3r.kit.geometry.cameras import relative_to_first
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.photos.images import load_photos, read_image
from edit3r.kit.photos.masks import load_masks
from edit3r.kit.provenance import installed_versions
from edit3r.running import MAX_PROMPT

Images = Float[Tensor, "frame 3 height width"]
Maps = Float[Tensor, "frame height width"]

# The numbers of this block: no figures kept.
EditType = Literal["Add", "Remove", "Modify", "Global"]
EDIT_TYPES: tuple[EditType, ...] = get_args(EditType)
EDITS_PER_SCENE = 5
# An edit with a known truth is where truth and photo differ by more than this [sRGB]
VISIBLE = 1.5 / 255
# Its mask reaches this much further than the change [image widths]
MARGIN = 0.025


class FrameRecord(Settings):
    """One image file of a scene."""

    file: str  # relative to the scene's folder
    sha256: str  # of the file


class SceneRecord(Settings):
    """Photos in a folder; a generated scene has no frames: images come with each item's sample."""

    id: str  # unique in the manifest
    folder: str = ""  # relative to the manifest's folder
    cameras: str = ""  # camera file in the folder; "" when poses are not known
    frames: tuple[FrameRecord, ...] = ()  # in the order that item indices count


class SampleRecord(Settings):
    """A generated scene with its edited truth."""

    dataset: str  # name of the dataset component
    settings: dict[str, Any]  # of the dataset
    index: int = Field(ge=0)  # of the sample
    sha256: str  # of the photos and of the edited truth, in 8 bits


class ItemRecord(Settings):
    """One edit of one scene."""

    id: str  # unique in the manifest, usable as a folder name
    scene: str  # id of its scene
    type: EditType
    prompt: str = Field(max_length=MAX_PROMPT)  # the instruction, shared by all views
    description: str = ""  # what the edited photo shows, for CLIP; "": use the prompt
    # what the unedited photo shows, for CLIP direction; "": not measured
    before: str = ""
    seed: int = Field(0, ge=0)  # shared by all views
    inputs: tuple[int, ...]  # frames given to the method; the first is the reference
    held_back: tuple[int, ...] = ()  # frames that it is not given, for measuring
    # one an input, white may change; none: everywhere
    masks: tuple[FrameRecord, ...] = ()
    # the edited photo of every frame that is used, inputs first; none: not known
    truth: tuple[FrameRecord, ...] = ()
    sample: SampleRecord | None = None  # for a generated scene


class Manifest(Settings):
    """A whole benchmark."""

    format: Literal["edit3r-bench"] = "edit3r-bench"
    version: Literal[1] = 1
    name: str = ""  # shown in reports
    image_size: int = Field(256, ge=16)  # longer side that photos are reduced to
    scenes: tuple[SceneRecord, ...]
    items: tuple[ItemRecord, ...]
    # versions of packages
    made_with: dict[str, str] = Field(default_factory=installed_versions)
    notes: dict[str, Any] = Field(default_factory=dict)  # how it was built

    def limited(self, scenes: int | None, edits: int | None) -> "Manifest":
        """Return the first `scenes` scenes with the first `edits` edits of each; None: all."""
        kept = self.scenes[:scenes]
        items: list[ItemRecord] = []
        for scene in kept:
            own = [item for item in self.items if item.scene == scene.id]
            items += own[:edits]
        return self.model_copy(update={"scenes": kept, "items": tuple(items)})

    @property
    def sha256(self) -> str:
        """Hash of everything that results depend on: not of names, notes and versions."""
        hashed = {"format", "version", "image_size", "scenes", "items"}
        content = self.model_dump(mode="json", include=hashed)
        text = json.dumps(content, sort_keys=True)
        return hashlib.sha256(text.encode("utf-8")).hexdigest()


def write_bench_manifest(path: str | Path, manifest: Manifest) -> None:
    """Write the manifest as JSON, the same bytes for the same benchmark and packages."""
    _check_consistent(manifest, Path(path))
    write_json(path, manifest.model_dump(mode="json"))


def read_bench_manifest(path: str | Path) -> Manifest:
    """Read and check a manifest. Raises an error that names the file and what is wrong with it."""
    path = Path(path)
    if not path.is_file():
        raise InputError(
            f"{path}: no such benchmark manifest; edit3r bench build makes one."
        )
    content = read_json(path)
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: not a benchmark manifest (expected a mapping).")
    manifest = make_settings(Manifest, content, where=path.name)
    _check_consistent(manifest, path)
    return manifest


def _check_consistent(manifest: Manifest, path: Path) -> None:
    names_of = {
        "scene": [scene.id for scene in manifest.scenes],
        "item": [item.id for item in manifest.items],
    }
    for what, names in names_of.items():
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"{path}: two {what}s are called {name!r}.")
    frames = {scene.id: len(scene.frames) for scene in manifest.scenes}
    for item in manifest.items:
        for problem, holds in _problems(item, frames).items():
            if holds:
                raise InputError(f"{path}: item {item.id[:60]!r} {problem}.")


def _problems(item: ItemRecord, frames: Mapping[str, int]) -> dict[str, bool]:
    """What may be wrong with an item of a scene with so many `frames`, and whether it is."""
    used = (*item.inputs, *item.held_back)
    count: float = frames.get(item.scene, 0)
    if item.sample is not None:
        count = math.inf  # told when the scene is made
    outside = [index for index in used if not 0 <= index < count]
    return {
        # Results lie in a folder of that name.
        "has an id that is not a plain file name": not is_plain_name(item.id),
        f"names the scene {item.scene!r}, which is not in the manifest": item.scene
        not in frames,
        "needs input frames, and a mask for each of them or none": not item.inputs
        or len(item.masks) not in (0, len(item.inputs)),
        "needs a true image for each frame it uses, or none": len(item.truth)
        not in (0, len(used)),
        f"uses frame {outside[:1]}, which its scene does not have": bool(outside),
        "uses a frame twice": len(set(used)) < len(used),
    }


# ---- from records to images ----


@dataclass(frozen=True)
class LoadedItem:
    """One edit with all that is known about its scene; the frames are its images, inputs first."""

    record: ItemRecord
    photos: Views  # batch 1, all frames, without poses
    inputs: int  # how many of the frames the method is given
    # What is not known is None.
    cameras: Cameras | None = None  # true, batch 1, relative to frame 0
    depths: Maps | None = None  # true camera z
    truth: Images | None = None  # the edited scene
    # where the edit may show; None also: everywhere
    masks: Maps | None = None


def load_item(
    manifest: Manifest, item: ItemRecord, root: Path, registry: Registry
) -> LoadedItem:
    """Load `item` of the manifest in `root`. Raises InputError where its images are others."""
    if item.sample is not None:
        loaded = _generated(item, item.sample, registry)
    else:
        scene = next(scene for scene in manifest.scenes if scene.id == item.scene)
        loaded = _photographed(scene, item, root, manifest.image_size)
    if loaded.truth is None or item.type == "Global":
        return loaded
    masks = change_masks(loaded.photos.images[0], loaded.truth)
    return replace(loaded, masks=masks)


def load_sample(record: SampleRecord, registry: Registry) -> SceneSample:
    """Make a generated scene again; the last ones are kept for the other methods of a run."""
    settings = json.dumps(record.settings, sort_keys=True)
    return _sample(record.dataset, settings, record.index, registry)


@lru_cache(maxsize=100)
def _sample(dataset: str, settings: str, index: int, registry: Registry) -> SceneSample:
    return registry.build("dataset", dataset, **json.loads(settings))[index]


def true_edits(sample: SceneSample) -> tuple[Images, Images]:
    """Return the edited truth of the context and of the target views. Raises InputError without."""
    if sample.edited_context is None or sample.edited_target is None:
        raise InputError(
            f"{sample.name or 'a generated scene'}: its dataset has no true edits; choose one "
            "that has, such as 'procedural'."
        )
    return sample.edited_context, sample.edited_target


def hash_of_sample(sample: SceneSample) -> str:
    """Return the SHA-256 of the photos and the edited truth, rounded to 8 bits."""
    digest = hashlib.sha256()
    for images in (sample.context, sample.target, *true_edits(sample)):
        digest.update((images * 255).round().to(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def hash_of_file(path: Path) -> str:
    """Return the SHA-256 of a file. Raises InputError when it is not there."""
    if not path.is_file():
        raise InputError(f"{path}: no such file, but the manifest needs it.")
    return sha256_of(path)


def change_masks(photos: Images, truth: Images) -> Maps:
    """Return 1 where the truth visibly differs from the photo and a little around, else 0."""
    changed = ((truth - photos).abs().amax(1) > VISIBLE).to(photos.dtype)
    return dilate(changed, max(1, round(MARGIN * photos.shape[-1])))


def _generated(
    item: ItemRecord, record: SampleRecord, registry: Registry
) -> LoadedItem:
    sample = load_sample(record, registry)
    if hash_of_sample(sample) != record.sha256:
        raise InputError(
            f"{item.id}: the scene that {record.dataset!r} generates here differs from the "
            "manifest's; install the versions listed under 'made_with'."
        )
    order = [*item.inputs, *item.held_back]
    if max(order) >= len(sample.context):
        raise InputError(
            f"{item.id}: uses frame {max(order)}, but the generated scene has "
            f"{len(sample.context)}."
        )
    cameras = sample.context_cameras.select(order)
    photos = sample.context[None, order]
    depths = sample.context_depths
    return LoadedItem(
        record=item,
        photos=Views(photos, cameras.intrinsics, _frame_names(order)),
        inputs=len(item.inputs),
        cameras=_relative(cameras),
        depths=None if depths is None else depths[order],
        truth=true_edits(sample)[0][order],
    )


def _photographed(
    scene: SceneRecord, item: ItemRecord, root: Path, size: int
) -> LoadedItem:
    folder = root / scene.folder
    order = [*item.inputs, *item.held_back]
    files = [_checked(folder, scene.frames[index]) for index in order]
    mask_files = [_checked(root, record) for record in item.masks]
    truth_files = [_checked(root, record) for record in item.truth]
    camera_file = folder / scene.cameras if scene.cameras else None
    names = _frame_names(order)
    loaded = load_photos(files, size=size, cameras=camera_file, names=names)
    views = loaded.views
    cameras = truth = masks = None
    if camera_file is not None and views.c2w is not None:
        cameras = _relative(Cameras(views.c2w, views.intrinsics, views.image_size))
    if truth_files:
        images = [np.asarray(read_image(file), np.float32) for file in truth_files]
        channels_last = torch.from_numpy(np.stack(images) / 255)
        truth = channels_last.permute(0, 3, 1, 2).contiguous()
    elif mask_files:
        inputs = replace(loaded, photos=loaded.photos[: len(item.inputs)])
        masks = load_masks(mask_files, inputs)[0]
        # NaN: where held-back frames may change is not known, so nothing is measured there.
        unknown = (0, 0, 0, 0, 0, len(item.held_back))
        masks = F.pad(masks, unknown, value=math.nan)
    return LoadedItem(
        record=item,
        photos=replace(views, c2w=None),
        inputs=len(item.inputs),
        cameras=cameras,
        truth=truth,
        masks=masks,
    )


def _checked(folder: Path, record: FrameRecord) -> Path:
    """Return the file of a record. Raises InputError where it is another than it was."""
    path = folder / record.file
    if hash_of_file(path) != record.sha256:
        raise InputError(
            f"{path}: not the image that the manifest was built with; results would not be "
            "comparable."
        )
    return path


def _relative(cameras: Cameras) -> Cameras:
    return replace(cameras, c2w=relative_to_first(cameras.c2w.double()).float())


def _frame_names(order: Sequence[int]) -> tuple[str, ...]:
    return tuple(f"frame{index:03d}" for index in order)
