"""A finished run: one folder of files that people can open, written and read back here.

What a further edit needs comes from the files that people see: `inputs/`, `edited/`, `scene.ply`,
`cameras.json` and `run.json`. Undo is `--from` of the run before. A folder may come from a
stranger: names are checked, nothing in it is executed, and reading writes nothing there.
"""

import json
import math
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import torch
from jaxtyping import Float
from pydantic import TypeAdapter
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import note, warn
from edit3r.contract.settings import of_file
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Rendering, Views
from edit3r.kit.contact_sheet import images_of
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.files.names import is_plain_name, unique_names
from edit3r.kit.files.text import read_json
from edit3r.kit.geometry.cameras import scale_poses
from edit3r.kit.photos.camera_files import (
    intrinsics_from_outside,
    pose_from_outside,
    posed_cameras,
    read_scene_cameras,
    write_cameras,
)
from edit3r.kit.photos.images import (
    Photo,
    read_image,
    save_image,
    save_pixels,
    to_bytes,
)
from edit3r.kit.provenance import installed_versions, recorded
from edit3r.kit.scenes.ply import VIEWER_DEGREE, save_ply
from edit3r.kit.scenes.reading import load_scene
from edit3r.running.records import READ_LENS, Inputs
from edit3r.running.unit import Direction

Read = TypeVar("Read")
GIVEN_SCENE = "scene.file"  # note in run.json: the file of a given scene, as edited
FORMAT = 1
"""Version of the layout of `run.json`; raised when a field changes its meaning or goes."""
FRAME = (
    "camera of view 0; OpenCV axes (x right, y down, z forward); c2w; "
    "the length unit is arbitrary"
)
METRIC_FRAME = FRAME.replace("the length unit is arbitrary", "in metres")
SCALE = "scale"  # note in run.json: what all lengths were multiplied by, to be metres
TURNED = "turned about view 0's camera so that y points straight down; before that, "
UP = "up"  # note in run.json: what pointed up before the scene was turned so that it is -y
UPRIGHT = (0.0, -1.0, 0.0)  # what points up since
CACHE = "cache"  # the folder of answers of slow stages, for further edits
HIDDEN = "hidden"  # note in run.json: that the edit hid something for good
VIEWS = "views"  # note in run.json with what the images do not hold: intrinsics and known poses
THINGS = "things"  # note in run.json: names of the masks in the folders `masks/0`, `masks/1`...


@dataclass(frozen=True)
class EarlierRun:
    """What a further edit of one scene (batch 1) starts from."""

    # of that edit; without `before`, it begins with the photos
    inputs: Inputs
    # the frames, reconstructor and matcher, as a configuration holds them
    settings: Mapping[str, Any]
    hid: bool = False  # it hid something for good

    def undone(self) -> "EarlierRun":
        """What was before the last edit: the photos. Raises InputError for an edit of an edit, and
        for one that hid something.
        """
        inputs = self.inputs
        if self.hid:
            raise InputError(
                "this edit hid something for good, and its folder does not hold what was there: "
                "start again from the photos."
            )
        count = len(inputs.prompts)
        if count > 1:
            raise InputError(
                f"this is edit {count} of {count}, and its folder does not hold the scene before "
                "it: give --from the folder that it went on from, and leave 'undo' out."
            )
        photos = replace(inputs, start=inputs.photos, before=None, prompts=())
        return replace(self, inputs=photos)


