"""Scenes to try at once: photos that are at hand, with an edit. Each is made when first asked for,
and opened again from then on.
"""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edit3r.contract.errors import InputError
from edit3r.kit.photos.images import packaged_pair
from edit3r_app import uploads
from edit3r_app.jobs import AppJob, JobsFolder

PHOTOS = Path(__file__).with_name("made")
MARK = "made"  # file beside a set of photos, which says which scene it is
_MAKING = threading.Lock()


@dataclass(frozen=True)
class MadeScene:
    """Photos, and what is asked of them."""

    title: str
    prompt: str
    stem: str = ""  # of its photos in the folder `made`; "": the packaged pair

    @property
    def photos(self) -> list[Path]:
        if not self.stem:
            return [Path(file) for file in packaged_pair()[0]]
        return sorted(PHOTOS.glob(f"{self.stem}_*.jpg"))


MADE = {
    "motorcycle": MadeScene("A motorcycle", "paint the motorcycle golden"),
    "sky": MadeScene("An evening sky", "paint the sky pink", "opera_house"),
    "night": MadeScene("A harbour", "make it night", "opera_house"),
}


def offered_scenes() -> Iterator[dict[str, str]]:
    """What the first page shows of each."""
    for name, one in MADE.items():
        yield {"name": name, "title": one.title, "prompt": one.prompt}


def photo_of(name: str) -> Path:
    """The first photo of a made scene; raises InputError where there is none of that name."""
    if name not in MADE:
        raise InputError(f"{name[:40]!r}: no made scene of that name.")
    return MADE[name].photos[0]


def open_made(folder: JobsFolder, name: str, size: int) -> dict[str, Any]:
    """The set of photos, and the newest of its edits that worked, or is being made."""
    photo_of(name)
    with _MAKING:
        scene = next((one for one in folder.scenes() if _is(folder, one, name)), "")
        if not scene:
            scene = uploads.copied(folder, name, MADE[name].photos)
            (folder.beside(scene) / MARK).write_text(name, encoding="utf-8")
        edits = [
            job for job in folder.history(scene) if job.is_active or job.state == "done"
        ]
        if not edits:
            settings = {"prompt": MADE[name].prompt}
            edits = [folder.new_job(AppJob("", scene, settings=settings, size=size))]
    return {"scene": scene, "at": edits[-1].name}


def _is(folder: JobsFolder, scene: str, name: str) -> bool:
    mark = folder.private / scene / MARK
    return mark.is_file() and mark.read_text(encoding="utf-8") == name
