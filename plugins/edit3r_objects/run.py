"""A run's folder as a scene with named objects: read, listed, written anew."""

import argparse
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r import default_registry
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import (
    Geometry,
    Matcher,
    NamedObjects,
    Rasterizer,
    RefineInputs,
    SceneToWrite,
)
from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.kit.contact_sheet import draw_sheet
from edit3r.kit.files.names import unique_names
from edit3r.kit.files.text import read_json
from edit3r.kit.geometry.cameras import scale_poses
from edit3r.kit.photos.images import LoadedPhotos, save_image
from edit3r.kit.rendering import render_each
from edit3r.kit.scenes.files import scene_file
from edit3r.kit.scenes.look import look_at
from edit3r.kit.scenes.ply import save_ply
from edit3r.kit.scenes.reading import load_scene
from edit3r.kit.scenes.scene_views import SceneGeometry, as_given, pictures_of
from edit3r.running import (
    MarkTexts,
    RunFolder,
    default_matcher,
    read_metres,
    select_with,
    usual_selector,
)
from edit3r_objects.drawn import choose_drawn, read_drawn
from edit3r_objects.finding import find_things, usual_tools
from edit3r_objects.lifting import lift, lift_all

MAX_NAME = 80
SMALLEST = 2e-4  # share of a view from which an object shows in it
NEW = 0.5  # share of a found thing that no object has, for it to be one
MAX_INDEX = 2**31 - 1  # of an object
PHOTOS = ("inputs", "edited", "masks")  # true only while the scene looks as it did
GO_ON = "edit3r objects {run} remove {name} --out {run}-without-{name}"
LOOK_ALIKE = ("add", "find", "rename", "measure")  # actions that change no pixel


@dataclass(frozen=True)
class Run:
    """A scene (batch 1) with its cameras and the names of its objects."""

    root: Path
    gaussians: Gaussians
    cameras: Cameras
    views: list[str]  # names of the views
    manifest: dict[str, Any]  # content of run.json
    names: Mapping[str, int] = field(default_factory=dict)  # object_index by name
    edits: tuple[str, ...] = ()  # what was done to objects, in order
    factor: float = 1.0  # that the last action multiplied lengths by
    guessed: int = 0  # Gaussians that the last action made where no photo sees

    @property
    def up(self) -> Float[Tensor, "3"] | None:
        """What points up in the scene, where somebody told."""
        told = RunFolder(self.root).up
        return None if told is None else torch.tensor(told)

    @property
    def free(self) -> int:
        """An index that no object has."""
        return max(self.names.values(), default=-1) + 1

    def chosen(self, name: str) -> Bool[Tensor, "gaussian"]:
        """The object's Gaussians. Raises InputError for a name that the run has not."""
        if name not in self.names:
            known = ", ".join(self.names) or "none; make one with: add NAME"
            raise InputError(f"{self.root}: has no object {name!r}; it has {known}.")
        return self.gaussians.objects == self.names[name]

    def named(self, name: str, index: int) -> "Run":
        """The run with one more name. Raises InputError for a name that is taken or unfit."""
        if name in self.names:
            raise InputError(
                f"{self.root}: already has an object {name!r}; choose another name."
            )
        if not (name.isprintable() and 0 < len(name) <= MAX_NAME):
            raise InputError(f"a name has 1 to {MAX_NAME} printable characters.")
        return replace(self, names={**self.names, name: index})

    def without(self, name: str, gaussians: Gaussians) -> "Run":
        names = {known: index for known, index in self.names.items() if known != name}
        return replace(self, names=names, gaussians=gaussians)


def read_run(root: Path) -> Run:
    """The run in a folder, or the scene in a file, with what lies beside it.

    Raises InputError, naming the file, for what is none.
    """
    scene = scene_file(str(root))
    root = root if root.is_dir() else root.parent
    folder = RunFolder(root)
    gaussians = load_scene(scene)
    cameras, posed = look_at(scene, None, gaussians)
    try:
        manifest = _manifest_of(folder)
        objects = manifest.get("objects", {})
        names = {str(name): int(index) for name, index in objects.items()}
        edits = tuple(map(str, manifest.get("object_edits", [])))
        _check(names)
    except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{folder.manifest}: cannot be read ({error}).") from None
    views = unique_names([Path(camera.file).stem for camera in posed])
    return Run(root, gaussians, cameras, views, manifest, names, edits)


def _manifest_of(folder: RunFolder) -> dict[str, Any]:
    """What run.json says; nothing of a scene that was made elsewhere."""
    if not folder.manifest.exists():
        return {}
    content: dict[str, Any] = read_json(folder.manifest)
    return content


