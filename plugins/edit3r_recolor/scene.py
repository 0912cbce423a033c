"""SAM2-style recolouring of a multi-view set (section 3.2): find objects, follow them, recolour region by region.

first photo --> proposals --> five criteria --> tracks --> views that show the same objects --> one colour transform a
region, drawn once --> soft blend in every view
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from edit3r.config import Settings
from edit3r.errors import InputError
from edit3r.interfaces import Proposal, Segmenter, Tracks
from edit3r.reporting import progress, track
from edit3r_recolor.augmentation import Fault, draw_outline, perturbed, with_outline
from edit3r_recolor.parameters import RecolorParameters, RecolorRanges
from edit3r_recolor.proposal_filter import ProposalFilter, kept_proposals
from edit3r_recolor.recipe import RegionRecipe, SceneRecipe, ViewRecipe
from edit3r_recolor.recoloring import recolored, visible_parameters
from edit3r_recolor.tracked_regions import (
    active_objects,
    overlap_ratio,
    processed_views,
    proposals_of_masks,
    soft_masks,
    tracks_of_masks,
)

Images = Float[Tensor, "view 3 height width"]
Masks = Float[Tensor, "object view height width"]


class RecoloringSettings(Settings):
    """How scenes are recoloured."""

    filter: ProposalFilter = Field(ProposalFilter(), description="which proposals become regions")
    max_objects: int = Field(8, ge=1, le=200, description="how many regions at most, the most salient ones")
    least_overlap: float = Field(
        0.5, ge=0, le=1, description="a view whose objects overlap less with the last used view's is left out"
    )
    ranges: RecolorRanges = Field(RecolorRanges(), description="how strongly colours change")
    least_change: float = Field(0.08, ge=0, le=1, description="least mean change of a region, where it can be had")
    mask_jitter: float = Field(0.5, ge=0, le=1, description="augmented: share of outlines grown, shrunk or leaking")
    palette_jitter: float = Field(0.5, ge=0, le=1, description="augmented: share of regions with colours a bit off")


@dataclass(frozen=True)
class FoundRegions:
    """Objects of a scene that passed the filter, in all views."""

    proposals: tuple[Proposal, ...]
    masks: Masks  # soft, in steps of 1/255, so that they survive a PNG file
    active: Bool[Tensor, "view object"]  # O_v
    rejected: dict[str, int]  # proposals that failed each criterion


def find_regions(images: Images, segmenter: Segmenter, settings: RecoloringSettings) -> FoundRegions:
    """Proposals on the first view, filtered, followed through the others. Raises InputError when none passes."""
    progress("find objects", 0, 2)
    chosen, rejected = _choose(segmenter.propose(images[0]), images.shape[-2:], settings)
    progress("find objects", 1, 2)
    tracks = segmenter.track(images, torch.stack([proposal.soft_mask for proposal in chosen]).to(images))
    progress("find objects", 2, 2)
    return _found(chosen, tracks, rejected)


def given_regions(masks: Masks, settings: RecoloringSettings) -> FoundRegions:
    """The data's own masks under the same criteria. Raises InputError when none passes."""
    proposals = proposals_of_masks(masks[:, 0])
    chosen, rejected = _choose(proposals, masks.shape[-2:], settings)
    index = [number for number, proposal in enumerate(proposals) if any(proposal is other for other in chosen)]
    return _found(chosen, tracks_of_masks(masks[index]), rejected)


def make_recipe(
    images: Images, names: Sequence[str], found: FoundRegions, settings: RecoloringSettings, seed: int, source: str
) -> SceneRecipe:
    """Draw the parameters of every region, and what augmented pictures get wrong, from `seed` alone."""
    used = processed_views(found.active, settings.least_overlap)
    regions = []
    for number, proposal in enumerate(found.proposals, start=1):
        rng = np.random.default_rng((seed, number))
        masks = found.masks[number - 1, used]
        parameters = visible_parameters(rng, images[used], masks, settings.least_change, ranges=settings.ranges)
        fields = (proposal.area, proposal.stability, proposal.predicted_iou, proposal.box)
        regions.append(RegionRecipe(number, parameters, *fields))
    views = tuple(_view_recipe(view, name, found, used, regions, settings, seed) for view, name in enumerate(names))
    return SceneRecipe(seed, source, tuple(regions), views, found.rejected)


def carry_out(images: Images, masks: Masks, recipe: SceneRecipe) -> Images:
    """The processed views, recoloured alike."""
    parameters = [region.parameters for region in recipe.regions]
    return _each_view(recipe, "recolour", lambda view: recolored(images[[view]], masks[:, [view]], parameters)[0])


def carry_out_with_faults(images: Images, masks: Masks, recipe: SceneRecipe) -> Images:
    """The processed views as a 2D editor might have returned them: the same edit, with every view's faults."""

    def augmented(view: int) -> Tensor:
        faults = [recipe.views[view].faults.get(region.id, Fault()) for region in recipe.regions]
        own = torch.stack([with_outline(mask, fault.outline) for mask, fault in zip(masks[:, view], faults)])
        parameters = [fault.parameters or region.parameters for region, fault in zip(recipe.regions, faults)]
        return recolored(images[[view]], own[:, None], parameters)[0]

    return _each_view(recipe, "augment", augmented)


def _each_view(recipe: SceneRecipe, text: str, picture) -> Images:
    return torch.stack([picture(view) for view in track(recipe.processed, text)])


def _choose(
    proposals: Sequence[Proposal], image_size: tuple[int, int], settings: RecoloringSettings
) -> tuple[list[Proposal], dict[str, int]]:
    kept, rejected = kept_proposals(proposals, tuple(image_size), settings.filter)
    if not kept:
        why = ", ".join(f"{name} {count}" for name, count in rejected.items()) or "there are none"
        raise InputError(
            f"First view: none of {len(proposals)} proposals passes the filter ({why}); loosen it, for example with "
            "--set filter.min_area=0.005 or --set filter.margin=0, or give --masks."
        )
    return kept[: settings.max_objects], rejected


def _found(proposals: Sequence[Proposal], tracks: Tracks, rejected: dict[str, int]) -> FoundRegions:
    masks = (soft_masks(tracks) * 255).round() / 255
    return FoundRegions(tuple(proposals), masks, active_objects(tracks), rejected)


def _view_recipe(
    view: int,
    name: str,
    found: FoundRegions,
    used: list[int],
    regions: Sequence[RegionRecipe],
    settings: RecoloringSettings,
    seed: int,
) -> ViewRecipe:
    before = max([other for other in used if other < view], default=view)
    shown = [region for region, here in zip(regions, found.active[view].tolist()) if here]
    faults = {region.id: _fault(region.parameters, settings, (seed, region.id, view)) for region in shown}
    return ViewRecipe(
        name,
        tuple(region.id for region in shown),
        overlap_ratio(found.active[view], found.active[before]),
        view in used,
        {number: fault for number, fault in faults.items() if fault != Fault() and view in used},
    )


def _fault(parameters: RecolorParameters, settings: RecoloringSettings, seed: tuple[int, int, int]) -> Fault:
    rng = np.random.default_rng(seed)
    outline = draw_outline(rng) if rng.random() < settings.mask_jitter else "exact"
    return Fault(outline, perturbed(parameters, rng) if rng.random() < settings.palette_jitter else None)
