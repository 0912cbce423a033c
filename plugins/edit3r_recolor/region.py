"""Where a recolouring applies: given masks, a marked object, the most salient object, or the whole picture."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r import reporting
from edit3r.errors import InputError
from edit3r.interfaces import Proposal, Segmenter
from edit3r.stage_checks import component_name
from edit3r_recolor.tracked_regions import soft_masks
from edit3r_recolor.wish import Wish

Box = tuple[float, float, float, float]
ADVICE = "mark it with --mask, editor.point=[x,y] or editor.box=[x,y,w,h] to be sure"


@dataclass(frozen=True)
class Region:
    """Soft masks of one region in every view of a scene, and how it was found."""

    masks: Float[Tensor, "view height width"]  # in [0, 1]
    source: str  # "masks", "point", "box", "everything", "named object", "most salient object" or "background"


def choose_region(
    images: Float[Tensor, "view 3 height width"],
    given: Float[Tensor, "view height width"] | None,
    wish: Wish,
    segmenter: Segmenter,
    point: tuple[float, float] | None = None,
    box: Box | None = None,
) -> Region:
    """Given masks first, then a point or box on view 0 (normalised), then what the wish says."""
    if given is not None:
        return Region(given.to(images), "masks")
    marked = point is not None or box is not None
    if wish.scope == "everything" and not marked:
        return Region(torch.ones_like(images[:, 0]), "everything")
    if marked:
        first = segmenter.segment(images[0], [point] if point is not None else (), box)
        how = "point" if point is not None else "box"
    else:
        first, how = _object(images[0], wish, segmenter)
    masks = _follow(images, first, segmenter)
    return Region(1 - masks, f"all but the {how}") if wish.scope == "background" else Region(masks, how)


def _object(image: Float[Tensor, "3 height width"], wish: Wish, segmenter: Segmenter) -> tuple[Proposal, str]:
    """The object on view 0 and how it was found: by its name where the segmenter reads text, else by salience."""
    prompt = getattr(getattr(segmenter, "settings", None), "prompt", "")
    named = prompt or " ".join(wish.subject)
    found = segmenter.segment_text(image, named) if named else None
    if found:
        return found[0], "named object"
    if found is not None:
        raise InputError(f"{named!r} was not found on the first view; use other words, or {ADVICE}.")
    proposals = segmenter.propose(image)
    if not proposals:
        raise InputError(f"No object stands out on the first view; {ADVICE}.")
    why = (
        f"Segmenter {component_name(segmenter)!r} does not understand {named!r}"
        if named
        else "No object is named or marked"
    )
    reporting.warn(f"{why}: the most salient object is taken, which is a guess; {ADVICE}.")
    return proposals[0], "most salient object"


def _follow(
    images: Float[Tensor, "view 3 height width"], first: Proposal, segmenter: Segmenter
) -> Float[Tensor, "view height width"]:
    """The object of view 0 in all views; zero, with a warning, where it is lost."""
    if len(images) == 1:
        return first.soft_mask[None].to(images)
    tracks = segmenter.track(images, first.soft_mask[None].to(images))
    lost = [str(view + 1) for view in range(len(images)) if not bool(tracks.present[view, 0])]
    if lost:
        reporting.warn(f"The object was not found again in view {', '.join(lost)}; it keeps its colours there.")
    masks = soft_masks(tracks)[0].to(images)
    masks[0] = first.soft_mask.to(images)
    return masks
