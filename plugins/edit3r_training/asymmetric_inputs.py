"""Which views a training step edits, and what every view should then show: the paper's asymmetric
inputs.

The truth is always the reference view's edit applied to all views (section 3.3: "one recolored
image and another original image"). Other regimes give the other views an edit of their own, as
editors do that disagree with themselves.
"""

from dataclasses import dataclass

import numpy as np
import torch
from edit3r_editors.mock_diffusion import with_look
from edit3r_recolor.api import (
    draw_outline,
    perturbed,
    recolored,
    visible_parameters,
    with_outline,
)
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.config import Settings
from edit3r.contract.interfaces import SceneSample


class RegimeShares(Settings):
    """How often each regime is drawn (normalised to sum to 1)."""

    reference: float = Field(
        0.4,
        ge=0,
        description="only the reference view is recoloured, the paper's set-up",
    )
    disagreeing: float = Field(
        0.3, ge=0, description="every view is recoloured differently"
    )
    agreeing: float = Field(0.15, ge=0, description="all views are recoloured alike")
    unedited: float = Field(0.15, ge=0, description="nothing is recoloured")
    viewwise: float = Field(
        0.0,
        ge=0,
        description="no recoloring: every image edited on its own by mock-diffusion and asked "
        "for as such",
    )
    whole_picture: float = Field(
        0.15, ge=0, le=1, description="share of edits that change the whole image"
    )
    mask_jitter: float = Field(
        0.3, ge=0, le=1, description="share of masks grown, shrunk or leaking a little"
    )
    palette_jitter: float = Field(
        0.0, ge=0, le=1, description="share of edited images with colours a bit off"
    )


@dataclass(frozen=True)
class EditedSample:
    """A sample with its edit: V context and T target views."""

    edited: Float[Tensor, "view 3 height width"]  # what the network is given
    truth: Float[Tensor, "view 3 height width"]  # what each context view should show
    target: Float[Tensor, "target 3 height width"]  # what each target view should show
    regime: str


def edit_sample(
    sample: SceneSample, shares: RegimeShares, rng: np.random.Generator
) -> EditedSample:
    """Draw a regime and edit the sample; without masks only the whole image can be edited."""
    names = ("reference", "disagreeing", "agreeing", "unedited", "viewwise")
    weights = np.array([getattr(shares, name) for name in names])
    regime = str(rng.choice(names, p=weights / weights.sum()))
    everything = torch.cat((sample.context, sample.target))
    views = len(sample.context)
    if regime == "unedited":
        return EditedSample(sample.context, sample.context, sample.target, regime)
    if regime == "viewwise":
        images = _edited_one_by_one(everything, rng)
        return EditedSample(images[:views], images[:views], images[views:], regime)
    masks = _regions(sample, shares, rng)
    chosen = [visible_parameters(rng, everything, mask) for mask in masks]
    truth = recolored(everything, masks, chosen)
    edited = [_edited_view(sample.context[0], masks[:, 0], chosen, shares, rng)]
    for view in range(1, views):
        if regime == "reference":
            edited.append(sample.context[view])
            continue
        if regime == "disagreeing":
            chosen = [visible_parameters(rng, everything, mask) for mask in masks]
        edited.append(
            _edited_view(sample.context[view], masks[:, view], chosen, shares, rng)
        )
    return EditedSample(torch.stack(edited), truth[:views], truth[views:], regime)


def _edited_one_by_one(
    images: Float[Tensor, "view 3 height width"],
    rng: np.random.Generator,
    disagreement: float = 0.5,
) -> Float[Tensor, "view 3 height width"]:
    """What training without recoloring has: images of one scene that a 2D editor edited
    independently.
    """
    seeds = rng.integers(2**31, size=len(images) + 1)
    first, *others = (torch.Generator().manual_seed(int(seed)) for seed in seeds)
    shared = torch.rand(6, generator=first)
    return torch.cat(
        [
            with_look(image[None], shared, own, disagreement)
            for image, own in zip(images, others)
        ]
    )


def _regions(
    sample: SceneSample, shares: RegimeShares, rng: np.random.Generator
) -> Float[Tensor, "region view height width"]:
    """Soft masks of one to three regions to edit, over context and target views."""
    shape = (len(sample.context) + len(sample.target), *sample.context.shape[-2:])
    if sample.context_masks is None or rng.random() < shares.whole_picture:
        return torch.ones(1, *shape)
    masks = sample.context_masks
    if sample.target_masks is not None:
        masks = torch.cat((masks, sample.target_masks), 1)
    visible = np.flatnonzero(masks[:, 0].mean((1, 2)).numpy() > 0.015)
    if len(visible) == 0:
        return torch.ones(1, *shape)
    count = min(len(visible), int(rng.choice([1, 2, 3], p=[0.6, 0.25, 0.15])))
    return masks[rng.choice(visible, count, replace=False)]


def _edited_view(
    image: Float[Tensor, "3 height width"],
    masks: Float[Tensor, "region height width"],
    parameters: list,
    shares: RegimeShares,
    rng: np.random.Generator,
) -> Float[Tensor, "3 height width"]:
    """One view as a 2D editor would return it: now and then its outlines or its colours are a
    little off.
    """
    if rng.random() < shares.mask_jitter:
        masks = with_outline(masks, draw_outline(rng))
    if shares.palette_jitter and rng.random() < shares.palette_jitter:
        parameters = [perturbed(given, rng) for given in parameters]
    return recolored(image[None], masks[:, None], parameters)[0]
