"""Files from a browser into a set of photos: limited in size, number and type, decoded once before
they are kept.

The name that the browser tells is a label: what is made of it is never a path. A file that is
refused leaves nothing.
"""

import asyncio
import os
import re
import secrets
import shutil
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import edit3r
from edit3r.contract.errors import Edit3rError, InputError
from edit3r.kit.files.atomic import sha256_of
from edit3r.kit.files.names import unique_names
from edit3r.kit.photos.camera_files import posed_cameras, write_cameras
from edit3r.kit.photos.coverage import VIDEO_SUFFIXES, take_frames
from edit3r.kit.photos.decode import READABLE, decode
from edit3r.kit.photos.images import SUFFIXES, save_image
from edit3r.kit.photos.temporary import temporary_photos
from edit3r.running import SCENE_ENDINGS, SceneInput, make_scene_input
from edit3r_app.jobs import SPLAT, JobsFolder

DRAFT = ".upload-"  # how names of files begin that are still being received
MAX_PHOTOS = 60  # of one set: more take hours on the machine of one person
MAX_BYTES = 100 * 1024**2  # of one photo
MAX_SCENE_BYTES = 1 << 30  # of one scene: four million Gaussians as PLY

UNNAMED = re.compile(
    r"(dsc[fn]?|frame|gopr|image|img|mvimg|photo|pxl|wp)?[\W\d_]*", re.I
)
"""Names that cameras give; they say nothing of what a photo shows."""
_LOOKED: dict[Path, SceneInput] = {}
"""The scene that was kept last, until it is opened."""
_KEEPING = threading.Lock()
"""Several uploads come at once: a free name is found and taken under this lock."""


def refuse_unwanted(
    folder: JobsFolder, scene: str, name: str, size: int | None
) -> None:
    """Raise InputError for what need not even be sent: a wrong type, too large, too many."""
    label = _label(name)
    if folder.is_run(scene):
        raise InputError(
            f"{label}: the photos of a finished run cannot be changed; begin with new photos."
        )
    is_splat = Path(label).suffix.lower() in SCENE_ENDINGS
    if not is_splat and Path(label).suffix.lower() not in (*SUFFIXES, *VIDEO_SUFFIXES):
        raise InputError(
            f"{label}: not a photo by its name; expected {READABLE}, a video, or a scene "
            f"({', '.join(SCENE_ENDINGS)})."
        )
    if size is not None and size > most_bytes(label):
        raise InputError(f"{label}: {size / 1024**2:,.0f} MB; {_limit(label)}")
    if folder.splat(scene) or (is_splat and folder.photos(scene)):
        raise InputError(f"{label}: a scene is edited alone; drop it by itself.")
    if len(folder.photos(scene)) >= MAX_PHOTOS:
        raise InputError(
            f"{label}: at most {MAX_PHOTOS} photos are taken; leave some out."
        )


def most_bytes(name: str) -> int:
    """The largest file of that name that is taken."""
    is_splat = Path(name).suffix.lower() in SCENE_ENDINGS
    return MAX_SCENE_BYTES if is_splat else MAX_BYTES


def _limit(name: str) -> str:
    is_splat = Path(name).suffix.lower() in SCENE_ENDINGS
    what = "scenes" if is_splat else "photos"
    return f"{what} of at most {most_bytes(name) >> 20} MB are taken."


def title_of(photo: str) -> str:
    """What a set of photos is called by its first one."""
    stem = Path(_label(photo)).stem
    return "scene" if UNNAMED.fullmatch(stem) else stem


async def receive(
    folder: JobsFolder,
    scene: str,
    name: str,
    size: int | None,
    chunks: AsyncIterator[bytes],
) -> Path:
    """Take in one file and return where it lies; raises InputError for what is refused."""
    refuse_unwanted(folder, scene, name, size)
    received = 0
    with _draft(folder) as draft:
        with draft.open("wb") as file:
            async for chunk in chunks:
                received += len(chunk)
                if received > most_bytes(_label(name)):
                    raise InputError(f"{_label(name)}: {_limit(_label(name))}")
                file.write(chunk)
        return await asyncio.to_thread(accept, folder, scene, name, draft)


@temporary_photos()
def accept(folder: JobsFolder, scene: str, name: str, draft: Path) -> Path:
    """Keep the file `draft` as a photo of the scene; of a video the frames `edit3r run` would use.

    Returns the photo, or the first frame.
    """
    label = Path(_label(name))
    try:
        if label.suffix.lower() in SCENE_ENDINGS:
            return _keep_splat(folder, scene, label.name, draft)
        if label.suffix.lower() not in VIDEO_SUFFIXES:
            decode(draft, 1)
            return _keep(folder, scene, label.name, draft)
        if not _is_video(draft):  # such as a list of other files
            raise InputError(f"{draft}: not a video that can be read.")
        frames = take_frames(draft)
    except Edit3rError as error:
        raise InputError(str(error).replace(str(draft), label.name)) from None
    names = [f"{label.stem}-{index:02}.png" for index in range(len(frames))]
    copies = [_copy(folder, scene, *pair) for pair in zip(frames, names)]
    return copies[0]


