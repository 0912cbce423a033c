from dataclasses import replace

import pytest
import torch

import edit3r
from edit3r.contract.types import Cameras, EditRequest, Features, Gaussians, Views
from edit3r_testing.scenes import balls, gaussian_cloud


def gaussians(view_index=None, count=6, batch=2):
    cloud = gaussian_cloud(count, batch)
    return cloud if view_index is None else replace(cloud, view_index=view_index)


def test_public_names_are_the_core_types():
    assert edit3r.Views is Views and edit3r.Gaussians is Gaussians
    assert set(edit3r.__all__) >= {
        "build",
        "components",
        "load_views",
        "run",
        "save_ply",
        "load_ply",
        "hookimpl",
    }


def test_a_wrong_shape_is_an_error_that_names_field_expected_and_given():
    with pytest.raises(
        ValueError,
        match=r"Views.intrinsics: expected shape \[1, 2, 3, 3\], got \[1, 3, 3, 3\]",
    ):
        Views(torch.zeros(1, 2, 3, 4, 5), torch.zeros(1, 3, 3, 3))
    with pytest.raises(ValueError, match=r"Cameras\.image_size"):
        Cameras(torch.zeros(1, 1, 4, 4), torch.zeros(1, 1, 3, 3), (0, 4))
    with pytest.raises(ValueError, match="harmonics: expected K in"):
        replace(gaussians(), harmonics=torch.zeros(2, 6, 5, 3))
    with pytest.raises(ValueError, match=r"Features\.levels"):
        Features((torch.zeros(1, 2, 5, 8),), grid=(2, 3))
    with pytest.raises(ValueError, match=r"EditRequest\.masks"):
        EditRequest("x", masks=torch.zeros(2, 4, 4))


def test_from_view_and_without_view_split_the_gaussians():
    scene = gaussians(torch.tensor([0, 0, 1, 1, -1, 1]))
    assert scene.from_view(1).count == 3 and scene.without_view(1).count == 3
    assert torch.equal(scene.from_view(0).means, scene.means[:, :2])
    joined = Gaussians.cat([scene.from_view(1), scene.without_view(1)])
    assert torch.equal(joined.means.sort(1).values, scene.means.sort(1).values)
    assert joined.view_index.tolist() == [1, 1, 1, 0, 0, -1]


def test_objects_follow_selecting_and_joining():
    index = torch.tensor([0, 0, 1, -1, 1, 2])
    scene = replace(gaussians(), object_index=index)
    assert scene.select(index == 1).object_index.tolist() == [1, 1]
    joined = Gaussians.cat([scene.select(torch.tensor([5, 3])), gaussians(count=2)])
    assert joined.object_index.tolist() == [2, -1, -1, -1]
    assert Gaussians.cat([gaussians(), gaussians()]).object_index is None
    with pytest.raises(ValueError, match=r"Gaussians\.object_index"):
        replace(scene, object_index=index[:2])


def test_uncertainty_follows_selecting_and_joining():
    number = torch.rand(2, 6)
    scene = replace(gaussians(), uncertainty=number)
    chosen = torch.tensor([4, 1])
    assert torch.equal(scene.select(chosen).uncertainty, number[:, chosen])
    joined = Gaussians.cat([scene, gaussians()]).uncertainty
    assert torch.equal(joined, torch.cat([number, torch.ones(2, 6)], 1))
    assert Gaussians.cat([gaussians(), gaussians()]).uncertainty is None
    with pytest.raises(ValueError, match=r"Gaussians\.uncertainty"):
        replace(scene, uncertainty=number[0])


def test_without_view_index_no_gaussian_belongs_to_a_view():
    scene = gaussians()
    assert scene.from_view(0).count == 0 and scene.without_view(0).count == scene.count
    assert scene.degree == 1


def test_an_empty_scene_is_allowed():
    assert gaussians(count=0).count == 0


