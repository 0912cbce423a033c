"""What it costs the pictures when all Gaussians of a rectangle of pixels become one: sums per cell, added upwards."""

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r_refiners.simplify.settings import SimplifySettings

STEEPEST = 3.0  # tangent between a surface and the picture plane; beyond it is a step in depth, not a slanted surface
LEAST_FILL = 0.5  # Gaussians per pixel; an emptier cell joins things that are apart
STILL = 0.25  # steps that move by less than this between the views do no harm [pixels]
COUNT, WEIGHT = 0, 1
VALUES = 4  # red, green, blue, disparity


def pixel_sums(
    x: Float[Tensor, "gaussian"],
    y: Float[Tensor, "gaussian"],
    disparity: Float[Tensor, "gaussian"],
    colours: Float[Tensor, "gaussian 3"],
    weight: Float[Tensor, "gaussian"],
) -> Float[Tensor, "channel gaussian"]:
    """Moments of single Gaussians; those of a cell are their sum.

    Channels: count, weight, then weighted: 5 moments of (x, y), the four values (colour, disparity), their squares
    (colour in one), the values by x, by y. Channels come first, so that each is one run of memory.
    """
    values = torch.stack((*colours.unbind(-1), disparity))
    position = torch.stack((x, y, x * x, y * y, x * y))
    squares = torch.stack((colours.square().sum(-1), disparity.square()))
    moments = torch.cat((position, values, squares, values * x, values * y))
    return torch.cat((torch.ones_like(weight)[None], weight[None], weight * moments))


def merging_cost(
    sums: Float[Tensor, "channel view row column"], area: int, parallax: float, focal: float, settings: SimplifySettings
) -> Float[Tensor, "view row column"]:
    """Squared error, summed over the cell's pixels, of one Gaussian in place of the cell's; infinite: must not merge.

    Colour: what its mean leaves over, where a linear change counts `gradient_share` only, because neighbouring
    Gaussians blend into each other. Depth: what no plane explains (a plane's disparity is linear in the picture), as
    pixels that the surface moves by between the views. `area` [pixels] is that of each cell; `parallax` and `focal`
    [pixels] are the distance between the views and one scene unit, each at camera z = 1.
    """
    weight = sums[WEIGHT]
    mean_x, mean_y, xx, yy, xy, *moments = sums[2:] / weight.clamp(min=1e-12)
    # A pixel is not a point: its own extent keeps the fit of few pixels from being exact.
    var_x, var_y, cov = xx - mean_x**2 + 1 / 12, yy - mean_y**2 + 1 / 12, xy - mean_x * mean_y
    steepness = 1 / (var_x * var_y - cov * cov).clamp(min=1e-12)
    values, squares = moments[:VALUES], moments[VALUES : VALUES + 2]

    def fitted(index: int) -> Tensor:
        """Variance that a linear function of (x, y) explains."""
        by_x, by_y = moments[6 + index], moments[6 + VALUES + index]
        along_x, along_y = by_x - values[index] * mean_x, by_y - values[index] * mean_y
        return (along_x * (var_y * along_x - 2 * cov * along_y) + var_x * along_y * along_y) * steepness

    linear = fitted(0) + fitted(1) + fitted(2)
    unequal = squares[0] - values[0] ** 2 - values[1] ** 2 - values[2] ** 2
    colour = (unequal - (1 - settings.gradient_share) * linear).clamp(min=0) / 3
    disparity = values[3]
    spread = (squares[1] - disparity**2).clamp(min=0)
    bent = (spread - fitted(3)).clamp(min=0)
    error = weight * (colour + (settings.edge * parallax) ** 2 * bent)
    steep = spread * focal**2 > STEEPEST**2 * (var_x + var_y) * disparity**2
    refused = (steep & (spread * parallax**2 > STILL**2)) | (sums[COUNT] < LEAST_FILL * area)
    return error.masked_fill_(refused, torch.inf)
