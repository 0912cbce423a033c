"""Which regions are recoloured: the paper's filter of proposals, tracks through the views, and the
marked object.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import torch
from jaxtyping import Bool, Float
from pydantic import Field, field_validator
from torch import Tensor

from edit3r.config import Settings
from edit3r.contract.interfaces import Proposal, Segmenter, Tracks
from edit3r.errors import PromptError
from edit3r.selection.select import Selection, select_masks
from edit3r_recolor.prompt import Instruction
from edit3r_recolor.steps import Paint, rgb_to_lab

FAINT = 0.01
"""A sigmoid never reaches 0; below this a pixel is outside and keeps its exact value."""

NEAR = (13.0, 20.0)
"""Colour differences [CIE94, lightness halved, hue by 1.7] up to which a pixel has a colour, and
from which not.
"""


class ProposalFilter(Settings):
    """The paper's five criteria of a region (section 3.2).

    The paper gives its thresholds in an appendix that is not public; these defaults are this
    project's own. They let through what the `classical` segmenter thinks of plain objects, whose
    stability and quality are proxies; with `sam2` raise them (0.92 and 0.85 are usual for it).
    """

    min_area: float = Field(
        0.01, ge=0, le=1, description="least share of the first picture"
    )
    min_stability: float = Field(
        0.8, ge=0, le=1, description="least overlap of the mask under two thresholds"
    )
    min_predicted_iou: float = Field(
        0.4, ge=0, le=1, description="least quality that the mask believes it has"
    )
    aspect: tuple[float, float] = Field(
        (0.2, 5.0), description="least and most width / height of the box"
    )
    margin: int = Field(
        2, ge=0, description="least distance of the box to the border [pixels]"
    )

    @field_validator("aspect")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not 0 < value[0] <= value[1]:
            raise ValueError("expected [least, most] with 0 < least <= most")
        return value

    def objection(self, proposal: Proposal, image_size: tuple[int, int]) -> str | None:
        """Name the first criterion that `proposal` fails on an image of (height, width) pixels;
        None: it is kept.
        """
        x, y, width, height = proposal.box
        margin = min(x, y, image_size[1] - (x + width), image_size[0] - (y + height))
        aspect = width / height if height > 0 else 0.0
        checks = {
            "area": proposal.area >= self.min_area,
            "stability": proposal.stability >= self.min_stability,
            "predicted IoU": proposal.predicted_iou >= self.min_predicted_iou,
            "aspect": self.aspect[0] <= aspect <= self.aspect[1],
            "margin": margin >= self.margin,
        }
        return next((name for name, passed in checks.items() if not passed), None)


def kept_proposals(
    proposals: Sequence[Proposal], image_size: tuple[int, int], criteria: ProposalFilter
) -> tuple[list[Proposal], dict[str, int]]:
    """Return those that pass, in their order, and how many failed each criterion (by the first one
    they fail).
    """
    objections = [criteria.objection(proposal, image_size) for proposal in proposals]
    kept = [
        proposal
        for proposal, objection in zip(proposals, objections)
        if objection is None
    ]
    return kept, dict(
        Counter(objection for objection in objections if objection is not None)
    )


def active_objects(tracks: Tracks) -> Bool[Tensor, "view object"]:
    """O_v: the objects that a view shows, those with a logit above zero."""
    return tracks.present & (tracks.logits > 0).flatten(2).any(2)


def overlap_ratio(one: Bool[Tensor, "object"], other: Bool[Tensor, "object"]) -> float:
    """Compute |A and B| / max(|A|, |B|) of two sets of objects; 0 when both are empty."""
    return float((one & other).sum() / max(int(one.sum()), int(other.sum()), 1))


def processed_views(
    active: Bool[Tensor, "view object"], least: float = 0.5
) -> list[int]:
    """List the views whose objects overlap by at least `least` with the most recently processed
    one's, from view 0.

    Against identity drift (section 3.2): a view that shows other objects is left out of everything
    that follows.
    """
    chosen = [0]
    for view in range(1, len(active)):
        if overlap_ratio(active[view], active[chosen[-1]]) >= least:
            chosen.append(view)
    return chosen


def soft_masks(tracks: Tracks) -> Float[Tensor, "object view height width"]:
    """Turn logits into foreground probabilities; exactly 0 where faint, and in views that do not
    show the object.
    """
    masks = tracks.logits.sigmoid() * active_objects(tracks)[..., None, None]
    return torch.where(masks < FAINT, 0, masks).transpose(0, 1)


def tracks_of_masks(masks: Float[Tensor, "object view height width"]) -> Tracks:
    """Turn the data's own masks in [0, 1] into tracks; `soft_masks` gives them back to 8 bits."""
    present = (masks > 0.5).flatten(2).any(2).T
    return Tracks(masks.transpose(0, 1).logit(1e-3), present)


