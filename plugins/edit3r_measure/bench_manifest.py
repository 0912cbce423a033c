"""The manifest of a benchmark, and how one of its items becomes images, cameras and masks.

The manifest is one JSON file that says everything a benchmark run depends on, outside the method
under test. It names images by their hashes and generated scenes by their seeds, so that a photo
that was changed, or a generator that draws something else, is noticed.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.config import Settings, make_settings
from edit3r.contract.interfaces import SceneSample
from edit3r.contract.types import Cameras, Views
from edit3r.errors import InputError
from edit3r.geometry.cameras import relative_to_first
from edit3r.geometry.maps import dilate
from edit3r.io.atomic import sha256_of
from edit3r.io.images import is_plain_name, load_photos, read_image
from edit3r.io.masks import load_masks
from edit3r.io.run_folder import installed_versions
from edit3r.pipeline.config import MAX_PROMPT
from edit3r.plugins.registry import Registry
from edit3r_measure.report import read_json, write_json

EditType = Literal["Add", "Remove", "Modify", "Global"]
EDIT_TYPES: tuple[EditType, ...] = get_args(EditType)
EDITS_PER_SCENE = 5
VERSION = 1
VISIBLE = (
    1.5 / 255
)  # a generated scene's edit is where truth and photo differ by more than this
MARGIN = 0.025  # a generated edit's mask reaches this much further than the change [image widths]


class FrameRecord(Settings):
    """One image file of a scene."""

    file: str = Field(description="relative to the scene's folder")
    sha256: str = Field(description="of the file")


class SceneRecord(Settings):
    """Photos in a folder; a generated scene has no frames, its images come with each item's
    sample.
    """

    id: str = Field(description="unique in the manifest")
    folder: str = Field(
        "", description="relative to the manifest's folder; '' for a generated scene"
    )
    cameras: str = Field(
        "", description="camera file in the folder; '' when poses are not known"
    )
    frames: tuple[FrameRecord, ...] = Field(
        (), description="in the order that item indices count"
    )


class SampleRecord(Settings):
    """A generated scene with its edited truth: a dataset component, its settings and an index."""

    dataset: str = Field(description="name of the dataset component")
    settings: dict[str, Any] = Field(description="of the dataset")
    index: int = Field(ge=0, description="of the sample")
    sha256: str = Field(description="of the photos and of the edited truth, in 8 bits")


class ItemRecord(Settings):
    """One edit of one scene."""

    id: str = Field(description="unique in the manifest, usable as a folder name")
    scene: str = Field(description="id of its scene")
    type: EditType
    prompt: str = Field(
        max_length=MAX_PROMPT, description="the instruction, shared by all views"
    )
    description: str = Field(
        "", description="what the edited photo shows, for CLIP; '' to use the prompt"
    )
    before: str = Field(
        "",
        description="what the unedited photo shows, for CLIP direction; '' not measured",
    )
    seed: int = Field(0, ge=0, description="shared by all views")
    inputs: tuple[int, ...] = Field(
        description="frames given to the method; the first is the reference"
    )
    held_back: tuple[int, ...] = Field(
        (), description="frames that the method is not given, for measuring"
    )
    masks: tuple[FrameRecord, ...] = Field(
        (), description="per input frame, white may change; empty: everywhere"
    )
    truth: tuple[FrameRecord, ...] = Field(
        (), description="per used frame, inputs first, the edited photo if known"
    )
    sample: SampleRecord | None = Field(None, description="for a generated scene")


class Manifest(Settings):
    """A whole benchmark."""

    format: Literal["edit3r-bench"] = "edit3r-bench"
    version: Literal[1] = VERSION
    name: str = Field("", description="shown in reports")
    image_size: int = Field(
        256, ge=16, description="longer side that photos are reduced to [pixels]"
    )
    scenes: tuple[SceneRecord, ...]
    items: tuple[ItemRecord, ...]
    made_with: dict[str, str] = Field(
        default_factory=installed_versions, description="versions of packages"
    )
    notes: dict[str, Any] = Field(
        default_factory=dict,
        description="how it was built: detectors, prompts, rejections",
    )

    def limited(self, scenes: int | None, edits: int | None) -> "Manifest":
        """Return the first `scenes` scenes with the first `edits` edits of each; None: all."""
        kept = self.scenes[:scenes]
        own = [
            [item for item in self.items if item.scene == scene.id][:edits]
            for scene in kept
        ]
        return self.model_copy(
            update={
                "scenes": kept,
                "items": tuple(item for items in own for item in items),
            }
        )

    @property
    def sha256(self) -> str:
        """Hash of everything that results depend on: not of names, notes and versions."""
        content = self.model_dump(
            mode="json", include={"format", "version", "image_size", "scenes", "items"}
        )
        return hashlib.sha256(
            json.dumps(content, sort_keys=True).encode("utf-8")
        ).hexdigest()


def write_bench_manifest(path: str | Path, manifest: Manifest) -> None:
    """Write the manifest as JSON, the same bytes for the same benchmark and packages."""
    _check_consistent(manifest, Path(path))
    write_json(path, manifest.model_dump(mode="json"))


def read_bench_manifest(path: str | Path) -> Manifest:
    """Read and check a manifest. Raises InputError naming the file and what is wrong with it."""
    path = Path(path)
    if not path.is_file():
        raise InputError(
            f"{path}: no such benchmark manifest; edit3r bench build makes one."
        )
    content = read_json(path)
    if not isinstance(content, Mapping) or content.get("format") != "edit3r-bench":
        raise InputError(
            f"{path}: not a benchmark manifest (its 'format' is not 'edit3r-bench')."
        )
    if content.get("version") != VERSION:
        raise InputError(
            f"{path}: manifest version {content.get('version')!r}, this edit3r reads version "
            f"{VERSION}."
        )
    manifest = make_settings(Manifest, content, where=path.name)
    _check_consistent(manifest, path)
    return manifest


def _check_consistent(manifest: Manifest, path: Path) -> None:
    scenes = [scene.id for scene in manifest.scenes]
    frames_of = {scene.id: len(scene.frames) for scene in manifest.scenes}
    items = [item.id for item in manifest.items]
    for what, names in (("scene", scenes), ("item", items)):
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"{path}: two {what}s are called {name!r}.")
    for item in manifest.items:
        if not is_plain_name(item.id):  # results lie in a folder of that name
            raise InputError(
                f"{path}: the item id {item.id[:60]!r} is no plain file name."
            )
        if item.scene not in scenes:
            raise InputError(
                f"{path}: item {item.id!r} names the scene {item.scene!r}, which is not in the "
                "manifest."
            )
        if len(item.inputs) < 1 or len(item.masks) not in (0, len(item.inputs)):
            raise InputError(
                f"{path}: item {item.id!r} needs input frames, and a mask for each of them or none."
            )
        used = (*item.inputs, *item.held_back)
        if len(item.truth) not in (0, len(used)):
            raise InputError(
                f"{path}: item {item.id!r} needs a true picture for each frame it uses, or none."
            )
        wrong = [
            index
            for index in used
            if index < 0 or (item.sample is None and index >= frames_of[item.scene])
        ]
        if wrong:
            raise InputError(
                f"{path}: item {item.id!r} uses frame {wrong[0]}, which its scene does not have."
            )
        if len(set(used)) < len(used):
            raise InputError(f"{path}: item {item.id!r} uses a frame twice.")


@dataclass(frozen=True)
class LoadedItem:
    """One edit with everything that is known about its scene; the frames are all its images, inputs
    first.
    """

    record: ItemRecord
    photos: Views  # batch 1, all frames, without poses
    inputs: int  # how many of the frames the method is given
    cameras: Cameras | None  # true, batch 1, relative to frame 0; None: not known
    depths: Float[Tensor, "frame height width"] | None  # true camera z; None: not known
    truth: (
        Float[Tensor, "frame 3 height width"] | None
    )  # the edited scene; None: not known
    masks: (
        Float[Tensor, "frame height width"] | None
    )  # where the edit may show; None: everywhere or not known


def load_item(
    manifest: Manifest, item: ItemRecord, root: Path, registry: Registry
) -> LoadedItem:
    """Load `item`; `root` is the manifest's folder. Raises InputError when images are not those of
    the manifest.
    """
    if item.sample is not None:
        return _generated(item, item.sample, registry)
    scene = next(scene for scene in manifest.scenes if scene.id == item.scene)
    return _photographed(scene, item, root, manifest.image_size)


def load_sample(record: SampleRecord, registry: Registry) -> SceneSample:
    """Make a generated scene again; the last ones are kept for the other methods of a run."""
    return _sample(
        record.dataset,
        json.dumps(record.settings, sort_keys=True),
        record.index,
        registry,
    )


@lru_cache(maxsize=100)
def _sample(dataset: str, settings: str, index: int, registry: Registry) -> SceneSample:
    return registry.build("dataset", dataset, **json.loads(settings))[index]


def hash_of_sample(sample: SceneSample) -> str:
    """Return the SHA-256 of the photos and the edited truth, rounded to 8 bits."""
    digest = hashlib.sha256()
    for images in (
        sample.context,
        sample.target,
        sample.edited_context,
        sample.edited_target,
    ):
        digest.update((images * 255).round().to(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def hash_of_file(path: Path) -> str:
    """Return the SHA-256 of a file. Raises InputError when it is not there."""
    if not path.is_file():
        raise InputError(f"{path}: no such file, and the manifest needs it.")
    return sha256_of(path)


def change_masks(
    photos: Float[Tensor, "frame 3 height width"],
    truth: Float[Tensor, "frame 3 height width"],
) -> Float[Tensor, "frame height width"]:
    """Return 1 where the truth visibly differs from the photo and a little around, else 0."""
    changed = ((truth - photos).abs().amax(1) > VISIBLE).to(photos.dtype)
    return dilate(changed, max(1, round(MARGIN * photos.shape[-1])))


def _generated(
    item: ItemRecord, record: SampleRecord, registry: Registry
) -> LoadedItem:
    sample = load_sample(record, registry)
    if hash_of_sample(sample) != record.sha256:
        raise InputError(
            f"{item.id}: the scene that {record.dataset!r} makes here is not the manifest's (its "
            "pictures differ); "
            "install the versions under 'made_with'."
        )
    order = [*item.inputs, *item.held_back]
    if max(order) >= len(sample.context):
        raise InputError(
            f"{item.id}: uses frame {max(order)}, but the scene that is made has "
            f"{len(sample.context)}."
        )
    photos, truth = sample.context[order], sample.edited_context[order]
    cameras = sample.context_cameras.select(order)
    return LoadedItem(
        record=item,
        photos=Views(photos[None], cameras.intrinsics, _frame_names(order)),
        inputs=len(item.inputs),
        cameras=_relative(cameras),
        depths=None if sample.context_depths is None else sample.context_depths[order],
        truth=truth,
        masks=None if item.type == "Global" else change_masks(photos, truth),
    )


def _photographed(
    scene: SceneRecord, item: ItemRecord, root: Path, size: int
) -> LoadedItem:
    order = [*item.inputs, *item.held_back]
    frames = [scene.frames[index] for index in order]
    folder = root / scene.folder
    known = [(folder / f.file, f) for f in frames] + [
        (root / m.file, m) for m in (*item.masks, *item.truth)
    ]
    for path, record in known:
        if hash_of_file(path) != record.sha256:
            raise InputError(
                f"{path}: not the picture that the manifest was built with; results would not "
                "compare."
            )
    camera_file = folder / scene.cameras if scene.cameras else None
    files = [folder / record.file for record in frames]
    loaded = load_photos(
        files, size=size, cameras=camera_file, names=_frame_names(order)
    )
    views, posed = (
        loaded.views,
        camera_file is not None and loaded.views.c2w is not None,
    )
    masks = truth = None
    if item.truth:
        pictures = [
            np.asarray(read_image(root / record.file), np.float32) / 255
            for record in item.truth
        ]
        truth = torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2).contiguous()
        masks = None if item.type == "Global" else change_masks(views.images[0], truth)
    elif item.masks:
        given = replace(loaded, photos=loaded.photos[: len(item.inputs)])
        masks = load_masks([root / record.file for record in item.masks], given)[0]
        unknown = masks.new_full(
            (len(item.held_back), *masks.shape[1:]), float("nan")
        )  # measures nothing there
        masks = torch.cat((masks, unknown))
    return LoadedItem(
        record=item,
        photos=replace(views, c2w=None),
        inputs=len(item.inputs),
        cameras=_relative(Cameras(views.c2w, views.intrinsics, views.image_size))
        if posed
        else None,
        depths=None,
        truth=truth,
        masks=masks,
    )


def _relative(cameras: Cameras) -> Cameras:
    return replace(cameras, c2w=relative_to_first(cameras.c2w.double()).float())


def _frame_names(order: list[int]) -> tuple[str, ...]:
    return tuple(f"frame{index:03d}" for index in order)
