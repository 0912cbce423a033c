"""From a manifest's record to pictures: the same for scenes on disk and for generated ones."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.errors import InputError
from edit3r.geometry.morphology import dilate
from edit3r.interfaces import SceneSample
from edit3r.io.cameras import read_cameras
from edit3r.io.images import LoadedPhotos, load_photos
from edit3r.io.masks import load_masks
from edit3r.registry import Registry
from edit3r.types import Cameras, Views
from edit3r_measure.bench.manifest import ItemRecord, Manifest, SampleRecord, SceneRecord

__all__ = ["LoadedItem", "hash_of_sample", "load_item", "load_sample"]

VISIBLE = 1.5 / 255
"""A generated scene's edit is where truth and photo differ by more than this."""

MARGIN = 0.025
"""A generated edit's mask reaches this much further than the change [picture widths]."""


@dataclass(frozen=True)
class LoadedItem:
    """One edit with everything that is known about its scene. Frames F are all pictures, inputs first."""

    record: ItemRecord
    photos: Views  # batch 1, all F frames, without poses
    inputs: int  # how many of the frames the method is given
    cameras: Cameras | None  # true, batch 1, relative to frame 0; None: not known
    depths: Float[Tensor, "frame height width"] | None  # true camera z; None: not known
    truth: Float[Tensor, "frame 3 height width"] | None  # the edited scene; None: not known
    masks: Float[Tensor, "frame height width"] | None  # where the edit may show; None: everywhere or not known

    @property
    def given(self) -> Views:
        """The views that a method gets."""
        return self.photos.select(range(self.inputs))

    @property
    def input_masks(self) -> Float[Tensor, "1 view height width"] | None:
        """The masks that a method's editor is confined by."""
        return None if self.masks is None else self.masks[None, : self.inputs]


def load_item(manifest: Manifest, item: ItemRecord, root: Path, registry: Registry, verify: bool = True) -> LoadedItem:
    """Load `item`; `root` is the manifest's folder. Raises InputError when pictures are not those of the manifest."""
    if item.sample is not None:
        return _generated(item, item.sample, registry, verify)
    return _photographed(manifest.scene(item.scene), item, root, manifest.image_size, verify)


def load_sample(record: SampleRecord, registry: Registry) -> SceneSample:
    """Make a generated scene again."""
    return registry.build("dataset", record.dataset, **record.settings)[record.index]


def hash_of_sample(sample: SceneSample) -> str:
    """Of the photos and the edited truth, rounded to 8 bits."""
    digest = hashlib.sha256()
    for images in (sample.context, sample.target, sample.edited_context, sample.edited_target):
        digest.update((images * 255).round().to(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def _generated(item: ItemRecord, record: SampleRecord, registry: Registry, verify: bool) -> LoadedItem:
    sample = load_sample(record, registry)
    if verify and hash_of_sample(sample) != record.sha256:
        raise InputError(
            f"{item.id}: the scene that {record.dataset!r} makes here is not the manifest's (its pictures differ); "
            "install the versions under 'made_with', or accept other pictures with --no-verify."
        )
    order = [*item.inputs, *item.held_back]
    photos, truth = sample.context[order], sample.edited_context[order]
    cameras = sample.context_cameras.select(order)
    return LoadedItem(
        record=item,
        photos=Views(photos[None], cameras.intrinsics, _names(order)),
        inputs=len(item.inputs),
        cameras=_relative(cameras),
        depths=None if sample.context_depths is None else sample.context_depths[order],
        truth=truth,
        masks=None if item.type == "Global" else change_masks(photos, truth),
    )


def change_masks(
    photos: Float[Tensor, "frame 3 height width"], truth: Float[Tensor, "frame 3 height width"]
) -> Float[Tensor, "frame height width"]:
    """1 where the truth visibly differs from the photo, and a little around; else 0."""
    changed = ((truth - photos).abs().amax(1) > VISIBLE).to(photos.dtype)
    reach = max(1, round(MARGIN * photos.shape[-1]))
    return dilate(changed, reach)


def _photographed(scene: SceneRecord, item: ItemRecord, root: Path, size: int, verify: bool) -> LoadedItem:
    order = [*item.inputs, *item.held_back]
    folder = root / scene.folder
    frames = [scene.frames[index] for index in order]
    if verify:
        for record in frames:
            check_hash(folder / record.file, record.sha256, item.id)
        for record in item.masks:
            check_hash(root / record.file, record.sha256, item.id)
    camera_file = folder / scene.cameras if scene.cameras else None
    files = [folder / record.file for record in frames]
    loaded = load_photos(files, size=size, cameras=camera_file, names=_names(order))
    return LoadedItem(
        record=item,
        photos=loaded.views,
        inputs=len(item.inputs),
        cameras=None if camera_file is None else _posed(camera_file, frames, loaded),
        depths=None,
        truth=None,
        masks=_read_masks(item, root, loaded),
    )


def _read_masks(item: ItemRecord, root: Path, loaded: LoadedPhotos) -> Float[Tensor, "frame height width"] | None:
    """Masks are of the input frames only; held-back frames get none, which measures nothing there."""
    if not item.masks:
        return None
    given = replace(loaded, photos=loaded.photos[: len(item.inputs)])
    masks = load_masks([root / record.file for record in item.masks], given)[0]
    rest = masks.new_full((len(item.held_back), *masks.shape[1:]), float("nan"))
    return torch.cat((masks, rest))


def _posed(camera_file: Path, frames: list, loaded: LoadedPhotos) -> Cameras | None:
    poses = {camera.file: camera.c2w for camera in read_cameras(camera_file)}
    found = [poses.get(record.file) for record in frames]
    if any(pose is None for pose in found):
        return None
    c2w = torch.stack([torch.from_numpy(pose) for pose in found])[None].float()
    return _relative(Cameras(c2w, loaded.views.intrinsics, loaded.views.image_size))


def _relative(cameras: Cameras) -> Cameras:
    from edit3r.geometry.cameras import relative_to_first

    return replace(cameras, c2w=relative_to_first(cameras.c2w.double()).float())


def check_hash(path: Path, sha256: str, item: str) -> None:
    """Raise InputError unless the file is there and is the one that was hashed."""
    if not path.is_file():
        raise InputError(f"{path}: item {item!r} of the manifest needs this picture, and it is not there.")
    if hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
        raise InputError(f"{path}: not the picture that the manifest was built with; results would not compare.")


def _names(order: list[int]) -> tuple[str, ...]:
    return tuple(f"frame{index:03d}" for index in order)
