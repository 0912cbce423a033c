"""SAM2-style recolouring of a multi-view set (section 3.2): find objects, follow them, recolour
region by region.

first photo --> proposals --> five criteria --> tracks --> views that show the same objects --> one
colour transform a region, drawn once --> soft blend in every view
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from torch import Tensor

from edit3r import Views, default_registry
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import PixelBox, Segmenter, Selection, Tracks
from edit3r.contract.reporting import progress, track
from edit3r.contract.settings import Settings
from edit3r.kit import asking
from edit3r.kit.cache import Cache, using
from edit3r.kit.command.results import write_json
from edit3r.kit.files.text import parse_json
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.segmenting import AutomaticMask, automatic_masks
from edit3r.running import default_matcher, select_with, usual_selector
from edit3r_recolor import recoloring
from edit3r_recolor.recoloring import Outline, RecolorParameters, RecolorRanges
from edit3r_recolor.regions import (
    ProposalFilter,
    active_objects,
    kept_proposals,
    overlap_ratio,
    processed_views,
    proposals_of_masks,
    soft_masks,
    tracks_of_masks,
)

FORMAT = "edit3r recolor 1"
_NO_UNKNOWN_KEYS = ConfigDict(extra="forbid")

Images = Float[Tensor, "view 3 height width"]
Masks = Float[Tensor, "object view height width"]


class RecoloringSettings(Settings):
    """How scenes are recoloured."""

    filter: ProposalFilter = ProposalFilter()
    """which proposals become regions"""
    max_objects: int = Field(8, ge=1, le=200)
    """how many regions at most, the most salient ones"""
    points_per_side: int = Field(6, ge=1, le=128)
    """grid of clicks that finds the regions; SAM 2's own has 32, and takes minutes on a CPU"""
    least_overlap: float = Field(0.5, ge=0, le=1)
    """a view whose objects overlap less with the last used view's is left out"""
    ranges: RecolorRanges = RecolorRanges()
    """how strongly colours change"""
    least_change: float = Field(0.08, ge=0, le=1)
    """least mean change of a region, where it can be had"""
    mask_jitter: float = Field(0.5, ge=0, le=1)
    """augmented: share of outlines grown, shrunk or leaking"""
    palette_jitter: float = Field(0.5, ge=0, le=1)
    """augmented: share of regions with colours a bit off"""


@dataclass(frozen=True)
class Fault:
    """What an augmented image gets wrong with one region in one view."""

    outline: Outline = "exact"
    # the region's colours in this view; None: as they should be
    parameters: RecolorParameters | None = None
    __pydantic_config__ = _NO_UNKNOWN_KEYS


@dataclass(frozen=True)
class RegionRecipe:
    """One object, its colour transform, and what its proposal said of it."""

    id: int  # persistent: the same object in every view, from 1
    parameters: RecolorParameters
    area: float  # share of the first view
    stability: float
    predicted_iou: float
    box: PixelBox  # on the first view
    __pydantic_config__ = _NO_UNKNOWN_KEYS


@dataclass(frozen=True)
class ViewRecipe:
    """One photo: the objects it shows and whether it was used."""

    name: str
    objects: tuple[int, ...]  # ids
    overlap: float  # of its objects with those of the most recently processed view
    processed: bool  # False: too different, left out
    # by id; what its augmented image gets wrong
    faults: dict[int, Fault] = field(default_factory=dict)
    __pydantic_config__ = _NO_UNKNOWN_KEYS


@dataclass(frozen=True)
class SceneRecipe:
    """How a scene was recoloured: enough to do it again, on the same photos at any size."""

    seed: int
    masks: str  # where they came from, such as "segmenter auto"
    regions: tuple[RegionRecipe, ...]
    views: tuple[ViewRecipe, ...]
    # proposals that failed each criterion
    rejected: dict[str, int] = field(default_factory=dict)
    __pydantic_config__ = _NO_UNKNOWN_KEYS

    @property
    def processed(self) -> list[int]:
        """Indices of the views in use."""
        return [index for index, view in enumerate(self.views) if view.processed]

    def save(self, path: Path) -> None:
        """Write as JSON; floats survive exactly."""
        write_json(path, {"format": FORMAT, **asdict(self)})

    @staticmethod
    def load(path: Path) -> "SceneRecipe":
        """Read what `save` wrote. Raises InputError for any other file."""
        try:
            data = parse_json(path.read_bytes())
            if data.pop("format") != FORMAT:
                raise ValueError(f"its format is not {FORMAT!r}")
            return TypeAdapter(SceneRecipe).validate_python(data)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}).") from None
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            reason: object = error
            if isinstance(error, ValidationError):
                first = error.errors()[0]
                reason = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
            raise InputError(
                f"{path}: not a recipe that `edit3r recolor` wrote ({reason})."
            ) from None


@dataclass(frozen=True)
class FoundRegions:
    """Objects of a scene that passed the filter, in all views."""

    proposals: tuple[AutomaticMask, ...]
    masks: Masks  # soft, in steps of 1/255, so that they survive a PNG file
    active: Bool[Tensor, "view object"]  # O_v
    rejected: dict[str, int]  # proposals that failed each criterion


