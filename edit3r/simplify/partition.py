"""Cut the pictures into rectangles that hold one Gaussian each: the exact best partition for a given price.

Dyadic CART (Donoho 1997, "CART and best-ortho-basis"): every rectangle with sides and position of powers of two is
either one cell or the better of its two halvings, left and right or top and bottom. With the error of every such
rectangle known, the best choice follows bottom-up, in time linear in the number of pixels.
"""

from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from edit3r.simplify.cell_cost import merging_cost, pixel_sums
from edit3r.simplify.placement import Placement
from edit3r.simplify.settings import SimplifySettings
from edit3r.types import Cameras

MARGIN = 0.5  # Gaussians further outside a picture than this are never merged [picture sizes]
MERGE, ALONG_X, ALONG_Y, STAY = 0, 1, 2, 3
ROWS, COLUMNS = 1, 2
LOWEST_PRICE, HIGHEST_PRICE, PRICE_STEP = 1e-9, 1e6, 1.02


@dataclass(frozen=True)
class Cells:
    """Errors of all dyadic rectangles of one scene, and which pixel each Gaussian falls on."""

    inside: Int[Tensor, "member"]  # Gaussians that take part
    pixel: tuple[Tensor, Tensor, Tensor]  # view, row and column of each of them on the padded grid
    count: dict[tuple[int, int], Float[Tensor, "view row column"]]  # Gaussians per cell, by (level of y, of x)
    error: dict[tuple[int, int], Float[Tensor, "view row column"]]
    total: int  # Gaussians of the scene

    @property
    def levels(self) -> int:
        return max(level for level, _ in self.error)


def measure_cells(
    placement: Placement,
    colours: Float[Tensor, "gaussian 3"],
    weight: Float[Tensor, "gaussian"],
    cameras: Cameras,
    parallax: float,
    settings: SimplifySettings,
) -> Cells:
    """Errors of the cells up to `settings.largest_cell`; empty cells cost nothing."""
    height, width = cameras.image_size
    near = _takes_part(placement, height, width)
    inside = near.nonzero()[:, 0]
    levels, side = settings.largest_cell, 2**settings.largest_cell
    row, rows = _padded(placement.row[inside], height, side)
    column, columns = _padded(placement.column[inside], width, side)
    pixel = placement.view[inside], row, column
    x, y = placement.x[inside] - width / 2, placement.y[inside] - height / 2
    sums = pixel_sums(x, y, 1 / placement.depth[inside], colours[inside].double(), weight[inside].double())
    dense = sums.new_zeros(cameras.count, rows, columns, sums.shape[-1]).index_put_(pixel, sums, accumulate=True)
    focal = float(cameras.intrinsics[0, 0, 0, 0]) * width
    count, error = {}, {}
    for by_y in range(levels + 1):
        wide = dense
        for by_x in range(levels + 1):
            count[by_y, by_x] = wide[..., 0].float()
            error[by_y, by_x] = merging_cost(wide, 1 << by_y + by_x, parallax, focal, settings).float()
            wide = _pairs(wide, COLUMNS) if by_x < levels else wide
        dense = _pairs(dense, ROWS) if by_y < levels else dense
    return Cells(inside, pixel, count, error, placement.view.numel())


def partition(cells: Cells, price: float) -> Int[Tensor, "gaussian"]:
    """Group of each Gaussian such that summed error + `price` per Gaussian left is least; -1: stays itself."""
    choices, _ = _choose(cells, price)
    view, row, column = cells.pixel
    by_y, by_x = (torch.full_like(view, cells.levels) for _ in range(2))
    made = torch.full_like(view, -1)  # the choice that ended the walk from the largest cell down
    for (level_y, level_x), choice in reversed(choices.items()):
        here = ((by_y == level_y) & (by_x == level_x) & (made < 0)).nonzero()[:, 0]
        taken = choice[view[here], row[here] >> level_y, column[here] >> level_x]
        made[here[taken == MERGE]], made[here[taken == STAY]] = MERGE, STAY
        by_x[here[taken == ALONG_X]] -= 1
        by_y[here[taken == ALONG_Y]] -= 1
    merged = (made == MERGE).nonzero()[:, 0]
    key = torch.stack((view, by_y, by_x, row >> by_y, column >> by_x), -1)[merged]
    group = torch.full((cells.total,), -1, dtype=torch.long, device=view.device)
    if merged.numel():
        group[cells.inside[merged]] = key.unique(dim=0, return_inverse=True)[1]
    return group


def count_left(cells: Cells, price: float) -> int:
    """How many Gaussians `partition` leaves; falls with the price."""
    return cells.total - cells.inside.numel() + round(float(_choose(cells, price)[1].sum()))


def price_for(cells: Cells, most: int) -> float:
    """The lowest price, to a few percent, at which at most `most` Gaussians are left, or the highest there is."""
    low, high = LOWEST_PRICE, HIGHEST_PRICE
    while high / low > PRICE_STEP:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if count_left(cells, middle) <= most else (middle, high)
    return high


def _choose(cells: Cells, price: float) -> tuple[dict[tuple[int, int], Tensor], Tensor]:
    """MERGE, ALONG_X, ALONG_Y or STAY for every cell, halves before wholes; Gaussians left in each largest cell."""
    cost: dict[tuple[int, int], Tensor] = {}
    left: dict[tuple[int, int], Tensor] = {}
    choices: dict[tuple[int, int], Tensor] = {}
    for level in sorted(product(range(cells.levels + 1), repeat=2), key=sum):
        count, error = cells.count[level], cells.error[level]
        options = [(torch.where(count > 1, error + price, torch.inf), torch.ones_like(count))]
        for half, dim in (((level[0], level[1] - 1), COLUMNS), ((level[0] - 1, level[1]), ROWS)):
            options.append((_pairs(cost[half], dim), _pairs(left[half], dim)) if half in cost else _impossible(count))
        options.append((price * count, count) if level == (0, 0) else _impossible(count))
        cost[level], choice = torch.stack([option for option, _ in options]).min(0)
        left[level] = torch.stack([number for _, number in options]).gather(0, choice[None])[0]
        choices[level] = choice
    return choices, left[level]


def _impossible(like: Tensor) -> tuple[Tensor, Tensor]:
    return torch.full_like(like, torch.inf), torch.zeros_like(like)


def _padded(position: Int[Tensor, "member"], size: int, side: int) -> tuple[Int[Tensor, "member"], int]:
    """Positions on an axis that starts and ends at multiples of `side` and holds all of them; its length."""
    first, last = (0, size - 1) if position.numel() == 0 else (min(0, int(position.min())), int(position.max()))
    start = first // side * side
    return position - start, -(-(max(last, size - 1) + 1 - start) // side) * side


def _takes_part(placement: Placement, height: int, width: int) -> Bool[Tensor, "gaussian"]:
    near_x = (placement.x >= -int(MARGIN * width)) & (placement.x < width + int(MARGIN * width))
    near_y = (placement.y >= -int(MARGIN * height)) & (placement.y < height + int(MARGIN * height))
    return near_x & near_y & (placement.depth > 0)


def _pairs(values: Tensor, dim: int) -> Tensor:
    """Sums of neighbours two by two along rows (1) or columns (2)."""
    return values.unflatten(dim, (-1, 2)).sum(dim + 1)
