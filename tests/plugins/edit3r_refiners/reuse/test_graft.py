"""What shows outside the edited region stays as it was; what shows inside alone takes the edit."""

from dataclasses import replace

import pytest
import torch
from edit3r_refiners.keep_outside_mask import differing, graft

from edit3r.geometry.harmonics import dc_to_colour
from edit3r.geometry.paths import between_and_around
from edit3r.types import Gaussians, Views

SAME = 1e-6


@pytest.fixture
def edit(planted):
    """Scenes before and after all colours were inverted, and the region of the first ball."""
    before = planted.reconstruct(planted.views)
    inverted = Views(1 - planted.views.images, planted.views.intrinsics)
    return before.gaussians, planted.reconstruct(inverted).gaussians, planted.masks[0, 0] > 0, before.cameras


def pictures(rasterizer, gaussians, cameras):
    with torch.no_grad():
        return rasterizer.render(gaussians, cameras)


def largest_change(rasterizer, before, after, cameras, counted) -> float:
    change = pictures(rasterizer, after, cameras).images - pictures(rasterizer, before, cameras).images
    return float(change[0].abs().amax(1)[counted].amax())


def test_pixels_outside_the_region_render_as_before(rasterizer, edit):
    before, after, region, cameras = edit
    grafted = graft(before, after, region, cameras, rasterizer).gaussians
    assert largest_change(rasterizer, before, grafted, cameras, ~region) <= SAME


def test_new_views_are_as_before_where_only_unchanged_gaussians_are_met(rasterizer, edit):
    before, after, region, cameras = edit
    result = graft(before, after, region, cameras, rasterizer)
    path = between_and_around(cameras, 4)
    touched = Gaussians.cat((result.removed, result.inserted))
    unmet = pictures(rasterizer, touched, path).alphas[0, :, 0] == 0
    assert 0.3 < float(unmet.float().mean()) < 1
    assert largest_change(rasterizer, before, result.gaussians, path, unmet) <= SAME


def test_inside_the_region_the_edit_arrives(rasterizer, edit):
    before, after, region, cameras = edit
    grafted = graft(before, after, region, cameras, rasterizer).gaussians
    inner = torch.nn.functional.max_pool2d((~region).float()[:, None], 9, 1, 4)[:, 0] == 0
    wanted, got, old = (pictures(rasterizer, g, cameras).images[0] for g in (after, grafted, before))
    missing = (got - wanted).abs().mean(1)[inner].mean() / (old - wanted).abs().mean(1)[inner].mean()
    assert inner.any() and float(missing) < 0.05


def test_gaussians_that_stay_are_bit_equal_and_in_place(rasterizer, edit):
    before, after, region, cameras = edit
    result = graft(before, after, region, cameras, rasterizer)
    changed = differing(before, result.gaussians)
    assert int(changed.sum()) == result.removed.count == result.inserted.count > 100
    assert torch.equal(result.gaussians.harmonics[:, changed], after.harmonics[:, changed])


def test_larger_gaussians_that_would_reach_over_the_border_are_not_taken(rasterizer, edit):
    before, after, region, cameras = edit
    larger = replace(after, scales=after.scales * 2)
    result = graft(before, larger, region, cameras, rasterizer)
    assert result.inserted.count > 50
    assert largest_change(rasterizer, before, result.gaussians, cameras, ~region) <= SAME


def test_another_reconstruction_with_other_gaussians_keeps_the_outside_too(rasterizer, edit):
    before, after, region, cameras = edit
    fewer = after.select(torch.randperm(after.count, generator=torch.Generator().manual_seed(0))[: after.count // 2])
    result = graft(before, fewer, region, cameras, rasterizer)
    assert largest_change(rasterizer, before, result.gaussians, cameras, ~region) <= SAME
    assert result.inserted.count > 50 and result.removed.count > 50
    colours = dc_to_colour(result.inserted.harmonics[0, :, 0])
    assert any(torch.equal(colours[0], colour) for colour in dc_to_colour(fewer.harmonics[0, :, 0]))


def test_an_answer_in_another_unit_of_length_is_brought_to_the_scene_s(rasterizer, edit):
    before, after, region, cameras = edit
    doubled = replace(after, means=after.means * 2, scales=after.scales * 2)
    result = graft(before, doubled, region, cameras, rasterizer)
    plain = graft(before, after, region, cameras, rasterizer)
    assert torch.allclose(result.inserted.means, plain.inserted.means, rtol=1e-5)


def test_an_empty_region_changes_nothing(rasterizer, edit):
    before, after, region, cameras = edit
    result = graft(before, after, torch.zeros_like(region), cameras, rasterizer)
    assert result.inserted.count == 0 and not differing(before, result.gaussians).any()
