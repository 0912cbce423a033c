"""Build a benchmark of generated scenes, whose edited truth is known."""

from typing import Any

from pydantic import Field

from edit3r import Registry
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneSample
from edit3r.contract.reporting import progress
from edit3r.contract.settings import Settings
from edit3r.kit.photos.images import evenly
from edit3r_bench.manifest import (
    EDITS_PER_SCENE,
    VISIBLE,
    ItemRecord,
    Manifest,
    SampleRecord,
    SceneRecord,
    hash_of_sample,
    load_sample,
    true_edits,
)

GENERATED_EDITS: tuple[tuple[str, str, dict[str, Any], str], ...] = (
    ("add", "Add", {"edit": "add"}, "add an object"),
    ("remove", "Remove", {"edit": "remove"}, "remove the object"),
    ("modify", "Modify", {"edit": "recolor"}, "recolor the object"),
    ("modify-2", "Modify", {"edit": "recolor", "edit_seed": 1}, "recolor the object"),
    ("global", "Global", {"edit": "global"}, "recolor everything"),
)
"""Suffix of the item, type, settings of the dataset, prompt. The first one is the pickiest, so it
is tried first.
"""

MAX_TRIES = 40  # generated scenes looked at for each that is taken, before giving up


class GeneratedSettings(Settings):
    """How the scenes are drawn and which are taken."""

    # dataset component that knows the edited truth of its scenes
    dataset: str = "procedural"
    image_size: int = Field(128, ge=32, le=1024)  # height and width [pixels]
    seed: int = Field(2026, ge=0)  # of the scenes
    # images a scene; first and last are given, the rest held back
    frames: int = Field(4, ge=3, le=16)
    inputs: int = Field(2, ge=2, le=15)  # how many are given, evenly spaced
    # between neighbouring images [degrees]
    angles: tuple[float, float] = (3.0, 8.0)
    # share of every image that a local edit must cover
    area: tuple[float, float] = (0.02, 0.5)
    # least mean absolute change where it changes [sRGB]
    change: float = Field(0.05, ge=0)


def build_generated(
    scenes: int, settings: GeneratedSettings, registry: Registry
) -> Manifest:
    """A benchmark of the generator's first `scenes` scenes whose five edits all images show."""
    records: list[SceneRecord] = []
    items: list[ItemRecord] = []
    tried = 0
    while len(records) < scenes:
        if tried - len(records) > MAX_TRIES * scenes:
            raise InputError(
                f"only {len(records)} of {tried} generated scenes show all edits; ask for weaker "
                "edits."
            )
        progress("generate scenes", len(records), scenes)
        found = _generated_items(tried, settings, registry)
        if found:
            records.append(SceneRecord(id=found[0].scene))
            items += found
        tried += 1
    return Manifest(
        name=f"{settings.dataset}: {scenes} scenes, {EDITS_PER_SCENE} edits each, truth known",
        image_size=settings.image_size,
        scenes=tuple(records),
        items=tuple(items),
        notes={
            "generator": settings.model_dump(mode="json"),
            "candidates": tried,
            "rejected_as_hardly_visible": tried - scenes,
        },
    )


def _generated_items(
    index: int, settings: GeneratedSettings, registry: Registry
) -> list[ItemRecord]:
    """Return the five edits of scene `index`; none as soon as one of them is hardly to be seen."""
    scene = f"scene{index:03d}"
    frames = range(settings.frames)
    inputs = evenly(frames, settings.inputs)
    held_back = [frame for frame in frames if frame not in inputs]
    drawn = {
        "seed": settings.seed,
        "image_size": settings.image_size,
        "context": settings.frames,
        "targets": 0,
        "angles": list(settings.angles),
    }
    items = []
    for number, (suffix, kind, edit, prompt) in enumerate(GENERATED_EDITS):
        how, name = {**drawn, **edit}, settings.dataset
        record = SampleRecord(dataset=name, settings=how, index=index, sha256="")
        sample = load_sample(record, registry)
        if not is_visible(sample, kind == "Global", settings):
            return []
        digest = hash_of_sample(sample)
        item = ItemRecord(
            id=f"{scene}-{suffix}",
            scene=scene,
            type=kind,
            prompt=prompt,
            seed=EDITS_PER_SCENE * index + number,
            inputs=tuple(inputs),
            held_back=tuple(held_back),
            sample=record.model_copy(update={"sha256": digest}),
        )
        items.append(item)
    return items


def is_visible(
    sample: SceneSample, everywhere: bool, settings: GeneratedSettings
) -> bool:
    """Whether the edit covers a fair part of every image and changes it by more than noise."""
    change = (true_edits(sample)[0] - sample.context).abs()
    changed = change.amax(1) > VISIBLE
    inside = change.mean(1)[changed]
    if inside.numel() == 0 or float(inside.mean()) < settings.change:
        return False
    low, high = settings.area
    share = changed.float().mean((1, 2))
    return everywhere or bool(((share >= low) & (share <= high)).all())
