"""EditSplat's fusion of edits through the geometry, and its trimming of attended Gaussians."""

from dataclasses import replace

import pytest
import torch
from edit3r_optimisers.editsplat import (
    OWN_WEIGHT,
    attention_maps,
    attention_of,
    fuse,
    nearest_views,
    trim,
)

from edit3r.contract.interfaces import GivesAttention
from edit3r.contract.types import EditRequest, Views
from edit3r_testing.scenes import cameras_around, gaussian_cloud, photograph


@pytest.fixture(scope="module")
def scene():
    return photograph(4, (48, 64))


def test_neighbours_are_the_nearest_cameras_without_the_view_itself(scene):
    assert nearest_views(scene.cameras, 0, 2) == [1, 2]
    assert nearest_views(scene.cameras, 3, 9) == [2, 1, 0]


def test_photos_fused_through_the_true_depth_are_the_photo(scene):
    """No edit: what neighbours say of a view must be the view, nearly, where they look at it."""
    photos, depths = scene.views.images[0], scene.depths[0]
    image, support = fuse(0, [1, 2], photos, depths, scene.cameras)
    seen = support > 0.5
    assert seen.float().mean() > 0.6
    assert (image - scene.views.images[0, 0]).abs().mean(0)[seen].mean() < 0.01


def test_where_no_neighbour_looks_the_own_edit_stays(scene):
    image, support = fuse(0, [2], scene.views.images[0], scene.depths[0], scene.cameras)
    alone = support < 1e-6
    own = scene.views.images[0, 0][:, alone]
    assert alone.any() and torch.allclose(image[:, alone], own)


def test_disagreeing_edits_are_averaged_by_weight(scene):
    edits = torch.zeros(4, 3, 48, 64)
    edits[1] = 1
    image, support = fuse(0, [1], edits, scene.depths[0], scene.cameras)
    exact = support / (support + OWN_WEIGHT)
    assert torch.allclose(image, exact.expand(3, -1, -1), atol=1e-6)
    assert exact.max() > 0.75


def test_what_a_ball_hides_from_a_neighbour_is_not_taken_from_it(scene):
    """Paint the balls in view 1 only; the wall behind them in view 0 must not catch the paint."""
    balls = scene.objects[:, 0].amax(0)
    edits = torch.zeros(4, 3, 48, 64)
    edits[1] = balls[1]
    painted = fuse(0, [1], edits, scene.depths[0], scene.cameras)[0][0]
    assert painted[balls[0] == 0].mean() < 0.02 and painted[balls[0] == 1].mean() > 0.5


def test_only_the_most_attended_share_of_the_attended_goes():
    attention = torch.tensor([0.1, 0.9, 0.6, 0.2, 0.8, 0.7])
    for share, left in ((0.5, [0, 2, 3, 5]), (1, [0, 3])):
        kept = trim(attention, share=share, threshold=0.5)
        assert kept.nonzero().flatten().tolist() == left
    assert trim(attention, share=0, threshold=0.5).all()
    assert trim(attention, share=1, threshold=0.95).all()


def test_attention_is_the_mean_of_the_map_over_the_pixels_a_gaussian_draws(rasterizer):
    """Against its definition: paint one Gaussian white and the others black, and average the map by
    what is seen.
    """
    scene, cameras = gaussian_cloud(8, degree=0), cameras_around(2)
    draw = torch.Generator().manual_seed(0)
    maps = torch.rand(1, 2, *cameras.image_size, generator=draw)
    attention = attention_of(scene, cameras, maps, rasterizer)[0]
    for one in range(8):
        harmonics = torch.full_like(scene.harmonics, -0.5 / 0.28209479177387814)
        harmonics[:, one] *= -1
        painted = replace(scene, harmonics=harmonics)
        weight = rasterizer.render(painted, cameras).images[:, :, 0].double()
        if weight.sum() > 0.5:
            expected = float((weight * maps).sum() / weight.sum())
            assert float(attention[one]) == pytest.approx(expected, abs=1e-3)


def test_a_gaussian_that_is_not_seen_is_not_attended(rasterizer):
    scene, cameras = gaussian_cloud(4), cameras_around(1)
    behind = replace(scene, means=-scene.means)
    maps = torch.ones(1, 1, *cameras.image_size)
    assert not attention_of(behind, cameras, maps, rasterizer).any()


@pytest.fixture
def views() -> tuple[Views, Views]:
    photos = Views(torch.full((1, 1, 3, 2, 2), 0.5), torch.eye(3).expand(1, 1, 3, 3))
    images = photos.images.clone()
    images[..., 0, 0] += 0.2
    images[..., 1, 1] += 0.1
    return photos, Views(images, photos.intrinsics)


def test_without_attention_or_masks_the_change_of_each_pixel_tells(views, editor):
    maps, told_by = attention_maps(editor, *views, EditRequest("x"))
    assert torch.allclose(maps, torch.tensor([[[[1, 0], [0, 0.5]]]]))
    assert "no attention" in told_by


def test_masks_come_before_change_and_the_editors_own_attention_before_both(
    views, editor
):
    masks = torch.tensor([[[[0, 0.5], [0, 0.5]]]])
    maps, told_by = attention_maps(editor, *views, EditRequest("x", masks=masks))
    assert torch.equal(maps, 2 * masks) and "masks" in told_by

    class Attentive(type(editor), GivesAttention):
        def attention(self, views, request):
            return torch.tensor([[[[3.0, 0], [0, 0]]]])

    maps, told_by = attention_maps(Attentive(), *views, EditRequest("x", masks=masks))
    assert maps.flatten().tolist() == [1, 0, 0, 0] and "cross-attention" in told_by
