"""The vetting file: candidate edits as YAML that a person edits, and the five of each scene that result from it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field

from edit3r.config import Settings, make_settings, read_yaml
from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write
from edit3r_measure.bench.candidates import Candidate
from edit3r_measure.bench.manifest import EDIT_TYPES, EDITS_PER_SCENE, EditType

__all__ = ["VettedEdit", "choose_edits", "read_vetting", "write_vetting"]

HEADER = """\
# Edits proposed for each scene. For every one set `verdict` to keep or drop, and change its prompt if you like.
# Exactly five of a scene must remain. With fewer than five kept, undecided ones ('') fill up in order, types in turn.
# A local edit needs masks; it gets them from `object` by the detector, or from files you name:
#   masks: [masks/left.png, masks/right.png]     one per input photo, relative to this file, white may change
# Then run the same edit3r bench build command again.
"""


class VettedEdit(Settings):
    """One candidate and what became of it."""

    verdict: Literal["keep", "drop", ""] = Field("", description="'' undecided")
    type: EditType
    prompt: str = Field(min_length=1, description="the instruction, as it may have been reworded")
    object: str = Field("", description="label of what a local edit is about")
    description: str = Field("", description="what the edited picture shows")
    source: str = Field("", description="where the candidate came from")
    masks: tuple[str, ...] = Field((), description="mask files of the inputs, relative to the vetting file")


def write_vetting(path: Path, candidates: Mapping[str, Sequence[Candidate]]) -> None:
    """Write all candidates as undecided."""
    scenes = {scene: [{"verdict": "", **asdict(c)} for c in own] for scene, own in candidates.items()}
    with atomic_write(path) as partial:
        text = yaml.safe_dump({"scenes": scenes}, sort_keys=False, allow_unicode=True, width=110)
        partial.write_text(HEADER + text, encoding="utf-8")


def read_vetting(path: Path) -> dict[str, list[VettedEdit]]:
    """Edits by scene. Raises an error that names scene and entry for anything that cannot be read."""
    content = read_yaml(path)
    scenes = content.get("scenes")
    if set(content) != {"scenes"} or not isinstance(scenes, Mapping):
        raise InputError(f"{path}: expected one key, 'scenes', with a list of edits for each scene.")
    return {
        str(scene): [_edit(entry, path, scene, n) for n, entry in enumerate(own or [])] for scene, own in scenes.items()
    }


def choose_edits(scene: str, edits: Sequence[VettedEdit]) -> list[VettedEdit]:
    """The five of a scene: those kept, then undecided ones, one of each type in turn. Raises InputError otherwise."""
    kept = [edit for edit in edits if edit.verdict == "keep"]
    if len(kept) > EDITS_PER_SCENE:
        raise InputError(f"scene {scene!r}: {len(kept)} edits are kept, expected {EDITS_PER_SCENE}; drop some.")
    undecided = [edit for edit in edits if edit.verdict == ""]
    while len(kept) < EDITS_PER_SCENE and undecided:
        have = {kind: sum(edit.type == kind for edit in kept) for kind in EDIT_TYPES}
        chosen = min(undecided, key=lambda edit: have[edit.type])
        kept.append(chosen)
        undecided.remove(chosen)
    if len(kept) < EDITS_PER_SCENE:
        raise InputError(
            f"scene {scene!r}: only {len(kept)} edits are left, expected {EDITS_PER_SCENE}; drop fewer, or add some."
        )
    return sorted(kept, key=lambda edit: EDIT_TYPES.index(edit.type))


def _edit(entry: Any, path: Path, scene: Any, number: int) -> VettedEdit:
    if not isinstance(entry, Mapping):
        raise InputError(f"{path}: scene {scene!r}, edit {number + 1} is not a mapping.")
    return make_settings(VettedEdit, entry, where=f"{path.name}, scene {scene!r}, edit {number + 1}")
