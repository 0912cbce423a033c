"""What shows outside the edited region stays as it was; what shows inside alone takes the edit."""

from dataclasses import replace

import pytest
import torch
from edit3r_refiners.keep_outside_mask import (
    FIELDS,
    differing,
    insert_edit,
    median_scale,
)

from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.paths import between_and_around
from edit3r_testing.scenes import photograph

from .scenes import gaussian_per_pixel

SAME = 1e-6


@pytest.fixture
def edit():
    """Scenes before and after all colours were inverted, the region of the first ball, and the
    cameras.
    """
    scene = photograph(2, (48, 64))
    images, depths, cameras = scene.views.images[0], scene.depths[0], scene.cameras
    before, after = (
        gaussian_per_pixel(colours, depths, cameras) for colours in (images, 1 - images)
    )
    around = torch.nn.functional.max_pool2d(scene.objects[0, 0][:, None], 7, 1, 3)[:, 0]
    return before, after, around > 0, cameras


def pictures(rasterizer, gaussians, cameras):
    with torch.no_grad():
        return rasterizer.render(gaussians, cameras)


def largest_change(rasterizer, before, after, cameras, counted) -> float:
    old, new = (pictures(rasterizer, g, cameras).images[0] for g in (before, after))
    return float((new - old).abs().amax(1)[counted].amax())


def rows_of(gaussians) -> set[tuple[float, ...]]:
    """All numbers of each Gaussian, so that two scenes' Gaussians can be compared bit for bit."""
    columns = [getattr(gaussians, name)[0, :, None].flatten(1) for name in FIELDS]
    return set(map(tuple, torch.cat(columns, 1).tolist()))


def test_pixels_outside_the_region_render_as_before(rasterizer, edit):
    before, after, region, cameras = edit
    edited = insert_edit(before, after, region, cameras, rasterizer)
    assert largest_change(rasterizer, before, edited, cameras, ~region) <= SAME


def test_new_views_are_as_before_where_only_unchanged_gaussians_are_met(
    rasterizer, edit
):
    before, after, region, cameras = edit
    result = insert_edit(before, after, region, cameras, rasterizer)
    changed = differing(before, result)
    path = between_and_around(cameras, 4)
    touched = Gaussians.cat((before.select(changed), result.select(changed)))
    unmet = pictures(rasterizer, touched, path).alphas[0, :, 0] == 0
    assert 0.3 < float(unmet.float().mean()) < 1
    assert largest_change(rasterizer, before, result, path, unmet) <= SAME


def test_inside_the_region_the_edit_arrives(rasterizer, edit):
    before, after, region, cameras = edit
    edited = insert_edit(before, after, region, cameras, rasterizer)
    outside = torch.nn.functional.max_pool2d((~region).float()[:, None], 9, 1, 4)
    inner = outside[:, 0] == 0
    wanted, got, old = (
        pictures(rasterizer, g, cameras).images[0] for g in (after, edited, before)
    )
    missing, asked = ((x - wanted).abs().mean(1)[inner].mean() for x in (got, old))
    assert inner.any() and float(missing / asked) < 0.05


def test_gaussians_that_stay_are_bit_equal_and_in_place(rasterizer, edit):
    before, after, region, cameras = edit
    result = insert_edit(before, after, region, cameras, rasterizer)
    changed = differing(before, result)
    assert int(changed.sum()) > 100
    for name in FIELDS:
        kept, given = (getattr(g, name)[:, changed] for g in (result, after))
        assert torch.equal(kept, given), name


def test_larger_gaussians_that_would_reach_over_the_border_are_not_taken(
    rasterizer, edit
):
    before, after, region, cameras = edit
    larger = replace(after, scales=after.scales * 2)
    result = insert_edit(before, larger, region, cameras, rasterizer)
    assert int(differing(before, result).sum()) > 50
    assert largest_change(rasterizer, before, result, cameras, ~region) <= SAME


def test_another_reconstruction_with_other_gaussians_keeps_the_outside_too(
    rasterizer, edit
):
    before, after, region, cameras = edit
    order = torch.randperm(after.count, generator=torch.Generator().manual_seed(0))
    fewer = after.select(order[: after.count // 2])
    result = insert_edit(before, fewer, region, cameras, rasterizer)
    assert largest_change(rasterizer, before, result, cameras, ~region) <= SAME
    stayed, came = (rows_of(result) & rows_of(scene) for scene in (before, fewer))
    assert len(came) > 50
    assert before.count - len(stayed) > 50
    assert len(stayed) + len(came) == result.count


def test_an_answer_in_another_unit_of_length_is_brought_to_the_scene_s(
    rasterizer, edit
):
    before, after, region, cameras = edit
    doubled = replace(after, means=after.means * 2, scales=after.scales * 2)
    result = insert_edit(before, doubled, region, cameras, rasterizer)
    plain = insert_edit(before, after, region, cameras, rasterizer)
    changed = differing(before, plain)
    assert torch.allclose(result.means[:, changed], plain.means[:, changed], rtol=1e-5)


def test_an_empty_region_changes_nothing(rasterizer, edit):
    before, after, region, cameras = edit
    result = insert_edit(before, after, torch.zeros_like(region), cameras, rasterizer)
    assert not differing(before, result).any()


@pytest.mark.parametrize("same", [True, False], ids=["counterparts", "sets"])
def test_what_shows_in_no_photo_takes_the_edit(rasterizer, edit, same):
    before, after, region, cameras = edit

    def with_hidden(gaussians, count):
        some = gaussians.select(torch.arange(count))
        away = replace(some, means=some.means + torch.tensor([100.0, 0.0, 0.0]))
        return Gaussians.cat((gaussians, away))

    old, new = with_hidden(before, 20), with_hidden(after, 20 if same else 15)
    result = insert_edit(old, new, region, cameras, rasterizer)
    hidden = [scene.select(scene.means[0, :, 0] > 50) for scene in (old, new, result)]
    assert not rows_of(hidden[2]) & rows_of(hidden[0])
    assert rows_of(hidden[2]) == rows_of(hidden[1])
    assert largest_change(rasterizer, old, result, cameras, ~region) <= SAME


def test_the_scale_between_two_units_is_that_of_the_points():
    points = torch.randn(5, 3, generator=torch.Generator().manual_seed(0))
    assert torch.isclose(median_scale(points, 0.5 * points), torch.tensor(0.5))
    assert median_scale(points[:0], points[:0]) == 1
