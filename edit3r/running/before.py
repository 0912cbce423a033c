"""The look before the edit: colours that the Gaussians of an edited scene would have without it."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.types import Cameras, Gaussians, Rendering, Views
from edit3r.kit.geometry.cameras import project
from edit3r.kit.geometry.harmonics import dc_to_colour

# The numbers of this block: no figures kept.
SAME_DEPTH = 1.05  # what lies farther than so many times the depth seen is hidden
SAME_COLOUR = 0.1  # largest difference to the edited photo of what surely shows there
LIKE_COLOUR = 0.3  # and of what likely does
NEARBY = 2  # how far from its pixel the colour of a Gaussian is looked for [pixels]


def colours_before(
    gaussians: Gaussians,
    cameras: Cameras,
    photos: Views,
    edited: Views,
    rendered: Rendering,
) -> Float[Tensor, "gaussian 3"]:
    """Return the colours (sRGB) that the Gaussians of an edited scene would have without the edit.

    For each Gaussian, the pixel most like it in colour is looked for among the nine around its
    place, in the view it came from, or in the first view that shows one of no view. The difference
    photo less edited photo at that pixel is added to its colour. What the edit left far from what
    the photo shows there, such as a rim of both colours, takes the photo's. What is like none of
    them (hidden things) keeps its colour. So this is a stand-in, not the scene before the edit,
    whose shapes may have been others. One scene (batch 1).
    """
    colours = dc_to_colour(gaussians.harmonics[0, :, 0])
    view_index = gaussians.view_index
    settled = torch.zeros_like(view_index, dtype=torch.bool)
    for view in range(cameras.count):
        places, depths = project(
            gaussians.means[0], cameras.intrinsics[0, view], cameras.c2w[0, view]
        )
        maps = (photos.images, edited.images, rendered.depths)
        values = torch.cat([each[:, view] for each in maps], 1).to(colours)
        change, difference, depth_seen = _most_alike(colours, places, values)
        likely = (difference < LIKE_COLOUR) & (depths < SAME_DEPTH * depth_seen)
        inside = ((places > 0) & (places < 1)).all(-1) & (depths > 0)
        of_view = (view_index == view) | (view_index < 0)
        own = inside & of_view & ~settled
        mine = ((difference < SAME_COLOUR) | likely) & own
        colours = torch.where(mine[:, None], colours + change, colours)
        photo, is_edited = _photo_there(photos, edited, view, places)
        off = (colours - photo).abs().amax(-1) > SAME_COLOUR
        stray = off & is_edited & (depths < SAME_DEPTH * depth_seen) & own
        colours = torch.where(stray[:, None], photo, colours)
        settled |= mine | stray
    return colours


def _photo_there(
    photos: Views, edited: Views, view: int, places: Float[Tensor, "gaussian 2"]
) -> tuple[Float[Tensor, "gaussian 3"], Bool[Tensor, "gaussian"]]:
    """What a photo shows at places, and whether the edit changed something near by."""
    photo = photos.images[:, view].to(places)
    change = (photo - edited.images[:, view].to(places)).abs().amax(1, keepdim=True)
    near = torch.nn.functional.max_pool2d(change, 2 * NEARBY + 1, 1, NEARBY)
    sampled = torch.nn.functional.grid_sample(
        torch.cat([photo, near], 1),
        2 * places[None, None] - 1,
        padding_mode="border",
        align_corners=False,
    )[0, :, 0].T
    return sampled[:, :3], sampled[:, 3] > SAME_COLOUR


def _most_alike(
    colours: Float[Tensor, "gaussian 3"],
    places: Float[Tensor, "gaussian 2"],
    values: Float[Tensor, "1 7 height width"],
) -> tuple[
    Float[Tensor, "gaussian 3"], Float[Tensor, "gaussian"], Float[Tensor, "gaussian"]
]:
    """At the most alike of nine pixels: what the edit changed there and how alike it is.

    Also the farthest depth of the nine. `values` holds photo, edited photo and depth.
    """
    pixel = 1 / places.new_tensor([values.shape[3], values.shape[2]])
    change = torch.zeros_like(colours)
    least = torch.full_like(colours[:, 0], torch.inf)
    farthest = torch.zeros_like(least)
    shifts = torch.arange(-1, 2).to(places)
    for shift in torch.cartesian_prod(shifts, shifts):
        grid = 2 * (places + NEARBY * shift * pixel) - 1
        sampled = torch.nn.functional.grid_sample(
            values,
            grid[None, None].to(colours),
            mode="nearest",
            padding_mode="border",
            align_corners=False,
        )
        photo, edit, depth = sampled[0, :, 0].T.split((3, 3, 1), 1)
        difference = (colours - edit).abs().amax(-1)
        change = torch.where((difference < least)[:, None], photo - edit, change)
        least = torch.minimum(difference, least)
        farthest = torch.maximum(depth[:, 0], farthest)
    return change, least, farthest
