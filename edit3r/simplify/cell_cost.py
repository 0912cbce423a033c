"""What it costs the pictures when all Gaussians of a rectangle of pixels become one: sums per cell, added upwards."""

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.simplify.settings import SimplifySettings

STEEPEST = 3.0  # tangent between a surface and the picture plane; beyond it is a step in depth, not a slanted surface
LEAST_FILL = 0.5  # Gaussians per pixel; an emptier cell joins things that are apart
STILL = 0.25  # steps that move by less than this between the views do no harm [pixels]


def pixel_sums(
    x: Float[Tensor, "gaussian"],
    y: Float[Tensor, "gaussian"],
    disparity: Float[Tensor, "gaussian"],
    colours: Float[Tensor, "gaussian 3"],
    weight: Float[Tensor, "gaussian"],
) -> Float[Tensor, "gaussian channel"]:
    """Moments of single Gaussians; those of a cell are their sum.

    Channels: count, weight, then weighted: 5 moments of (x, y), colour 3, squared colour, colour by x 3, by y 3,
    disparity, its square, by x, by y.
    """
    position = torch.stack((x, y, x * x, y * y, x * y), -1)
    colour = torch.cat(
        (colours, colours.square().sum(-1, keepdim=True), colours * x[:, None], colours * y[:, None]), -1
    )
    depth = torch.stack((disparity, disparity.square(), disparity * x, disparity * y), -1)
    moments = torch.cat((torch.ones_like(position[:, :1]), position, colour, depth), -1)
    return torch.cat((torch.ones_like(weight)[:, None], weight[:, None] * moments), -1)


def merging_cost(
    sums: Float[Tensor, "view row column channel"], area: int, parallax: float, focal: float, settings: SimplifySettings
) -> Float[Tensor, "view row column"]:
    """Squared error, summed over the cell's pixels, of one Gaussian in place of the cell's; infinite: must not merge.

    Colour: what its mean leaves over, where a linear change counts `gradient_share` only, because neighbouring
    Gaussians blend into each other. Depth: what no plane explains (a plane's disparity is linear in the picture), as
    pixels that the surface moves by between the views. `area` [pixels] is that of each cell; `parallax` and `focal`
    [pixels] are the distance between the views and one scene unit, each at camera z = 1.
    """
    weight = sums[..., 1].clamp(min=1e-12)
    mean_x, mean_y, xx, yy, xy = (sums[..., i] / weight for i in range(2, 7))
    # A pixel is not a point: its own extent keeps the fit of few pixels from being exact.
    var_x, var_y, cov = xx - mean_x**2 + 1 / 12, yy - mean_y**2 + 1 / 12, xy - mean_x * mean_y

    def fitted(value: Tensor, by_x: Tensor, by_y: Tensor) -> Tensor:
        """Variance that a linear function of (x, y) explains."""
        along_x, along_y = by_x - value * mean_x, by_y - value * mean_y
        determinant = (var_x * var_y - cov * cov).clamp(min=1e-12)
        return (var_y * along_x**2 - 2 * cov * along_x * along_y + var_x * along_y**2) / determinant

    moments = sums[..., 7:] / weight[..., None]
    mean, square, by_x, by_y = moments[..., :3], moments[..., 3], moments[..., 4:7], moments[..., 7:10]
    linear = sum(fitted(mean[..., i], by_x[..., i], by_y[..., i]) for i in range(3))
    colour = (square - mean.square().sum(-1) - (1 - settings.gradient_share) * linear).clamp(min=0) / 3
    disparity, squared, disparity_x, disparity_y = moments[..., 10:].unbind(-1)
    spread = (squared - disparity**2).clamp(min=0)
    bent = (spread - fitted(disparity, disparity_x, disparity_y)).clamp(min=0)
    error = weight * (colour + (settings.edge * parallax) ** 2 * bent)
    steep = spread.sqrt() * focal > STEEPEST * (var_x + var_y).sqrt() * disparity
    refused = (steep & (spread.sqrt() * parallax > STILL)) | (sums[..., 0] < LEAST_FILL * area)
    return torch.where(refused, torch.inf, error)