class RunFolder:
    """The folder that a run leaves: where each result lies in it, and how it is read and written.

    Reading raises InputError, naming the file, for what is no run's folder or is damaged.
    """

    def __init__(self, root: str | Path) -> None:
        self.root = root = Path(root)
        self.scene = root / "scene.ply"  # the edited 3D Gaussians
        # photo, 2D edit and 3D result of each view on one sheet
        self.before_after = root / "before_after.png"
        self.video = root / "video.webm"  # the camera path
        self.viewer = root / "viewer.html"  # the scene in one page that opens from disk
        self.cameras = root / "cameras.json"  # intrinsics and poses of the input views
        self.manifest = root / "run.json"  # how the run was made
        self.cache = root / CACHE

    def subfolder(self, name: Literal["inputs", "edited", "renders", "masks"]) -> Path:
        """The folder of photos as they were used, 2D edits, images of the scene, or masks of what
        was named (a folder for each); made when asked for.
        """
        folder = self.root / name
        folder.mkdir(exist_ok=True)
        return folder

    # reading

    def read(self, trusted: bool = False) -> EarlierRun:
        """What a further edit starts from.

        Not `trusted`: what run.json says cannot name programs or addresses (`USER_ONLY`).
        """
        earlier = self._of_manifest(self._earlier)
        if trusted:
            return earlier
        return replace(earlier, settings=of_file(earlier.settings))

    def given_scene(self) -> tuple[Path, Path] | None:
        """The scene and the cameras of a run that edited a given scene; None of another one."""
        name = self._notes.get(GIVEN_SCENE)
        if name is None:
            return None
        if not is_plain_name(name) or not (self.root / name).is_file():
            raise InputError(
                f"{self.root}: lacks its scene, which run.json calls {str(name)[:60]!r}."
            )
        return self.root / name, self.cameras

    @property
    def _saved_scene(self) -> Path:
        """The file of the scene, a given one in its own format."""
        given = self.given_scene()
        return self.scene if given is None else given[0]

    @property
    def up(self) -> Direction | None:
        """What points up in the scene's file, where somebody told; None for no run's folder."""
        try:
            told = _direction(self._notes.get(UP))
        except (ValueError, TypeError):
            return None
        return None if told is None else UPRIGHT

    @property
    def unit(self) -> str:
        """Of lengths in the scene's file: m where somebody told one, else nothing."""
        return "m" if SCALE in self._notes else ""

    @property
    def _notes(self) -> Mapping[str, Any]:
        """Of run.json; none where it cannot be read."""
        try:
            notes = read_json(self.manifest)["notes"]
        except (OSError, ValueError, LookupError, TypeError, RecursionError):
            return {}
        return notes if isinstance(notes, dict) else {}

    def read_views(self) -> tuple[Views, Views]:
        """The unedited and the edited views, without the scene."""
        return self._of_manifest(self._views)

    def _of_manifest(self, read: Callable[[dict[str, Any]], Read]) -> Read:
        """What `read` makes of the content of run.json and the files beside it."""
        if not self.root.is_dir():
            raise InputError(
                f"{self.root}: no such folder; expected that of an earlier run, as edit3r run "
                "wrote it with --out."
            )
        for needed in (self.manifest, self._saved_scene, self.cameras):
            if not needed.is_file():
                raise InputError(
                    f"{self.root}: not the folder of an earlier run that can be continued, it "
                    f"lacks {needed.name}; --from takes what edit3r run wrote with --out."
                )
        try:
            return read(read_json(self.manifest))
        except (
            KeyError,
            TypeError,
            ValueError,
            AttributeError,
            RecursionError,
            OverflowError,
        ) as error:
            raise InputError(
                f"{self.manifest}: lacks what is needed to continue ({type(error).__name__}: "
                f"{error}); start again from the photos."
            ) from None

    def _earlier(self, manifest: dict[str, Any]) -> EarlierRun:
        run, notes = manifest["settings"]["run"], manifest["notes"]
        photos, edited = self._views(manifest)
        cameras, _ = read_scene_cameras(self.cameras)
        if (cameras.count, cameras.image_size) != (photos.count, photos.image_size):
            raise ValueError(
                f"cameras.json has {cameras.count} cameras, expected one for each of "
                f"{photos.count} views"
            )
        scale = float(notes.get(SCALE, 1.0))
        if not 0 < scale < math.inf:
            raise ValueError(f"the scale is {scale}, expected a number above 0")
        inputs = Inputs(
            photos=photos,
            start=edited,
            files=_files(manifest, photos.count),
            prompts=tuple(str(prompt) for prompt in notes["edits"]),
            things=self._things(notes.get(THINGS, []), photos),
            before=Reconstruction(load_scene(self._saved_scene), cameras),
            scale=scale,
            up=_direction(notes.get(UP)),
        ).unmeasured()
        chosen = {
            kind: {"name": run[kind]["name"], **run[kind]["settings"]}
            for kind in ("reconstructor", "matcher")
        }
        settings = {"frames": int(run["frames"]), **chosen}
        return EarlierRun(inputs, settings, hid=notes.get(HIDDEN) is True)

    def _views(self, manifest: dict[str, Any]) -> tuple[Views, Views]:
        """The images of `inputs/` and `edited/` as views."""
        stored = manifest["notes"][VIEWS]
        names = tuple(stored["names"])
        for name, safe in zip(names, unique_names([str(name) for name in names])):
            if name != safe:  # the folder may come from a stranger
                raise InputError(
                    f"{self.manifest}: the view name {str(name)[:60]!r} is no plain file name, or "
                    "is there twice."
                )
        lens = [intrinsics_from_outside(one, 1, 1) for one in stored["intrinsics"]]
        poses = None
        if stored["c2w"] is not None:
            poses = _as_batch([pose_from_outside(c2w, "c2w") for c2w in stored["c2w"]])
        assumed = tuple(bool(one) for one in stored["assumed"])
        photos, edited = (
            Views(self._images(folder, names), _as_batch(lens), names, poses, assumed)
            for folder in ("inputs", "edited")
        )
        return photos, edited

    def _images(
        self, folder: str, names: Sequence[str]
    ) -> Float[Tensor, "1 view 3 height width"]:
        pixels = [
            np.array(read_image(self.root / folder / f"{name}.png"), dtype=np.float32)
            for name in names
        ]
        images = torch.from_numpy(np.stack(pixels) / np.float32(255))
        return images.permute(0, 3, 1, 2).contiguous()[None]

    def _things(
        self, names: list[str], photos: Views
    ) -> dict[str, Float[Tensor, "view height width"]]:
        """Masks of what was named, by name."""
        things = {}
        for place, name in enumerate(TypeAdapter(list[str]).validate_python(names)):
            masks = self._images(f"masks/{place}", photos.names)[0, :, 0]
            if tuple(masks.shape[1:]) != photos.image_size:
                raise ValueError(
                    f"masks/{place} has masks that differ in size from the photos"
                )
            things[name] = masks
        return things

    # writing

    def write_images(
        self,
        photos: Views,
        edited: Views,
        rendered: Rendering,
        things: Mapping[str, Float[Tensor, "view height width"]],
    ) -> None:
        """Photos, 2D edits, the scene from the photos' places, and masks of what was named, which
        a further edit knows by these names.
        """
        shown = {
            self.subfolder("inputs"): images_of(photos),
            self.subfolder("edited"): images_of(edited),
            self.subfolder("renders"): images_of(rendered),
        }
        jobs = [
            (picture, directory / f"{name}.png")
            for directory, pictures in shown.items()
            for name, picture in zip(photos.names, pictures)
        ]
        with ThreadPoolExecutor(os.cpu_count()) as pool:  # coding runs outside the GIL
            list(pool.map(lambda job: save_image(*job), jobs))
        for place, masks in enumerate(things.values()):
            folder = self.subfolder("masks") / str(place)
            folder.mkdir()
            for name, mask in zip(photos.names, masks):
                save_pixels(to_bytes(mask.expand(3, -1, -1)), folder / f"{name}.png")
        if things:
            note(THINGS, list(things))

    def write_scene(
        self, gaussians: Gaussians, cameras: Cameras, names: Sequence[str], prompt: str
    ) -> None:
        """The scene and the cameras of its photos.

        `scene.ply` is for viewers, and common ones refuse harmonics above degree 3.
        """
        if gaussians.degree > VIEWER_DEGREE:
            warn(
                f"scene.ply holds harmonics up to degree {VIEWER_DEGREE} of {gaussians.degree}: "
                "viewers refuse more."
            )
        comment = [f"prompt: {' '.join(prompt.split())}"]
        save_ply(self.scene, gaussians, degree=VIEWER_DEGREE, comment_lines=comment)
        files = [f"inputs/{name}.png" for name in names]
        write_cameras(self.cameras, posed_cameras(cameras, files))

    def write_manifest(self, facts: Mapping[str, Any]) -> None:
        """Write run.json: these facts in their order, mappings in them sorted, secrets blanked,
        what is not finite as null.
        """
        content = {
            **{name: recorded(value) for name, value in facts.items()},
            "frame": facts.get("frame", FRAME),
            "versions": recorded(installed_versions()),
            "format": FORMAT,
        }
        with atomic_write(self.manifest) as partial:
            text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
            partial.write_text(text + "\n", encoding="utf-8")

    def continue_from(
        self,
        before: Path,
        folders: Sequence[str],
        content: Mapping[str, Any],
        factor: float = 1.0,
    ) -> None:
        """Write what stays true of the run in `before`: cameras, the `folders` of images that are
        there, and run.json with this `content`; a given scene goes on as `scene.ply`. With another
        `factor` than 1 all lengths were multiplied by it, to be metres.

        The run may be a stranger's: what is a link there is not followed, and a linked folder left
        out.
        """
        shutil.copyfile(RunFolder(before).cameras, self.cameras)
        if factor != 1:
            earlier = RunFolder(before)  # whose manifest is named where it is damaged
            content = earlier._of_manifest(lambda _: self._in_metres(content, factor))
        for name in folders:
            source = before / name
            if source.is_dir() and not source.is_symlink():
                shutil.copytree(source, self.root / name, symlinks=True)
        notes = content.get("notes", {})
        if GIVEN_SCENE in notes:
            content = {**content, "notes": {**notes, GIVEN_SCENE: self.scene.name}}
        text = json.dumps(content, indent=2, ensure_ascii=False)
        self.manifest.write_text(text + "\n", encoding="utf-8")

    def _in_metres(self, content: Mapping[str, Any], factor: float) -> dict[str, Any]:
        """What run.json says once lengths are multiplied; those of the cameras' file are, too."""
        cameras, posed = read_scene_cameras(self.cameras)
        scaled = replace(cameras, c2w=scale_poses(cameras.c2w, factor))
        write_cameras(self.cameras, posed_cameras(scaled, [one.file for one in posed]))
        notes = dict(content["notes"])
        notes[SCALE] = factor * float(notes.get(SCALE, 1.0))
        if notes[VIEWS]["c2w"] is not None:
            given = [pose_from_outside(c2w, "c2w") for c2w in notes[VIEWS]["c2w"]]
            poses = scale_poses(torch.from_numpy(np.array(given)), factor)
            notes[VIEWS] = {**notes[VIEWS], "c2w": poses.tolist()}
        frame = METRIC_FRAME if UP not in notes else f"{TURNED}{METRIC_FRAME}"
        return {**content, "frame": frame, "notes": notes}


