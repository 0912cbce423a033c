"""The folder of an earlier run, read so that a further edit can go on from its scene.

Everything comes from the files that people see: `inputs/`, `edited/`, `scene.ply`, `cameras.json`
and `run.json`. Undo is `--from` of the run before. The folder may come from a stranger: names are
checked, nothing in it is executed, and nothing is written there.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Float
from pydantic import TypeAdapter
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import note
from edit3r.contract.settings import of_file
from edit3r.contract.types import Reconstruction, Views
from edit3r.kit.files.names import unique_names
from edit3r.kit.files.text import read_json
from edit3r.kit.photos.cameras import (
    intrinsics_from_outside,
    pose_from_outside,
    read_scene_cameras,
)
from edit3r.kit.photos.images import Photo, read_image
from edit3r.kit.run_folder import RunFolder
from edit3r.kit.scenes.ply import load_ply
from edit3r.running.records import READ_LENS

Read = TypeVar("Read")
NOTE = "views"  # note in run.json with what the images do not hold: intrinsics and known poses
THINGS = "things"  # note in run.json: names of the masks in the folders `masks/0`, `masks/1`...
CACHE = "cache"  # folder of the run's cache inside its results


@dataclass(frozen=True)
class EarlierRun:
    """What a further edit starts from. Everything is of one scene (batch 1)."""

    photos: Views  # unedited; geometry is read from them
    edited: Views  # what the next edit is applied to
    # the Gaussians of scene.ply, and the cameras of the views; None: the photos are begun with
    scene: Reconstruction | None
    prompts: tuple[str, ...]  # the edits so far, in order
    records: tuple[Photo, ...]  # how the photos became views
    reconstructor: dict[str, Any]  # name and settings, as a configuration holds them
    matcher: dict[str, Any]  # the same
    frames: int  # of its camera path
    # masks of what was named, in [0, 1]; the last named comes last
    things: Mapping[str, Float[Tensor, "view height width"]] = field(
        default_factory=dict
    )

    def undone(self) -> "EarlierRun":
        """What was before the last edit: the photos. Raises InputError for an edit of an edit."""
        if len(self.prompts) > 1:
            raise InputError(
                f"this is edit {len(self.prompts)} of {len(self.prompts)}, and its folder does not "
                "hold the scene before it: give --from the folder that it went on from, and leave "
                "'undo' out."
            )
        return replace(self, edited=self.photos, scene=None, prompts=())


def note_views(views: Views) -> None:
    """Note for run.json what `read_earlier_run` needs beside the images; numbers stay exact."""
    c2w = None if views.c2w is None else views.c2w[0].tolist()
    facts = {
        "names": list(views.names),
        "intrinsics": views.intrinsics[0].tolist(),
        "c2w": c2w,
    }
    note(NOTE, {**facts, "assumed": list(views.assumed)})


def read_earlier_run(root: str | Path, trusted: bool = False) -> EarlierRun:
    """Read a run folder. Raises InputError, naming the file, where it is not one or is damaged.

    Not `trusted`: what run.json says cannot name programs or addresses (`USER_ONLY`).
    """
    earlier = _read(root, _earlier_run)
    if trusted:
        return earlier
    return replace(
        earlier,
        reconstructor=of_file(earlier.reconstructor),
        matcher=of_file(earlier.matcher),
    )


def read_views_of_run(root: str | Path) -> tuple[Views, Views]:
    """The unedited and the edited views of a run folder, without its scene."""
    return _read(root, _views_of_run)


def _read(root: str | Path, reader: Callable[[Path, dict[str, Any]], Read]) -> Read:
    """What `reader` makes of the folder and the content of its run.json."""
    root = Path(root)
    if not root.is_dir():
        raise InputError(
            f"{root}: no such folder; expected that of an earlier run, as edit3r run wrote it "
            "with --out."
        )
    folder = RunFolder(root)
    for needed in (folder.manifest, folder.scene, folder.cameras):
        if not needed.is_file():
            raise InputError(
                f"{root}: not the folder of an earlier run that can be continued, it lacks "
                f"{needed.name}; --from takes what edit3r run wrote with --out."
            )
    try:
        manifest = read_json(folder.manifest)
        return reader(root, manifest)
    except (
        KeyError,
        TypeError,
        ValueError,
        AttributeError,
        RecursionError,
        OverflowError,
    ) as error:
        raise InputError(
            f"{folder.manifest}: lacks what is needed to continue ({type(error).__name__}: "
            f"{error}); start again from the photos."
        ) from None


def _earlier_run(root: Path, manifest: dict[str, Any]) -> EarlierRun:
    """The run that `manifest` (the content of run.json) and the files beside it describe."""
    run, (photos, edited) = manifest["settings"]["run"], _views_of_run(root, manifest)
    names = photos.names
    cameras, _ = read_scene_cameras(root / "cameras.json")
    if cameras.count != len(names) or cameras.image_size != photos.image_size:
        raise ValueError(
            f"cameras.json has {cameras.count} cameras, expected one for each of {len(names)} views"
        )
    return EarlierRun(
        photos=photos,
        edited=edited,
        scene=Reconstruction(load_ply(root / "scene.ply", visible=True), cameras),
        prompts=tuple(str(prompt) for prompt in manifest["notes"]["edits"]),
        records=_records(manifest, len(names)),
        reconstructor=_flat(run["reconstructor"]),
        matcher=_flat(run["matcher"]),
        frames=int(run["frames"]),
        things=_things(root, manifest["notes"].get(THINGS, []), photos),
    )


def _flat(choice: dict[str, Any]) -> dict[str, Any]:
    """A component's name and settings, as a configuration holds them."""
    return {"name": choice["name"], **choice["settings"]}


