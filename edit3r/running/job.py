"""What a run is asked to do. Everything that starts a run builds a `RunJob`, and nothing else.

`job_from` makes one from words: flags of the command line, or a line of a batch. The call from
Python (`edit3r.api`) makes one from objects.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError, PromptError
from edit3r.contract.interfaces import Selection
from edit3r.contract.reporting import note, say
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.kit import asking
from edit3r.kit.cache import Cache
from edit3r.kit.photos.images import packaged_pair
from edit3r.loading.registry import Registry
from edit3r.running.config import DEFAULTS, JobInputs, RunConfig, make_run_config
from edit3r.running.run_folder import EarlierRun, RunFolder
from edit3r.running.scene_input import SceneInput, is_scene
from edit3r.running.selecting.marks import MarkTexts


@dataclass(frozen=True)
class RunJob:
    """One run: settings, photos, what may change on them, and what is known about them."""

    config: RunConfig
    # files, folders and videos, or loaded views; () where an earlier run brings them
    photos: Views | tuple[Path, ...] = ()
    # edited in place of photos: a file, Gaussians, or both read and looked at
    scene: Path | Gaussians | SceneInput | None = None
    # of loaded photos: a camera file, or the cameras of all of them
    cameras: Path | Cameras | None = None
    refine_poses: bool = False  # the given poses may move to where the photos want them
    # where pixels may change, in [0, 1]; or what was marked, from which a segmenter finds that
    masks: Float[Tensor, "batch view height width"] | Selection | MarkTexts | None = (
        None
    )
    earlier: EarlierRun | None = None  # the run whose scene is edited again
    cache: Cache | None = None  # answers of earlier runs on the same photos
    components: Mapping[str, Any] = field(default_factory=dict)  # built ones, by kind


def job_from(
    inputs: JobInputs, *layers: Mapping[str, Any], trusted: bool = False
) -> RunJob:
    """The job that `inputs` and layers of run settings describe, later layers over earlier.

    Without photos and without an earlier run it is the packaged pair. Raises InputError for an
    earlier run that cannot be read, SettingsError for wrong settings. `trusted`: its run.json is.
    """
    continued = RunFolder(inputs.earlier).given_scene() if inputs.earlier else None
    if continued is not None and not inputs.photos:
        file, cameras = map(str, continued)
        again = {"photos": (file,), "cameras": inputs.cameras or cameras}
        inputs = inputs.model_copy(update={**again, "earlier": None})
    earlier = RunFolder(inputs.earlier).read(trusted) if inputs.earlier else None
    cache = _answers(inputs)
    if earlier is not None:
        layers = (inherited(earlier, layers), *layers)
    elif not inputs.photos and not _names_another("editor", DEFAULTS["editor"], layers):
        # what another editor does, its own settings say
        layers = ({"prompt": DEFAULTS["prompt"]}, *layers)
    scene = scene_among(inputs.photos)
    if scene is not None:
        said = any({"prompt", "editor"} & {*layer} for layer in layers)
        looks = () if said else ({"editor": "none"},)  # only looked at
        layers = (DEFAULTS["of_scenes"], *looks, *layers)
    config = make_run_config(*layers)
    if earlier is None and not inputs.photos:
        inputs = _packaged(inputs, config)
    texts = MarkTexts(
        inputs.point,
        inputs.not_point,
        inputs.box,
        inputs.mask,
        inputs.thing,
        inputs.stroke,
        inputs.region,
    )
    return RunJob(
        config=config,
        photos=() if scene is not None else tuple(map(Path, inputs.photos)),
        scene=scene,
        cameras=Path(inputs.cameras) if inputs.cameras else None,
        refine_poses=inputs.refine_poses,
        masks=texts if texts.given else None,
        # Photos that are given are edited from the start.
        earlier=None if inputs.photos else earlier,
        cache=cache,
    )


def scene_among(photos: Sequence[str | Path]) -> Path | None:
    """The scene that is given in place of photos. Raises InputError for one among others."""
    scenes = [Path(path) for path in photos if is_scene(path)]
    if scenes and len(photos) > 1:
        raise InputError(
            f"{scenes[0]}: a scene is edited alone; give it without photos and other scenes."
        )
    return scenes[0] if scenes else None


def _answers(inputs: JobInputs) -> Cache | None:
    """What the earlier run found; else what `edit3r mask` found and keeps beside its masks."""
    folders = [Path(inputs.earlier)] if inputs.earlier else []
    masks = [Path(mask) for mask in inputs.mask[:1]]
    folders += [mask if mask.is_dir() else mask.parent for mask in masks]
    caches = [RunFolder(folder).cache for folder in folders]
    return next((Cache(cache) for cache in caches if cache.is_dir()), None)


def inherited(
    earlier: EarlierRun, layers: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The earlier run's frames and, unless others are asked for, its reconstructor and matcher."""
    settings = dict(earlier.settings)
    by_preset = any("quality" in layer for layer in layers)
    for kind in ("reconstructor", "matcher"):
        if by_preset or _names_another(kind, settings[kind]["name"], layers):
            del settings[kind]
    return settings


