"""Refinement steps help on the input views, know when to stop, and are never worse than no
refining.
"""

import subprocess
import sys
from dataclasses import replace

import pytest
import torch
from edit3r_refiners.refine import BETAS, Adam, RefineRefiner, RefineSettings, refine

from edit3r.contract.interfaces import Rasterizer, RefineInputs
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Views
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r_testing.scenes import cameras_around, gaussian_cloud


@pytest.fixture
def scene(rasterizer):
    """A cloud, two cameras, and what the cloud looked like before its colours were spoilt."""
    truth, cameras = gaussian_cloud(80), cameras_around(2)
    with torch.no_grad():
        images = rasterizer.render(truth, cameras).images
    spoilt = replace(truth, harmonics=truth.harmonics * 0.5 + 0.1)
    return spoilt, cameras, images


def test_steps_bring_the_pictures_closer_to_the_photos(rasterizer, scene):
    result = refine(*scene, rasterizer, 30)
    assert result.steps > 10
    assert result.fitted[1] < 0.5 * result.fitted[0]
    assert result.held_back[1] < 0.5 * result.held_back[0]


def test_the_state_that_was_best_by_held_back_pixels_is_returned(rasterizer, scene):
    wild = RefineSettings(colour=1.0, opacity=1.0, scale=1.0, centre=1.0)
    taken = []
    report = Report(on_event=lambda event, text, done, total: taken.append(done))
    with collecting(report):
        result = refine(*scene, rasterizer, 30, wild)
    assert max(taken) == 30 > result.steps
    assert result.held_back[1] <= result.held_back[0]


def test_a_later_state_about_as_good_counts_and_one_that_fits_noise_does_not(
    rasterizer, scene, monkeypatch
):
    gaussians, cameras, images = scene
    noise = torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    asked = gaussians, cameras, images + 0.05 * noise, rasterizer, 30
    later = refine(*asked)
    monkeypatch.setattr("edit3r_refiners.refine.AS_GOOD", 1)
    best = refine(*asked)
    assert best.steps < later.steps < 30
    assert later.fitted[1] < best.fitted[1]
    assert best.held_back[1] < later.held_back[1] < 1.05 * best.held_back[1]


def test_more_photos_get_more_steps(rasterizer):
    truth = gaussian_cloud(40)
    spoilt = replace(truth, harmonics=truth.harmonics * 0.5 + 0.1)
    for asked, count, steps in ((8, 1, 8), (8, 2, 16), (20, 3, 60), (2, 22, 40)):
        refiner = RefineRefiner(RefineRefiner.Settings(steps=asked))
        cameras, told = cameras_around(count), []
        with torch.no_grad():
            views = Views(rasterizer.render(truth, cameras).images, cameras.intrinsics)
        report = Report(on_event=lambda *event, told=told: told.append(event[3]))
        with collecting(report):
            refiner(spoilt, RefineInputs(cameras, views, rasterizer))
        assert max(told) == steps


def test_the_last_steps_are_shorter(rasterizer, scene, monkeypatch):
    """Else the views that come last win where several show the same Gaussians."""
    moved, step = [], Adam.step

    def watched(adam, gradients, length):
        before = adam.values[0].detach().clone()
        adam.values, adam.rates = adam.values[:1], [0.1]
        step(adam, [torch.ones_like(before)], length)
        moved.append(float((before - adam.values[0].detach()).mean()))

    monkeypatch.setattr(Adam, "step", watched)
    refine(*scene, rasterizer, 10, RefineSettings())
    assert moved[:6] == pytest.approx([0.1] * 6, rel=0.05)
    assert moved[6:] == sorted(moved[6:], reverse=True) and moved[-1] < 0.05


