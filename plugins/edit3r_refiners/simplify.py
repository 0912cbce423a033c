"""Leave only the Gaussians that a scene requires: drop what no view needs, merge what is flat,
polish what is left.
"""

from dataclasses import dataclass
from math import inf, log10
from typing import Any

import torch
from pydantic import Field, field_validator

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Rasterizer, RefineInputs, Refiner
from edit3r.contract.reporting import note
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.compute.layers import one_thread
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.photos.images import evenly
from edit3r_refiners.importance import (
    drop_unneeded_harmonics,
    first_focal,
    viewpoints,
    visible_weight,
)
from edit3r_refiners.merging import (
    Placement,
    Region,
    duplicates,
    merge_groups,
    own_pixel_inside,
    place,
)
from edit3r_refiners.partition import (
    measure_cells,
    partition,
    price_for_count,
    scene_price,
)
from edit3r_refiners.refine import RefineSettings, refine
from edit3r_refiners.settings import Budget, SimplifySettings, parse_budget, passes

# The numbers of this block: no figures kept.
# Smaller steps than towards photos: the scene is nearly what it should show.
# merged Gaussians may grow to close what is left between them
POLISH = RefineSettings(
    colour=0.015, opacity=0.08, scale=0.08, centre=0.04, growth=1000, recolouring=1000
)
# drop a Gaussian whose blending weight sums to less over the pictures [pixels]
CONTRIBUTION = 0.02
# change of a pixel up to which harmonics of higher degrees are dropped
TOLERANCE = 1 / 255
TELLING_VIEWS = 3  # that tell what simplifying lost, where there are more
# how far new views of a lone photo are taken to be [its median depth]
LONE_BASELINE = 0.1


class SimplifyRefiner(Refiner):
    """Keeps only the Gaussians that the scene requires, or at most a number of them."""

    class Settings(SimplifySettings):
        gaussians: Budget = "auto"
        """all, auto (only what the scene requires), or the most there may be"""
        max_gaussians: int | None = Field(None, ge=1)
        """never leave more than this"""

        @field_validator("gaussians", mode="before")
        @classmethod
        def _parse_gaussians(cls, value: Any) -> Budget:
            return parse_budget(value)

    settings: Settings

    def __call__(self, gaussians: Gaussians, inputs: RefineInputs) -> Gaussians:
        """Simplify to the wanted number, and once more where `max_gaussians` asks for fewer.

        A part of the scene that is to be exchanged afterwards stays fine, so that it fits up to its
        border.
        """
        fine = None
        if inputs.before is not None and inputs.masks is not None and inputs.confined:
            fine = inputs.masks[0] > 0
        for most in passes(self.settings.gaussians, self.settings.max_gaussians):
            gaussians = simplify(
                gaussians, inputs.cameras, inputs.rasterizer, most, self.settings, fine
            ).gaussians
            fine = None
        return gaussians


@dataclass(frozen=True)
class Simplified:
    """Fewer Gaussians, and what was lost."""

    gaussians: Gaussians
    before: int
    unseen: int  # dropped because no camera sees them
    doubled: int  # dropped because an earlier view shows the same surface
    merged: int  # gone into others


@torch.no_grad()
@one_thread()
def simplify(
    gaussians: Gaussians,
    cameras: Cameras,
    rasterizer: Rasterizer,
    most: int | None = None,
    settings: SimplifySettings | None = None,
    fine: Region | None = None,
) -> Simplified:
    """Simplify one scene (batch 1) as seen from `cameras`, its input views in the order of
    `view_index`.

    `most` is a budget: the price of a Gaussian is searched so that at most so many are left. With
    None the price follows from the scene's detail, see `scene_price`, and Gaussians on pixels of
    `fine` are not merged. Raises InputError for a batch of several scenes.
    """
    settings = settings or SimplifySettings()
    if gaussians.means.shape[0] != 1:
        raise InputError(
            f"simplify takes one scene at a time, got a batch of {gaussians.means.shape[0]}."
        )
    if gaussians.count <= (1 if most is None else most):
        return Simplified(gaussians, gaussians.count, 0, 0, 0)
    seen_from = viewpoints(cameras)
    kept = drop_unneeded_harmonics(gaussians, seen_from, rasterizer, TOLERANCE)
    alike_up_to = settings.duplicate_colour
    twice = duplicates(kept, cameras, place(kept, cameras), alike_up_to)
    kept = kept.select(~twice)
    seen = visible_weight(kept, cameras, rasterizer) >= CONTRIBUTION
    kept = kept.select(seen)
    fewer = _merge(kept, cameras, most, settings, fine)
    if most is not None and fewer.count > most:
        weight = visible_weight(fewer, cameras, rasterizer)
        fewer = fewer.select(
            weight.argsort(descending=True, stable=True)[:most].sort().values
        )
    merged = kept.count - fewer.count
    if settings.polish:
        images = rasterizer.render(gaussians, cameras).images.clamp(0, 1)
        fewer = refine(
            fewer, cameras, images, rasterizer, settings.polish * cameras.count, POLISH
        ).gaussians
    result = Simplified(
        fewer, gaussians.count, int((~seen).sum()), int(twice.sum()), merged
    )
    _note(result)
    return result


@torch.no_grad()
def agreement(
    gaussians: Gaussians, fewer: Gaussians, cameras: Cameras, rasterizer: Rasterizer
) -> float:
    """PSNR [dB] of the pictures of fewer Gaussians against those of all, from a few cameras."""
    cameras = cameras.select(evenly(range(cameras.count), TELLING_VIEWS))
    before, after = (
        rasterizer.render(scene, cameras).images.clamp(0, 1)
        for scene in (gaussians, fewer)
    )
    squared_error = float((after - before).square().mean())
    return -10 * log10(squared_error) if squared_error > 0 else inf


def _note(result: Simplified) -> None:
    for name in ("before", "unseen", "doubled", "merged"):
        note(f"simplify.{name}", getattr(result, name))
    note("simplify.left", result.gaussians.count)


def _merge(
    gaussians: Gaussians,
    cameras: Cameras,
    most: int | None,
    settings: SimplifySettings,
    fine: Region | None,
) -> Gaussians:
    """Merge the Gaussians that share a cell of the best partition of the views."""
    placement = place(gaussians, cameras)
    colours = dc_to_colour(gaussians.harmonics[0, :, 0])
    parallax = _parallax(placement, cameras)
    weight = gaussians.opacities[0]
    cells = measure_cells(placement, colours, weight, cameras, parallax)
    price = (
        scene_price(cells, settings) if most is None else price_for_count(cells, most)
    )
    groups = partition(cells, price)
    if fine is not None and most is None:
        groups[own_pixel_inside(gaussians, fine, cameras.at(size_of(fine)))] = -1
        groups[groups >= 0] = torch.unique(groups[groups >= 0], return_inverse=True)[1]
    return merge_groups(gaussians, groups, cameras)


def _parallax(placement: Placement, cameras: Cameras) -> float:
    """Focal length times the mean distance of neighbouring views [pixels x scene units]."""
    focal = first_focal(cameras)
    centres = cameras.c2w[0, :, :3, 3]
    if cameras.count == 1:
        return focal * LONE_BASELINE * float(placement.depth.median())
    return focal * float((centres[1:] - centres[:-1]).norm(dim=-1).mean())
