"""Build a benchmark of folders of photos: edits are proposed; vetted by a person, they become the
manifest.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r import Registry
from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.reporting import track, warn
from edit3r.kit.command.results import make_folder
from edit3r.kit.photos.camera_files import CAMERA_FILES, read_cameras
from edit3r.kit.photos.images import evenly, find_photos, load_photos, save_image
from edit3r.kit.photos.triples import choose_triples
from edit3r.kit.service import ChatModel
from edit3r.running import RunJob, make_run_config, preview
from edit3r_bench import proposals
from edit3r_bench.manifest import (
    VISIBLE,
    FrameRecord,
    ItemRecord,
    Manifest,
    SceneRecord,
    hash_of_file,
)
from edit3r_bench.options import BuildOptions
from edit3r_bench.proposals import LOCAL, Boxes, ProposedEdit, choose_edits

MAX_SHOWN_SIDE = 512  # longer side of what the language model is shown [pixels]
UNNAMED = "object in the middle"  # what templates speak of when nobody knows what a scene shows

Images = Float[Tensor, "view 3 height width"]


@dataclass(frozen=True)
class PhotoFolder:
    """Photos of one scene: which of them a method is given, and which are held back."""

    id: str
    path: Path
    cameras: str  # name of the camera file, "" without
    files: tuple[str, ...]  # relative to `path`
    inputs: tuple[int, ...]  # indices of `files`
    held_back: tuple[int, ...]

    def load(self, size: int, indices: Sequence[int]) -> Images:
        """Load the photos at `indices`, longer side `size` [pixels]."""
        files = [self.path / self.files[index] for index in indices]
        return load_photos(files, size=size).views.images[0]


def find_photo_folders(folder: Path, views: int) -> list[PhotoFolder]:
    """Return every sub-folder with two photos or more, else the folder itself; without poses
    `views` photos are inputs.

    Raises InputError without any.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of scenes.")
    inner = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    visible = [path for path in inner if not path.name.startswith(".")]
    folders = [_photo_folder(path, views) for path in visible]
    scenes = [scene for scene in folders if scene]
    if not scenes and (alone := _photo_folder(folder, views)):
        scenes = [alone]
    if not scenes:
        raise InputError(f"{folder}: expected folders with at least two photos each.")
    return scenes


