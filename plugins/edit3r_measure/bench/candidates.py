"""Candidate edits of one scene: from a list of templates, or from a language model told what the photos show."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edit3r.errors import RunError
from edit3r_measure.bench.language_model import LanguageModel
from edit3r_measure.bench.manifest import EDIT_TYPES, EditType

__all__ = ["Candidate", "asked_candidates", "template_candidates"]


@dataclass(frozen=True)
class Candidate:
    """An edit somebody may vet."""

    type: EditType
    prompt: str  # the instruction
    object: str = ""  # what a local edit is about, as a label; "" for global ones
    description: str = ""  # what the edited picture shows
    source: str = "template"


TEMPLATES: dict[EditType, tuple[tuple[str, str], ...]] = {
    "Add": (
        ("put a red hat on top of the {object}", "a photo of the {object} with a red hat on top"),
        ("add a small potted plant next to the {object}", "a photo of the {object} beside a small potted plant"),
        ("add a yellow ball in front of the {object}", "a photo of the {object} with a yellow ball in front of it"),
    ),
    "Remove": (("remove the {object}", "a photo of the place without the {object}"),),
    "Modify": (
        ("paint the {object} blue", "a photo of a blue {object}"),
        ("paint the {object} red", "a photo of a red {object}"),
        ("make the {object} look like polished bronze", "a photo of a {object} made of polished bronze"),
    ),
    "Global": (
        ("make it look like a snowy winter day", "a photo taken on a snowy winter day"),
        ("make it warmer", "a photo in warm light"),
        ("turn it into a watercolor painting", "a watercolor painting"),
        ("make it black and white", "a black and white photo"),
    ),
}
"""Prompt and description; local ones are filled in with a label. Some are plain colour changes, which `recolor` can."""


def template_candidates(labels: Sequence[str], seed: int) -> list[Candidate]:
    """Every template for every label, shuffled within each type so that scenes do not all get the same five."""
    found = []
    rng = np.random.default_rng(seed)
    for kind in EDIT_TYPES:
        own = []
        for prompt, description in TEMPLATES[kind]:
            for label in labels if kind != "Global" else [""]:
                own.append(Candidate(kind, prompt.format(object=label), label, description.format(object=label)))
        found += [own[index] for index in rng.permutation(len(own))]
    return found


SYSTEM = (
    "You write instructions for a benchmark of 3D scene editing. An instruction is one short imperative sentence that "
    "an image editor could carry out on every photo of the scene alike. Answer with JSON only."
)
REQUEST = """\
Photos of one scene show: {labels}.
Write {count} instructions of each type: Add (a new object), Remove (an object named above), Modify (colour or material
of an object named above), Global (weather, light, season or style of the whole picture).
Answer with a JSON list of objects with the keys "type", "prompt", "object" (one of the names above, empty for Global)
and "description" (what the edited photo shows, one short phrase)."""


def asked_candidates(labels: Sequence[str], model: LanguageModel, count: int = 4) -> list[Candidate]:
    """What the model proposes. Raises RunError when its answer holds no usable edit."""
    answer = model.ask(SYSTEM, REQUEST.format(labels=", ".join(labels) or "unknown things", count=count))
    found = [candidate for entry in _json_list(answer) if (candidate := _candidate(entry, labels, model.name))]
    if not found:
        raise RunError(f"language model {model.name}: no usable edit in its answer: {answer[:200]!r}")
    return found


def _json_list(answer: str) -> list:
    """The first JSON list in the answer; models like to put words around it."""
    start, end = answer.find("["), answer.rfind("]")
    try:
        content = json.loads(answer[start : end + 1])
    except ValueError:
        return []
    return content if isinstance(content, list) else []


def _candidate(entry: object, labels: Sequence[str], source: str) -> Candidate | None:
    """None for an entry that is not an edit of this scene."""
    if not isinstance(entry, dict):
        return None
    kind = str(entry.get("type", "")).strip().capitalize()
    prompt = re.sub(r"\s+", " ", str(entry.get("prompt", ""))).strip()
    thing = str(entry.get("object", "") or "").strip().lower()
    if kind not in EDIT_TYPES or not prompt or (kind in ("Remove", "Modify") and thing not in labels):
        return None
    description = re.sub(r"\s+", " ", str(entry.get("description", ""))).strip()
    return Candidate(kind, prompt, thing if kind != "Global" else "", description, source)
