"""The partition is the best there is, and the price is its dial."""

from functools import cache

import pytest
import torch
from edit3r_refiners import partition as module
from edit3r_refiners.merging import place
from edit3r_refiners.partition import (
    Cells,
    count_left,
    measure_cells,
    partition,
    price_for_count,
    scene_price,
)
from edit3r_refiners.settings import SimplifySettings

from .scenes import cameras_side_by_side, gaussian_per_pixel

LEVELS = 2


@pytest.fixture
def cells():
    """A picture of noise: every cell has an error of its own."""
    colours = torch.rand(1, 3, 8, 8, generator=torch.Generator().manual_seed(0))
    return measured(colours, torch.full((1, 8, 8), 2.0))


@pytest.fixture(autouse=True)
def few_levels(monkeypatch):
    monkeypatch.setattr(module, "LARGEST_CELL", LEVELS)


def measured(colours, depths, parallax=10.0) -> Cells:
    cameras = cameras_side_by_side(1, depths.shape[1:])
    # pixels as narrow as those of a large picture
    cameras.intrinsics[..., :2, :2] *= 20
    gaussians = gaussian_per_pixel(colours, depths, cameras)
    placement = place(gaussians, cameras)
    flat = colours[0].permute(1, 2, 0).reshape(-1, 3)
    return measure_cells(placement, flat, gaussians.opacities[0], cameras, parallax)


def best_cost_by_trying_all(cells: Cells, price: float) -> float:
    """The definition, by recursion over one rectangle at a time."""

    @cache
    def best(by_y: int, by_x: int, row: int, column: int) -> float:
        error = cells.error[by_y, by_x][0, row, column] if by_y + by_x else 0.0
        options = [price + float(error)]
        if by_y:
            halves = (best(by_y - 1, by_x, 2 * row + i, column) for i in (0, 1))
            options.append(sum(halves))
        if by_x:
            halves = (best(by_y, by_x - 1, row, 2 * column + i) for i in (0, 1))
            options.append(sum(halves))
        return min(options)

    side = 8 >> LEVELS
    return sum(
        best(LEVELS, LEVELS, row, column)
        for row in range(side)
        for column in range(side)
    )


def cost_of(group: torch.Tensor, cells: Cells, price: float) -> float:
    """Error and price of a grouping, each group's cell found from its members."""
    cost = price * int((group < 0).sum())
    _, row, column = cells.pixel
    for one in group[group >= 0].unique():
        rows, columns = row[group == one], column[group == one]
        by_y, by_x = (
            int(p.max() - p.min() + 1).bit_length() - 1 for p in (rows, columns)
        )
        cost += price + float(
            cells.error[by_y, by_x][0, int(rows[0]) >> by_y, int(columns[0]) >> by_x]
        )
    return cost


@pytest.mark.parametrize("price", [0.003, 0.03, 0.1, 0.3])
def test_no_other_dyadic_partition_costs_less(cells, price):
    group = partition(cells, price)
    assert cost_of(group, cells, price) == pytest.approx(
        best_cost_by_trying_all(cells, price), rel=1e-5
    )


def test_count_left_is_what_partition_leaves_and_falls_with_the_price(cells):
    counts = []
    for price in (1e-4, 0.01, 0.05, 0.2, 10):
        group = partition(cells, price)
        assert (
            count_left(cells, price)
            == int((group < 0).sum()) + group[group >= 0].unique().numel()
        )
        counts.append(count_left(cells, price))
    assert counts == sorted(counts, reverse=True)
    assert counts[0] == 64
    assert counts[-1] == 4


@pytest.mark.parametrize("most", [4, 17, 40, 63])
def test_price_for_keeps_to_the_budget_and_uses_it(cells, most):
    price = price_for_count(cells, most)
    assert count_left(cells, price) <= most < count_left(cells, price / 1.05) + 1


