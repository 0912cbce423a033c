"""Edits for photographed scenes: what the photos show, edits proposed for it, and a person's
verdicts on them.

photos -> labels (detector) -> proposals (language model, templates) -> near duplicates out ->
vetting file (YAML) vetting file, edited by a person -> five edits a scene
"""

import base64
import io
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from jaxtyping import Float
from PIL import Image
from pydantic import Field
from torch import Tensor

from edit3r.config import Settings, make_settings, read_yaml
from edit3r.contract.interfaces import Detection, Detector, Segmenter
from edit3r.errors import InputError, MissingDependencyError, RunError
from edit3r.geometry.maps import dilate_softly
from edit3r_measure.bench_manifest import EDIT_TYPES, EDITS_PER_SCENE, EditType
from edit3r_measure.report import write_text

Boxes = tuple[
    Detection | None, ...
]  # one object's box in each photo; None where a photo does not show it

KEY_VARIABLE = "OPENAI_API_KEY"
SHARE_OF_VIEWS = 0.5  # an object counts when at least this share of the photos shows it
LARGEST_SHARE = (
    0.7  # boxes over more of a photo than this name the place rather than a thing in it
)
MOST_OBJECTS = 8  # objects of a scene that edits are proposed for
PROPOSALS = 4  # edits of each type that a language model is asked for
# Vocabulary of detectors, templates of edits, requests to language models, the head of the vetting
# file
WORDS = read_yaml(Path(__file__).with_name("bench_words.yaml"))


class ProposedEdit(Settings):
    """One edit of a scene and what a person made of it; an entry of the vetting file."""

    verdict: Literal["keep", "drop", ""] = Field("", description="'' undecided")
    type: EditType
    prompt: str = Field(
        min_length=1, description="the instruction, as it may have been reworded"
    )
    object: str = Field("", description="label of what a local edit is about")
    description: str = Field("", description="what the edited photo shows")
    source: str = Field("", description="where the proposal came from")
    masks: tuple[str, ...] = Field(
        (), description="mask files of the inputs, relative to the vetting file"
    )


def find_objects(
    images: Iterable[Float[Tensor, "3 height width"]],
    detector: Detector,
    words: Sequence[str],
) -> dict[str, Boxes]:
    """Return at most MOST_OBJECTS of `words` that enough photos show, by mean score, with the best
    box in each.
    """
    boxes: dict[str, Boxes] = dict.fromkeys(words, ())
    for image in images:
        area = image.shape[-2] * image.shape[-1]
        boxes = {
            word: (*own, _best(detector.detect(image, word), area))
            for word, own in boxes.items()
        }
    seen = {word: [box.score for box in own if box] for word, own in boxes.items()}
    often = [
        word
        for word, scores in seen.items()
        if scores and len(scores) >= SHARE_OF_VIEWS * len(boxes[word])
    ]
    return {
        word: boxes[word]
        for word in sorted(often, key=lambda word: -sum(seen[word]))[:MOST_OBJECTS]
    }


def _best(detections: Sequence[Detection], area: int) -> Detection | None:
    fit = [d for d in detections if d.box[2] * d.box[3] <= LARGEST_SHARE * area]
    return max(fit, key=lambda d: d.score, default=None)


def masks_from_boxes(
    images: Float[Tensor, "view 3 height width"],
    boxes: Sequence[Detection],
    segmenter: Segmenter | None,
) -> Float[Tensor, "view height width"]:
    """Return masks around one object, a little larger than it; from the boxes themselves without a
    segmenter.
    """
    height, width = images.shape[-2:]
    masks = images.new_zeros(len(images), height, width)
    for mask, image, (x, y, w, h) in zip(masks, images, (found.box for found in boxes)):
        if segmenter is None:
            mask[max(0, round(y)) : round(y + h), max(0, round(x)) : round(x + w)] = 1
        else:
            box = (
                max(0.0, x / width),
                max(0.0, y / height),
                min(1.0, w / width),
                min(1.0, h / height),
            )
            mask[:] = segmenter.segment(image, box=box).soft_mask > 0.5
    return dilate_softly(masks)


