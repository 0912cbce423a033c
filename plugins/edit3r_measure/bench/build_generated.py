"""The offline benchmark: generated scenes whose edited 3D truth is known, five edits each."""

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from edit3r.config import Settings
from edit3r.errors import InputError
from edit3r.interfaces import SceneSample
from edit3r.registry import Registry
from edit3r.reporting import progress
from edit3r_measure.bench.loading import hash_of_sample, load_sample
from edit3r_measure.bench.manifest import EDITS_PER_SCENE, ItemRecord, Manifest, SampleRecord, SceneRecord

__all__ = ["GeneratedSettings", "build_generated"]

KINDS = (
    ("add", "Add", {"edit": "add"}, "add an object"),
    ("remove", "Remove", {"edit": "remove"}, "remove the object"),
    ("modify", "Modify", {"edit": "recolor"}, "recolor the object"),
    ("modify-2", "Modify", {"edit": "recolor", "edit_seed": 1}, "recolor the object"),
    ("global", "Global", {"edit": "global"}, "recolor everything"),
)
"""Suffix of the item, type, settings of the dataset, prompt. The first one is the pickiest, so it is tried first."""

MOST_TRIES = 40
"""Candidates looked at per scene before giving up."""


class GeneratedSettings(Settings):
    """How the scenes are drawn and which are taken."""

    dataset: str = Field("procedural", description="dataset component that knows the edited truth of its scenes")
    image_size: int = Field(128, ge=32, le=1024, description="height and width of the pictures [pixels]")
    seed: int = Field(2026, ge=0, description="of the scenes")
    frames: int = Field(4, ge=3, le=16, description="pictures a scene; first and last are given, the rest held back")
    angles: tuple[float, float] = Field((3.0, 8.0), description="between neighbouring pictures [degrees]")
    area: tuple[float, float] = Field((0.02, 0.5), description="share of every picture that a local edit must cover")
    change: float = Field(0.05, ge=0, description="least mean absolute change where it changes [sRGB]")


def build_generated(scenes: int, settings: GeneratedSettings, registry: Registry) -> Manifest:
    """The first `scenes` scenes of the generator whose five edits can all be seen in all pictures."""
    records, items, rejected, index = [], [], 0, 0
    while len(records) < scenes:
        if rejected > MOST_TRIES * scenes:
            raise InputError(f"only {len(records)} of {index} generated scenes show all edits; ask for weaker edits.")
        name = f"scene{index:03d}"
        progress("generate scenes", len(records), scenes)
        found = _items(name, index, settings, registry)
        if found is None:
            rejected += 1
        else:
            records.append(SceneRecord(id=name))
            items += found
        index += 1
    notes = {"generator": settings.model_dump(mode="json"), "candidates": index, "rejected_as_hardly_visible": rejected}
    return Manifest(
        name=f"{settings.dataset}: {scenes} scenes, {EDITS_PER_SCENE} edits each, truth known",
        image_size=settings.image_size,
        scenes=tuple(records),
        items=tuple(items),
        notes=notes,
    )


def _items(name: str, index: int, settings: GeneratedSettings, registry: Registry) -> list[ItemRecord] | None:
    """The five edits of scene `index`; None as soon as one of them is hardly to be seen."""
    items = []
    for number, (suffix, kind, edit, prompt) in enumerate(KINDS):
        record = SampleRecord(
            dataset=settings.dataset, settings=_dataset_settings(settings, edit), index=index, sha256=""
        )
        sample = load_sample(record, registry)
        if not is_visible(sample, kind == "Global", settings):
            return None
        items.append(
            ItemRecord(
                id=f"{name}-{suffix}",
                scene=name,
                type=kind,
                prompt=prompt,
                seed=EDITS_PER_SCENE * index + number,
                inputs=(0, settings.frames - 1),
                held_back=tuple(range(1, settings.frames - 1)),
                sample=record.model_copy(update={"sha256": hash_of_sample(sample)}),
            )
        )
    return items


def _dataset_settings(settings: GeneratedSettings, edit: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "seed": settings.seed,
        "image_size": settings.image_size,
        "context": settings.frames,
        "targets": 0,
        "angles": list(settings.angles),
        **edit,
    }


def is_visible(sample: SceneSample, everywhere: bool, settings: GeneratedSettings) -> bool:
    """Whether the edit covers a fair part of every picture and changes it by more than noise."""
    change = (sample.edited_context - sample.context).abs()
    changed = change.amax(1) > 1.5 / 255
    share = changed.float().mean((1, 2))
    low, high = settings.area
    inside = change.mean(1)[changed]
    strong = inside.numel() > 0 and float(inside.mean()) >= settings.change
    return strong and (everywhere or bool(((share >= low) & (share <= high)).all()))
