"""Edits for photographed scenes: what the photos show, edits proposed for it, and a person's
verdicts on them.

    photos -> labels             detector
    labels -> proposals          language model, templates; near duplicates removed
    proposals -> vetting file    YAML, edited by a person
    vetting file -> five edits a scene
"""

import base64
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import yaml
from jaxtyping import Float
from PIL import Image
from pydantic import Field, ValidationError
from torch import Tensor

from edit3r.contract.errors import InputError, RunError
from edit3r.contract.interfaces import Detection, Detector, Segmenter
from edit3r.contract.settings import Settings, make_settings
from edit3r.kit import asking
from edit3r.kit.command.results import write_text
from edit3r.kit.files.configs import read_yaml
from edit3r.kit.geometry.maps import dilate_softly
from edit3r.kit.photos.images import to_bytes
from edit3r.kit.segmenting import mask_in_box
from edit3r.kit.service import ChatModel
from edit3r_bench.manifest import EDIT_TYPES, EDITS_PER_SCENE, EditType

Photo = Float[Tensor, "3 height width"]
Images = Float[Tensor, "view 3 height width"]
# One object's box in each photo; None where a photo does not show it
Boxes = tuple[Detection | None, ...]

LOCAL = ("Remove", "Modify")  # types of edits that stay on one object
SHARE_OF_VIEWS = 0.5  # an object counts when at least this share of the photos shows it
# Boxes over more of a photo than this name the place rather than a thing in it; no figure kept
LARGEST_SHARE = 0.7
MAX_OBJECTS = 8  # objects of a scene that edits are proposed for
PROPOSALS = 4  # edits of each type that a language model is asked for
# Vocabulary of detectors, templates of edits, requests to language models, the head of the vetting
# file
WORDS = read_yaml(Path(__file__).with_name("words.yaml"))


class ProposedEdit(Settings):
    """One edit of a scene and what a person made of it; an entry of the vetting file."""

    verdict: Literal["keep", "drop", ""] = ""  # "": undecided
    type: EditType
    prompt: str = Field(min_length=1)  # the instruction, as it may have been reworded
    object: str = ""  # label of what a local edit is about
    description: str = ""  # what the edited photo shows
    source: str = ""  # where the proposal came from
    # mask files of the inputs, relative to the vetting file
    masks: tuple[str, ...] = ()


# ---- what the photos show ----


def find_objects(
    images: Iterable[Photo], detector: Detector, words: Sequence[str]
) -> dict[str, Boxes]:
    """At most MAX_OBJECTS of `words` that enough photos show, by score, with the best boxes."""
    boxes: dict[str, Boxes] = dict.fromkeys(words, ())
    for image in images:
        for word in words:
            boxes[word] += (_best_box(asking.detect(detector, image, word), image),)
    scores = {}
    for word, own in boxes.items():
        seen = [box.score for box in own if box]
        if seen and len(seen) >= SHARE_OF_VIEWS * len(own):
            scores[word] = sum(seen)
    best = sorted(scores, key=scores.__getitem__, reverse=True)
    return {word: boxes[word] for word in best[:MAX_OBJECTS]}


def _best_box(detections: Sequence[Detection], image: Photo) -> Detection | None:
    largest = LARGEST_SHARE * image.shape[-2] * image.shape[-1]
    fit = [one for one in detections if one.box[2] * one.box[3] <= largest]
    return max(fit, key=lambda one: one.score, default=None)


def masks_from_boxes(
    images: Images, boxes: Sequence[Detection], segmenter: Segmenter | None
) -> Float[Tensor, "view height width"]:
    """Masks around one object, a little larger than it; without a segmenter the boxes."""
    height, width = images.shape[-2:]
    masks = torch.zeros_like(images[:, 0])
    for mask, image, detection in zip(masks, images, boxes):
        x, y, w, h = detection.box
        if segmenter is None:
            rows = slice(max(0, round(y)), round(y + h))
            columns = slice(max(0, round(x)), round(x + w))
            mask[rows, columns] = 1
        else:
            corner = (max(0.0, x / width), max(0.0, y / height))
            size = (min(1.0, w / width), min(1.0, h / height))
            mask[:] = mask_in_box(segmenter, image, (*corner, *size)) > 0.5
    return dilate_softly(masks)


# ---- proposals ----