@dataclass(frozen=True)
class LanguageModel:
    """A model behind an OpenAI-compatible address, asked once a scene; its key comes from the
    environment only.
    """

    address: str  # such as http://localhost:8000/v1; local servers want no key
    name: str

    def ask(
        self, system: str, request: str, images: Float[Tensor, "frame 3 height width"]
    ) -> str:
        """Return the model's answer at temperature 0, shown the images too. Raises RunError when
        none comes.
        """
        try:
            import openai
        except ImportError:
            cure = 'install with: pip install "edit3r[bench]"'
            raise MissingDependencyError(
                f"--llm needs the openai client; {cure}"
            ) from None
        key = os.environ.get(KEY_VARIABLE, "").strip() or "none"
        client = openai.OpenAI(
            api_key=key, base_url=self.address, timeout=120, max_retries=2
        )
        content = [{"type": "text", "text": request}]
        content += [
            {"type": "image_url", "image_url": {"url": _as_jpeg(image)}}
            for image in images
        ]
        messages = [
            {"role": "system", "content": system},
            {"role": "user", "content": content if len(images) else request},
        ]
        try:
            answer = client.chat.completions.create(
                model=self.name, messages=messages, temperature=0
            )
        except openai.OpenAIError as error:
            sentence = f"language model {self.name} at {self.address}: {' '.join(str(error).split())}"
            raise RunError(
                f"{sentence}; one that takes no pictures needs --llm-photos 0."
            ) from None
        text = answer.choices[0].message.content if answer.choices else None
        if not text:
            raise RunError(
                f"language model {self.name} at {self.address} gave an empty answer."
            )
        return text


def _as_jpeg(image: Float[Tensor, "3 height width"]) -> str:
    """Return an image as the address that holds it."""
    buffer = io.BytesIO()
    Image.fromarray((image * 255).round().byte().permute(1, 2, 0).numpy()).save(
        buffer, "JPEG", quality=90
    )
    return (
        f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
    )


def edits_from_templates(labels: Sequence[str], seed: int) -> list[ProposedEdit]:
    """Return every template for every label, shuffled within each type so that scenes do not all
    get the same five.
    """
    found = []
    rng = np.random.default_rng(seed)
    for kind in EDIT_TYPES:
        objects = labels if kind != "Global" else [""]
        own = [
            (texts, label) for texts in WORDS["templates"][kind] for label in objects
        ]
        for texts, label in (own[index] for index in rng.permutation(len(own))):
            prompt, description = (text.format(object=label) for text in texts)
            named = {"prompt": prompt, "object": label, "description": description}
            found.append(ProposedEdit(type=kind, **named, source="template"))
    return found


def edits_from_model(
    labels: Sequence[str],
    images: Float[Tensor, "frame 3 height width"],
    model: LanguageModel,
) -> list[ProposedEdit]:
    """Return what the model proposes for a scene whose objects it is told and whose images, if any,
    it sees.

    Raises RunError when its answer holds no usable edit.
    """
    request = WORDS["request"].format(
        labels=", ".join(labels) or "unknown things", count=PROPOSALS
    )
    answer = model.ask(WORDS["system"], request, images)
    start, end = (
        answer.find("["),
        answer.rfind("]"),
    )  # models like to put words around the list
    try:
        entries = json.loads(answer[start : end + 1])
    except ValueError:
        entries = []
    found = [
        edit for entry in entries if (edit := _usable_edit(entry, labels, model.name))
    ]
    if not found:
        raise RunError(
            f"language model {model.name}: no usable edit in its answer: {answer[:200]!r}"
        )
    return found