def _check(names: Mapping[str, int]) -> None:
    for name, index in names.items():
        if not (name.isprintable() and 0 <= index <= MAX_INDEX):
            raise ValueError(f"{name!r}: {index} is no object")


def describe(run: Run, rasterizer: Rasterizer) -> list[str]:
    """A line for each object: Gaussians, centre and extent [scene units], views that show it."""
    height, width = run.cameras.image_size
    lines = []
    for name in run.names:
        own = run.gaussians.select(run.chosen(name))
        if not own.count:
            lines.append(f"{name}: no Gaussian is left of it")
            continue
        low, high = own.means[0].quantile(torch.tensor([0.02, 0.98]), 0)
        shown = [
            view
            for place, view in enumerate(run.views)
            if _area(run, name, place, rasterizer) > SMALLEST * height * width
        ]
        centre = " ".join(f"{value:.3g}" for value in (low + high) / 2)
        extent = " ".join(f"{value:.3g}" for value in high - low)
        lines.append(
            f"{name}: {own.count:,} Gaussians, centre {centre}, extent {extent}, seen in "
            f"{', '.join(shown) or 'no view'}"
        )
    return lines or ["no objects; make one with: add NAME"]


def _area(run: Run, name: str, view: int, rasterizer: Rasterizer) -> float:
    """How much of a view the object covers [pixels]."""
    covered = rasterizer.contributions(run.gaussians, run.cameras.select([view]))
    return float(covered[0, run.chosen(name)].sum())


def in_metres(run: Run, told: str) -> Run:
    """The run with all lengths multiplied so that one is as it is told: `3.58=69.4cm`.

    Raises InputError for what tells no length, and for a scene whose unit is not ours to choose.
    """
    asked = f"measure {told}"
    if "notes" not in run.manifest or RunFolder(run.root).given_scene() is not None:
        raise InputError(
            f"{asked}: a given scene keeps its unit; only scenes made of photos take one."
        )
    seen, _, true = told.partition("=")
    try:
        now = float(seen)
    except ValueError:
        now = 0.0
    if not 0 < now < math.inf:
        raise InputError(
            f"{asked}: expected a length of the scene, and how long it is in truth, such as "
            "3.58=69.4cm."
        )
    factor = read_metres(asked, true) / now
    cameras = replace(run.cameras, c2w=scale_poses(run.cameras.c2w, factor))
    gaussians = replace(
        run.gaussians,
        means=factor * run.gaussians.means,
        scales=factor * run.gaussians.scales,
    )
    return replace(run, gaussians=gaussians, cameras=cameras, factor=factor)


def add_object(run: Run, args: argparse.Namespace, rasterizer: Rasterizer) -> Run:
    """The run with one more object: what is marked, or what the run itself selected."""
    name = args.name
    run = run.named(name, run.free)
    if args.drawn:
        chosen = what_is_drawn(run, Path(args.drawn), rasterizer)
    else:
        _check_photos(run)
        chosen = lift(
            run.gaussians, run.cameras, _masks(run, args, rasterizer), rasterizer
        )
    if not chosen.any():
        raise InputError(
            f"{name}: nothing of the scene lies inside the masks; mark it with --point X,Y, "
            "--thing WORDS or --mask FILE."
        )
    index = torch.where(chosen, run.names[name], run.gaussians.objects)
    return replace(run, gaussians=replace(run.gaussians, object_index=index))


def what_is_drawn(
    run: Run, file: Path, rasterizer: Rasterizer
) -> Bool[Tensor, "gaussian"]:
    """The Gaussians that a file of strokes chooses. Raises InputError where that are none, or all.

    The file is JSON: `{"strokes": [...], "grown": 0}`, each stroke with the fields of
    `edit3r_objects.drawn.Drawn`.
    """
    try:
        content = read_json(file)
        strokes, grown = read_drawn(content["strokes"]), int(content.get("grown", 0))
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputError(f"{file}: expected JSON with strokes ({error}).") from None
    chosen = choose_drawn(run.gaussians, strokes, rasterizer, grown)
    if not chosen.any() or chosen.all():
        raise InputError("the strokes select nothing, or the whole scene.")
    return chosen


def without_floaters(run: Run, rasterizer: Rasterizer) -> Gaussians:
    """The scene without what hangs before all cameras. Raises InputError where nothing does."""
    shown = render_each(rasterizer, run.gaussians, run.cameras, "look at the scene")
    views = Views(shown.images.clamp(0, 1), run.cameras.intrinsics)
    inputs = RefineInputs(run.cameras, views, rasterizer)
    clean = default_registry().build("refiner", "clean")
    rest = clean(run.gaussians, inputs)
    if rest.count == run.gaussians.count:
        raise InputError(
            "no floaters were found: every point lies where some photo sees it."
        )
    return rest


