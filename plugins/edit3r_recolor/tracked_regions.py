"""What following objects through the views says: which are where, which views are used, and their soft masks."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.interfaces import Proposal, Tracks

FAINT = 0.01
"""A sigmoid never reaches 0; below this a pixel is outside and keeps its exact value."""


def active_objects(tracks: Tracks) -> Bool[Tensor, "view object"]:
    """O_v: the objects that a view shows, those with a logit above zero."""
    return tracks.present & (tracks.logits > 0).flatten(2).any(2)


def overlap_ratio(one: Bool[Tensor, "object"], other: Bool[Tensor, "object"]) -> float:
    """|A and B| / max(|A|, |B|) of two sets of objects; 0 when both are empty."""
    return float((one & other).sum() / max(int(one.sum()), int(other.sum()), 1))


def processed_views(active: Bool[Tensor, "view object"], least: float = 0.5) -> list[int]:
    """Views whose objects overlap by at least `least` with those of the most recently processed one; 0 always is.

    Against identity drift (section 3.2): a view that shows other objects is left out of everything that follows.
    """
    chosen = [0]
    for view in range(1, len(active)):
        if overlap_ratio(active[view], active[chosen[-1]]) >= least:
            chosen.append(view)
    return chosen


def soft_masks(tracks: Tracks) -> Float[Tensor, "object view height width"]:
    """Foreground probabilities; exactly 0 where faint, and in views that do not show the object."""
    masks = tracks.logits.sigmoid() * active_objects(tracks)[..., None, None]
    return torch.where(masks < FAINT, 0, masks).transpose(0, 1)


def tracks_of_masks(masks: Float[Tensor, "object view height width"]) -> Tracks:
    """The data's own masks in [0, 1] as tracks; `soft_masks` gives them back to 8 bits."""
    present = (masks > 0.5).flatten(2).any(2).T
    return Tracks(masks.transpose(0, 1).logit(1e-3), present)


def proposals_of_masks(masks: Float[Tensor, "object height width"]) -> list[Proposal]:
    """The data's own masks of the first view as proposals: stable and sure, since they are given."""
    return [Proposal(mask, float((mask > 0.5).float().mean()), 1.0, 1.0, _box(mask > 0.5)) for mask in masks]


def _box(inside: Bool[Tensor, "height width"]) -> tuple[float, float, float, float]:
    if not inside.any():
        return (0.0, 0.0, 0.0, 0.0)
    rows, columns = (torch.nonzero(inside.any(axis)).flatten() for axis in (1, 0))
    left, top = int(columns[0]), int(rows[0])
    return (float(left), float(top), float(int(columns[-1]) + 1 - left), float(int(rows[-1]) + 1 - top))
