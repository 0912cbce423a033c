"""Drop what no picture needs, merge what is flat, polish what is left; say how much the pictures changed."""

from dataclasses import dataclass, replace
from math import isfinite, log10

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.errors import InputError
from edit3r.geometry.cameras import to_pixels
from edit3r.geometry.harmonics import dc_to_colour
from edit3r.geometry.paths import between_and_around
from edit3r.interfaces import Rasterizer
from edit3r.reporting import note
from edit3r.types import Cameras, Gaussians
from edit3r_refiners.refine import RefineSettings, refine
from edit3r_refiners.simplify.contribution import contributions
from edit3r_refiners.simplify.degree import needed_degree
from edit3r_refiners.simplify.duplicates import duplicates
from edit3r_refiners.simplify.merging import merge_groups
from edit3r_refiners.simplify.partition import measure_cells, own_price, partition, price_for
from edit3r_refiners.simplify.placement import Placement, place
from edit3r_refiners.simplify.settings import SimplifySettings

PATH_CAMERAS = 2  # pictures from between and around, per input view
PATH_REDUCTION = 2  # of their sides
PATH_WIDENING = 1.5  # of what they show: a rim beyond the photos' borders counts too
# Larger steps than towards photos: merged Gaussians reach across the borders of things and must shrink within few.
POLISH = RefineSettings(colour=0.015, opacity=0.08, scale=0.08)
LONE_BASELINE = 0.1  # how far new views of a lone picture are taken to be [its median depth]


@dataclass(frozen=True)
class Simplified:
    """Fewer Gaussians, and what it cost."""

    gaussians: Gaussians
    before: int
    unseen: int  # dropped because no camera sees them
    doubled: int  # dropped because an earlier view shows the same surface
    merged: int  # gone into others
    psnr: float  # of the cameras' pictures against those of all Gaussians [dB]


@torch.no_grad()
def simplify(
    gaussians: Gaussians,
    cameras: Cameras,
    rasterizer: Rasterizer,
    most: int | None = None,
    settings: SimplifySettings | None = None,
) -> Simplified:
    """Simplify one scene (batch 1) as seen from `cameras`, its input views in the order of `view_index`.

    `most` is a budget: with it the price of a Gaussian is searched so that at most so many are left; None: the price
    follows from the scene's detail, see `own_price`.
    """
    settings = settings or SimplifySettings()
    if gaussians.means.shape[0] != 1:
        raise InputError(f"simplify takes one scene at a time, got a batch of {gaussians.means.shape[0]}.")
    if gaussians.count <= (1 if most is None else most):
        return Simplified(gaussians, gaussians.count, 0, 0, 0, float("inf"))
    kept = needed_degree(gaussians, looks(cameras), rasterizer, settings.harmonics)
    twice = duplicates(kept, cameras, place(kept, cameras), settings)
    kept = kept.select(~twice)
    seen = visible_weight(kept, cameras, rasterizer) >= settings.contribution
    kept = kept.select(seen)
    fewer = _merge(kept, cameras, most, settings)
    if most is not None and fewer.count > most:
        fewer = _most_visible(fewer, cameras, rasterizer, most)
    merged = kept.count - fewer.count
    pictures = rasterizer.render(gaussians, cameras).images.clamp(0, 1)
    fewer = refine(fewer, cameras, pictures, rasterizer, settings.polish, POLISH).gaussians
    again = rasterizer.render(fewer, cameras).images.clamp(0, 1)
    fidelity = _decibels(float((again - pictures).square().mean()))
    result = Simplified(fewer, gaussians.count, int((~seen).sum()), int(twice.sum()), merged, fidelity)
    _tell(result)
    return result


def _decibels(squared_error: float) -> float:
    return -10 * log10(squared_error) if squared_error > 0 else float("inf")


def _tell(result: Simplified) -> None:
    for name in ("before", "unseen", "doubled", "merged"):
        note(f"simplify.{name}", getattr(result, name))
    note("simplify.left", result.gaussians.count)
    note("simplify.psnr_of_input_views_against_all", round(result.psnr, 3) if isfinite(result.psnr) else None)


def looks(cameras: Cameras) -> tuple[Cameras, ...]:
    """The input views, and some smaller and wider pictures from between and around them.

    What only a new viewpoint uncovers, or looks past the border at, must stay, although no input view needs it.
    """
    if cameras.count == 1:
        return (cameras,)
    path = between_and_around(cameras, PATH_CAMERAS * cameras.count)
    height, width = (max(1, size // PATH_REDUCTION) for size in cameras.image_size)
    intrinsics = path.intrinsics.clone()
    intrinsics[..., :2, :2] /= PATH_WIDENING
    return cameras, replace(path, intrinsics=intrinsics, image_size=(height, width))


def visible_weight(gaussians: Gaussians, cameras: Cameras, rasterizer: Rasterizer) -> Float[Tensor, "gaussian"]:
    """The most that each Gaussian adds to the input views or to the others [pixels of the input views]."""
    weights = []
    for look in looks(cameras):
        area = (_focal(cameras) / _focal(look)) ** 2
        weights.append(area * contributions(gaussians, look, rasterizer)[0])
    return torch.stack(weights).amax(0)


def _merge(gaussians: Gaussians, cameras: Cameras, most: int | None, settings: SimplifySettings) -> Gaussians:
    placement = place(gaussians, cameras)
    colours = dc_to_colour(gaussians.harmonics[0, :, 0])
    parallax = _parallax(placement, cameras)
    cells = measure_cells(placement, colours, gaussians.opacities[0], cameras, parallax, settings)
    price = own_price(cells, settings) if most is None else price_for(cells, most)
    return merge_groups(gaussians, partition(cells, price), cameras, settings)


def _most_visible(gaussians: Gaussians, cameras: Cameras, rasterizer: Rasterizer, most: int) -> Gaussians:
    weight = visible_weight(gaussians, cameras, rasterizer)
    return gaussians.select(weight.argsort(descending=True, stable=True)[:most].sort().values)


def _focal(cameras: Cameras) -> float:
    """Of the first camera [pixels]."""
    return float(to_pixels(cameras.intrinsics, cameras.image_size)[0, 0, 0, 0])


def _parallax(placement: Placement, cameras: Cameras) -> float:
    """Focal length times the mean distance between neighbouring views [pixels times scene units]."""
    focal = _focal(cameras)
    centres = cameras.c2w[0, :, :3, 3]
    if cameras.count == 1:
        return focal * LONE_BASELINE * float(placement.depth.median())
    return focal * float((centres[1:] - centres[:-1]).norm(dim=-1).mean())
