"""Drop what no picture needs, then merge what is flat; say how much the pictures changed."""

from dataclasses import dataclass

import torch

from edit3r.evaluation.metrics import psnr
from edit3r.interfaces import Rasterizer
from edit3r.simplify.cells import place
from edit3r.simplify.contribution import contributions
from edit3r.simplify.duplicates import duplicates
from edit3r.simplify.merging import merge_flat
from edit3r.simplify.settings import SimplifySettings
from edit3r.types import Cameras, Gaussians


@dataclass(frozen=True)
class Simplified:
    """Fewer Gaussians, and what it cost."""

    gaussians: Gaussians
    before: int
    unseen: int  # dropped because no camera sees them
    doubled: int  # dropped because an earlier view shows the same surface
    psnr: float  # of the cameras' pictures against those of all Gaussians [dB]


@torch.no_grad()
def simplify(
    gaussians: Gaussians, cameras: Cameras, rasterizer: Rasterizer, settings: SimplifySettings | None = None
) -> Simplified:
    """Simplify one scene (batch 1) as seen from `cameras`, its input views in the order of `view_index`."""
    settings = settings or SimplifySettings()
    before = rasterizer.render(gaussians, cameras).images.clamp(0, 1)
    seen = contributions(gaussians, cameras, rasterizer)[0] >= settings.contribution
    kept = gaussians.select(seen)
    placement = place(kept, cameras)
    twice = duplicates(kept, cameras, placement, settings.duplicate_depth, settings.colour)
    kept = kept.select(~twice)
    merged = merge_flat(kept, place(kept, cameras), settings)
    after = rasterizer.render(merged, cameras).images.clamp(0, 1)
    unseen, doubled = int((~seen).sum()), int(twice.sum())
    return Simplified(merged, gaussians.count, unseen, doubled, psnr(after.cpu().numpy(), before.cpu().numpy()))