def _views_of_run(root: Path, manifest: dict[str, Any]) -> tuple[Views, Views]:
    """The images of `inputs/` and `edited/` as views."""
    stored = manifest["notes"][NOTE]
    names = tuple(stored["names"])
    for name, safe in zip(names, unique_names([str(name) for name in names])):
        if name != safe:  # the folder may come from a stranger
            raise InputError(
                f"{root / 'run.json'}: the view name {str(name)[:60]!r} is no plain file name, "
                "or there twice."
            )
    photos, edited = (
        _views(root / folder, names, stored) for folder in ("inputs", "edited")
    )
    return photos, edited


def _views(folder: Path, names: tuple[str, ...], stored: dict[str, Any]) -> Views:
    """The images `NAME.png` of a folder as views, with the stored intrinsics and poses."""
    pixels = [
        np.array(read_image(folder / f"{name}.png"), dtype=np.float32) / 255
        for name in names
    ]
    images = torch.from_numpy(np.stack(pixels)).permute(0, 3, 1, 2).contiguous()[None]
    known = [intrinsics_from_outside(matrix, 1, 1) for matrix in stored["intrinsics"]]
    poses = (
        None
        if stored["c2w"] is None
        else [pose_from_outside(matrix, "c2w") for matrix in stored["c2w"]]
    )
    return Views(
        images,
        _as_batch(known),
        names,
        None if poses is None else _as_batch(poses),
        tuple(bool(assumed) for assumed in stored["assumed"]),
    )


def _as_batch(
    matrices: Sequence[np.ndarray | None],
) -> Float[Tensor, "1 view rows columns"]:
    return torch.from_numpy(np.array(matrices, dtype=np.float32))[None]


def _things(
    root: Path, names: list[str], photos: Views
) -> dict[str, Float[Tensor, "view height width"]]:
    """Masks of what was named, by name."""
    things = {}
    for place, name in enumerate(TypeAdapter(list[str]).validate_python(names)):
        folder = root / "masks" / str(place)
        pixels = [np.array(read_image(folder / f"{view}.png")) for view in photos.names]
        masks = torch.from_numpy(np.stack(pixels)[..., 0].astype(np.float32) / 255)
        if tuple(masks.shape[1:]) != photos.image_size:
            raise ValueError(f"{folder} holds masks of another size than the photos")
        things[name] = masks
    return things


def _records(manifest: dict[str, Any], count: int) -> tuple[Photo, ...]:
    """How each of `count` photos became a view; raises ValueError for anything else."""
    records = TypeAdapter(tuple[Photo, ...]).validate_python(manifest["inputs"])
    if len(records) != count:
        raise ValueError(
            f"{len(records)} inputs, expected one for each of {count} views"
        )
    for record in records:
        height, width = record.frame.source
        left, top, right, bottom = record.frame.box
        if not (
            0 <= left < right <= width + 1
            and 0 <= top < bottom <= height + 1
            and min(record.frame.target) > 0
        ):
            raise ValueError(
                f"{record.name} is cut from {record.frame.box} of {width}x{height} pixels"
            )
    lens = [str(one) for one in manifest["notes"].get("lens.source", ())]
    if lens and lens[0].startswith(READ_LENS):
        return tuple(replace(one, intrinsics_source=lens[0]) for one in records)
    return records
