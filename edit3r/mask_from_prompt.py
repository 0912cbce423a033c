"""Masks from words: what an instruction is about, found and followed by a segmenter that understands text."""

import re
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.morphology import dilate_softly
from edit3r.interfaces import Proposal, Segmenter
from edit3r.reporting import note, warn
from edit3r.stage_checks import component_name
from edit3r.types import EditRequest, Views

_DETERMINERS = "the|this|that|these|those|my|our|your|his|her|its|their"
_ENDS = (
    "to|into|in|on|at|with|of|for|from|as|and|or|so|look|looks|like|appear|become|becomes|be|is|are|wear|wearing|have|should|must|"
    "red|orange|yellow|green|blue|purple|violet|pink|brown|black|white|grey|gray|gold|golden|silver|more|less|bright|"
    "brighter|dark|darker"
)
_OBJECT = re.compile(rf"\b(?:{_DETERMINERS})\s+((?:(?!(?:{_ENDS})\b)[\w'-]+\s*){{1,4}})", re.IGNORECASE)
_WHOLE = re.compile(r"\b(picture|image|photo|scene|everything|whole|view|style|background)\b", re.IGNORECASE)
_ADDS = re.compile(r"^\s*(?:please\s+)?(?:add|insert|place|put)\b", re.IGNORECASE)


def object_of(instruction: str) -> str:
    """The thing an instruction changes, such as 'the bike' of 'paint the bike red'; '' when it changes no one thing.

    Additions ('add a dog to the street') and edits of the whole picture name nothing that could be masked.
    """
    found = _OBJECT.search(instruction)
    if found is None or _ADDS.match(instruction) or _WHOLE.search(found.group(1)):
        return ""
    return f"the {found.group(1).strip()}"


def confine(request: EditRequest, views: Views, segmenter: Segmenter) -> EditRequest:
    """The request with masks around what it is about; unchanged, with a warning, when that cannot be found.

    The words are the segmenter's own `prompt` setting where it has one, else the instruction's object.
    """
    words = getattr(segmenter.settings, "prompt", "") or object_of(request.prompt)
    if not words:
        warn("the instruction names no one object, so nothing confines the edit; name it with segmenter.prompt=...")
        return request
    found = [segmenter.segment_text(scene[0], words) for scene in views.images]
    if any(answer is None for answer in found):
        name = component_name(segmenter)
        warn(f"segmenter {name!r} cannot look up {words!r}, so nothing confines the edit; use sam2, or --mask.")
        return request
    if not all(found):
        warn(f"{words!r} was not found on the first photo, so nothing confines the edit; use other words, or --mask.")
        return request
    masks = [_follow(scene, proposals, segmenter) for scene, proposals in zip(views.images, found)]
    note("edit.confined_to", words)
    return replace(request, masks=torch.stack(masks))


def _follow(
    images: Float[Tensor, "view 3 height width"], proposals: tuple[Proposal, ...], segmenter: Segmenter
) -> Float[Tensor, "view height width"]:
    """One mask per view around all the proposals of view 0."""
    first = torch.stack([proposal.soft_mask for proposal in proposals]).to(images)
    if len(images) == 1:
        return dilate_softly((first > 0.5).any(0, keepdim=True).to(images))
    tracks = segmenter.track(images, first)
    inside = ((tracks.logits > 0) & tracks.present[..., None, None]).any(1)
    lost = [view for view in range(len(images)) if not inside[view].any()]
    if lost:
        warn(f"what the instruction names was not found again in views {lost}; they stay unedited.")
    return dilate_softly(inside.to(images))
