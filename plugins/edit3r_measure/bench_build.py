"""Build a benchmark's manifest: from generated scenes whose edited truth is known, or from folders
of photos.
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from pydantic import Field
from torch import Tensor

from edit3r.config import Settings
from edit3r.contract.interfaces import (
    Detection,
    Detector,
    Editor,
    SceneSample,
    Segmenter,
)
from edit3r.contract.types import EditRequest
from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write
from edit3r.io.cameras import CAMERA_FILES, read_cameras
from edit3r.io.images import evenly, find_photos, load_photos, save_image
from edit3r.pipeline.checks import component_name
from edit3r.plugins.registry import Registry
from edit3r.reporting import progress, track, warn
from edit3r_measure import bench_proposals
from edit3r_measure.bench_manifest import (
    EDITS_PER_SCENE,
    VISIBLE,
    FrameRecord,
    ItemRecord,
    Manifest,
    SampleRecord,
    SceneRecord,
    hash_of_file,
    hash_of_sample,
    load_sample,
)
from edit3r_measure.bench_proposals import (
    Boxes,
    LanguageModel,
    ProposedEdit,
    choose_edits,
)
from edit3r_measure.report import make_folder
from edit3r_measure.scene_sources import choose_triples

GENERATED_EDITS = (
    ("add", "Add", {"edit": "add"}, "add an object"),
    ("remove", "Remove", {"edit": "remove"}, "remove the object"),
    ("modify", "Modify", {"edit": "recolor"}, "recolor the object"),
    ("modify-2", "Modify", {"edit": "recolor", "edit_seed": 1}, "recolor the object"),
    ("global", "Global", {"edit": "global"}, "recolor everything"),
)
"""Suffix of the item, type, settings of the dataset, prompt. The first one is the pickiest, so it
is tried first.
"""

MOST_TRIES = 40  # generated scenes looked at for each that is taken, before giving up
PAPER_SCENES = 20
MOST_SHOWN_SIDE = 512  # longer side of what the language model is shown [pixels]
UNNAMED = "object in the middle"  # what templates speak of when nobody knows what a scene shows


class GeneratedSettings(Settings):
    """How the scenes are drawn and which are taken."""

    dataset: str = Field(
        "procedural",
        description="dataset component that knows the edited truth of its scenes",
    )
    image_size: int = Field(
        128, ge=32, le=1024, description="height and width of the pictures [pixels]"
    )
    seed: int = Field(2026, ge=0, description="of the scenes")
    frames: int = Field(
        4,
        ge=3,
        le=16,
        description="pictures a scene; first and last are given, the rest held back",
    )
    inputs: int = Field(
        2, ge=2, le=15, description="how many of them are given, evenly spaced"
    )
    angles: tuple[float, float] = Field(
        (3.0, 8.0), description="between neighbouring pictures [degrees]"
    )
    area: tuple[float, float] = Field(
        (0.02, 0.5), description="share of every picture that a local edit must cover"
    )
    change: float = Field(
        0.05, ge=0, description="least mean absolute change where it changes [sRGB]"
    )


def build_generated(
    scenes: int, settings: GeneratedSettings, registry: Registry
) -> Manifest:
    """Return a benchmark of the generator's first `scenes` scenes whose five edits can all be seen
    in all images.
    """
    records, items, index = [], [], 0
    while len(records) < scenes:
        if index - len(records) > MOST_TRIES * scenes:
            raise InputError(
                f"only {len(records)} of {index} generated scenes show all edits; ask for weaker "
                "edits."
            )
        name = f"scene{index:03d}"
        progress("generate scenes", len(records), scenes)
        found = _generated_items(name, index, settings, registry)
        if found is not None:
            records.append(SceneRecord(id=name))
            items += found
        index += 1
    notes = {"generator": settings.model_dump(mode="json"), "candidates": index}
    return Manifest(
        name=f"{settings.dataset}: {scenes} scenes, {EDITS_PER_SCENE} edits each, truth known",
        image_size=settings.image_size,
        scenes=tuple(records),
        items=tuple(items),
        notes={**notes, "rejected_as_hardly_visible": index - scenes},
    )


def _generated_items(
    name: str, index: int, settings: GeneratedSettings, registry: Registry
) -> list[ItemRecord] | None:
    """Return the five edits of scene `index`; None as soon as one of them is hardly to be seen."""
    items = []
    inputs = tuple(evenly(range(settings.frames), settings.inputs))
    drawn = {
        "seed": settings.seed,
        "image_size": settings.image_size,
        "context": settings.frames,
        "targets": 0,
    }
    for number, (suffix, kind, edit, prompt) in enumerate(GENERATED_EDITS):
        own = {**drawn, "angles": list(settings.angles), **edit}
        record = SampleRecord(
            dataset=settings.dataset, settings=own, index=index, sha256=""
        )
        sample = load_sample(record, registry)
        if not is_visible(sample, kind == "Global", settings):
            return None
        items.append(
            ItemRecord(
                id=f"{name}-{suffix}",
                scene=name,
                type=kind,
                prompt=prompt,
                seed=EDITS_PER_SCENE * index + number,
                inputs=inputs,
                held_back=tuple(
                    frame for frame in range(settings.frames) if frame not in inputs
                ),
                sample=record.model_copy(update={"sha256": hash_of_sample(sample)}),
            )
        )
    return items


def is_visible(
    sample: SceneSample, everywhere: bool, settings: GeneratedSettings
) -> bool:
    """Return whether the edit covers a fair part of every image and changes it by more than
    noise.
    """
    change = (sample.edited_context - sample.context).abs()
    changed = change.amax(1) > VISIBLE
    share = changed.float().mean((1, 2))
    low, high = settings.area
    inside = change.mean(1)[changed]
    strong = inside.numel() > 0 and float(inside.mean()) >= settings.change
    return strong and (everywhere or bool(((share >= low) & (share <= high)).all()))


@dataclass(frozen=True)
class PhotoFolder:
    """Photos of one scene: which of them a method is given, and which are held back."""

    id: str
    path: Path
    cameras: str  # name of the camera file, "" without
    files: tuple[str, ...]  # relative to `path`
    inputs: tuple[int, ...]  # indices of `files`
    held_back: tuple[int, ...]

    def load(
        self, size: int, indices: Sequence[int]
    ) -> Float[Tensor, "view 3 height width"]:
        """Load the photos at `indices`, longer side `size` [pixels]."""
        return load_photos(
            [self.path / self.files[index] for index in indices], size=size
        ).views.images[0]


def find_photo_folders(folder: Path, views: int) -> list[PhotoFolder]:
    """Return every sub-folder with two photos or more, else the folder itself; without poses
    `views` photos are inputs.

    Raises InputError without any.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of scenes.")
    inner = sorted(
        path
        for path in folder.iterdir()
        if path.is_dir() and not path.name.startswith(".")
    )
    scenes = [
        scene for path in inner if (scene := _photo_folder(path, views)) is not None
    ]
    scenes = scenes or [
        scene for scene in [_photo_folder(folder, views)] if scene is not None
    ]
    if not scenes:
        raise InputError(f"{folder}: expected folders with at least two photos each.")
    return scenes


