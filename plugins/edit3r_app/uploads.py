"""Files from a browser into a set of photos: limited in size, number and type, decoded once before
they are kept.

The name that the browser tells is a label: what is made of it is never a path. A file that is
refused leaves nothing.
"""

import asyncio
import os
import secrets
import shutil
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

from edit3r.errors import Edit3rError, InputError
from edit3r.io.atomic import sha256_of
from edit3r.io.coverage import VIDEO_SUFFIXES, take_frames
from edit3r.io.decode import READABLE, decode
from edit3r.io.images import SUFFIXES, unique_names
from edit3r_app.jobs import DRAFT, JobsFolder

MOST_PHOTOS = (
    60  # of one set; a reconstruction of more takes hours on the machine of one person
)
MOST_BYTES = 100 * 1024**2  # of one photo
THUMBNAIL = 320  # [pixels], longer side


def refuse_unwanted(
    folder: JobsFolder, scene: str, name: str, size: int | None
) -> None:
    """Raise InputError for what need not even be sent: too large by its own word, too many, or of
    no photo's type.
    """
    label = _label(name)
    if folder.is_run(scene):
        raise InputError(
            f"{label}: the photos of a finished run cannot be changed; begin with new photos."
        )
    if Path(label).suffix.lower() not in (*SUFFIXES, *VIDEO_SUFFIXES):
        raise InputError(
            f"{label}: not a photo by its name; expected {READABLE}, or a video."
        )
    if size is not None and size > MOST_BYTES:
        raise InputError(
            f"{label}: {size / 1024**2:,.0f} MB; photos of at most {MOST_BYTES >> 20} MB are taken."
        )
    if len(folder.photos(scene)) >= MOST_PHOTOS:
        raise InputError(
            f"{label}: at most {MOST_PHOTOS} photos are taken; leave some out."
        )


async def receive(
    folder: JobsFolder,
    scene: str,
    name: str,
    size: int | None,
    chunks: AsyncIterator[bytes],
) -> Path:
    """Take in one file and return where it lies. Raises InputError, in one sentence, for what is
    refused.
    """
    refuse_unwanted(folder, scene, name, size)
    draft, received = folder.private / f"{DRAFT}{secrets.token_hex(8)}", 0
    try:
        with draft.open("wb") as file:
            async for chunk in chunks:
                received += len(chunk)
                if received > MOST_BYTES:
                    raise InputError(
                        f"{_label(name)}: photos of at most {MOST_BYTES >> 20} MB are taken."
                    )
                file.write(chunk)
        return await asyncio.to_thread(accept, folder, scene, name, draft)
    finally:
        draft.unlink(missing_ok=True)


def accept(folder: JobsFolder, scene: str, name: str, draft: Path) -> Path:
    """Keep the file `draft` as a photo of the scene, under a name made from `name`; the same
    picture only once.

    Of a video the frames are kept that `edit3r run` would use; returns the first of them.
    """
    try:
        if Path(_label(name)).suffix.lower() in VIDEO_SUFFIXES:
            with draft.open("rb") as file:
                head = file.read(12)
            if head[4:8] != b"ftyp" and head[:4] not in (
                b"\x1aE\xdf\xa3",
                b"RIFF",
            ):  # such as a list of other files
                raise InputError(f"{draft}: not a video that can be read.")
            stem = Path(_label(name)).stem
            kept = [
                _copy(folder, scene, frame, f"{stem}-{n:02}.png")
                for n, frame in enumerate(take_frames(draft))
            ]
            return kept[0]
        decode(draft)
    except Edit3rError as error:
        raise InputError(str(error).replace(str(draft), _label(name))) from None
    photos, digest = folder.photos(scene), sha256_of(draft)
    refuse_unwanted(folder, scene, name, draft.stat().st_size)
    for photo in photos:
        if photo.stat().st_size == draft.stat().st_size and sha256_of(photo) == digest:
            return photo
    stem = unique_names([*(photo.stem for photo in photos), Path(_label(name)).stem])[
        -1
    ]
    kept = folder.path(scene) / "images" / f"{stem}{Path(_label(name)).suffix.lower()}"
    os.replace(draft, kept)
    return kept


def remove(folder: JobsFolder, scene: str, index: int) -> None:
    """Take a photo out of a set that nothing was made from yet."""
    if folder.is_run(scene) or folder.history(scene):
        raise InputError(
            f"{scene}: edits were made from these photos; begin with new photos to leave one out."
        )
    folder.photos(scene)[index].unlink()


def _label(name: str) -> str:
    """The last part of whatever path the browser told, as a file name, for messages."""
    stem, dot, suffix = (
        name.replace("\\", "/").rpartition("/")[2] or "photo"
    ).rpartition(".")
    return (
        ".".join(unique_names([part])[0] for part in (stem[:200], suffix[:12]) if part)
        if dot
        else suffix[:200]
    )


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
    draft = folder.private / f"{DRAFT}{secrets.token_hex(8)}"
    try:
        shutil.copyfile(photo, draft)
        return accept(folder, scene, name, draft)
    finally:
        draft.unlink(missing_ok=True)