def find_regions(
    views: Views, segmenter: Segmenter, settings: RecoloringSettings
) -> FoundRegions:
    """The first view's proposals, filtered and followed. Raises InputError when none passes."""
    images = views.images[0]
    progress("find objects", 0, 2)
    proposals = automatic_masks(segmenter, images[0], settings.points_per_side)
    chosen, rejected = _choose(proposals, size_of(images), settings)
    progress("find objects", 1, 2)
    masks = torch.stack([proposal.soft_mask for proposal in chosen]).to(images)
    tracks = asking.track(segmenter, images, masks) or _carried(views, masks, segmenter)
    progress("find objects", 2, 2)
    return _found(chosen, tracks, rejected)


def _carried(views: Views, masks: Images, segmenter: Segmenter) -> Tracks:
    """Where geometry says that the objects of the first view lie on the others."""
    matcher, selector = default_matcher(default_registry()), usual_selector(segmenter)
    with using(Cache()):
        found = [
            select_with(views, Selection(masks={0: mask}), selector, matcher).masks[0]
            for mask in masks
        ]
    return tracks_of_masks(torch.stack(found))


def given_regions(masks: Masks, settings: RecoloringSettings) -> FoundRegions:
    """Take the data's own masks under the same criteria. Raises InputError when none passes."""
    proposals = proposals_of_masks(masks[:, 0])
    chosen, rejected = _choose(proposals, size_of(masks), settings)
    taken = {id(proposal) for proposal in chosen}
    index = [number for number, one in enumerate(proposals) if id(one) in taken]
    return _found(chosen, tracks_of_masks(masks[index]), rejected)


def _choose(
    proposals: Sequence[AutomaticMask],
    image_size: tuple[int, int],
    settings: RecoloringSettings,
) -> tuple[list[AutomaticMask], dict[str, int]]:
    kept, rejected = kept_proposals(proposals, image_size, settings.filter)
    if not kept:
        failed = [f"{name} {count}" for name, count in rejected.items()]
        why = ", ".join(failed) or "there are none"
        raise InputError(
            f"First view: none of {len(proposals)} proposals passes the filter ({why}); loosen "
            "it, for example with "
            "--set filter.min_area=0.005 or --set filter.margin=0, or give --masks."
        )
    return kept[: settings.max_objects], rejected


def _found(
    proposals: Sequence[AutomaticMask], tracks: Tracks, rejected: dict[str, int]
) -> FoundRegions:
    masks = (soft_masks(tracks) * 255).round() / 255
    return FoundRegions(tuple(proposals), masks, active_objects(tracks), rejected)


def make_recipe(
    images: Images,
    names: Sequence[str],
    regions_found: FoundRegions,
    settings: RecoloringSettings,
    seed: int,
    source: str,
) -> SceneRecipe:
    """Parameters of every region, and what augmented images get wrong, from `seed` alone."""
    used = processed_views(regions_found.active, settings.least_overlap)
    regions = []
    for number, proposal in enumerate(regions_found.proposals, start=1):
        rng = np.random.default_rng((seed, number))
        masks, least = regions_found.masks[number - 1, used], settings.least_change
        parameters = recoloring.visible_parameters(
            rng, images[used], masks, least, ranges=settings.ranges
        )
        facts = proposal.area, proposal.stability, proposal.predicted_iou, proposal.box
        regions.append(RegionRecipe(number, parameters, *facts))
    views = []
    for view, name in enumerate(names):
        before = max([other for other in used if other < view], default=view)
        overlap = overlap_ratio(
            regions_found.active[view], regions_found.active[before]
        )
        here = regions_found.active[view].tolist()
        shown = [region for region, is_here in zip(regions, here) if is_here]
        faults = _draw_faults(view, shown, settings, seed) if view in used else {}
        ids = tuple(region.id for region in shown)
        views.append(ViewRecipe(name, ids, overlap, view in used, faults))
    return SceneRecipe(
        seed, source, tuple(regions), tuple(views), regions_found.rejected
    )


def _draw_faults(
    view: int, shown: Sequence[RegionRecipe], settings: RecoloringSettings, seed: int
) -> dict[int, Fault]:
    """Faults of the regions that one view shows, by their ids, where there are any."""
    faults = {}
    for region in shown:
        rng = np.random.default_rng((seed, region.id, view))
        is_jittered = rng.random() < settings.mask_jitter
        outline = recoloring.draw_outline(rng) if is_jittered else "exact"
        is_off = rng.random() < settings.palette_jitter
        other = recoloring.perturbed(region.parameters, rng) if is_off else None
        faults[region.id] = Fault(outline, other)
    return {number: fault for number, fault in faults.items() if fault != Fault()}


def carry_out(
    images: Images, masks: Masks, recipe: SceneRecipe, with_faults: bool = False
) -> Images:
    """Recolour the processed views; `with_faults` each as a 2D editor might, with its own."""
    views = []
    for view in track(recipe.processed, "augment" if with_faults else "recolour"):
        known = recipe.views[view].faults if with_faults else {}
        faults = [known.get(region.id, Fault()) for region in recipe.regions]
        outlines = [fault.outline for fault in faults]
        own = torch.stack(
            [recoloring.with_outline(*one) for one in zip(masks[:, view], outlines)]
        )
        parameters = [
            fault.parameters or region.parameters
            for region, fault in zip(recipe.regions, faults)
        ]
        views.append(recoloring.recolored(images[[view]], own[:, None], parameters)[0])
    return torch.stack(views)