def test_to_changes_float_fields_and_keeps_indices_whole():
    scene = gaussians(torch.arange(6)).to(torch.float64)
    assert scene.means.dtype == torch.float64 and scene.view_index.dtype == torch.int64
    cameras = Cameras(
        torch.eye(4).repeat(1, 2, 1, 1), torch.eye(3).repeat(1, 2, 1, 1), (4, 5)
    )
    features = Features(
        (torch.zeros(1, 2, 6, 8),), (2, 3), cameras, {"camera": torch.zeros(1, 2, 1, 9)}
    ).to(torch.float64)
    assert features.levels[0].dtype == features.cameras.c2w.dtype == torch.float64
    assert features.tokens["camera"].dtype == torch.float64
    with pytest.raises(ValueError, match=r"tokens\['camera'\]: expected shape \[1, 2"):
        replace(features, tokens={"camera": torch.zeros(1, 3, 1, 9)})


def test_views_without_names_are_called_by_their_numbers():
    views = Views(torch.rand(1, 2, 3, 4, 4), torch.eye(3).expand(1, 2, 3, 3))
    assert views.called == ("view 0", "view 1")
    assert replace(views, names=("a", "b")).called == ("a", "b")


def test_views_select_keeps_names_with_their_pictures():
    views = Views(
        torch.arange(3.0).view(1, 3, 1, 1, 1).expand(1, 3, 3, 2, 2),
        torch.zeros(1, 3, 3, 3),
        ("a", "b", "c"),
    )
    chosen = views.select([2, 0])
    assert chosen.names == ("c", "a") and chosen.images[0, :, 0, 0, 0].tolist() == [
        2,
        0,
    ]
    assert chosen.c2w is None


def test_views_that_are_all_selected_are_not_copied():
    views = Views(torch.rand(1, 3, 3, 2, 2), torch.zeros(1, 3, 3, 3))
    assert views.select(range(3)) is views
    assert views.select([0, 2, 1]) is not views


def test_views_select_keeps_poses_with_their_pictures():
    poses = torch.arange(3.0).view(1, 3, 1, 1) * torch.eye(4)
    views = Views(torch.zeros(1, 3, 3, 2, 2), torch.zeros(1, 3, 3, 3), c2w=poses)
    assert torch.equal(views.select([2, 0]).c2w, poses[:, [2, 0]])
    with pytest.raises(
        ValueError,
        match=r"Views.c2w: expected shape \[1, 3, 4, 4\], got \[1, 2, 4, 4\]",
    ):
        Views(views.images, views.intrinsics, c2w=poses[:, :2])


@pytest.mark.parametrize("size", [(31, 41), (64, 85), (96, 128), (151, 201)])
def test_views_of_another_size_stay_in_range(size):
    """White stays white: rounding led above 1, which every later check refuses."""
    white = Views(torch.ones(1, 1, 3, 200, 300), torch.eye(3).expand(1, 1, 3, 3))
    assert float(white.at(size).images.max()) == 1


def test_views_and_cameras_of_another_size_show_the_same():
    ramp, size = torch.linspace(0, 1, 30).expand(1, 2, 3, 20, 30), (10, 15)
    views = Views(ramp, torch.eye(3).expand(1, 2, 3, 3))
    assert views.at((20, 30)) is views and views.at(size).image_size == size
    assert torch.allclose(
        views.at(size).images[..., 1:-1],
        torch.linspace(0.5, 28.5, 15)[1:-1] / 29,
        atol=1e-3,
    )
    cameras = Cameras(torch.eye(4).expand(1, 2, 4, 4), views.intrinsics, (20, 30)).at(
        size
    )
    assert cameras.image_size == size and torch.equal(
        cameras.intrinsics, views.intrinsics
    )


def test_a_smaller_scene_of_a_batch_repeats_its_last_gaussian_transparently():
    few, more = (balls(torch.rand(1, n, 3), opacity=0.5) for n in (2, 4))
    both = Gaussians.stack([few, more])
    assert both.opacities.tolist() == [[0.5, 0.5, 0, 0], [0.5] * 4]
    assert torch.equal(both.means[0, 2], both.means[0, 1])
