"""How much each Gaussian adds to the pictures of given cameras."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.harmonics import DC
from edit3r.interfaces import Rasterizer
from edit3r.types import Cameras, Gaussians


def contributions(
    gaussians: Gaussians,
    cameras: Cameras,
    rasterizer: Rasterizer,
    pixels: Bool[Tensor, "camera height width"] | None = None,
) -> Float[Tensor, "batch gaussian"]:
    """Blending weight (transmittance times alpha) of each Gaussian, summed over the `pixels` of all cameras [pixels].

    A picture is linear in the colours, so the weight is the gradient of the summed picture by the constant harmonic,
    divided by the basis function. Grey Gaussians keep every colour away from the clamp at 0.
    """
    grey = torch.zeros_like(gaussians.harmonics[:, :, :1]).requires_grad_(True)
    with torch.enable_grad():
        pictures = rasterizer.render(replace(gaussians, harmonics=grey), cameras).images
        shown = pictures[:, :, 0] if pixels is None else pictures[:, :, 0] * pixels
        (gradient,) = torch.autograd.grad(shown.sum(), grey)
    return gradient[:, :, 0, 0] / DC
