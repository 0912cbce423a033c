"""Step 1: the photos, as views, and what is marked on them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Reader
from edit3r.contract.lens import Lens
from edit3r.contract.reporting import say, stage, warn
from edit3r.contract.types import Views
from edit3r.kit.files.atomic import sha256_of
from edit3r.kit.files.names import unique_names
from edit3r.kit.photos.coverage import USUAL_FRAMES, choose_photos, origin
from edit3r.kit.photos.images import LoadedPhotos, find_photos, load_photos
from edit3r.kit.photos.masks import read_mask
from edit3r.running.earlier import EarlierRun
from edit3r.running.job import RunJob
from edit3r.running.scene import Scene
from edit3r.running.selecting.marks import MarkTexts
from edit3r.running.selecting.select import Selection

_MOST_OF_A_THING = 0.5
"""Share of the photos [mean of the masks] above which masks are of no thing."""


def read(job: RunJob, read_lens: Callable[[Views], Lens | None]) -> Scene:
    """The photos of the job, or of the earlier run that it goes on from, and their marks.

    `read_lens` says of photos whose lens nobody knows what bends straight lines in them.
    """
    with stage("read photos"):
        masks = job.masks
        if job.earlier is not None:
            scene = _read_earlier(job.earlier)
        elif isinstance(job.photos, Views):
            names = tuple(unique_names(job.photos.called))
            photos = replace(job.photos, names=names)
            scene = Scene(photos=photos, start=photos)
        else:
            found, scene = _read_files(job.photos, job, read_lens)
            if isinstance(masks, MarkTexts):
                used = [record.file for record in scene.records]
                masks = masks.for_photos([origin(path) for path in found], used)
            if masks is None and job.config.prompt:
                scene = _with_masks_of_cameras(scene)
        scene = replace(scene, prompts=(*scene.prompts, job.config.prompt))
        return _with_marks(scene, masks, job.components["reader"])


def _read_earlier(earlier: EarlierRun) -> Scene:
    return Scene(
        photos=earlier.photos,
        start=earlier.edited,
        records=earlier.records,
        prompts=earlier.prompts,
        things=earlier.things,
        before=earlier.scene,
    )


def _read_files(
    photos: tuple[Path, ...], job: RunJob, read_lens: Callable[[Views], Lens | None]
) -> tuple[list[Path], Scene]:
    """All photos that were found, and the scene of those that are used."""
    config = job.config
    found = find_photos(photos, max(USUAL_FRAMES, config.views or 0))
    loaded = load_photos(
        choose_photos(found, config.views),
        fov=config.fov,
        size=config.size,
        cameras=job.cameras if isinstance(job.cameras, Path) else None,
        read_lens=read_lens,
    )
    return found, Scene(photos=loaded.views, start=loaded.views, records=loaded.photos)


def _with_masks_of_cameras(scene: Scene) -> Scene:
    """The scene with the masks that its camera file names, where they are of a thing.

    Such masks also leave out of training what moves: then they are white nearly everywhere.
    """
    named = {view: one for view, one in enumerate(scene.records) if one.mask}
    files = {view: str(record.mask) for view, record in named.items()}
    try:
        masks = {v: read_mask(Path(files[v]), one.frame) for v, one in named.items()}
    except InputError as error:
        warn(f"{error} The masks of the camera file (mask_path) are not used.")
        return scene
    if not masks:
        return scene
    share = sum(float(mask.mean()) for mask in masks.values()) / len(masks)
    used = share < _MOST_OF_A_THING
    says = (
        f"those of the camera file (mask_path), {share:.0%} of the photos; marks of your own"
        f" (--mask, --point) come before them"
        if used
        else f"those of the camera file (mask_path) are not used: with {share:.0%} of the photos"
        " white they rather leave out what moves"
    )
    say("selection.masks", says)
    hashes = {file: sha256_of(Path(file)) for file in files.values()}
    marked = Selection(masks=masks)
    return replace(scene, marked=marked, mask_files=hashes) if used else scene


def _with_marks(
    scene: Scene, masks: Tensor | Selection | MarkTexts | None, reader: Reader
) -> Scene:
    """The scene with given masks, or with what is marked on its photos."""
    if masks is None:
        return scene
    if isinstance(masks, Tensor):
        return replace(scene, masks=masks)
    if isinstance(masks, Selection):
        return replace(scene, marked=masks)
    if not scene.records:
        raise InputError("marks in words need photos that were read from files.")
    marked = masks.read(LoadedPhotos(scene.start, scene.records), reader)
    hashes = {file: sha256_of(Path(file)) for file in masks.mask_files}
    return replace(scene, marked=marked, mask_files=hashes)