def what_images_lack(views: Views) -> dict[str, Any]:
    """What `RunFolder.read_views` needs beside the images, as JSON data; numbers stay exact."""
    return {
        "names": list(views.names),
        "intrinsics": views.intrinsics[0].tolist(),
        "c2w": None if views.c2w is None else views.c2w[0].tolist(),
        "assumed": list(views.assumed),
    }


def _direction(told: Any) -> Direction | None:
    """A unit vector as run.json holds it. Raises ValueError for what is none."""
    if told is None:
        return None
    x, y, z = (float(number) for number in told)
    if abs(math.hypot(x, y, z) - 1) > 1e-3:
        raise ValueError(f"up is {told}, expected a vector of length 1")
    return x, y, z


def _as_batch(
    matrices: Sequence[np.ndarray | None],
) -> Float[Tensor, "1 view rows columns"]:
    return torch.from_numpy(np.array(matrices, dtype=np.float32))[None]


def _files(manifest: dict[str, Any], count: int) -> tuple[Photo, ...]:
    """How each of `count` photos became a view; raises ValueError for anything else."""
    files = TypeAdapter(tuple[Photo, ...]).validate_python(manifest["inputs"])
    if len(files) != count:
        raise ValueError(f"{len(files)} inputs, expected one for each of {count} views")
    for file in files:
        height, width = file.frame.source
        left, top, right, bottom = file.frame.box
        if not (
            0 <= left < right <= width + 1
            and 0 <= top < bottom <= height + 1
            and min(file.frame.target) > 0
        ):
            raise ValueError(
                f"{file.name} is cut from {file.frame.box} of {width}x{height} pixels"
            )
    lens = [str(one) for one in manifest["notes"].get("lens.source", ())]
    if lens and lens[0].startswith(READ_LENS):
        return tuple(replace(file, intrinsics_source=lens[0]) for file in files)
    return files