def test_the_photos_may_be_larger_than_the_grid_of_gaussians(rasterizer, scene):
    gaussians, cameras, images = scene
    small = cameras.at(tuple(size // 2 for size in cameras.image_size))
    refiner = RefineRefiner(RefineRefiner.Settings(steps=4))
    views = Views(images, cameras.intrinsics)
    from_small, from_full = (
        refiner(gaussians, RefineInputs(c, views, rasterizer)) for c in (small, cameras)
    )
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        assert torch.equal(getattr(from_small, name), getattr(from_full, name))


def test_a_perfect_scene_is_returned_as_it_was(rasterizer):
    gaussians, cameras = gaussian_cloud(40), cameras_around(2)
    with torch.no_grad():
        images = rasterizer.render(gaussians, cameras).images
    result = refine(gaussians, cameras, images, rasterizer, 5)
    assert result.steps == 0 and result.gaussians is gaussians


def test_no_steps_change_nothing(rasterizer, scene):
    result = refine(*scene, rasterizer, 0)
    assert result.gaussians is scene[0] and result.held_back[0] == result.held_back[1]


def test_the_result_is_what_was_measured(rasterizer, scene):
    _, cameras, images = scene
    result = refine(*scene, rasterizer, 6)
    with torch.no_grad():
        shown = rasterizer.render(result.gaussians, cameras).images
    error = (shown - images).square().mean()
    share = RefineSettings().held_back
    expected = share * result.held_back[1] + (1 - share) * result.fitted[1]
    assert float(error) == pytest.approx(expected, rel=1e-3)


def test_of_many_views_eight_tell_the_error_before_and_after(rasterizer):
    truth, cameras = gaussian_cloud(40), cameras_around(10)
    with torch.no_grad():
        images = rasterizer.render(truth, cameras).images
    counts = []

    class Counting:
        def render(self, gaussians, seen_from):
            counts.append(seen_from.count)
            return rasterizer.render(gaussians, seen_from)

    spoilt = replace(truth, harmonics=truth.harmonics * 0.5 + 0.1)
    result = refine(spoilt, cameras, images, Counting(), 10)
    assert counts == [8, *[1] * 10, 8]
    assert 0 < result.fitted[1] < result.fitted[0]


def test_opacities_at_their_limits_can_still_be_refined(rasterizer, scene):
    gaussians, cameras, images = scene
    hard = replace(gaussians, opacities=(gaussians.opacities > 0.5).float())
    result = refine(hard, cameras, images, rasterizer, 10)
    assert result.fitted[1] < result.fitted[0]


def test_steps_of_adam_are_those_of_torch():
    generator = torch.Generator().manual_seed(0)
    start = [torch.randn(size, generator=generator) for size in ((5, 3), (4,))]
    ours, theirs = (
        [value.clone().requires_grad_(True) for value in start] for _ in range(2)
    )
    adam, reference = Adam(ours, [0.1, 1e-3]), torch.optim.Adam(
        [{"params": [value], "lr": rate} for value, rate in zip(theirs, [0.1, 1e-3])], betas=BETAS
    )  # fmt: skip
    for _ in range(20):
        gradients = [
            torch.randn(value.shape, generator=generator) ** 3 for value in start
        ]
        adam.step(gradients)
        for value, gradient in zip(theirs, gradients):
            value.grad = gradient
        reference.step()
    for value, expected in zip(ours, theirs):
        assert torch.equal(value, expected)


def test_a_gradient_of_zero_moves_nothing():
    value = torch.ones(3)
    Adam([value], [0.1]).step([torch.zeros(3)])
    assert torch.equal(value, torch.ones(3))


def test_what_a_view_does_not_show_is_not_carried_on_by_earlier_steps():
    value = torch.ones(2)
    adam = Adam([value], [0.1])
    adam.step([torch.ones(2)])
    moved = value.clone()
    adam.step([torch.tensor([0.0, 1.0])])
    assert value[0] == moved[0] < 1 and value[1] < moved[1]


@pytest.mark.slow
def test_no_compiler_is_loaded():
    code = "import sys, torch; from edit3r_refiners.refine import Adam; "
    code += "Adam([torch.ones(1)], [1.0]).step([torch.ones(1)])"
    code += "; sys.exit('torch._dynamo' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("growth", [1.0, 1.2])
def test_no_gaussian_grows_by_more_than_it_may(rasterizer, scene, growth):
    small, cameras, images = scene
    small = replace(small, scales=small.scales * 0.3)  # gaps, which growing would fill
    settings = RefineSettings(growth=growth)
    refined = refine(small, cameras, images, rasterizer, 20, settings)
    change = refined.gaussians.scales / small.scales
    assert refined.steps > 0 and change.max() == pytest.approx(growth)


@pytest.mark.parametrize("most", [0.05, 0.15])
def test_no_colour_goes_farther_than_it_may(rasterizer, scene, most):
    gaussians, cameras, images = scene
    settings = RefineSettings(recolouring=most)
    refined = refine(gaussians, cameras, 1 - images, rasterizer, 20, settings)
    change = refined.gaussians.harmonics - gaussians.harmonics
    colours = dc_to_colour(change[:, :, 0]) - 0.5
    assert refined.steps > 0 and colours.abs().max() == pytest.approx(most, abs=1e-5)


@pytest.mark.parametrize("large", [False, True])
def test_of_large_photos_a_quarter_of_the_steps_are_at_half_the_size(
    rasterizer, scene, large
):
    """And never the last ones, whose state is told by the pixels held back."""
    gaussians, cameras, images = scene
    height, width = cameras.image_size
    watch = Sizes(rasterizer)
    settings = RefineSettings(half_above=max(height, width) - large)
    result = refine(gaussians, cameras, images, watch, 16, settings)
    half = [(height // 2, width // 2)] * 2
    full = [(height, width)] * 6
    steps = watch.seen[1:-1]
    assert steps == (2 * [*half, *full] if large else [(height, width)] * 16)
    assert result.steps == 16
    assert result.held_back[1] < result.held_back[0]


class Sizes(Rasterizer):
    """Remembers the size of each picture."""

    def __init__(self, rasterizer):
        self.rasterizer, self.seen = rasterizer, []

    def render(self, gaussians, cameras):
        self.seen.append(cameras.image_size)
        return self.rasterizer.render(gaussians, cameras)