def _keep_splat(folder: JobsFolder, scene: str, label: str, draft: Path) -> Path:
    """Keep a scene with pictures of it, which are what the page shows of it."""
    looked = _looked_at(draft)
    place = folder.own(scene) / SPLAT
    place.mkdir(exist_ok=True)
    _keep_pictures(folder, scene, looked)
    os.replace(draft, place / label)
    _LOOKED.clear()
    _LOOKED[place / label] = replace(looked, file=place / label)
    return place / label


def turn_upright(folder: JobsFolder, scene: str, up: str) -> None:
    """Take the pictures of a dropped scene anew, with another axis of it upwards."""
    splat = folder.splat(scene)
    if splat is None or folder.is_run(scene) or folder.history(scene):
        raise InputError(
            f"{scene}: only a scene that nothing was made of can be turned."
        )
    looked = _looked_at(splat[0], up[:20])
    _keep_pictures(folder, scene, looked)
    _LOOKED[splat[0]] = looked


def looked_at(file: Path) -> SceneInput | None:
    """The scene of a file, where it was just kept: it need not be read again."""
    return _LOOKED.pop(file, None)


def _looked_at(file: Path, up: str | None = None) -> SceneInput:
    rasterizer = edit3r.build("rasterizer", "auto")
    return make_scene_input(file, rasterizer, cameras="none", up=up)


def _keep_pictures(folder: JobsFolder, scene: str, looked: SceneInput) -> None:
    names = looked.places.names
    files = [f"{name}.png" for name in names]
    cameras = posed_cameras(looked.places.cameras, files)
    images = folder.own(scene) / "images"
    for name, picture in zip(files, looked.views.pictures.images[0]):
        save_image(picture, images / name)
    write_cameras(folder.own(scene) / SPLAT / "cameras.json", cameras)


def remove(folder: JobsFolder, scene: str, photo: str) -> None:
    """Take a photo, by its name, out of a set that nothing was made from yet."""
    if folder.is_run(scene) or folder.history(scene):
        raise InputError(
            f"{scene}: edits were made from these photos; begin with new photos to leave one out."
        )
    if folder.splat(scene):
        raise InputError(f"{scene}: its pictures belong to the scene and stay.")
    folder.own(scene)
    file = folder.photos(scene).get(photo)
    if file is not None:  # else it is out already
        file.unlink(missing_ok=True)


def discard(folder: JobsFolder, scene: str) -> None:
    """Take away a set of photos that holds none."""
    with suppress(OSError):
        (folder.path(scene) / "images").rmdir()
        folder.path(scene).rmdir()


def copied(folder: JobsFolder, name: str, photos: list[Path]) -> str:
    """Make a new set of photos from files of this machine, and return its name."""
    scene = folder.new_scene(name)
    for photo in photos:
        _copy(folder, scene, photo, photo.name)
    return scene


def _copy(folder: JobsFolder, scene: str, photo: Path, name: str) -> Path:
    with _draft(folder) as draft:
        shutil.copyfile(photo, draft)
        return accept(folder, scene, name, draft)


def _keep(folder: JobsFolder, scene: str, label: str, draft: Path) -> Path:
    """Move a photo to a name that is free; the same photo is kept only once."""
    size = draft.stat().st_size
    digest = sha256_of(draft)
    with _KEEPING:
        refuse_unwanted(folder, scene, label, size)
        photos = folder.photos(scene)
        for photo in photos.values():
            if photo.stat().st_size == size and sha256_of(photo) == digest:
                return photo
        stem = unique_names([*photos, Path(label).stem])[-1]
        suffix = Path(label).suffix.lower()
        kept = folder.own(scene) / "images" / f"{stem}{suffix}"
        os.replace(draft, kept)
    return kept


@contextmanager
def _draft(folder: JobsFolder) -> Iterator[Path]:
    """A file for what is being received, which does not stay."""
    draft = folder.private / f"{DRAFT}{secrets.token_hex(8)}"
    try:
        yield draft
    finally:
        draft.unlink(missing_ok=True)


def _is_video(draft: Path) -> bool:
    """Whether it begins as MP4 (or MOV), WebM (or MKV) or AVI do."""
    with draft.open("rb") as file:
        head = file.read(12)
    return head[4:8] == b"ftyp" or head[:4] in (b"\x1aE\xdf\xa3", b"RIFF")


def _label(name: str) -> str:
    """The last part of whatever path the browser told, as a file name, for messages."""
    last = name.replace("\\", "/").rpartition("/")[2]
    stem, suffix = os.path.splitext(last)
    return unique_names([stem[:200]])[0] + re.sub(r"[^.\w]", "_", suffix[:12])
