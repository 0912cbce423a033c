"""The manifest: one JSON file that says everything a benchmark run depends on, outside the method under test.

Pictures are named by their hashes and generated scenes by their seeds, so the file alone reproduces a report: photos
that were changed, or a generator that draws something else, are noticed and not silently measured.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import Field

from edit3r.config import Settings, make_settings
from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write
from edit3r.io.run_folder import installed_versions

__all__ = [
    "EDITS_PER_SCENE",
    "EDIT_TYPES",
    "EditType",
    "FrameRecord",
    "ItemRecord",
    "Manifest",
    "SampleRecord",
    "SceneRecord",
    "read_bench_manifest",
    "write_bench_manifest",
]

EditType = Literal["Add", "Remove", "Modify", "Global"]
EDIT_TYPES: tuple[EditType, ...] = get_args(EditType)
EDITS_PER_SCENE = 5
VERSION = 1


class FrameRecord(Settings):
    """One picture of a scene."""

    file: str = Field(description="relative to the scene's folder")
    sha256: str = Field(description="of the file")


class SceneRecord(Settings):
    """Photos in a folder; a generated scene has no frames, its pictures come with each item's sample."""

    id: str = Field(description="unique in the manifest")
    folder: str = Field("", description="relative to the manifest's folder; '' for a generated scene")
    cameras: str = Field("", description="camera file in the folder; '' when poses are not known")
    frames: tuple[FrameRecord, ...] = Field((), description="in the order that item indices count")


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
    prompt: str = Field(description="the instruction, shared by all views")
    description: str = Field("", description="what the edited picture shows, for CLIP; '' to use the prompt")
    before: str = Field("", description="what the unedited picture shows, for CLIP direction; '' not measured")
    seed: int = Field(0, ge=0, description="shared by all views")
    inputs: tuple[int, ...] = Field(description="frames given to the method; the first is the reference")
    held_back: tuple[int, ...] = Field((), description="frames that the method is not given, for measuring")
    masks: tuple[FrameRecord, ...] = Field((), description="per input frame, white may change; empty: everywhere")
    sample: SampleRecord | None = Field(None, description="for a generated scene")


class Manifest(Settings):
    """A whole benchmark."""

    format: Literal["edit3r-bench"] = "edit3r-bench"
    version: Literal[1] = VERSION
    name: str = Field("", description="shown in reports")
    image_size: int = Field(256, ge=16, description="longer side that photos are reduced to [pixels]")
    scenes: tuple[SceneRecord, ...]
    items: tuple[ItemRecord, ...]
    made_with: dict[str, str] = Field(default_factory=installed_versions, description="versions of packages")
    notes: dict[str, Any] = Field(default_factory=dict, description="how it was built: detectors, prompts, rejections")

    def scene(self, name: str) -> SceneRecord:
        """The scene called `name`."""
        return next(scene for scene in self.scenes if scene.id == name)

    def item(self, name: str) -> ItemRecord:
        """The item called `name`."""
        return next(item for item in self.items if item.id == name)

    def limited(self, scenes: int | None, edits: int | None, types: tuple[str, ...] = ()) -> "Manifest":
        """Only the first scenes, the first edits of each, and edits of the given types."""
        kept = self.scenes[:scenes]
        items = []
        for scene in kept:
            own = [item for item in self.items if item.scene == scene.id and (not types or item.type in types)]
            items += own[:edits]
        return self.model_copy(update={"scenes": kept, "items": tuple(items)})

    @property
    def sha256(self) -> str:
        """Of everything that results depend on: not of names, notes and versions."""
        content = self.model_dump(mode="json", include={"format", "version", "image_size", "scenes", "items"})
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode("utf-8")).hexdigest()


def write_bench_manifest(path: str | Path, manifest: Manifest) -> None:
    """Write as JSON, the same bytes for the same benchmark and packages."""
    _check_consistent(manifest, Path(path))
    with atomic_write(path) as partial:
        text = json.dumps(manifest.model_dump(mode="json"), indent=1, ensure_ascii=False)
        partial.write_text(text + "\n", encoding="utf-8")


def read_bench_manifest(path: str | Path) -> Manifest:
    """Read and check. Raises InputError naming the file and what is wrong with it."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such benchmark manifest; edit3r bench build makes one.")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON ({error}).") from None
    if not isinstance(content, Mapping) or content.get("format") != "edit3r-bench":
        raise InputError(f"{path}: not a benchmark manifest (its 'format' is not 'edit3r-bench').")
    if content.get("version") != VERSION:
        raise InputError(f"{path}: manifest version {content.get('version')!r}, this edit3r reads version {VERSION}.")
    manifest = make_settings(Manifest, content, where=path.name)
    _check_consistent(manifest, path)
    return manifest


def _check_consistent(manifest: Manifest, path: Path) -> None:
    scenes = [scene.id for scene in manifest.scenes]
    items = [item.id for item in manifest.items]
    for what, names in (("scene", scenes), ("item", items)):
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"{path}: two {what}s are called {twice!r}.")
    for item in manifest.items:
        if item.scene not in scenes:
            raise InputError(f"{path}: item {item.id!r} names the scene {item.scene!r}, which is not in the manifest.")
        if len(item.inputs) < 1 or len(item.masks) not in (0, len(item.inputs)):
            raise InputError(f"{path}: item {item.id!r} needs input frames, and a mask for each of them or none.")
