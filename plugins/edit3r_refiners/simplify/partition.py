"""Cut the pictures into rectangles that hold one Gaussian each: the exact best partition for a given price.

Dyadic CART (Donoho 1997, "CART and best-ortho-basis"): every rectangle with sides and position of powers of two is
either one cell or the better of its two halvings, left and right or top and bottom. With the error of every such
rectangle known, the best choice follows bottom-up, in time linear in the number of pixels.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from edit3r.types import Cameras
from edit3r_refiners.simplify.cell_cost import COUNT, merging_cost, pixel_sums
from edit3r_refiners.simplify.placement import Placement
from edit3r_refiners.simplify.settings import SimplifySettings

MARGIN = 0.5  # Gaussians further outside a picture than this are never merged [picture sizes]
MERGE, ALONG_X, ALONG_Y, STAY = 0, 1, 2, 3
ROWS, COLUMNS = -2, -1
LEAST_PRICE = 0.1  # of the highest that the settings allow
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
    # Positions within the largest cell, so that squares of single precision tell neighbours apart.
    x, y = placement.x[inside] % side, placement.y[inside] % side
    values = (x, y, 1 / placement.depth[inside], colours[inside], weight[inside])
    sums = pixel_sums(*(value.float() for value in values))
    dense = _gathered(sums, (pixel[0] * rows + row) * columns + column, (cameras.count, rows, columns))
    focal = float(cameras.intrinsics[0, 0, 0, 0]) * width
    count, error = {}, {}
    for by_y in range(levels + 1):
        wide = dense
        for by_x in range(levels + 1):
            count[by_y, by_x] = wide[COUNT]
            error[by_y, by_x] = merging_cost(wide, 1 << by_y + by_x, parallax, focal, settings)
            wide = _pairs(wide, COLUMNS) if by_x < levels else wide
        dense = _pairs(dense, ROWS) if by_y < levels else dense
    return Cells(inside, pixel, count, error, placement.view.numel())


def partition(cells: Cells, price: float) -> Int[Tensor, "gaussian"]:
    """Group of each Gaussian such that summed error + `price` per Gaussian left is least; -1: stays itself."""
    choices, _ = _choose(cells, price)
    view, row, column = cells.pixel
    group = torch.full((cells.total,), -1, dtype=torch.long, device=view.device)
    walking = torch.arange(view.numel(), device=view.device)
    by_y, by_x = (torch.full_like(view, cells.levels) for _ in range(2))
    table, first, wide = _joined(choices)
    merged, keys = [], []
    while True:  # from the largest cell down, a halving at a time
        level = by_y * (cells.levels + 1) + by_x
        down, along = row[walking] >> by_y, column[walking] >> by_x
        cell = first[level] + (view[walking] * wide[level, 0] + down) * wide[level, 1] + along
        choice = table[cell]
        merged.append(walking[choice == MERGE])
        keys.append(cell[choice == MERGE])
        by_y, by_x = by_y - (choice == ALONG_Y).long(), by_x - (choice == ALONG_X).long()
        further = (choice == ALONG_X) | (choice == ALONG_Y)
        walking, by_y, by_x = walking[further], by_y[further], by_x[further]
        if not walking.numel():
            break
    group[cells.inside[torch.cat(merged)]] = _numbered(torch.cat(keys), table.numel())
    return group


def own_price(cells: Cells, settings: SimplifySettings) -> float:
    """The price that suits the scene: the mean error of merging 2x2 pixels, so that sharp, clean scenes stay so.

    Where the finest detail is strong, photos were noisy or do not fit together, and its reconstruction is off by as
    much; where it is faint, the same error would be the worst of the picture. Flat scenes pay `LEAST_PRICE` at least.
    """
    if cells.levels == 0:
        return settings.price
    errors = cells.error[1, 1][cells.count[1, 1] > 1]
    errors = errors[errors.isfinite()].double()
    mean = float(errors.mean()) if errors.numel() else 0.0
    return min(max(settings.relative_price * mean, LEAST_PRICE * settings.price), settings.price)


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
        count = cells.count[level]
        least = torch.where(count > 1, cells.error[level] + price, torch.inf)
        number, choice = torch.ones_like(count), torch.full_like(count, MERGE, dtype=torch.int8)
        for other, its_cost, its_number in _alternatives(cells, price, level, cost, left):
            better = its_cost < least
            least = torch.where(better, its_cost, least)
            number = torch.where(better, its_number, number)
            choice.masked_fill_(better, other)
        cost[level], left[level], choices[level] = least, number, choice
    return choices, left[level]


def _alternatives(
    cells: Cells, price: float, level: tuple[int, int], cost: dict, left: dict
) -> Iterator[tuple[int, Tensor, Tensor]]:
    """What a cell may be instead of merged: choice, cost and Gaussians left."""
    by_y, by_x = level
    if by_x:
        yield ALONG_X, _pairs(cost[by_y, by_x - 1], COLUMNS), _pairs(left[by_y, by_x - 1], COLUMNS)
    if by_y:
        yield ALONG_Y, _pairs(cost[by_y - 1, by_x], ROWS), _pairs(left[by_y - 1, by_x], ROWS)
    if level == (0, 0):
        yield STAY, price * cells.count[level], cells.count[level]


def _joined(choices: dict[tuple[int, int], Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """All choices in one row, where each level starts in it, and each level's rows and columns; levels in order."""
    tables = [choices[level] for level in sorted(choices)]
    sizes = torch.tensor([0] + [table.numel() for table in tables[:-1]], device=tables[0].device)
    wide = torch.tensor([table.shape[1:] for table in tables], device=tables[0].device)
    return torch.cat([table.flatten() for table in tables]), sizes.cumsum(0), wide


def _numbered(keys: Int[Tensor, "member"], limit: int) -> Int[Tensor, "member"]:
    """Equal keys get equal numbers, from 0 without gaps, in the order of the keys."""
    used = torch.zeros(limit, dtype=torch.long, device=keys.device)
    used[keys] = 1
    return used.cumsum(0)[keys] - 1


def _gathered(
    sums: Float[Tensor, "channel member"], place: Int[Tensor, "member"], shape: tuple[int, int, int]
) -> Float[Tensor, "channel view row column"]:
    """What falls on the same place, added up."""
    size = shape[0] * shape[1] * shape[2]
    return torch.stack([channel.new_zeros(size).index_add_(0, place, channel) for channel in sums]).view(-1, *shape)


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
    first, second = values.unflatten(dim, (-1, 2)).unbind(dim)
    return first + second
