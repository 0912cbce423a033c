"""What is guessed half-way between photos: the views that a flight shows and no photo does.

A photo whose depth is mostly guessed does no harm where its neighbours measured the same place, and
a guess on a blank wall is seldom seen. What is seen is a pattern half-way that nobody measured.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Cameras, Views
from edit3r.kit.geometry.cameras import project_to_pixels, unproject
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.geometry.paths import half_way
from edit3r.kit.geometry.warping import nearest_views

# The numbers of this block: docs/notes/verdict.md.
LONGEST = 172  # size at which photos are looked at [pixels]
NEAR_VIEWS = 4  # others whose measurements count half-way from a photo to its nearest
BESIDE = 2  # pixels around a measured point that count as measured: points lie apart
AROUND = 0.03  # half the side of the window in which colours are compared [long sides]
BLANK = 0.02  # standard deviation of colours [sRGB] below which a surface shows nothing


@torch.no_grad()
def guessed_between(geometry: Geometry, photos: Views) -> Float[Tensor, "batch view"]:
    """For each photo the share of the view half-way to its nearest one that shows a pattern whose
    depth no photo measured; 1 for photos that were not placed, or alone.
    """
    share = min(1.0, LONGEST / max(photos.image_size))
    height, width = (max(1, round(share * side)) for side in photos.image_size)
    views = geometry.calibrated(photos).at((height, width)).to("cpu")
    geometry = geometry.at((height, width)).to("cpu")
    shares = torch.ones(geometry.registered.shape)
    for scene, registered in enumerate(geometry.registered):
        placed = registered.nonzero()[:, 0]
        if len(placed) > 1:
            shares[scene, placed] = _of_scene(geometry, views, scene, placed)
    return shares


def _of_scene(
    geometry: Geometry, views: Views, scene: int, placed: Tensor
) -> Float[Tensor, "placed"]:
    """Of each view that is `placed` in one scene the share that is guessed between it and its
    nearest one.
    """
    lenses, size = views.intrinsics[scene, placed], views.image_size
    c2w, depths = geometry.c2w[scene, placed], geometry.depths[scene, placed]
    colours = views.images[scene, placed].permute(0, 2, 3, 1).flatten(1, 2)
    measured = geometry.is_measured[scene, placed].flatten(1)
    points = unproject(depths, lenses, c2w).flatten(1, 2)
    near = nearest_views(c2w[None], depths[None], NEAR_VIEWS)
    cameras, pairs = half_way(Cameras(c2w[None], lenses[None], size))
    poses, shares = cameras.c2w[0], torch.ones(len(placed))
    apart = [float(torch.dist(*c2w[list(pair), :3, 3])) for pair in pairs]
    # the nearest last: of the pairs of a view that one counts
    for number in sorted(range(len(pairs)), key=lambda one: -apart[one]):
        pair = pairs[number]
        seen = sorted({*pair, *near[pair[0]], *near[pair[1]]})
        pixel, depth, inside = project_to_pixels(
            points[seen].flatten(0, 1), lenses[pair[0]], poses[number], size
        )
        pixel, depth = pixel[inside], depth[inside]
        known = torch.zeros(size).flatten()
        known[pixel[measured[seen].flatten()[inside]]] = 1
        nearest = torch.full_like(known, torch.inf)
        nearest.scatter_reduce_(0, pixel, depth, "amin")
        front = depth <= nearest[pixel]
        shown = torch.zeros(len(known), 4)  # colours, and 1 where there are any
        shown[pixel[front], :3] = colours[seen].flatten(0, 1)[inside][front]
        shown[pixel, 3] = 1
        guessed = dilate(known.view(size), BESIDE) == 0
        patterned = _patterned(shown.T.unflatten(1, size))
        shares[list(pair)] = (guessed & patterned).float().mean()
    return shares


def _patterned(
    shown: Float[Tensor, "4 height width"],
) -> Bool[Tensor, "height width"]:
    """Where colours differ around a pixel, or nothing is known of them."""
    radius = max(1, round(AROUND * max(shown.shape[1:])))
    known = shown[3:]
    stacked = torch.cat((shown[:3], shown[:3].square(), known))
    means = F.avg_pool2d(stacked[None], 2 * radius + 1, 1, radius)[0]
    mean, square = (means[:6] / means[6:].clamp(min=1e-6)).split(3)
    spread = (square - mean.square()).mean(0)
    return (spread > BLANK**2) | (means[6] == 0)