def _photo_folder(path: Path, views: int) -> PhotoFolder | None:
    """Return two photos 5 to 30 degrees apart and one between them, where poses are known; else
    evenly spaced ones.
    """
    try:
        files = tuple(file.relative_to(path).as_posix() for file in find_photos(path))
    except InputError:  # a folder of something else
        return None
    if len(files) < 2:
        return None
    cameras = next((name for name in CAMERA_FILES if (path / name).is_file()), "")
    known = read_cameras(path / cameras) if cameras else []
    posed = [
        camera for camera in known if camera.c2w is not None and camera.file in files
    ]
    inputs, held_back = tuple(evenly(range(len(files)), views)), ()
    if triples := choose_triples(posed, 3):
        middle = triples[len(triples) // 2]
        first, second, target = (
            files.index(posed[i].file)
            for i in (middle.first, middle.second, middle.target)
        )
        inputs, held_back = (first, second), (target,)
    return PhotoFolder(
        os.path.basename(os.path.abspath(path)), path, cameras, files, inputs, held_back
    )


class PhotoBuild(Settings):
    """A benchmark from folders of photos: first edits are proposed; vetted by a person, they become
    the manifest.
    """

    folder: Path = Field(description="folder of scenes")
    out: Path = Field(
        description="the manifest, whose folder all paths in it are relative to"
    )
    vetting: Path = Field(
        description="the vetting file, whose folder mask files named in it are relative to"
    )
    image_size: int = Field(
        256,
        ge=32,
        le=4096,
        description="longer side that photos are reduced to [pixels]",
    )
    seed: int = Field(
        2026, ge=0, description="of the edits, shared by all views of an item"
    )
    views: int = Field(
        2,
        ge=2,
        le=32,
        description="input photos of scenes without poses, evenly spaced",
    )
    labels: tuple[str, ...] = Field(
        (), description="what the photos show; with a detector what it looks for"
    )
    detector: Detector | None = None
    segmenter: Segmenter | None = None
    model: LanguageModel | None = None
    photos_shown: int = Field(
        8, ge=0, description="most photos of a scene that the language model is shown"
    )
    count: int | None = Field(
        None, ge=1, description="how many of the scenes, drawn by the seed; None: all"
    )
    truth: Editor | None = (
        None  # edits all frames, held-back ones too; what it makes is the truth
    )

    @cached_property
    def scenes(self) -> list[PhotoFolder]:
        """The folders of photos. Raises InputError where there are fewer than are asked for."""
        found = find_photo_folders(self.folder, self.views)
        if self.count is None:
            return found
        if len(found) < self.count:
            raise InputError(
                f"{self.folder}: holds {len(found)} scenes, --scenes asks for {self.count}."
            )
        chosen = np.random.default_rng(self.seed).choice(
            len(found), self.count, replace=False
        )
        return [found[index] for index in sorted(chosen)]

    def propose(self) -> dict[str, list[ProposedEdit]]:
        """Return the proposed edits of every scene, near duplicates removed."""
        found = {}
        for number, scene in enumerate(track(self.scenes, "propose edits")):
            labels = tuple(self._objects(scene))
            if not labels:
                warn(
                    f"scene {scene.id!r}: nothing in it is known by name; give --labels, or a "
                    "--detector."
                )
            own = []
            if self.model is not None:
                shown = (
                    evenly(range(len(scene.files)), self.photos_shown)
                    if self.photos_shown
                    else []
                )
                photos = (
                    scene.load(MOST_SHOWN_SIDE, shown)
                    if shown
                    else torch.zeros(0, 3, 1, 1)
                )
                own = bench_proposals.edits_from_model(labels, photos, self.model)
            own += bench_proposals.edits_from_templates(
                labels or (UNNAMED,), self.seed + number
            )
            found[scene.id] = bench_proposals.without_near_duplicates(own)
        return found

    def manifest(self, vetted: Mapping[str, Sequence[ProposedEdit]]) -> Manifest:
        """Return the benchmark; masks are written beside it. Raises InputError for a scene without
        just five edits.
        """
        missing = [scene.id for scene in self.scenes if scene.id not in vetted]
        if missing:
            raise InputError(
                f"{self.vetting}: no edits for {missing[0]!r}; delete the file to propose edits "
                "anew."
            )
        chosen = {
            scene.id: choose_edits(scene.id, vetted[scene.id]) for scene in self.scenes
        }
        items = [
            item
            for scene in track(self.scenes, "masks")
            for item in self._items(scene, chosen[scene.id])
        ]
        return Manifest(
            name=f"{len(self.scenes)} photographed scenes",
            image_size=self.image_size,
            scenes=tuple(map(self._record, self.scenes)),
            items=tuple(items),
            notes={
                "built_from": "photos",
                "detector": self.detector and component_name(self.detector),
                "segmenter": self.segmenter and component_name(self.segmenter),
                "language_model": self.model and self.model.name,
                "edits_without_masks": [item.id for item in items if not item.masks],
                "not_as_the_paper": self._differences(items, chosen.values()),
            },
        )

    def _differences(
        self, items: Sequence[ItemRecord], chosen: Iterable[Sequence[ProposedEdit]]
    ) -> list[str]:
        """Return in what this benchmark was not built as the paper says (its section 3.5)."""
        unmasked = sum(
            item.type in ("Remove", "Modify") and not item.masks for item in items
        )
        unvetted = sum(edit.verdict != "keep" for own in chosen for edit in own)
        said = {
            f"{len(self.scenes)} scenes, the paper has {PAPER_SCENES}": len(self.scenes)
            != PAPER_SCENES,
            "objects are named by hand, not found by a detector in all photos": self.detector
            is None,
            "edits come from templates, not from a language model": self.model is None,
            "the language model was shown no photo": self.model is not None
            and not self.photos_shown,
            f"{unvetted} edits are kept by no person": unvetted > 0,
            f"{unmasked} local edits have no masks": unmasked > 0,
        }
        return [sentence for sentence, holds in said.items() if holds]

    def _objects(self, scene: PhotoFolder) -> dict[str, Boxes]:
        """Return what the scene shows, with boxes: what the detector finds in all photos, else what
        the user says.
        """
        if self.detector is None:
            return dict.fromkeys(self.labels, ())
        photos = (
            scene.load(self.image_size, [index])[0] for index in range(len(scene.files))
        )  # of several shapes
        return bench_proposals.find_objects(
            photos, self.detector, self.labels or bench_proposals.WORDS["vocabulary"]
        )

    def _record(self, scene: PhotoFolder) -> SceneRecord:
        frames = tuple(
            FrameRecord(file=file, sha256=hash_of_file(scene.path / file))
            for file in scene.files
        )
        return SceneRecord(
            id=scene.id,
            folder=self._relative(scene.path),
            cameras=scene.cameras,
            frames=frames,
        )

    def _items(
        self, scene: PhotoFolder, edits: Sequence[ProposedEdit]
    ) -> list[ItemRecord]:
        objects = {
            word: [own[i] for i in scene.inputs] if own else []
            for word, own in self._objects(scene).items()
        }
        names = [
            f"{scene.id}-{number}-{edit.type.lower()}"
            for number, edit in enumerate(edits, start=1)
        ]
        return [
            ItemRecord(
                id=name,
                scene=scene.id,
                type=edit.type,
                prompt=edit.prompt,
                description=edit.description,
                before=f"a photo of the {edit.object}" if edit.object else "a photo",
                seed=self.seed,
                inputs=scene.inputs,
                held_back=scene.held_back,
                masks=self._masks(name, scene, edit, objects.get(edit.object, [])),
                truth=self._truth(name, scene, edit),
            )
            for name, edit in zip(names, edits)
        ]

    def _masks(
        self,
        item: str,
        scene: PhotoFolder,
        edit: ProposedEdit,
        boxes: Sequence[Detection | None],
    ) -> tuple[FrameRecord, ...]:
        """Return masks a person named, else those around a removed or modified object that was
        found in every input.
        """
        if edit.masks and len(edit.masks) != len(scene.inputs):
            counts = f"{len(edit.masks)} masks for {len(scene.inputs)} inputs"
            raise InputError(
                f"{self.vetting}, scene {scene.id!r}, {edit.prompt!r}: {counts}."
            )
        files = [self.vetting.parent / mask for mask in edit.masks]
        if (
            not files
            and edit.type in ("Remove", "Modify")
            and boxes
            and None not in boxes
        ):
            folder = make_folder(self.out.parent / f"{self.out.stem}-masks")
            files = [folder / f"{item}-{index:03d}.png" for index in scene.inputs]
            masks = bench_proposals.masks_from_boxes(
                scene.load(self.image_size, scene.inputs), boxes, self.segmenter
            )
            for file, mask in zip(files, masks):
                with atomic_write(file) as partial:
                    Image.fromarray((mask * 255).round().byte().numpy()).save(partial)
        return tuple(
            FrameRecord(file=self._relative(file), sha256=hash_of_file(file))
            for file in files
        )

    def _truth(
        self, item: str, scene: PhotoFolder, edit: ProposedEdit
    ) -> tuple[FrameRecord, ...]:
        """Write every frame as the editor that makes the truth edits it; none without one."""
        if self.truth is None:
            return ()
        frames = (*scene.inputs, *scene.held_back)
        views = load_photos(
            [scene.path / scene.files[index] for index in frames], size=self.image_size
        ).views
        edited = self.truth.edit(
            views, EditRequest(edit.prompt, self.seed, guess=True)
        ).images[0]
        change = (edited - views.images[0]).abs().amax((1, 2, 3))
        unchanged = [
            scene.files[index] for index, most in zip(frames, change) if most <= VISIBLE
        ]
        if unchanged:
            raise InputError(
                f"scene {scene.id!r}, {edit.prompt!r}: the editor left {unchanged[0]} as it was; "
                "drop it."
            )
        folder = make_folder(self.out.parent / f"{self.out.stem}-truth")
        files = [folder / f"{item}-{index:03d}.png" for index in frames]
        for file, image in zip(files, edited):
            save_image(image, file)
        return tuple(
            FrameRecord(file=self._relative(file), sha256=hash_of_file(file))
            for file in files
        )

    def _relative(self, path: Path) -> str:
        return Path(
            os.path.relpath(os.path.abspath(path), os.path.abspath(self.out.parent))
        ).as_posix()
