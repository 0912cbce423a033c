"""Step 1: the photos, as views in a unit of their own, and what is marked on them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Rasterizer, Reader, Selection
from edit3r.contract.lens import Lens
from edit3r.contract.reporting import say, stage, warn
from edit3r.contract.types import Views
from edit3r.kit.files.atomic import sha256_of
from edit3r.kit.files.names import unique_names
from edit3r.kit.photos.coverage import USUAL_FRAMES, choose_photos
from edit3r.kit.photos.images import LoadedPhotos, find_photos, read_photos
from edit3r.kit.photos.masks import read_mask
from edit3r.kit.photos.temporary import origin, temporary_photos
from edit3r.running.job import RunJob
from edit3r.running.measuring import with_what_is_known
from edit3r.running.records import Inputs
from edit3r.running.scene_input import SceneInput, make_scene_input
from edit3r.running.selecting.marks import MarkTexts
from edit3r.running.unit import has_given_poses, own_unit

_MOST_OF_A_THING = 0.5
"""Share of the photos [mean of the masks] above which masks are of no thing."""


@temporary_photos()
def read(
    job: RunJob,
    read_lens: Callable[[Views], Lens | None],
    rasterizer: Callable[[], Rasterizer],
) -> Inputs:
    """The photos of the job, or of the earlier run that it goes on from, and their marks.

    `read_lens` says of photos whose lens nobody knows what bends straight lines in them; the
    `rasterizer` makes the pictures of a given scene.
    """
    with stage("read photos"):
        masks = job.masks
        if job.scene is not None:
            inputs = _pictures_of_scene(job, rasterizer())
            inputs = replace(inputs, prompts=(job.config.prompt,))
            return _with_marks(inputs, masks, job.components["reader"])
        if job.earlier is not None:
            inputs = job.earlier.inputs
        elif isinstance(job.photos, Views):
            names = tuple(unique_names(job.photos.called))
            photos = replace(job.photos, names=names)
            inputs = Inputs(photos=photos, start=photos)
        else:
            files, inputs = _read_files(job.photos, job, read_lens)
            if isinstance(masks, MarkTexts):
                used = [record.file for record in inputs.files]
                masks = masks.for_photos([origin(path) for path in files], used)
            if masks is None and job.config.prompt:
                inputs = _with_masks_of_cameras(inputs)
        inputs = replace(inputs, prompts=(*inputs.prompts, job.config.prompt))
        inputs = _with_marks(inputs, masks, job.components["reader"])
        if job.config.measure is not None or job.config.up is not None:
            inputs = with_what_is_known(inputs, job.config)
        return _in_own_unit(inputs)


def _pictures_of_scene(job: RunJob, rasterizer: Rasterizer) -> Inputs:
    """Pictures of the given scene in place of photos."""
    config, scene = job.config, job.scene
    assert scene is not None
    if config.measure is not None:
        raise InputError(
            f"--measure {config.measure}: a given scene keeps its unit; only scenes made of photos "
            "take one."
        )
    if not isinstance(scene, SceneInput):
        scene = make_scene_input(
            scene,
            rasterizer,
            views=config.views,
            size=config.size if "size" in config.set_by_the_user() else None,
            up=config.up,
            cameras=job.cameras,
        )
    pictures = scene.views.pictures
    return Inputs(pictures, pictures, scene.records(), scene=scene)


def _in_own_unit(inputs: Inputs) -> Inputs:
    """The inputs in a unit in which the given cameras stand about 1 apart."""
    unit, before = own_unit(inputs.photos), inputs.before
    if before is not None:
        stands = has_given_poses(before, inputs.photos)
        before = unit.where(stands).reconstruction(before)
    photos, start = unit.views(inputs.photos), unit.views(inputs.start)
    return replace(inputs, photos=photos, start=start, before=before, unit=unit)


def _read_files(
    photos: tuple[Path, ...], job: RunJob, read_lens: Callable[[Views], Lens | None]
) -> tuple[list[Path], Inputs]:
    """All photos that were found, and the inputs of those that are used."""
    config = job.config
    files = find_photos(photos, max(USUAL_FRAMES, config.views or 0))
    if len(files) < 2:
        for folder in (one for one in photos if (one / "run.json").is_file()):
            raise InputError(
                f"{folder}: the folder of a run, with no photos of its own; go on from it with "
                f"--from {folder}, or edit its scene: {folder / 'scene.ply'}."
            )
    loaded = read_photos(
        choose_photos(files, config.views),
        fov=config.fov,
        size=config.size,
        cameras=job.cameras if isinstance(job.cameras, Path) else None,
        read_lens=read_lens,
    )
    return files, Inputs(photos=loaded.views, start=loaded.views, files=loaded.photos)


def _with_masks_of_cameras(inputs: Inputs) -> Inputs:
    """The inputs with the masks that their camera file names, where they are of a thing.

    Such masks also leave out of training what moves: then they are white nearly everywhere.
    """
    named = {view: one for view, one in enumerate(inputs.files) if one.mask}
    files = {view: str(record.mask) for view, record in named.items()}
    try:
        masks = {v: read_mask(Path(files[v]), one.frame) for v, one in named.items()}
    except InputError as error:
        warn(f"{error} The masks of the camera file (mask_path) are not used.")
        return inputs
    if not masks:
        return inputs
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
    return replace(inputs, marked=marked, mask_files=hashes) if used else inputs


def _with_marks(
    inputs: Inputs, masks: Tensor | Selection | MarkTexts | None, reader: Reader
) -> Inputs:
    """The inputs with given masks, or with what is marked on their photos."""
    if masks is None:
        return inputs
    if isinstance(masks, Tensor):
        return replace(inputs, masks=masks)
    if isinstance(masks, Selection):
        return replace(inputs, marked=masks)
    if not inputs.files:
        raise InputError("marks in words need photos that were read from files.")
    marked = masks.read(LoadedPhotos(inputs.start, inputs.files), reader)
    hashes = {file: sha256_of(Path(file)) for file in masks.mask_files}
    return replace(inputs, marked=marked, mask_files=hashes)
