"""The scene as a run leaves it to the next one: photos, their edits, Gaussians, cameras."""

from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from edit3r.errors import InputError
from edit3r.io.framing import Frame
from edit3r.io.images import Photo
from edit3r.reuse.parts import pack_reconstruction, unpack_reconstruction
from edit3r.reuse.store import Entry, load_entry, save_entry
from edit3r.types import Cameras, Reconstruction, Views

FOLDER = "reuse"
FILE = "scene.safetensors"


@dataclass(frozen=True)
class Drawn:
    """What the frames of the camera path, `renders/path_*.png`, are pictures of."""

    whole: bool  # of the state's very Gaussians, none made fewer or refined
    rasterizer: str  # identity of what drew them
    frames: tuple[str, ...]  # hash of each file, as `edit3r.reuse.frames` takes it


@dataclass(frozen=True)
class SceneState:
    """What a further edit starts from. Everything is of one scene (batch 1)."""

    photos: Views  # unedited; geometry is read from them
    edited: Views  # what the next edit is applied to
    scene: Reconstruction  # of `edited`: all Gaussians, before they were made fewer or refined, and the cameras
    path: Cameras  # of the frames
    drawn: Drawn
    prompts: tuple[str, ...]  # the edits so far, in order
    records: tuple[Photo, ...]  # how the photos became views
    reconstructor: dict  # name and settings, as a run is asked for them
    root: Path = Path()  # the run folder it was read from


def save_state(root: Path, state: SceneState) -> None:
    """Write `state` into the run folder `root`."""
    tensors, facts = pack_reconstruction(state.scene)
    tensors |= {"photos": _eight_bits(state.photos.images), "edited": _eight_bits(state.edited.images)}
    tensors |= {"lens": state.photos.intrinsics, "path.c2w": state.path.c2w, "path.intrinsics": state.path.intrinsics}
    if state.photos.c2w is not None:
        tensors["known.c2w"] = state.photos.c2w
    facts |= {"names": list(state.photos.names), "prompts": list(state.prompts), "drawn": asdict(state.drawn)}
    facts |= {"reconstructor": state.reconstructor, "assumed": list(state.photos.assumed)}
    facts |= {"path_size": list(state.path.image_size), "records": [asdict(record) for record in state.records]}
    (root / FOLDER).mkdir(exist_ok=True)
    save_entry(root / FOLDER / FILE, Entry("scene", "", tensors, facts))


def load_state(root: str | Path) -> SceneState:
    """Read the state of a run folder. Raises InputError where there is none, or it is damaged."""
    root = Path(root)
    file = root / FOLDER / FILE
    if not root.is_dir():
        raise InputError(f"{root}: no such folder; --from takes the folder of an earlier run.")
    if not file.is_file():
        raise InputError(
            f"{root}: not the folder of an earlier run that can be continued, it lacks {FOLDER}/{FILE}; "
            f"--from takes what edit3r run wrote with --out."
        )
    entry = load_entry(file)
    try:
        return _state(entry, root)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{file}: lacks what is needed to continue ({error}); start again from the photos.") from None


def _state(entry: Entry, root: Path) -> SceneState:
    tensors, facts = dict(entry.tensors), entry.facts
    lens, known, names = tensors.pop("lens"), tensors.pop("known.c2w", None), tuple(facts["names"])
    assumed = tuple(facts["assumed"])
    photos, edited = (Views(_unit(tensors.pop(name)), lens, names, known, assumed) for name in ("photos", "edited"))
    path = Cameras(tensors.pop("path.c2w"), tensors.pop("path.intrinsics"), tuple(facts["path_size"]))
    scene = unpack_reconstruction(tensors, facts)
    records = tuple(_record(record) for record in facts["records"])
    drawn = Drawn(**{**facts["drawn"], "frames": tuple(facts["drawn"]["frames"])})
    prompts = tuple(facts["prompts"])
    return SceneState(photos, edited, scene, path, drawn, prompts, records, facts["reconstructor"], root)


def frame_file(folder: Path, index: int) -> Path:
    """A picture of the camera path."""
    return folder / f"path_{index:04d}.png"


def _record(record: dict) -> Photo:
    frame = Frame(**{name: tuple(value) for name, value in record["frame"].items()})
    pairs = {name: tuple(record[name]) for name in ("size", "focal")}
    return Photo(**{**record, **pairs, "frame": frame})


def _eight_bits(images: Tensor) -> Tensor:
    """Bytes where that loses nothing (photos are), else as they are."""
    values = images.mul(255).round().clamp(0, 255).to(torch.uint8)
    return values if torch.equal(_unit(values), images) else images


def _unit(values: Tensor) -> Tensor:
    return values.to(torch.float32) / 255 if values.dtype == torch.uint8 else values