def proposals_of_masks(masks: Float[Tensor, "object height width"]) -> list[Proposal]:
    """Turn the data's own masks of the first view into proposals: stable and sure, since they are
    given.
    """
    inside = [mask > 0.5 for mask in masks]
    boxes = [
        tuple(map(float, cv2.boundingRect(one.byte().cpu().numpy()))) for one in inside
    ]
    return [
        Proposal(mask, float(i.float().mean()), 1.0, 1.0, box)
        for mask, i, box in zip(masks, inside, boxes)
    ]


@dataclass(frozen=True)
class Region:
    """Soft masks of one region in every view of a scene, and how it was found."""

    masks: Float[Tensor, "view height width"]  # in [0, 1]
    # "masks", "point", "box", "everything", "named object", "most salient object", "all but the
    # ..."
    source: str


def choose_region(
    images: Float[Tensor, "view 3 height width"],
    given: Float[Tensor, "view height width"] | None,
    instruction: Instruction,
    segmenter: Segmenter,
    marks: Selection,
) -> Region:
    """Take the given masks, else the marks (a point or box), else what the instruction says,
    whatever its colours.

    `marks.guess` allows the most salient object where the segmenter cannot look up what the
    instruction names.
    """
    if given is not None:
        return Region(given.to(images), "masks")
    if instruction.scope == "everything" and not marks.views:
        return Region(torch.ones_like(images[:, 0]), "everything")
    words = segmenter.prompt or (
        "background"
        if instruction.scope == "background"
        else " ".join(instruction.subject)
    )
    selected = select_masks(images, replace(marks, words=words), segmenter)
    found = {"words": "named object", "guess": "most salient object"}
    how = found.get(selected.how[0], "point" if marks.positive else "box")
    masks = selected.masks[:, 0]
    if instruction.scope == "all but" or (
        instruction.scope == "background" and how != "named object"
    ):
        seen = torch.tensor([how != "not found" for how in selected.how]).to(
            masks
        )  # a view without it stays as it is
        return Region((1 - masks) * seen[:, None, None], f"all but the {how}")
    return Region(masks, how)


def only_near(
    region: Region, images: Float[Tensor, "view 3 height width"], colour: Paint | None
) -> Region:
    """The part of a region that has a colour, by its named sRGB; None: all of it. Raises
    PromptError for no part.

    By CIE94 around the named colour, which allows the more difference in chroma the more chroma the
    name has, as things are duller than the names of their colours; but a fifth of that chroma there
    must be: grey is never red.
    """
    if colour is None:
        return region
    from kornia.filters import median_blur
    from skimage.color import deltaE_ciede94

    lab = rgb_to_lab(median_blur(images, 3)).movedim(1, -1).double()
    named = rgb_to_lab(lab.new_tensor(colour.rgb)[:, None, None]).movedim(0, -1)
    distance = torch.from_numpy(
        deltaE_ciede94(named.numpy(force=True), lab.numpy(force=True), kL=2, kH=0.6)
    )
    near = ((NEAR[1] - distance) / (NEAR[1] - NEAR[0])).clamp(0, 1).to(images)
    chroma, least = lab[..., 1:].norm(dim=-1), 0.2 * named[..., 1:].norm()
    masks = (
        region.masks
        * near
        * (4 * (chroma - least) / least.clamp(min=4) + 1).clamp(0, 1).to(images)
    )
    if not masks.any():
        raise PromptError(
            f"nothing there is near {colour.colour}, so nothing would change; name the colour it "
            "has."
        )
    return Region(masks, f"{region.source}, {colour.colour}")
