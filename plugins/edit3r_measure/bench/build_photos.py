"""A benchmark from folders of photos, in two steps with a person between them.

photos -> labels (detector) -> candidate edits (language model or templates) -> near-duplicates out -> vetting file
vetting file, edited -> five edits a scene -> masks of local edits -> manifest
"""

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from pydantic import Field

from edit3r.config import Settings
from edit3r.errors import InputError
from edit3r.interfaces import Detector, Segmenter
from edit3r.io.atomic import atomic_write
from edit3r.reporting import track, warn
from edit3r.stage_checks import component_name
from edit3r_measure.bench.candidates import Candidate, asked_candidates, template_candidates
from edit3r_measure.bench.labels import VOCABULARY, SceneLabels, find_labels, masks_of
from edit3r_measure.bench.language_model import LanguageModel
from edit3r_measure.bench.manifest import FrameRecord, ItemRecord, Manifest, SceneRecord
from edit3r_measure.bench.near_duplicates import without_near_duplicates
from edit3r_measure.bench.scene_folders import SceneFolder
from edit3r_measure.bench.vetting import VettedEdit, choose_edits

__all__ = ["PhotoBuild", "PhotoSettings", "PhotoTools", "propose"]

UNNAMED = "object in the middle"
"""What templates speak of when nobody knows what a scene shows."""


class PhotoSettings(Settings):
    """How scenes are read."""

    image_size: int = Field(256, ge=32, le=4096, description="longer side that photos are reduced to [pixels]")
    seed: int = Field(2026, ge=0, description="of the edits, shared by all views of an item")
    views: int = Field(2, ge=2, le=32, description="input photos of scenes without poses, evenly spaced")
    labels: tuple[str, ...] = Field((), description="what the photos show; with a detector what it looks for")


@dataclass(frozen=True)
class PhotoTools:
    """What helps to find edits; each may be absent."""

    detector: Detector | None = None
    segmenter: Segmenter | None = None
    model: LanguageModel | None = None

    def names(self) -> dict[str, str | None]:
        """For the manifest's notes."""
        parts = {"detector": self.detector, "segmenter": self.segmenter}
        found = {kind: None if part is None else component_name(part) for kind, part in parts.items()}
        return {"built_from": "photos", **found, "language_model": None if self.model is None else self.model.name}


def propose(scenes: Sequence[SceneFolder], tools: PhotoTools, settings: PhotoSettings) -> dict[str, list[Candidate]]:
    """Candidate edits of every scene, near-duplicates removed."""
    found = {}
    for number, scene in enumerate(track(scenes, "propose edits")):
        labels = _labels(scene, tools, settings).labels
        if not labels:
            warn(f"scene {scene.id!r}: nothing in it is known by name; give --labels, or a --detector.")
        own = asked_candidates(labels, tools.model) if tools.model is not None else []
        own += template_candidates(labels or (UNNAMED,), settings.seed + number)
        found[scene.id] = without_near_duplicates(own, lambda candidate: candidate.prompt)[0]
    return found


@dataclass(frozen=True)
class PhotoBuild:
    """The second step: five vetted edits a scene become items; masks are written beside the manifest."""

    tools: PhotoTools
    settings: PhotoSettings
    out: Path  # the manifest, whose folder all paths in it are relative to
    vetting: Path

    def manifest(self, scenes: Sequence[SceneFolder], vetted: Mapping[str, list[VettedEdit]]) -> Manifest:
        """The whole benchmark. Raises InputError naming a scene that has not exactly five edits."""
        missing = [scene.id for scene in scenes if scene.id not in vetted]
        if missing:
            raise InputError(f"{self.vetting}: no edits for {missing[0]!r}; delete the file to propose edits anew.")
        chosen = {scene.id: choose_edits(scene.id, vetted[scene.id]) for scene in scenes}
        items = [item for scene in track(scenes, "masks") for item in self._items(scene, chosen[scene.id])]
        return Manifest(
            name=f"{len(scenes)} photographed scenes",
            image_size=self.settings.image_size,
            scenes=tuple(self._record(scene) for scene in scenes),
            items=tuple(items),
            notes={**self.tools.names(), "edits_without_masks": [item.id for item in items if not item.masks]},
        )

    def _record(self, scene: SceneFolder) -> SceneRecord:
        frames = tuple(FrameRecord(file=file, sha256=_sha256(scene.path / file)) for file in scene.files)
        return SceneRecord(id=scene.id, folder=self._relative(scene.path), cameras=scene.cameras, frames=frames)

    def _items(self, scene: SceneFolder, edits: Sequence[VettedEdit]) -> list[ItemRecord]:
        labels = _labels(scene, self.tools, self.settings)
        names = [f"{scene.id}-{number}-{edit.type.lower()}" for number, edit in enumerate(edits, start=1)]
        return [
            ItemRecord(
                id=name,
                scene=scene.id,
                type=edit.type,
                prompt=edit.prompt,
                description=edit.description,
                before=f"a photo of the {edit.object}" if edit.object else "a photo",
                seed=self.settings.seed,
                inputs=scene.inputs,
                held_back=scene.held_back,
                masks=self._masks(name, scene, edit, labels),
            )
            for name, edit in zip(names, edits)
        ]

    def _masks(self, item: str, scene: SceneFolder, edit: VettedEdit, labels: SceneLabels) -> tuple[FrameRecord, ...]:
        """Those a person named; else around the object that is removed or modified, where a detector found it."""
        if edit.masks and len(edit.masks) != len(scene.inputs):
            counts = f"{len(edit.masks)} masks for {len(scene.inputs)} inputs"
            raise InputError(f"{self.vetting}, scene {scene.id!r}, {edit.prompt!r}: {counts}.")
        files = [self.vetting.parent / mask for mask in edit.masks] or self._drawn(item, scene, edit, labels)
        return tuple(FrameRecord(file=self._relative(file), sha256=_sha256(file)) for file in files)

    def _drawn(self, item: str, scene: SceneFolder, edit: VettedEdit, labels: SceneLabels) -> list[Path]:
        """Mask files made from the detector's boxes; none when it did not find the object in every input."""
        boxes = labels.boxes.get(edit.object) if edit.type in ("Remove", "Modify") else None
        if boxes is None:
            return []
        masks = masks_of(scene.pictures(self.settings.image_size), boxes, self.tools.segmenter)
        if masks is None:
            return []
        folder = self.out.parent / f"{self.out.stem}-masks"
        folder.mkdir(exist_ok=True)
        files = [folder / f"{item}-{index:03d}.png" for index in scene.inputs]
        for file, mask in zip(files, masks):
            with atomic_write(file) as partial:
                Image.fromarray((mask * 255).round().byte().numpy()).save(partial)
        return files

    def _relative(self, path: Path) -> str:
        return Path(os.path.relpath(os.path.abspath(path), os.path.abspath(self.out.parent))).as_posix()


def _labels(scene: SceneFolder, tools: PhotoTools, settings: PhotoSettings) -> SceneLabels:
    if tools.detector is None:
        return SceneLabels(settings.labels, {})
    return find_labels(scene.pictures(settings.image_size), tools.detector, settings.labels or VOCABULARY)


def _sha256(path: Path) -> str:
    if not path.is_file():
        raise InputError(f"{path}: no such file.")
    return hashlib.sha256(path.read_bytes()).hexdigest()
