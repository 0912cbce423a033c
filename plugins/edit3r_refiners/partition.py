"""Cut the views into rectangles that hold one Gaussian each: the best such partition for a given
price.

Dyadic CART (Donoho 1997, "CART and best-ortho-basis"): every rectangle with sides and position of
powers of two is either one cell or the better of its two halvings, left and right or top and
bottom. With the error of every such rectangle known, the best choice follows bottom-up, in time
linear in the number of pixels.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from edit3r.contract.types import Cameras
from edit3r_refiners.merging import Placement
from edit3r_refiners.settings import SimplifySettings

# The numbers of this block: no figures kept.
LARGEST_CELL = 5  # merged cells have sides of at most 2^this pixels
# share of a linear change of colour that counts as error within a merged cell
GRADIENT_SHARE = 0.5
EDGE = 0.05  # change of colour per pixel that surfaces out of place are taken to cause
# Gaussians further outside an image than this are never merged [image sizes]
MARGIN = 0.5
VIEWS_AT_ONCE = 8  # that are measured together: the sums of a pixel take 84 bytes
MERGE, ALONG_X, ALONG_Y, STAY = 0, 1, 2, 3
ROWS, COLUMNS = -2, -1
LEAST_PRICE = 0.1  # of the highest that the settings allow
LOWEST_PRICE, HIGHEST_PRICE, PRICE_STEP = 1e-9, 1e6, 1.02
# tangent between a surface and the image plane; beyond it is a step in depth, not a slanted surface
STEEPEST = 3.0
LEAST_FILL = 0.5  # Gaussians per pixel; an emptier cell joins things that are apart
STILL = 0.25  # steps that move by less than this between the views do no harm [pixels]
COUNT, WEIGHT = 0, 1
VALUES = 4  # red, green, blue, disparity
CHANNELS = 2 + 5 + VALUES + 2 + 2 * VALUES  # as `_pixel_sums` lists them


@dataclass(frozen=True)
class Cells:
    """Errors of all dyadic rectangles of one scene, and which pixel each Gaussian falls on."""

    inside: Int[Tensor, "member"]  # Gaussians that take part
    # view, row and column of each of them on the padded grid
    pixel: tuple[Tensor, Tensor, Tensor]
    # Gaussians per cell, by (level of y, of x)
    count: dict[tuple[int, int], Float[Tensor, "view row column"]]
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
) -> Cells:
    """Measure the error of every cell up to `LARGEST_CELL`; empty cells cost nothing."""
    height, width = cameras.image_size
    near = _near_images(placement, height, width)
    inside = near.nonzero()[:, 0]
    side = 2**LARGEST_CELL
    row, rows = _padded(placement.row[inside], height, side)
    column, columns = _padded(placement.column[inside], width, side)
    pixel = placement.view[inside], row, column
    # Positions within the largest cell, so that squares of single precision tell neighbours apart.
    x, y = placement.x[inside] % side, placement.y[inside] % side
    values = (x, y, 1 / placement.depth[inside], colours[inside], weight[inside])
    focal = float(cameras.intrinsics[0, 0, 0, 0]) * width
    blocks = []
    for first in range(0, cameras.count, VIEWS_AT_ONCE):
        views = min(VIEWS_AT_ONCE, cameras.count - first)
        view = pixel[0] - first
        own = ((view >= 0) & (view < views)).nonzero()[:, 0]
        place = (view[own] * rows + row[own]) * columns + column[own]
        sums = _pixel_sums(*(value[own].float() for value in values))
        dense = _sum_per_pixel(sums, place, (views, rows, columns))
        blocks.append(_measure_block(dense, parallax, focal))
    count, error = (
        {level: torch.cat([table[level] for table in tables]) for level in tables[0]}
        for tables in zip(*blocks)
    )
    return Cells(inside, pixel, count, error, placement.view.numel())


def _measure_block(
    dense: Float[Tensor, "channel view row column"], parallax: float, focal: float
) -> tuple[dict[tuple[int, int], Tensor], dict[tuple[int, int], Tensor]]:
    """Count and error of every cell of some views, by level, from the sums of each pixel."""
    levels = LARGEST_CELL
    count, error = {}, {}
    for by_y in range(levels + 1):
        wide = dense
        for by_x in range(levels + 1):
            count[by_y, by_x] = wide[COUNT].clone()  # a view would keep all channels
            error[by_y, by_x] = _merging_cost(wide, 1 << by_y + by_x, parallax, focal)
            wide = _sum_pairs(wide, COLUMNS) if by_x < levels else wide
        dense = _sum_pairs(dense, ROWS) if by_y < levels else dense
    return count, error


def partition(cells: Cells, price: float) -> Int[Tensor, "gaussian"]:
    """The group of each Gaussian, -1: left alone, of least summed error + `price` a group."""
    choices, _ = _best_choices(cells, price)
    view, row, column = cells.pixel
    group = torch.full((cells.total,), -1, dtype=torch.long, device=view.device)
    walking = torch.arange(view.numel(), device=view.device)
    by_y, by_x = (torch.full_like(view, cells.levels) for _ in range(2))
    table, first, wide = _concatenated(choices)
    merged, keys = [], []
    while True:  # from the largest cell down, a halving at a time
        level = by_y * (cells.levels + 1) + by_x
        down, along = row[walking] >> by_y, column[walking] >> by_x
        cell = (
            first[level]
            + (view[walking] * wide[level, 0] + down) * wide[level, 1]
            + along
        )
        choice = table[cell]
        merged.append(walking[choice == MERGE])
        keys.append(cell[choice == MERGE])
        by_y = by_y - (choice == ALONG_Y).long()
        by_x = by_x - (choice == ALONG_X).long()
        further = (choice == ALONG_X) | (choice == ALONG_Y)
        walking, by_y, by_x = walking[further], by_y[further], by_x[further]
        if not walking.numel():
            break
    group[cells.inside[torch.cat(merged)]] = torch.unique(
        torch.cat(keys), return_inverse=True
    )[1]
    return group


def scene_price(cells: Cells, settings: SimplifySettings) -> float:
    """Return the price that suits the scene: the mean error of merging 2x2 pixels, so that sharp
    scenes stay sharp.

    Where the finest detail is strong, photos were noisy or do not fit together, and the
    reconstruction is off by as much. Where it is faint, the same error would be the worst of the
    view. Flat scenes pay `LEAST_PRICE` at least.
    """
    errors = cells.error[1, 1][cells.count[1, 1] > 1]
    errors = errors[errors.isfinite()].double()
    mean = float(errors.mean()) if errors.numel() else 0.0
    return min(
        max(settings.relative_price * mean, LEAST_PRICE * settings.price),
        settings.price,
    )


def count_left(cells: Cells, price: float) -> int:
    """Return how many Gaussians `partition` leaves; the number falls with the price."""
    return (
        cells.total
        - cells.inside.numel()
        + round(float(_best_choices(cells, price)[1].sum()))
    )


def price_for_count(cells: Cells, most: int) -> float:
    """The lowest price, to a few percent, that leaves at most `most`, or the highest there is."""
    low, high = LOWEST_PRICE, HIGHEST_PRICE
    while high / low > PRICE_STEP:
        middle = (low * high) ** 0.5
        low, high = (
            (low, middle) if count_left(cells, middle) <= most else (middle, high)
        )
    return high


def _best_choices(
    cells: Cells, price: float
) -> tuple[dict[tuple[int, int], Tensor], Tensor]:
    """MERGE, ALONG_X, ALONG_Y or STAY for every cell by level; Gaussians left per largest cell."""
    cost: dict[tuple[int, int], Tensor] = {}
    left: dict[tuple[int, int], Tensor] = {}
    choices: dict[tuple[int, int], Tensor] = {}
    sides = range(cells.levels + 1)
    for level in sorted(((by_y, by_x) for by_y in sides for by_x in sides), key=sum):
        count = cells.count[level]
        least = torch.where(count > 1, cells.error[level] + price, torch.inf)
        number = torch.ones_like(count)
        choice = torch.full_like(count, MERGE, dtype=torch.int8)
        for other, its_cost, its_number in _alternatives(
            cells, price, level, cost, left
        ):
            better = its_cost < least
            least = torch.where(better, its_cost, least)
            number = torch.where(better, its_number, number)
            choice.masked_fill_(better, other)
        cost[level], left[level], choices[level] = least, number, choice
    return choices, left[level]


def _alternatives(
    cells: Cells, price: float, level: tuple[int, int], cost: dict, left: dict
) -> Iterator[tuple[int, Tensor, Tensor]]:
    """Yield what may be done instead of merging a cell: choice, cost and Gaussians left."""
    by_y, by_x = level
    if by_x:
        yield (
            ALONG_X,
            _sum_pairs(cost[by_y, by_x - 1], COLUMNS),
            _sum_pairs(left[by_y, by_x - 1], COLUMNS),
        )
    if by_y:
        yield (
            ALONG_Y,
            _sum_pairs(cost[by_y - 1, by_x], ROWS),
            _sum_pairs(left[by_y - 1, by_x], ROWS),
        )
    if level == (0, 0):
        yield STAY, price * cells.count[level], cells.count[level]


def _concatenated(
    choices: dict[tuple[int, int], Tensor],
) -> tuple[Tensor, Tensor, Tensor]:
    """All choices in one row, where each level starts in it, and its rows and columns."""
    tables = [choices[level] for level in sorted(choices)]
    sizes = torch.tensor(
        [0] + [table.numel() for table in tables[:-1]], device=tables[0].device
    )
    wide = torch.tensor([table.shape[1:] for table in tables], device=tables[0].device)
    return torch.cat([table.flatten() for table in tables]), sizes.cumsum(0), wide


def _sum_per_pixel(
    sums: Iterable[Float[Tensor, "member"]],
    place: Int[Tensor, "member"],
    shape: tuple[int, int, int],
) -> Float[Tensor, "channel view row column"]:
    """Sums of what falls on one pixel; `place`: flat index in `shape` (views, rows, columns)."""
    total = torch.zeros((CHANNELS, *shape), device=place.device)
    for own, channel in zip(total, sums):
        own.view(-1).index_add_(0, place, channel)
    return total


def _padded(
    position: Int[Tensor, "member"], size: int, side: int
) -> tuple[Int[Tensor, "member"], int]:
    """Positions on an axis that begins and ends at multiples of `side`, and its length."""
    first, last = (
        (0, size - 1)
        if position.numel() == 0
        else (min(0, int(position.min())), int(position.max()))
    )
    start = first // side * side
    return position - start, -(-(max(last, size - 1) + 1 - start) // side) * side


def _near_images(
    placement: Placement, height: int, width: int
) -> Bool[Tensor, "gaussian"]:
    """Which Gaussians lie in front of their camera, at most `MARGIN` outside of its image."""
    near_x = (placement.x >= -int(MARGIN * width)) & (
        placement.x < width + int(MARGIN * width)
    )
    near_y = (placement.y >= -int(MARGIN * height)) & (
        placement.y < height + int(MARGIN * height)
    )
    return near_x & near_y & (placement.depth > 0)


def _sum_pairs(values: Float[Tensor, "*shape"], dim: int) -> Float[Tensor, "*half"]:
    """Add neighbours two by two along ROWS or COLUMNS."""
    first, second = values.unflatten(dim, (-1, 2)).unbind(dim)
    return first + second


def _pixel_sums(
    x: Float[Tensor, "gaussian"],
    y: Float[Tensor, "gaussian"],
    disparity: Float[Tensor, "gaussian"],
    colours: Float[Tensor, "gaussian 3"],
    weight: Float[Tensor, "gaussian"],
) -> Iterator[Float[Tensor, "gaussian"]]:
    """Yield the moments of single Gaussians, a channel at a time; those of a cell are their sum.

    Channels: count, weight, then weighted: 5 moments of (x, y), the four values (colour,
    disparity), their squares (colour in one), the values by x, by y.
    """
    values = (*colours.unbind(-1), disparity)
    yield torch.ones_like(weight)
    yield weight
    for position in (
        x,
        y,
        x * x,
        y * y,
        x * y,
        *values,
        colours.square().sum(-1),
        disparity.square(),
    ):
        yield weight * position
    for place in (x, y):
        yield from (weight * (value * place) for value in values)


def _merging_cost(
    sums: Float[Tensor, "channel view row column"],
    area: int,
    parallax: float,
    focal: float,
) -> Float[Tensor, "view row column"]:
    """Return the squared error, summed over a cell's pixels, of merging its Gaussians; infinite
    where they must not.

    Colour: what its mean leaves over, where a linear change counts `GRADIENT_SHARE` only, because
    neighbouring Gaussians blend into each other. Depth: what no plane explains (a plane's disparity
    is linear in the image), as pixels that the surface moves by between the views. `area` [pixels]
    is that of each cell; `parallax` and `focal` [pixels] are the distance between the views and one
    scene unit, each at camera z = 1.
    """
    weight = sums[WEIGHT]
    mean_x, mean_y, xx, yy, xy, *moments = sums[2:] / weight.clamp(min=1e-12)
    # A pixel is not a point: its own extent keeps the fit of few pixels from being exact.
    var_x = xx - mean_x**2 + 1 / 12
    var_y = yy - mean_y**2 + 1 / 12
    cov = xy - mean_x * mean_y
    steepness = 1 / (var_x * var_y - cov * cov).clamp(min=1e-12)
    values, squares = moments[:VALUES], moments[VALUES : VALUES + 2]

    def fitted(index: int) -> Float[Tensor, "view row column"]:
        """Return the variance of a value that a linear function of (x, y) explains."""
        by_x, by_y = moments[6 + index], moments[6 + VALUES + index]
        along_x, along_y = by_x - values[index] * mean_x, by_y - values[index] * mean_y
        return (
            along_x * (var_y * along_x - 2 * cov * along_y) + var_x * along_y * along_y
        ) * steepness

    linear = fitted(0) + fitted(1) + fitted(2)
    unequal = squares[0] - values[0] ** 2 - values[1] ** 2 - values[2] ** 2
    colour = (unequal - (1 - GRADIENT_SHARE) * linear).clamp(min=0) / 3
    disparity = values[3]
    spread = (squares[1] - disparity**2).clamp(min=0)
    bent = (spread - fitted(3)).clamp(min=0)
    error = weight * (colour + (EDGE * parallax) ** 2 * bent)
    steep = spread * focal**2 > STEEPEST**2 * (var_x + var_y) * disparity**2
    refused = (steep & (spread * parallax**2 > STILL**2)) | (
        sums[COUNT] < LEAST_FILL * area
    )
    return error.masked_fill_(refused, torch.inf)