def asked_of_model(request: str, images: Images) -> list[dict[str, Any]]:
    """What a chat model is told: its part, the request, and the images."""
    content: list[dict[str, Any]] = [{"type": "text", "text": request}]
    for image in images:
        jpeg = io.BytesIO()
        Image.fromarray(to_bytes(image)).save(jpeg, "JPEG", quality=90)
        code = base64.b64encode(jpeg.getvalue()).decode("ascii")
        url = {"url": f"data:image/jpeg;base64,{code}"}
        content.append({"type": "image_url", "image_url": url})
    return [
        {"role": "system", "content": WORDS["system"]},
        {"role": "user", "content": content if len(images) else request},
    ]


def edits_from_templates(labels: Sequence[str], seed: int) -> list[ProposedEdit]:
    """Every template for every label, shuffled within each type, so that scenes differ."""
    edits = []
    rng = np.random.default_rng(seed)
    for kind in EDIT_TYPES:
        objects = labels if kind != "Global" else [""]
        own = list(product(WORDS["templates"][kind], objects))
        for index in rng.permutation(len(own)):
            texts, label = own[index]
            prompt, description = (text.format(object=label) for text in texts)
            edit = ProposedEdit(
                type=kind,
                prompt=prompt,
                object=label,
                description=description,
                source="template",
            )
            edits.append(edit)
    return edits


def edits_from_model(
    labels: Sequence[str], images: Images, model: ChatModel
) -> list[ProposedEdit]:
    """Return what the model proposes for a scene whose objects it is told and whose images, if any,
    it sees.

    Raises RunError when its answer holds no usable edit.
    """
    named = ", ".join(labels) or "unknown things"
    request = WORDS["request"].format(labels=named, count=PROPOSALS)
    answer = model.ask(asked_of_model(request, images))
    # Models like to put words around the list.
    start = answer.find("[")
    end = answer.rfind("]") + 1
    try:
        entries = json.loads(answer[start:end])
    except ValueError:
        entries = []
    edits = [_usable_edit(entry, labels, model.name) for entry in entries]
    usable = [edit for edit in edits if edit is not None]
    if not usable:
        raise RunError(
            f"language model {model.name}: no usable edit in its answer: {answer[:200]!r}"
        )
    return usable


def _usable_edit(
    entry: object, labels: Sequence[str], source: str
) -> ProposedEdit | None:
    """Return None for an entry that is not an edit of this scene."""
    if not isinstance(entry, dict):
        return None
    keys = ("type", "prompt", "object", "description")
    texts = {key: " ".join(str(entry.get(key) or "").split()) for key in keys}
    texts["type"] = texts["type"].capitalize()
    texts["object"] = texts["object"].lower()
    if texts["type"] in LOCAL and texts["object"] not in labels:
        return None
    if texts["type"] == "Global":
        texts["object"] = ""
    try:
        return ProposedEdit(**texts, source=source)
    except ValidationError:
        return None


def without_near_duplicates(edits: Iterable[ProposedEdit]) -> list[ProposedEdit]:
    """Return the edits in order, without those whose prompt has the words of one before.

    Order, case, plural s and words that carry nothing do not count. It knows no meaning: "red" and
    "crimson" stay two prompts, of which a person may drop one in the vetting file.
    """
    kept: dict[frozenset[str], ProposedEdit] = {}
    for edit in edits:
        words = re.findall(r"[^\W_]+", edit.prompt.lower())
        plain = {word.removesuffix("s") if len(word) > 3 else word for word in words}
        kept.setdefault(frozenset(plain - set(WORDS["fillers"])), edit)
    return list(kept.values())


# ---- a person's verdicts ----


def write_vetting(path: Path, proposed: Mapping[str, Sequence[ProposedEdit]]) -> None:
    """Write the proposals of every scene as YAML that a person edits."""
    scenes = {}
    for scene, edits in proposed.items():
        scenes[scene] = [edit.model_dump(exclude={"masks"}) for edit in edits]
    content = {"scenes": scenes}
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=110)
    write_text(path, WORDS["vetting_head"] + text)


class _Vetting(Settings):
    scenes: dict[str, list[ProposedEdit]]


def read_vetting(path: Path) -> dict[str, list[ProposedEdit]]:
    """Edits by scene. Raises an error that names scene and entry where one cannot be read."""
    return make_settings(_Vetting, read_yaml(path), where=path.name).scenes


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
        raise InputError(
            f"scene {scene!r}: only {len(kept)} edits are left, expected {EDITS_PER_SCENE}; drop "
            "fewer, or add some."
        )
    return sorted(kept, key=lambda edit: EDIT_TYPES.index(edit.type))