def scene_price_of_noise(amplitude: float) -> float:
    noise = torch.rand(1, 3, 8, 8, generator=torch.Generator().manual_seed(1)) - 0.5
    cells = measured(0.5 + amplitude * noise, torch.full((1, 8, 8), 2.0))
    return scene_price(cells, SimplifySettings())


def test_the_price_of_a_scene_follows_the_variance_of_its_finest_detail_within_bounds():
    twice, once = scene_price_of_noise(0.12), scene_price_of_noise(0.06)
    assert twice == pytest.approx(4 * once, rel=1e-3)
    highest = SimplifySettings().price
    assert scene_price_of_noise(0) == pytest.approx(highest / 10)
    assert scene_price_of_noise(1) == highest


@pytest.mark.parametrize(("parallax", "bridged"), [(200.0, False), (0.5, True)])
def test_a_step_in_depth_is_bridged_at_no_price_but_where_it_hardly_moves(
    parallax, bridged
):
    depths = torch.full((1, 8, 8), 2.0)
    depths[:, :, 3:] = 4.0
    cells = measured(torch.full((1, 3, 8, 8), 0.5), depths, parallax=parallax)
    group = partition(cells, 1e6)
    near, merged = depths.flatten() == 2, group >= 0
    both = set(group[near].tolist()) & set(group[~near & merged].tolist())
    assert bool(both) == bridged
    assert bridged or merged.float().mean() > 0.8


def test_a_slanted_plane_is_one_cell():
    rows, columns = torch.meshgrid(torch.arange(8.0), torch.arange(8.0), indexing="ij")
    depths = 1 / (0.3 + 0.001 * rows + 0.002 * columns)[None]
    cells = measured(torch.full((1, 3, 8, 8), 0.5), depths, parallax=200.0)
    assert count_left(cells, 0.01) == 4


def test_gaussians_far_outside_the_pictures_stay_themselves():
    cameras = cameras_side_by_side(1, (8, 8))
    grey, depths = torch.full((1, 3, 8, 8), 0.5), torch.full((1, 8, 8), 2.0)
    gaussians = gaussian_per_pixel(grey, depths, cameras)
    gaussians.means[0, :3] = torch.tensor([[100.0, 0, 2], [0, 0, -3], [0, -50, 1]])
    colours, opacities = torch.full((64, 3), 0.5), gaussians.opacities[0]
    where = place(gaussians, cameras)
    cells = measure_cells(where, colours, opacities, cameras, 1.0)
    group = partition(cells, 1.0)
    assert (group[:3] == -1).all() and (group[3:] >= 0).all()


def test_cells_hold_no_more_memory_than_they_say(cells):
    """A count that is a view of its pixels' sums would keep all of their channels."""
    sums = torch.rand(module.CHANNELS, 1, 8, 8)
    block = module._measure_block(sums, 10.0, 1.0)
    for tables in (cells.count, cells.error, *block):
        for table in tables.values():
            assert table.untyped_storage().nbytes() == table.numel() * 4


def test_views_measured_a_few_at_a_time_have_the_same_cells(monkeypatch):
    cameras = cameras_side_by_side(3, (8, 8))
    draw = torch.Generator().manual_seed(0)
    colours = torch.rand(3, 3, 8, 8, generator=draw)
    gaussians = gaussian_per_pixel(colours, torch.full((3, 8, 8), 2.0), cameras)
    flat = colours.permute(0, 2, 3, 1).reshape(-1, 3)
    weight, where = gaussians.opacities[0], place(gaussians, cameras)
    given = where, flat, weight, cameras, 10.0
    together = measure_cells(*given)
    monkeypatch.setattr(module, "VIEWS_AT_ONCE", 2)
    apart = measure_cells(*given)
    for kind in ("count", "error"):
        tables = getattr(together, kind), getattr(apart, kind)
        assert tables[0].keys() == tables[1].keys()
        assert all(torch.equal(tables[0][key], tables[1][key]) for key in tables[0])
