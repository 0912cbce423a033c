import torch
from edit3r_model.edited_views import find_correspondences, partner_views

from edit3r.kit.geometry.warping import warp
from edit3r_testing import photograph


def test_partner_of_every_view_is_the_reference_and_of_the_reference_view_1():
    assert partner_views(2) == [1, 0]
    assert partner_views(4) == [1, 0, 0, 0]


def test_true_geometry_pulls_the_same_colours_where_both_views_see_the_surface():
    scene = photograph(3, (48, 64))
    matches = find_correspondences(
        scene.depths, scene.views.intrinsics, scene.cameras.c2w
    )
    warped = warp(scene.views.images[:, partner_views(3)], matches.coordinates)
    both = (matches.inside > 0.5) & (matches.depth_ratio.abs() < 0.02)
    gap = (warped - scene.views.images).abs().mean(2)
    assert both.float().mean() > 0.5
    assert gap[both].mean() < 0.03 < gap[~both].mean()


def test_points_in_front_of_what_the_partner_sees_have_a_negative_ratio():
    scene = photograph(2, (48, 64))
    depths = scene.depths.clone()
    depths[:, 0] *= 0.7
    matches = find_correspondences(depths, scene.views.intrinsics, scene.cameras.c2w)
    inside = matches.inside[:, 0] > 0.5
    assert matches.depth_ratio[:, 0][inside].median() < -0.2


def test_points_behind_the_partner_are_outside_and_finite():
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1] = torch.diag(torch.tensor([-1.0, 1, -1, 1]))  # looks the other way
    k = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
    matches = find_correspondences(torch.ones(1, 2, 4, 4), k, c2w)
    assert (matches.inside == 0).all() and matches.coordinates.isfinite().all()
