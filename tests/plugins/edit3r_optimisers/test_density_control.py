"""Which Gaussians are cloned, split and removed, on cases counted by hand."""

import pytest
import torch
from edit3r_optimisers.density_control import (
    CHILDREN,
    DensityStatistics,
    control_density,
    gradient_in_image,
    is_due,
    is_reset_due,
    needs_statistics,
    split,
)
from edit3r_optimisers.settings import FitSettings
from edit3r_optimisers.trainable import Parameters, TrainableGaussians

from edit3r.testing.scenes import broad_gaussians, cameras_around
from edit3r.types import Gaussians

SETTINGS = FitSettings(grow_gradient=1.0, split_size=0.1, prune_opacity=0.05, reset_every=100, prune_world=1.0)
FIELDS = ("means", "scales", "quats", "opacities", "harmonics")


def scene_of(scales, opacities) -> TrainableGaussians:
    """Round Gaussians in a row along x, view_index counting up."""
    count = len(scales)
    means = torch.stack((torch.arange(count).float(), torch.zeros(count), torch.full((count,), 3.0)), -1)
    quats = torch.tensor([1.0, 0, 0, 0]).repeat(1, count, 1)
    harmonics = torch.arange(3.0 * count).view(1, count, 1, 3)
    sizes = torch.tensor(scales)[None, :, None].repeat(1, 1, 3)
    scene = Gaussians(means[None], sizes, quats, torch.tensor(opacities)[None], harmonics, torch.arange(count))
    return TrainableGaussians(scene, degree=0)


def statistics_of(gradient, size=None) -> DensityStatistics:
    gradient = torch.tensor(gradient)
    return DensityStatistics(
        2 * gradient, torch.full_like(gradient, 2), torch.zeros_like(gradient) if size is None else size
    )


def controlled(scene: TrainableGaussians, statistics: DensityStatistics, done: int = 50, **changes) -> Gaussians:
    control_density(
        scene, statistics, FitSettings(**{**SETTINGS.model_dump(), **changes}), extent=1.0, done=done, seed=0
    )
    return scene.gaussians()


def test_small_ones_of_large_gradient_are_cloned_large_ones_split_and_faint_ones_removed():
    scene = scene_of(scales=[0.05, 0.05, 0.4, 0.4, 0.05], opacities=[0.5, 0.5, 0.5, 0.5, 0.01])
    scene = controlled(scene, statistics_of([0.2, 1.5, 0.2, 1.5, 0.2]))
    # 0 and 2 stay, 1 is there twice, 3 gave way to two children, 4 is gone.
    assert scene.view_index.tolist() == [0, 1, 2, 1, 3, 3]
    assert scene.means[0, :4, 0].tolist() == [0, 1, 2, 1]
    assert scene.scales[0, :, 0].tolist() == pytest.approx([0.05, 0.05, 0.4, 0.05, 0.25, 0.25])
    assert torch.equal(scene.harmonics[0, 4], scene.harmonics[0, 5])
    assert not torch.equal(scene.means[0, 4], scene.means[0, 5])


def test_the_gradient_is_a_mean_over_the_steps_a_gaussian_was_seen_in():
    statistics = DensityStatistics(torch.tensor([3.0, 3.0]), torch.tensor([2.0, 4.0]), torch.zeros(2))
    scene = controlled(scene_of([0.05, 0.05], [0.5, 0.5]), statistics)
    assert scene.view_index.tolist() == [0, 1, 0]


def test_huge_ones_are_removed_only_after_a_reset_of_opacities():
    def left(done):
        scene = scene_of([0.05, 2.0, 0.05], [0.5, 0.5, 0.5])
        size = torch.tensor([0.0, 0.0, 0.9])
        return controlled(scene, statistics_of([0.0, 0.0, 0.0], size), done=done).view_index.tolist()

    assert left(done=50) == [0, 1, 2] and left(done=150) == [0]


def test_growth_stops_at_the_most_there_may_be_with_the_largest_gradients_first():
    scene = controlled(scene_of([0.05] * 4, [0.5] * 4), statistics_of([1.1, 3.0, 1.2, 2.0]), most=6)
    assert scene.view_index.tolist() == [0, 1, 2, 3, 1, 3]


def test_never_is_the_last_one_removed():
    assert controlled(scene_of([0.05], [0.01]), statistics_of([0.0])).count == 1


def test_children_are_drawn_from_their_parent():
    parent = scene_of([0.4], [0.5]).parameters
    wide = Parameters(**{**vars(parent), "scales": torch.tensor([[0.5, 0.2, 0.1]]).log()})
    turned = Parameters(**{**vars(wide), "quats": torch.tensor([[2**-0.5, 0, 0, 2**-0.5]])})  # 90° about z
    many = turned[torch.zeros(4000, dtype=torch.int64)]
    children = split(many, torch.Generator().manual_seed(0))
    assert len(children) == CHILDREN * 4000
    spread = (children.means - parent.means).std(0)
    assert torch.allclose(spread, torch.tensor([0.2, 0.5, 0.1]), rtol=0.05)


def test_when_control_is_due():
    settings = FitSettings(densify_from=100, densify_every=50, densify_until=0.5, reset_every=200)
    assert [d for d in range(1001) if is_due(settings, d, 1000)] == list(range(150, 501, 50))
    assert [d for d in range(1, 1001) if is_reset_due(settings, d, 1000)] == [200, 400]
    assert all(needs_statistics(settings, d, 1000) == (d <= 500) for d in range(1, 1001))
    assert not needs_statistics(settings, 10, 200)  # it would be over before it begins


def test_the_gradient_in_the_image_is_the_slope_of_moving_sideways():
    """Against finite differences: shift a Gaussian by one half picture in its camera's own x and y."""
    scene, cameras = broad_gaussians(torch.float64), cameras_around(2, (12, 16), dtype=torch.float64).select([1])
    weights = torch.randn(scene.count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    w2c, focal = torch.linalg.inv(cameras.c2w[0, 0]), cameras.intrinsics[0, 0, [0, 1], [0, 1]]
    means = scene.means[0]

    def loss(moved):
        return (moved * weights).sum(-1).sin()  # any function of each centre alone

    leaf = means.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(leaf).sum(), leaf)
    slopes = []
    for axis in (0, 1):
        z = means @ w2c[2, :3] + w2c[2, 3]
        step = cameras.c2w[0, 0, :3, axis] * (z / (2 * focal[axis]))[:, None]  # one half picture, in the world
        slopes.append((loss(means + 1e-6 * step) - loss(means - 1e-6 * step)) / 2e-6)
    expected = torch.stack(slopes, -1).norm(dim=-1)
    assert torch.allclose(gradient_in_image(means, gradient, cameras), expected, rtol=1e-6)


def test_what_lies_outside_the_picture_is_not_counted():
    camera = cameras_around(1)
    parameters = scene_of([0.1, 0.1], [0.5, 0.5]).parameters
    parameters = Parameters(**{**vars(parameters), "means": torch.tensor([[0.0, 0, 3], [0, 0, -3]])})
    statistics = DensityStatistics.of(2, parameters.means)
    statistics.add(parameters, torch.ones(2, 3), camera)
    assert statistics.seen.tolist() == [1, 0] and statistics.gradient[0] > 0 and statistics.gradient[1] == 0
    assert statistics.size[0] == pytest.approx(0.1 * float(camera.intrinsics[0, 0, 0, 0]) / 3)
