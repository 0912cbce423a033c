"""Masks around what a prompt is about, found on view 0 and followed by a segmenter that reads
words.
"""

import re

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Segmenter
from edit3r.contract.types import Views
from edit3r.geometry.maps import dilate_softly
from edit3r.reporting import note, warn
from edit3r.selection.select import Selection, select_masks

_DETERMINERS = "the|this|that|these|those|my|our|your|his|her|its|their"
_ENDS = (
    "to|into|in|on|at|with|of|for|from|as|and|or|so|look|looks|like|appear|become|becomes|be|is|are|wear|wearing|have|should|must|"
    "red|orange|yellow|green|blue|purple|violet|pink|brown|black|white|grey|gray|gold|golden|silver|more|less|bright|"
    "brighter|dark|darker"
)
_OBJECT = re.compile(
    rf"\b(?:{_DETERMINERS})\s+((?:(?!(?:{_ENDS})\b)[\w'-]+\s*){{1,4}})", re.IGNORECASE
)
_WHOLE = re.compile(
    r"\b(picture|image|photo|scene|everything|whole|view|style|background)\b",
    re.IGNORECASE,
)
_ADDS = re.compile(r"^\s*(?:please\s+)?(?:add|insert|place|put)\b", re.IGNORECASE)
_CLAUSES = re.compile(r"[,.;!?]+|\band\b|\bthen\b|&", re.IGNORECASE)
_KEEPS = re.compile(r"^\s*(?:but\s+)?(?:keep|leave|do not|don't)\b", re.IGNORECASE)
_EXCEPT = re.compile(
    r"\b(?:everything|all|rest)\b.*?\b(?:except|but|besides|apart from|other than)\b",
    re.IGNORECASE,
)


def things_in_prompt(prompt: str) -> tuple[tuple[str, ...], bool]:
    """Return what a prompt changes, such as 'the door' and 'the wall' of 'paint the door green and
    the wall white'.

    True beside it: all but that changes ('everything except the bear'). Nothing, where it changes
    no one thing: additions ('add a dog to the street') and edits of the whole image name nothing
    that could be masked.
    """
    things: dict[str, None] = {}
    excepted = _EXCEPT.search(prompt)
    for clause in _CLAUSES.split(prompt[excepted.end() :] if excepted else prompt):
        found = _OBJECT.search(clause)
        if found is None or _KEEPS.match(clause):
            continue
        if _ADDS.match(clause) or _WHOLE.search(found.group(1)):
            return (), False
        things[f"the {found.group(1).strip()}"] = None
    return tuple(things), bool(excepted and things)


def masks_from_prompt(
    prompt: str, views: Views, segmenter: Segmenter, guess: bool = False
) -> Float[Tensor, "batch view height width"] | None:
    """Find soft masks around what a prompt is about; None, with a warning, when it is about no one
    thing.

    The segmenter is asked for its own `prompt` setting where it has one, else for each of the
    prompt's things. Each mask is 1 on them, falls off within a small margin around them and is
    exactly 0 beyond. Raises InputError for words that it does not know, or does not find, unless a
    `guess` is allowed.
    """
    things, all_but = (
        ((segmenter.prompt,), False) if segmenter.prompt else things_in_prompt(prompt)
    )
    if not things:
        warn(
            "the instruction names no one object, so nothing confines the edit; name it with "
            "segmenter.prompt=..."
        )
        return None
    note("edit.confined_to", ("all but " if all_but else "") + " and ".join(things))
    masks = []
    for scene in views.images:
        found = [
            select_masks(scene, Selection(words=words, guess=guess), segmenter)
            for words in things
        ]
        soft = dilate_softly(
            torch.stack([one.masks[:, 0] > 0.5 for one in found]).any(0).to(scene)
        )
        if all_but:  # a view that lost what is left alone stays as it is
            kept = [
                all(one.how[view] != "not found" for one in found)
                for view in range(views.count)
            ]
            soft = (1 - soft) * torch.tensor(kept).to(scene)[:, None, None]
        masks.append(soft)
    return torch.stack(masks)
