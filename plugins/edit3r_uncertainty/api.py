"""What others may use of this plugin."""

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.rendering import render_numbers


def render_uncertainty(
    rasterizer: Rasterizer, gaussians: Gaussians, cameras: Cameras
) -> Float[Tensor, "batch camera height width"]:
    """The probability, for each pixel, that its colour is wrong; 1 where the scene shows nothing.

    Raises ValueError for a scene without `uncertainty`.
    """
    if gaussians.uncertainty is None:
        raise ValueError(
            "render_uncertainty: nobody estimated this scene's uncertainty"
        )
    shown = render_numbers(rasterizer, gaussians, gaussians.uncertainty, cameras)
    missing = 1 - shown.alphas[:, :, 0]
    return (shown.images[:, :, 0] + missing).clamp(0, 1)
