"""Which regions are recoloured: the paper's filter of proposals, tracks through the views, and the
marked object.
"""

from collections import Counter
from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from pydantic import Field, field_validator
from torch import Tensor

from edit3r.contract.interfaces import Tracks
from edit3r.contract.settings import Settings
from edit3r.kit.segmenting import AutomaticMask

FAINT = 0.01
"""A sigmoid never reaches 0; below this a pixel is outside and keeps its exact value.
No figure kept.
"""


class ProposalFilter(Settings):
    """The paper's five criteria of a region (section 3.2).

    The paper gives its thresholds in an appendix that is not public; these defaults are this
    project's own. They let through what `grabcut` cuts out, which cannot tell how good it is; with
    a SAM raise them (0.92 and 0.85 are usual for it).
    """

    min_area: float = Field(0.01, ge=0, le=1)
    """least share of the first picture"""
    min_stability: float = Field(0.8, ge=0, le=1)
    """least overlap of the mask under two thresholds"""
    min_predicted_iou: float = Field(0.4, ge=0, le=1)
    """least quality that the mask believes it has"""
    aspect: tuple[float, float] = (0.2, 5.0)
    """least and most width / height of the box"""
    margin: int = Field(2, ge=0)
    """least distance of the box to the border [pixels]"""

    @field_validator("aspect")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not 0 < value[0] <= value[1]:
            raise ValueError("expected [least, most] with 0 < least <= most")
        return value

    def objection(
        self, proposal: AutomaticMask, image_size: tuple[int, int]
    ) -> str | None:
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
    proposals: Sequence[AutomaticMask],
    image_size: tuple[int, int],
    criteria: ProposalFilter,
) -> tuple[list[AutomaticMask], dict[str, int]]:
    """Those that pass, in order, and how many failed each criterion (their first)."""
    objections = [criteria.objection(proposal, image_size) for proposal in proposals]
    kept = [one for one, objection in zip(proposals, objections) if objection is None]
    failed = [objection for objection in objections if objection is not None]
    return kept, dict(Counter(failed))


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
    """Foreground probabilities of logits; 0 where faint, and in views without the object."""
    masks = tracks.logits.sigmoid() * active_objects(tracks)[..., None, None]
    return torch.where(masks < FAINT, 0, masks).transpose(0, 1)


def tracks_of_masks(masks: Float[Tensor, "object view height width"]) -> Tracks:
    """Turn the data's own masks in [0, 1] into tracks; `soft_masks` gives them back to 8 bits."""
    present = (masks > 0.5).flatten(2).any(2).T
    return Tracks(masks.transpose(0, 1).logit(1e-3), present)


def proposals_of_masks(
    masks: Float[Tensor, "object height width"],
) -> list[AutomaticMask]:
    """The data's own masks of the first view as proposals: stable and sure, as given."""
    return [AutomaticMask(mask) for mask in masks]