def _photo_folder(path: Path, views: int) -> PhotoFolder | None:
    """Two photos 5 to 30 degrees apart and one between, where posed; else evenly spaced ones."""
    try:
        files = tuple(file.relative_to(path).as_posix() for file in find_photos(path))
    except InputError:  # a folder of something else
        return None
    if len(files) < 2:
        return None
    cameras = next((name for name in CAMERA_FILES if (path / name).is_file()), "")
    known = read_cameras(path / cameras) if cameras else []
    there = [own for own in known if own.file in files]
    posed = [(own.file, own.c2w) for own in there if own.c2w is not None]
    inputs = evenly(range(len(files)), views)
    held_back: tuple[int, ...] = ()
    if triples := choose_triples([c2w for _, c2w in posed], 3):
        middle = triples[len(triples) // 2]
        *inputs, target = (files.index(posed[i][0]) for i in middle)
        held_back = (target,)
    name = os.path.basename(os.path.abspath(path))
    return PhotoFolder(name, path, cameras, files, tuple(inputs), held_back)


@dataclass(frozen=True)
class PhotoBuild:
    """A benchmark from folders of photos."""

    folder: Path  # of scenes
    options: BuildOptions
    registry: Registry

    @property
    def out(self) -> Path:
        """The manifest, whose folder all paths in it are relative to."""
        return Path(self.options.out)

    @property
    def image_size(self) -> int:
        """Longer side that photos are reduced to [pixels]."""
        return self.options.size or 256

    @property
    def vetting(self) -> Path:
        """The vetting file, whose folder mask files named in it are relative to."""
        beside = self.out.with_name(f"{self.out.stem}.vetting.yaml")
        return Path(self.options.vetting or beside)

    @cached_property
    def model(self) -> ChatModel | None:
        options = self.options
        if bool(options.llm) != bool(options.llm_model):
            raise SettingsError(
                "--llm and --llm-model go together: give an address and the name of a model there."
            )
        advice = "one that takes no images needs --llm-photos 0"
        asked = ChatModel(options.llm_model, options.llm, 120, advice)
        return asked if options.llm else None

    @cached_property
    def parts(self) -> dict[str, Any]:
        """The components by the option that names them."""
        kinds = {"detector": "detector", "segmenter": "segmenter", "truth": "editor"}
        parts = {}
        for option, kind in kinds.items():
            choice = getattr(self.options, option)
            if choice is not None:
                parts[option] = self.registry.build_choice(kind, choice)
        return parts

    @cached_property
    def labels(self) -> tuple[str, ...]:
        labels = [label.strip().lower() for label in self.options.labels.split(",")]
        return tuple(label for label in labels if label)

    @cached_property
    def scenes(self) -> list[PhotoFolder]:
        """The folders of photos. Raises InputError where there are fewer than are asked for."""
        folders = find_photo_folders(self.folder, self.options.views)
        count = self.options.scenes
        if count is None:
            return folders
        if len(folders) < count:
            raise InputError(
                f"{self.folder}: holds {len(folders)} scenes, --scenes asks for {count}."
            )
        rng = np.random.default_rng(self.options.seed)
        chosen = rng.choice(len(folders), count, replace=False)
        return [folders[index] for index in sorted(chosen)]

    def propose(self) -> dict[str, list[ProposedEdit]]:
        """Return the proposed edits of every scene, near duplicates removed."""
        proposed = {}
        for number, scene in enumerate(track(self.scenes, "propose edits")):
            labels = tuple(self._objects(scene))
            if not labels:
                warn(
                    f"scene {scene.id!r}: none of its objects has a name; give --labels or a "
                    "--detector."
                )
            edits = self._proposals_of_model(scene, labels)
            edits += proposals.edits_from_templates(
                labels or (UNNAMED,), self.options.seed + number
            )
            proposed[scene.id] = proposals.without_near_duplicates(edits)
        return proposed

    def _proposals_of_model(
        self, scene: PhotoFolder, labels: Sequence[str]
    ) -> list[ProposedEdit]:
        if self.model is None:
            return []
        photos = torch.zeros(0, 3, 1, 1)
        if self.options.llm_photos:
            shown = evenly(range(len(scene.files)), self.options.llm_photos)
            photos = scene.load(MAX_SHOWN_SIDE, shown)
        return proposals.edits_from_model(labels, photos, self.model)

    def manifest(self, vetted: Mapping[str, Sequence[ProposedEdit]]) -> Manifest:
        """The benchmark; writes masks. Raises InputError for a scene without just five edits."""
        chosen = {}
        for scene in self.scenes:
            if scene.id not in vetted:
                raise InputError(
                    f"{self.vetting}: no edits for {scene.id!r}; delete the file to propose edits "
                    "anew."
                )
            chosen[scene.id] = choose_edits(scene.id, vetted[scene.id])
        items = []
        for scene in track(self.scenes, "masks"):
            items += self._items(scene, chosen[scene.id])
        options = self.options
        return Manifest(
            name=f"{len(self.scenes)} photographed scenes",
            image_size=self.image_size,
            scenes=tuple(map(self._record, self.scenes)),
            items=tuple(items),
            notes={
                "built_from": "photos",
                "detector": options.detector and options.detector.name,
                "segmenter": options.segmenter and options.segmenter.name,
                "language_model": options.llm_model or None,
            },
        )

    def _objects(self, scene: PhotoFolder) -> dict[str, Boxes]:
        """What the scene shows, with boxes: found in all photos, else as the user says."""
        if "detector" not in self.parts:
            return dict.fromkeys(self.labels, ())
        # One by one, since they may have several shapes.
        indices = range(len(scene.files))
        photos = (scene.load(self.image_size, [index])[0] for index in indices)
        words = self.labels or proposals.WORDS["vocabulary"]
        return proposals.find_objects(photos, self.parts["detector"], words)

    def _record(self, scene: PhotoFolder) -> SceneRecord:
        hashes = [(file, hash_of_file(scene.path / file)) for file in scene.files]
        frames = tuple(FrameRecord(file=file, sha256=sha) for file, sha in hashes)
        folder = self._relative(scene.path)
        return SceneRecord(
            id=scene.id, folder=folder, cameras=scene.cameras, frames=frames
        )

    def _items(
        self, scene: PhotoFolder, edits: Sequence[ProposedEdit]
    ) -> list[ItemRecord]:
        objects = self._objects(scene)
        items = []
        for number, edit in enumerate(edits, start=1):
            name = f"{scene.id}-{number}-{edit.type.lower()}"
            item = ItemRecord(
                id=name,
                scene=scene.id,
                type=edit.type,
                prompt=edit.prompt,
                description=edit.description,
                before=f"a photo of the {edit.object}" if edit.object else "a photo",
                seed=self.options.seed,
                inputs=scene.inputs,
                held_back=scene.held_back,
                masks=self._masks(name, scene, edit, objects.get(edit.object, ())),
                truth=self._truth(name, scene, edit),
            )
            items.append(item)
        return items

    def _masks(
        self, item: str, scene: PhotoFolder, edit: ProposedEdit, boxes: Boxes
    ) -> tuple[FrameRecord, ...]:
        """Masks that a person named, else around what is removed or modified in every input."""
        if edit.masks:
            if len(edit.masks) != len(scene.inputs):
                raise InputError(
                    f"{self.vetting}, scene {scene.id!r}, {edit.prompt!r}: {len(edit.masks)} "
                    f"masks for {len(scene.inputs)} inputs."
                )
            return self._records([self.vetting.parent / mask for mask in edit.masks])
        of_inputs = [boxes[i] for i in scene.inputs] if boxes else []
        own = [box for box in of_inputs if box is not None]
        if edit.type not in LOCAL or not own or len(own) < len(of_inputs):
            return ()
        photos = scene.load(self.image_size, scene.inputs)
        masks = proposals.masks_from_boxes(photos, own, self.parts.get("segmenter"))
        grey = masks[:, None].expand(-1, 3, -1, -1)
        return self._written("masks", item, scene.inputs, grey)

    def _truth(
        self, item: str, scene: PhotoFolder, edit: ProposedEdit
    ) -> tuple[FrameRecord, ...]:
        """Write every frame as the editor that makes the truth edits it; none without one."""
        if "truth" not in self.parts:
            return ()
        frames = (*scene.inputs, *scene.held_back)
        files = [scene.path / scene.files[index] for index in frames]
        views = load_photos(files, size=self.image_size).views
        config = make_run_config({"prompt": edit.prompt, "seed": self.options.seed})
        job = RunJob(config, views, components={"editor": self.parts["truth"]})
        preview_edit = preview(job, self.registry).edit
        assert preview_edit is not None  # it was asked for
        edited = preview_edit.views.images[0]
        changes = (edited - views.images[0]).abs().amax((1, 2, 3))
        for file, change in zip(files, changes):
            if change <= VISIBLE:
                raise InputError(
                    f"scene {scene.id!r}, {edit.prompt!r}: the editor left {file.name} as it was; "
                    "drop it."
                )
        return self._written("truth", item, frames, edited)

    def _written(
        self, what: str, item: str, frames: Sequence[int], images: Images
    ) -> tuple[FrameRecord, ...]:
        """Write images beside the manifest, and return their records."""
        folder = make_folder(self.out.parent / f"{self.out.stem}-{what}")
        files = [folder / f"{item}-{index:03d}.png" for index in frames]
        for file, image in zip(files, images):
            save_image(image, file)
        return self._records(files)

    def _records(self, files: Sequence[Path]) -> tuple[FrameRecord, ...]:
        hashes = [(self._relative(file), hash_of_file(file)) for file in files]
        return tuple(FrameRecord(file=name, sha256=sha) for name, sha in hashes)

    def _relative(self, path: Path) -> str:
        return Path(os.path.relpath(path, self.out.parent)).as_posix()