def _check_photos(run: Run) -> None:
    if not (run.root / "inputs").is_dir():
        raise InputError(
            f"{run.root}: has no photos to mark the object on, since its scene was edited; add "
            "all objects before the first edit, or begin with a run that kept its images."
        )


def find_objects(run: Run, rasterizer: Rasterizer) -> Run:
    """The run with an object for each thing that is found; what is an object already stays one."""
    _check_photos(run)
    images = RunFolder(run.root).read_views()[0].images[0]
    rendered = render_each(rasterizer, run.gaussians, run.cameras, "depth")
    depths = rendered.depths[0, :, 0]
    things = find_things(images, depths, run.cameras, usual_tools())
    if not things:
        raise InputError(f"{run.root}: nothing was found; mark a thing with: add NAME.")
    masks = torch.stack([thing.masks for thing in things])
    lifted = lift_all(run.gaussians, run.cameras, masks, rasterizer)
    index = run.gaussians.objects.clone()
    for thing, chosen in zip(things, lifted):
        free = chosen & (index < 0)
        if free.sum() > NEW * chosen.sum():
            run = run.named(_free_name(run, thing.name), run.free)
            index[free] = run.free - 1
    return replace(run, gaussians=replace(run.gaussians, object_index=index))


def _free_name(run: Run, name: str) -> str:
    """The word and the first number that is free; the first of a kind goes without."""
    numbered = (f"{name or 'thing'} {number}" for number in count(1))
    if name and name not in run.names:
        return name
    return next(one for one in numbered if one not in run.names and one != f"{name} 1")


class SceneMatcher(Matcher):
    """The geometry of a given scene at its cameras; nothing is matched."""

    def __init__(self, run: Run, rasterizer: Rasterizer) -> None:
        self.run, self.rasterizer = run, rasterizer

    def match(self, views: Views) -> Geometry:
        places = as_given(self.run.cameras, self.run.views)
        seen = pictures_of(self.run.gaussians, places, self.rasterizer)
        return SceneGeometry(seen.scene).find_geometry(views)


def _masks(run: Run, args: argparse.Namespace, rasterizer: Rasterizer) -> Tensor:
    """Masks of the object `[V, H, W]` on the run's photos."""
    earlier = RunFolder(run.root).read().inputs
    views = earlier.photos
    texts = MarkTexts(
        tuple(args.point),
        tuple(args.not_point),
        tuple(args.box),
        tuple(args.mask),
        args.thing,
        tuple(args.stroke),
        tuple(args.region),
    )
    if not texts.given:
        if not earlier.things:
            raise InputError(
                f"{run.root}: the run kept no masks; mark the object with --point X,Y, "
                "--thing WORDS or --mask FILE."
            )
        return list(earlier.things.values())[-1]
    marks = replace(
        texts.read(LoadedPhotos(views, earlier.files)),
        larger=sum(args.larger or ()),
        candidate=args.candidate or 1,
        grow=args.grow or 0.0,
        inverted=bool(args.invert),
    )
    segmenter = default_registry().build("segmenter", "auto")
    matcher: Matcher = default_matcher(default_registry())
    if RunFolder(run.root).given_scene() is not None:
        matcher = SceneMatcher(run, rasterizer)
    return select_with(views, marks, usual_selector(segmenter), matcher).masks[0]


def write_run(root: Path, before: Run, run: Run, rasterizer: Rasterizer) -> None:
    """Write a run's folder with the scene, its renders and a sheet that compares both scenes."""
    folder = RunFolder(root)
    save_ply(folder.scene, run.gaussians)
    images = {}
    for caption, one in (("before", before), ("after", run)):
        shown = render_each(rasterizer, one.gaussians, one.cameras, caption)
        images[caption] = shown.images[0].clamp(0, 1)
    for view, image in zip(run.views, images["after"]):
        save_image(image, folder.subfolder("renders") / f"{view}.png")
    draw_sheet(images, names=run.views, title=run.edits[-1]).save(folder.before_after)
    scene = SceneToWrite(
        run.gaussians,
        run.cameras,
        up=RunFolder(before.root).up,
        unit="m" if run.factor != 1 else RunFolder(before.root).unit,
        names=tuple(run.views),
        title=run.edits[-1],
        objects=NamedObjects(run.names, GO_ON),
    )
    default_registry().build("writer", "viewer").write(folder.viewer, scene)
    facts = {
        "gaussians": run.gaussians.count,
        "objects": dict(run.names),
        "object_edits": list(run.edits),
        "object_guesses": run.guessed,
        "edited_from": str(before.root),
    }
    stays_true = PHOTOS if run.edits[-1].split()[0] in LOOK_ALIKE else ()
    content = {**run.manifest, **facts}
    folder.continue_from(before.root, stays_true, content, run.factor)
