"""What an earlier view shows is not needed twice."""

from dataclasses import replace

import pytest
import torch
from edit3r_refiners import merging
from edit3r_refiners.merging import duplicates, merge_groups, place
from edit3r_refiners.settings import SimplifySettings

from edit3r.kit.geometry.harmonics import colour_to_dc

from .scenes import cameras_side_by_side, flat_wall, gaussian_per_pixel


def found(gaussians, cameras):
    alike_up_to = SimplifySettings().duplicate_colour
    return duplicates(gaussians, cameras, place(gaussians, cameras), alike_up_to)


def test_the_second_view_of_a_wall_keeps_only_what_the_first_does_not_show():
    gaussians, cameras = flat_wall(views=2)
    twice = found(gaussians, cameras)
    first, second = twice.view(2, 64, 64)
    assert not first.any()
    # disparity of the wall [pixels]
    shift = round(0.1 / 2.0 * float(cameras.intrinsics[0, 0, 0, 0]) * 64)
    assert second[:, : 64 - shift - 1].all() and not second[:, 64 - shift + 1 :].any()


def test_another_colour_or_another_depth_is_no_duplicate():
    gaussians, cameras = flat_wall(views=2)
    second = gaussians.view_index == 1
    red = replace(gaussians, harmonics=gaussians.harmonics.clone())
    red.harmonics[:, second] = colour_to_dc(torch.tensor([0.9, 0.1, 0.1]))
    assert not found(red, cameras).any()
    nearer = replace(gaussians, means=gaussians.means.clone())
    nearer.means[:, second, 2] -= 0.5
    assert not found(nearer, cameras).any()


def test_a_view_from_closer_by_keeps_its_finer_pixels():
    cameras = cameras_side_by_side(2, (32, 32), step=0.0)
    cameras.c2w[0, 1, 2, 3] = 1.0
    depths = torch.stack((torch.full((32, 32), 2.0), torch.full((32, 32), 1.0)))
    gaussians = gaussian_per_pixel(torch.full((2, 3, 32, 32), 0.6), depths, cameras)
    assert not found(gaussians, cameras).any()


def test_of_three_views_of_one_place_only_the_first_stays():
    gaussians, cameras = flat_wall(views=3, size=16)
    cameras.c2w[0, :, 0, 3] = 0
    gaussians = gaussian_per_pixel(
        torch.full((3, 3, 16, 16), 0.6), torch.full((3, 16, 16), 2.0), cameras
    )
    assert found(gaussians, cameras).view(3, -1).all(1).tolist() == [False, True, True]


def test_transparent_gaussians_hide_no_duplicate():
    gaussians, cameras = flat_wall(views=2, size=16)
    faint = replace(gaussians, opacities=gaussians.opacities * 0.3)
    assert not found(faint, cameras).any()


def test_a_merged_gaussian_has_its_members_moments_and_covers_like_both(monkeypatch):
    """Means count by opacity; 1 - (1 - mean)^2 is what two of the mean opacity hide."""
    gaussians, cameras = flat_wall(size=2)
    opacities = torch.tensor([[0.6, 0.2, 0.5, 0.5]])
    gaussians = replace(gaussians, opacities=opacities)
    gaussians.harmonics[0, :, 0, 0] = torch.tensor([1.0, 5.0, 0.0, 0.0])
    group = torch.tensor([0, 0, -1, -1])
    monkeypatch.setattr(merging, "BEHIND", 0)
    merged = merge_groups(gaussians, group, cameras).select(torch.tensor([2]))
    share = torch.tensor([0.75, 0.25])
    expected = (share[:, None] * gaussians.means[0, :2]).sum(0)
    assert torch.allclose(merged.means[0, 0], expected, atol=1e-6)
    assert float(merged.harmonics[0, 0, 0, 0]) == pytest.approx(2)
    mean = 0.75 * 0.6 + 0.25 * 0.2
    assert float(merged.opacities) == pytest.approx(1 - (1 - mean) ** 2)
    monkeypatch.setattr(merging, "BEHIND", 1)
    behind = merge_groups(gaussians, group, cameras)
    away = behind.means[0, 2] - merged.means[0, 0]
    assert float(away[2]) > 0  # from the camera
    assert float(away.norm()) == pytest.approx(float(merged.scales.max()), rel=1e-4)


def test_merged_gaussians_come_after_those_that_stay_of_their_view():
    gaussians, cameras = flat_wall(views=2, size=2)
    gaussians = gaussians.select(torch.tensor([0, 1, 2, 4, 5]))
    group = torch.tensor([0, 0, -1, -1, -1])
    result = merge_groups(gaussians, group, cameras)
    assert result.view_index.tolist() == [0, 0, 1, 1]
    kept = result.select(torch.tensor([0, 2, 3]))
    assert torch.equal(kept.means, gaussians.means[:, 2:])
