"""The easy call from Python.

edit3r.run(["a.jpg", "b.jpg"], "paint the bike red", editor="recolor", recon="edit3r")
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor
from typing_extensions import Unpack

from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.interfaces import Editor, Reconstructor, Selection
from edit3r.contract.reporting import Report
from edit3r.contract.settings import PartChoice
from edit3r.contract.torch_state import in_usual_torch
from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.kit.cache import Cache
from edit3r.kit.photos.temporary import Pictures, as_files, temporary_photos
from edit3r.loading.registry import Registry
from edit3r.running.config import DEFAULTS, PART_KEYS, make_run_config
from edit3r.running.given import check_cameras, check_views, checked_masks
from edit3r.running.job import RunJob, inherited, scene_among, with_cameras
from edit3r.running.keywords import Choice, RunKeywords
from edit3r.running.pipeline import run as run_job
from edit3r.running.result import RunResult
from edit3r.running.run_folder import EarlierRun, RunFolder
from edit3r.running.selecting.marks import MarkTexts

Files = str | Path | Sequence[str | Path]


@in_usual_torch
@temporary_photos()
def run(
    photos: Views | Pictures | Gaussians = (),
    prompt: str | None = None,
    *,
    editor: Choice | Editor | None = None,
    recon: Choice | Reconstructor | None = None,
    masks: Float[Tensor, "batch view height width"] | Selection | Files | None = None,
    cameras: str | Path | Cameras | None = None,
    refine_poses: bool = False,
    earlier: RunResult | EarlierRun | str | Path | None = None,
    registry: Registry | None = None,
    report: Report | None = None,
    cache: Cache | None = None,
    progress: bool = False,
    **settings: Unpack[RunKeywords],
) -> RunResult:
    """Edit photos as `prompt` says and reconstruct them in 3D, or edit a scene that is there.

    Settings that are not given have the defaults of `edit3r run --help`, which tells them.

    Args:
        photos: Loaded views; photo files, folders and videos; or pictures in memory, of any sizes:
            arrays [height, width, 3], tensors [3, height, width], PIL images. May be left out with
            `earlier`. Or a scene: its file (.ply, .spz, .sog, .splat, .glb), or its Gaussians;
            `RunResult.scene` is then the edited one in its own frame.
        prompt: What to change, such as "paint the bike red".
        editor, recon: Names, names with settings, or built objects; `recon` is the reconstructor.
        masks: Where pixels may change: masks in [0, 1] of all views, mask files, or a Selection
            (clicks, boxes, masks of some views) from which a segmenter finds them.
        cameras: A camera file, or the cameras of all loaded views. Poses in it are used as they
            are.
        refine_poses: Refine the given poses by bundle adjustment.
        earlier: Edit the scene of this earlier run again: its result, or its folder.
        registry: Where components are looked up; default: all that is installed.
        report: Collects stages, notes and warnings. Without one, warnings are Python's own too.
        cache: Keeps what several runs have in common from being computed twice.
        progress: Show stages and warnings as the command line does, in notebooks too; a `report`
            shows its own.
        **settings: All other settings of a run, by the names of its flags. Components among them
            (`matcher`, `rasterizer`, `reader`, `segmenter`) are given as `editor` is.

    Raises:
        InputError: For photos, masks or a folder that cannot be used.
        SettingsError: For a setting that is unknown or out of range.
        UnknownComponentError: For a name that no installed plugin offers.
        PluginError: For a component that breaks its contract.
    """
    if "reconstructor" in settings:
        raise SettingsError(
            "run: the reconstructor is given as recon=, by one name only."
        )
    named = {"prompt": prompt, "editor": editor, "reconstructor": recon}
    given = {k: v for k, v in {**settings, **named}.items() if v is not None}
    scene, cameras = _scene(photos, cameras, earlier)
    if scene is not None:  # an earlier run is its scene
        earlier = None
    built = {key: given.pop(key) for key in PART_KEYS if _is_built(given.get(key))}
    if isinstance(earlier, RunResult) and not {"reconstructor", "quality"} & {
        *given,
        *built,
    }:
        built["reconstructor"] = earlier.reconstructor
        if (matcher := earlier.components.job.components.get("matcher")) is not None:
            built.setdefault("matcher", matcher)
    before = _earlier(earlier)
    layers = [{key: _plain(value) for key, value in given.items()}]
    if before is not None:
        layers.insert(0, inherited(before, layers))
    if scene is not None:
        layers.insert(0, DEFAULTS["of_scenes"])
    loaded = (
        ()
        if scene is not None or isinstance(photos, Gaussians)
        else _photos(photos, cameras)
    )
    job = RunJob(
        config=make_run_config(*layers),
        photos=loaded,
        scene=scene,
        cameras=Path(cameras) if isinstance(cameras, str) else cameras,
        refine_poses=refine_poses,
        masks=_masks(masks),
        earlier=None if loaded else before,
        cache=cache,
        components=built,
    )
    listener: Any = nullcontext()
    if progress:
        from edit3r.kit.command.console import StageConsole

        listener = StageConsole()
    with listener as console:
        own_report = report or Report(on_event=console)
        result = run_job(job, registry, own_report)
    if report is None and not progress:
        for text in own_report.warnings:
            warnings.warn(text, stacklevel=4)  # of the caller, past the decorators
    return result


def _is_built(choice: Any) -> bool:
    return choice is not None and not isinstance(choice, str | Mapping | PartChoice)


def _plain(value: Any) -> Any:
    """A PartChoice as the mapping that configuration files hold."""
    if isinstance(value, PartChoice):
        return {"name": value.name, **value.settings}
    return (
        [_plain(item) for item in value] if isinstance(value, list | tuple) else value
    )


def _scene(
    photos: Views | Pictures | Gaussians,
    cameras: str | Path | Cameras | None,
    earlier: RunResult | EarlierRun | str | Path | None,
) -> tuple[Path | Gaussians | None, str | Path | Cameras | None]:
    """The scene that is given in place of photos, or was by an earlier run, and its cameras."""
    if isinstance(photos, Gaussians):
        return photos, cameras
    paths = (photos,) if isinstance(photos, str | Path) else photos
    if isinstance(paths, list | tuple) and len(paths):
        files = [one for one in paths if isinstance(one, str | Path)]
        return scene_among(files), cameras
    if isinstance(earlier, RunResult) and earlier.records.inputs.scene is not None:
        given = earlier.records.inputs.scene
        return earlier.scene, cameras or given.cameras_in_own_frame(earlier.cameras)
    if isinstance(earlier, str | Path):
        file, beside = RunFolder(earlier).given_scene() or (None, None)
        return file, cameras or beside
    return None, cameras


def _photos(
    photos: Views | Pictures, cameras: str | Path | Cameras | None
) -> Views | tuple[Path, ...]:
    if not isinstance(photos, Views):
        return tuple(map(Path, as_files(photos)))
    check_views(photos)
    if not isinstance(cameras, Cameras):
        return photos
    check_cameras(cameras, photos)
    return with_cameras(photos, cameras)


def _paths(name: str, files: Files, other: str) -> tuple[Path, ...]:
    """The files as paths; raises InputError for what is neither files nor, as told, `other`."""
    listed: list[Any] = [files]
    if isinstance(files, Iterable) and not isinstance(files, str | Path):
        listed = list(files)
    if not all(isinstance(file, str | Path) for file in listed):
        raise InputError(
            f"{name}: got {type(files).__name__}, expected files or {other}."
        )
    return tuple(map(Path, listed))


def _masks(
    masks: Tensor | Selection | Files | None,
) -> Tensor | Selection | MarkTexts | None:
    if masks is None or isinstance(masks, Selection):
        return masks
    if isinstance(masks, Tensor):
        return checked_masks(masks)
    files = _paths("masks", masks, "a tensor of all views, or a Selection")
    return MarkTexts(mask_files=tuple(map(str, files)))


def _earlier(earlier: RunResult | EarlierRun | str | Path | None) -> EarlierRun | None:
    if isinstance(earlier, RunResult):
        return earlier.as_earlier()
    return RunFolder(earlier).read() if isinstance(earlier, str | Path) else earlier