def _usable_edit(
    entry: object, labels: Sequence[str], source: str
) -> ProposedEdit | None:
    """Return None for an entry that is not an edit of this scene."""
    if not isinstance(entry, dict):
        return None
    kind, prompt, thing, description = (
        " ".join(str(entry.get(key) or "").split())
        for key in ("type", "prompt", "object", "description")
    )
    kind, thing = kind.capitalize(), thing.lower()
    if (
        kind not in EDIT_TYPES
        or not prompt
        or (kind in ("Remove", "Modify") and thing not in labels)
    ):
        return None
    named = {
        "prompt": prompt,
        "object": "" if kind == "Global" else thing,
        "description": description,
    }
    return ProposedEdit(type=kind, **named, source=source)


def without_near_duplicates(edits: Iterable[ProposedEdit]) -> list[ProposedEdit]:
    """Return the edits in order, without those whose prompt has the words of one before.

    Order, case, plural s and words that carry nothing do not count. It knows no meaning: "red" and
    "crimson" stay two prompts, of which a person may drop one in the vetting file.
    """
    kept: dict[frozenset[str], ProposedEdit] = {}
    for edit in edits:
        words = re.findall(r"[^\W_]+", edit.prompt.lower())
        plain = (word.removesuffix("s") if len(word) > 3 else word for word in words)
        kept.setdefault(
            frozenset(word for word in plain if word not in WORDS["fillers"]), edit
        )
    return list(kept.values())


def write_vetting(path: Path, proposed: Mapping[str, Sequence[ProposedEdit]]) -> None:
    """Write the proposals of every scene as YAML that a person edits."""
    scenes = {
        scene: [edit.model_dump(exclude={"masks"}) for edit in own]
        for scene, own in proposed.items()
    }
    text = yaml.safe_dump(
        {"scenes": scenes}, sort_keys=False, allow_unicode=True, width=110
    )
    write_text(path, WORDS["vetting_head"] + text)


def read_vetting(path: Path) -> dict[str, list[ProposedEdit]]:
    """Return edits by scene. Raises an error that names scene and entry for anything that cannot be
    read.
    """
    content = read_yaml(path)
    scenes = content.get("scenes")
    if set(content) != {"scenes"} or not isinstance(scenes, Mapping):
        raise InputError(
            f"{path}: expected one key, 'scenes', with a list of edits for each scene."
        )
    found: dict[str, list[ProposedEdit]] = {}
    for scene, own in scenes.items():
        found[scene] = []
        for number, entry in enumerate(own or [], start=1):
            where = f"scene {scene!r}, edit {number}"
            if not isinstance(entry, Mapping):
                raise InputError(f"{path}: {where} is not a mapping.")
            found[scene].append(
                make_settings(ProposedEdit, entry, where=f"{path.name}, {where}")
            )
    return found


def choose_edits(scene: str, edits: Sequence[ProposedEdit]) -> list[ProposedEdit]:
    """Return the five of a scene, in the order of EDIT_TYPES: those kept, then undecided ones,
    types in turn.

    Raises InputError for another count.
    """
    kept = [edit for edit in edits if edit.verdict == "keep"]
    if len(kept) > EDITS_PER_SCENE:
        raise InputError(
            f"scene {scene!r}: {len(kept)} edits are kept, expected {EDITS_PER_SCENE}; drop some."
        )
    undecided = [edit for edit in edits if edit.verdict == ""]
    while len(kept) < EDITS_PER_SCENE and undecided:
        types = [edit.type for edit in kept]
        kept.append(min(undecided, key=lambda edit: types.count(edit.type)))
        undecided.remove(kept[-1])
    if len(kept) < EDITS_PER_SCENE:
        left = f"only {len(kept)} edits are left, expected {EDITS_PER_SCENE}"
        raise InputError(f"scene {scene!r}: {left}; drop fewer, or add some.")
    return sorted(kept, key=lambda edit: EDIT_TYPES.index(edit.type))
