"""Masks around what a prompt is about, found on view 0 and followed by a segmenter that reads words."""

import re

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.maps import dilate_softly
from edit3r.interfaces import Proposal, Segmenter
from edit3r.reporting import note, warn
from edit3r.stage_checks import component_name
from edit3r.types import Views

_DETERMINERS = "the|this|that|these|those|my|our|your|his|her|its|their"
_ENDS = (
    "to|into|in|on|at|with|of|for|from|as|and|or|so|look|looks|like|appear|become|becomes|be|is|are|wear|wearing|have|should|must|"
    "red|orange|yellow|green|blue|purple|violet|pink|brown|black|white|grey|gray|gold|golden|silver|more|less|bright|"
    "brighter|dark|darker"
)
_OBJECT = re.compile(rf"\b(?:{_DETERMINERS})\s+((?:(?!(?:{_ENDS})\b)[\w'-]+\s*){{1,4}})", re.IGNORECASE)
_WHOLE = re.compile(r"\b(picture|image|photo|scene|everything|whole|view|style|background)\b", re.IGNORECASE)
_ADDS = re.compile(r"^\s*(?:please\s+)?(?:add|insert|place|put)\b", re.IGNORECASE)


def object_in_prompt(prompt: str) -> str:
    """Return what a prompt changes, such as 'the bike' of 'paint the bike red'; '' when it changes no one thing.

    Additions ('add a dog to the street') and edits of the whole image name nothing that could be masked.
    """
    found = _OBJECT.search(prompt)
    if found is None or _ADDS.match(prompt) or _WHOLE.search(found.group(1)):
        return ""
    return f"the {found.group(1).strip()}"


def masks_from_prompt(
    prompt: str, views: Views, segmenter: Segmenter
) -> Float[Tensor, "batch view height width"] | None:
    """Find soft masks around what a prompt is about; None, with a warning, when that cannot be found.

    The segmenter is asked for its own `prompt` setting where it has one, else for the prompt's object. Each mask is 1
    on the object, falls off within a small margin around it and is exactly 0 beyond.
    """
    words = segmenter.prompt or object_in_prompt(prompt)
    if not words:
        warn("the instruction names no one object, so nothing confines the edit; name it with segmenter.prompt=...")
        return None
    found = [segmenter.segment_text(scene[0], words) for scene in views.images]
    if any(answer is None for answer in found):
        warn(
            f"segmenter {component_name(segmenter)!r} cannot look up {words!r}, so nothing confines the edit; use a "
            "segmenter that reads words (edit3r list-plugins --kind segmenter), or --mask."
        )
        return None
    if not all(found):
        warn(f"{words!r} was not found on the first photo, so nothing confines the edit; use other words, or --mask.")
        return None
    masks = [_follow(scene, proposals, segmenter) for scene, proposals in zip(views.images, found)]
    note("edit.confined_to", words)
    return torch.stack(masks)


def _follow(
    images: Float[Tensor, "view 3 height width"], proposals: tuple[Proposal, ...], segmenter: Segmenter
) -> Float[Tensor, "view height width"]:
    """Follow all the proposals of view 0 together: one mask per view."""
    first = torch.stack([proposal.soft_mask for proposal in proposals]).to(images)
    if len(images) == 1:
        return dilate_softly((first > 0.5).any(0, keepdim=True).to(images))
    tracks = segmenter.track(images, first)
    inside = ((tracks.logits > 0) & tracks.present[..., None, None]).any(1)
    lost = [view for view in range(len(images)) if not inside[view].any()]
    if lost:
        warn(f"what the instruction names was not found again in views {lost}; they stay unedited.")
    return dilate_softly(inside.to(images))