def _names_another(kind: str, name: str, layers: Sequence[Mapping[str, Any]]) -> bool:
    """Whether a layer names another component of that kind than `name`."""
    choices = [layer[kind] for layer in layers if kind in layer]
    names = {one.get("name") if isinstance(one, Mapping) else one for one in choices}
    return not names <= {None, name}


def _packaged(inputs: JobInputs, config: RunConfig) -> JobInputs:
    """The packaged pair, with masks of its subject where only the prompt names it."""
    photos, cameras = packaged_pair()
    pair: dict[str, Any] = {
        "photos": tuple(photos),
        "cameras": inputs.cameras or str(cameras),
    }
    clicked = (inputs.point, inputs.not_point, inputs.stroke, inputs.box)
    marked = any((inputs.mask, inputs.thing, inputs.region, *clicked))
    subject = DEFAULTS["subject"]
    usual = config.editor is None or config.editor.name == DEFAULTS["editor"]
    if usual and not marked and subject in config.prompt.lower():
        note("selection.mask", f"the packaged pair brings masks of its {subject}")
        folder = Path(cameras).parent
        pair["mask"] = tuple(
            str(folder / f"motorcycle_mask{side}.png") for side in ("", "_right")
        )
    return inputs.model_copy(update=pair)


def with_cameras(views: Views, cameras: Cameras) -> Views:
    """Views whose intrinsics and poses somebody knows."""
    return replace(views, intrinsics=cameras.intrinsics, c2w=cameras.c2w, assumed=())


def with_reader(job: RunJob, registry: Registry) -> RunJob:
    """The job with its reader built, the one of all its words."""
    if "reader" in job.components:
        return job
    reader = registry.build_choice("reader", job.config.reader)
    return replace(job, components={**job.components, "reader": reader})


def undone(job: RunJob) -> RunJob:
    """The job without the earlier run's edit, where its sentence begins with "undo".

    Raises PromptError where no earlier run of photos is given.
    """
    rest = asking.after_undo(job.components["reader"], job.config.prompt)
    if rest is None:
        return job
    if job.scene is not None:
        raise PromptError(
            "'undo': a given scene keeps no earlier edit; edit the file that it was made from, "
            "which run.json names among its inputs."
        )
    if job.earlier is None:
        raise PromptError(
            "'undo' takes back an edit of an earlier run, and none is given: add --from its "
            "folder, without photos."
        )
    say("edit.undone", f"taken back: {job.earlier.inputs.prompts[-1]}")
    changed: dict[str, Any] = {"prompt": rest}
    if not rest:
        changed["editor"] = PartChoice(name="none")
    return replace(
        job, config=job.config.model_copy(update=changed), earlier=job.earlier.undone()
    )
