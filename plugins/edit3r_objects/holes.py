"""The place behind a thing that went away: closed by continuing what is around it."""

from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.rendering import render_numbers

# The numbers of this block: no figures kept.
RIM = 0.015  # around the object, where colours are mixed with its own [longer sides]
COVERED = 0.3  # share of a pixel from which the object covers it
ITS_OWN = 0.9  # share inside the outlines above which a Gaussian shows only the object
SEEN = 0.02  # contribution [pixels] below which nothing is known of a Gaussian
OPEN = 0.7  # alpha below which a pixel is closed
MIXED = 2  # pixels around what is open that are not believed
OPACITY, FOOTPRINT = 0.95, 0.5  # of the new Gaussians, the second one in pixels


def without_object(
    gaussians: Gaussians,
    chosen: Bool[Tensor, "gaussian"],
    cameras: Cameras,
    rasterizer: Rasterizer,
) -> tuple[Gaussians, int]:
    """The scene (batch 1) without the chosen Gaussians, the place behind them closed.

    What another view shows there stays, as do other objects. The rest continues the colours and
    depths around the hole; view after view, each closes what is still open. Also returns how
    many Gaussians are such guesses, the last ones.
    """
    holes = _outlines(gaussians, chosen, cameras, rasterizer)
    rest = gaussians.select(~chosen)
    weights = torch.stack((holes, torch.ones_like(holes)), 1)
    within, total = rasterizer.contributions(rest, cameras, weights)[0].T
    named = rest.objects >= 0  # other objects stay whole
    scene = rest.select(named | (within <= ITS_OWN * total) | (total <= SEEN))
    known = scene.count
    for view, hole in enumerate(holes):
        camera = cameras.select([view])
        closing = patch(scene, hole > 0, camera, rasterizer)
        index = torch.full_like(closing.view_index, view)
        scene = Gaussians.cat([scene, replace(closing, view_index=index)])
    return scene, scene.count - known


def _outlines(
    gaussians: Gaussians,
    chosen: Bool[Tensor, "gaussian"],
    cameras: Cameras,
    rasterizer: Rasterizer,
) -> Float[Tensor, "camera height width"]:
    """1 where the chosen Gaussians and their rim are seen, 0 elsewhere."""
    flags = render_numbers(rasterizer, gaussians, chosen[None], cameras)
    share = flags.images[:, :, 0]
    reach = round(RIM * max(cameras.image_size))
    return dilate((share > COVERED).to(share), reach)[0]


def patch(
    scene: Gaussians,
    hole: Bool[Tensor, "height width"],
    camera: Cameras,
    rasterizer: Rasterizer,
) -> Gaussians:
    """New Gaussians, one a pixel, where one scene (batch 1) is open in the hole of one camera."""
    shown = rasterizer.render(scene, camera)
    alpha = shown.alphas[0, 0, 0]
    missing = hole & (alpha < OPEN)
    known = 1 - dilate((alpha < OPEN).to(alpha), MIXED)
    image = (shown.images[0, 0] / alpha.clamp(min=OPEN)).clamp(0, 1)
    near = 1 / shown.depths[0, 0].clamp(min=1e-6)
    colours, near = _continued(torch.cat((image, near)), known[None]).split((3, 1))
    depths = 1 / near[None].clamp(min=1e-6)
    scales = pixel_scales(depths, camera.intrinsics, FOOTPRINT)
    every = pixels_to_gaussians(
        colours[None, None], depths, camera, scales, torch.full_like(depths, OPACITY)
    )
    patch = every.select(missing.flatten())
    coefficients = scene.harmonics.shape[2] - 1
    harmonics = F.pad(patch.harmonics, (0, 0, 0, coefficients))
    return replace(patch, harmonics=harmonics)


def _continued(
    values: Float[Tensor, "channel height width"],
    known: Float[Tensor, "1 height width"],
) -> Float[Tensor, "channel height width"]:
    """`values` where they are `known` (1), elsewhere continued from there.

    From coarse to fine, each level fills what the next one lacks (pull-push, Gortler et al. 1996).
    """
    size = tuple(values.shape[1:])
    if max(size) == 1:
        return values
    weights = F.avg_pool2d(known, 2, ceil_mode=True)
    means = F.avg_pool2d(values * known, 2, ceil_mode=True) / weights.clamp(min=1e-6)
    coarse = _continued(means, (weights > 0).to(known))
    fine = F.interpolate(coarse[None], size, mode="bilinear")[0]
    return torch.where(known > 0, values, fine)
