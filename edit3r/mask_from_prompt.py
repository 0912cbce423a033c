"""Masks around what a prompt is about, found on view 0 and followed by a segmenter that reads words."""

import re

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.maps import dilate_softly
from edit3r.interfaces import Segmenter
from edit3r.reporting import note, warn
from edit3r.selection import Selection, select_masks
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
    prompt: str, views: Views, segmenter: Segmenter, guess: bool = False
) -> Float[Tensor, "batch view height width"] | None:
    """Find soft masks around what a prompt is about; None, with a warning, when it is about no one thing.

    The segmenter is asked for its own `prompt` setting where it has one, else for the prompt's object. Each mask is 1
    on the object, falls off within a small margin around it and is exactly 0 beyond. Raises InputError for words that
    it does not know, or does not find, unless a `guess` is allowed.
    """
    words = segmenter.prompt or object_in_prompt(prompt)
    if not words:
        warn("the instruction names no one object, so nothing confines the edit; name it with segmenter.prompt=...")
        return None
    found = [select_masks(scene, Selection(words=words, guess=guess), segmenter) for scene in views.images]
    note("edit.confined_to", words)
    return torch.stack([dilate_softly((scene.masks[:, 0] > 0.5).to(scene.masks)) for scene in found])
