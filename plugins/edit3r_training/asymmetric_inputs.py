"""Which views a training step edits, and what every view should then show: the paper's asymmetric
inputs.

The truth is always the reference view's edit applied to all views (section 3.1: "one recolored
image and another original image"). Other regimes give the other views an edit of their own, as
editors do that disagree with themselves. `generated` takes view-consistent edits that the data
brings, things added and removed included: the reference as edited, the others as they were.
"""

from dataclasses import dataclass

import numpy as np
import torch
from edit3r_editors.api import with_look
from edit3r_recolor.api import (
    draw_outline,
    perturbed,
    recolored,
    visible_parameters,
    with_outline,
)
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import SettingsError
from edit3r.contract.interfaces import SceneSample
from edit3r.contract.settings import NonNegative, Settings, Share

REGIMES = ("reference", "disagreeing", "agreeing", "unedited", "viewwise", "generated")
DISAGREEMENT = 0.5
"""Of mock-diffusion's edits of one scene: how much of each view's look is its own."""
MIN_REGION = 0.015
"""Share of the reference that an edited region covers at least. No figure kept."""

Images = Float[Tensor, "view 3 height width"]


class RegimeShares(Settings):
    """How often each regime is drawn (normalised to sum to 1)."""

    reference: NonNegative = 0.4
    """only the reference view is recoloured, the paper's set-up"""
    disagreeing: NonNegative = 0.3
    """every view is recoloured differently"""
    agreeing: NonNegative = 0.15
    """all views are recoloured alike"""
    unedited: NonNegative = 0.15
    """nothing is recoloured"""
    viewwise: NonNegative = 0.0
    """no recoloring: every image edited on its own, by the data's own edits or else by
    mock-diffusion, and asked for as such
    """
    generated: NonNegative = 0.0
    """no recoloring: only the reference view is edited, and every view should show the data's own
    edits, things added or removed included
    """
    whole_picture: Share = 0.15
    """share of edits that change the whole image"""
    mask_jitter: Share = 0.3
    """share of masks grown, shrunk or leaking a little"""
    palette_jitter: Share = 0.0
    """share of edited images with colours a bit off"""


@dataclass(frozen=True)
class EditedSample:
    """A sample with its edit: V context and T target views."""

    edited: Images  # what the network is given
    truth: Images  # what each context view should show
    target: Images  # what each target view should show
    regime: str
    reshaped: bool = False  # the edit may have added or removed things


def edit_sample(
    sample: SceneSample, shares: RegimeShares, rng: np.random.Generator
) -> EditedSample:
    """Draw a regime and edit the sample; without masks only the whole image can be edited."""
    weights = np.array([getattr(shares, name) for name in REGIMES])
    regime = str(rng.choice(REGIMES, p=weights / weights.sum()))
    photos = torch.cat((sample.context, sample.target))
    views = len(sample.context)
    if regime == "unedited":
        return EditedSample(sample.context, sample.context, sample.target, regime)
    if regime == "viewwise":
        edits = _own_edits(sample, photos, rng)
        return EditedSample(edits[:views], edits[:views], edits[views:], regime)
    if regime == "generated":
        return _generated(sample)
    masks = _regions(sample, shares, rng)

    def parameters() -> list:
        return [visible_parameters(rng, photos, mask) for mask in masks]

    chosen = parameters()
    truth = recolored(photos, masks, chosen)
    edited = [_edited_view(photos[0], masks[:, 0], chosen, shares, rng)]
    for view in range(1, views):
        if regime == "reference":
            edited.append(photos[view])
            continue
        if regime == "disagreeing":
            chosen = parameters()
        own = masks[:, view]
        edited.append(_edited_view(photos[view], own, chosen, shares, rng))
    return EditedSample(torch.stack(edited), truth[:views], truth[views:], regime)


def _generated(sample: SceneSample) -> EditedSample:
    """The data's own edit of the reference, beside the other views as they were; asked of all."""
    if sample.edited_context is None or sample.edited_target is None:
        raise SettingsError(
            "trainer.regimes.generated: the data has no edited views of its own; give some "
            "(train_data.edits of the dataset transforms, train_data.edit of procedural)."
        )
    edits = sample.edited_context
    edited = torch.cat((edits[:1], sample.context[1:]))
    return EditedSample(edited, edits, sample.edited_target, "generated", reshaped=True)


def _own_edits(sample: SceneSample, photos: Images, rng: np.random.Generator) -> Images:
    """What training without recoloring has: images that a 2D editor edited one by one.

    The data's own, else those of mock-diffusion.
    """
    if sample.edited_context is not None and sample.edited_target is not None:
        return torch.cat((sample.edited_context, sample.edited_target))
    seeds = rng.integers(2**31, size=len(photos) + 1)
    first, *others = (torch.Generator().manual_seed(int(seed)) for seed in seeds)
    shared = torch.rand(6, generator=first)
    pairs = zip(photos[:, None], others)
    return torch.cat([with_look(x, shared, own, DISAGREEMENT) for x, own in pairs])


def _regions(
    sample: SceneSample, shares: RegimeShares, rng: np.random.Generator
) -> Float[Tensor, "region view height width"]:
    """Soft masks of one to three regions to edit, over context and target views."""
    count = len(sample.context) + len(sample.target)
    everything = torch.ones(1, count, *sample.context.shape[-2:])
    masks = sample.context_masks
    if masks is None or rng.random() < shares.whole_picture:
        return everything
    if sample.target_masks is not None:
        masks = torch.cat((masks, sample.target_masks), 1)
    visible = np.flatnonzero(masks[:, 0].mean((1, 2)).numpy() > MIN_REGION)
    if len(visible) == 0:
        return everything
    count = min(len(visible), int(rng.choice([1, 2, 3], p=[0.6, 0.25, 0.15])))
    return masks[rng.choice(visible, count, replace=False)]


def _edited_view(
    image: Float[Tensor, "3 height width"],
    masks: Float[Tensor, "region height width"],
    parameters: list,
    shares: RegimeShares,
    rng: np.random.Generator,
) -> Float[Tensor, "3 height width"]:
    """One view as a 2D editor would return it: now and then outlines or colours are off."""
    if rng.random() < shares.mask_jitter:
        masks = with_outline(masks, draw_outline(rng))
    if shares.palette_jitter and rng.random() < shares.palette_jitter:
        parameters = [perturbed(given, rng) for given in parameters]
    return recolored(image[None], masks[:, None], parameters)[0]
