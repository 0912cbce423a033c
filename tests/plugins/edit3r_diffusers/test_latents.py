"""The latent blend by closed forms."""

import pytest
import torch
from edit3r_diffusers import images
from edit3r_diffusers.latents import StepEnd, noised


@pytest.fixture
def scheduler():
    from diffusers import DDIMScheduler

    scheduler = DDIMScheduler(clip_sample=False)
    scheduler.set_timesteps(4)
    return scheduler


class Pipeline:
    def __init__(self, scheduler):
        self.scheduler = scheduler


def test_outside_the_mask_the_photo_follows_its_own_noise_and_ends_clean(scheduler):
    clean, noise, edit = torch.randn(3, 1, 4, 8, 8)
    mask = torch.zeros(1, 1, 16, 16)
    mask[..., :8] = 1
    step_end = StepEnd("x", 4, mask, noised(clean, noise))
    for step, timestep in enumerate(scheduler.timesteps):
        latents = step_end(Pipeline(scheduler), step, timestep, {"latents": edit})[
            "latents"
        ]
        last = step == 3
        following = None if last else scheduler.timesteps[step + 1 : step + 2]
        expected = clean if last else scheduler.add_noise(clean, noise, following)
        assert torch.equal(latents[..., 4:], expected[..., 4:])
        assert torch.equal(latents[..., :4], edit[..., :4])


def test_a_soft_edge_is_left_to_the_pipeline_which_mixes_it_in_once(scheduler):
    clean, noise, edit = torch.randn(3, 1, 4, 8, 8)
    step_end = StepEnd("x", 4, torch.full((1, 1, 16, 16), 0.1), noised(clean, noise))
    latents = step_end(
        Pipeline(scheduler), 0, scheduler.timesteps[0], {"latents": edit}
    )["latents"]
    assert torch.equal(latents, edit)


def test_without_a_mask_the_latents_are_untouched(scheduler):
    tensors = {"latents": torch.randn(1, 4, 8, 8)}
    step_end = StepEnd("x", 4)
    assert step_end(Pipeline(scheduler), 0, scheduler.timesteps[0], tensors) is tensors


def test_a_latent_cell_may_change_when_any_of_its_pixels_may():
    mask = torch.zeros(1, 1, 16, 16)
    mask[0, 0, 5, 9] = 1
    small = images.resize_mask(mask, (4, 4))
    assert small.sum() == 1 and small[0, 0, 1, 2] == 1


def test_the_working_size_keeps_the_shape_and_the_multiple():
    assert images.working_size(480, 640, 512, 8) == (384, 512)
    assert images.working_size(480, 640, 0, 8) == (480, 640)
    assert images.working_size(3, 5, 0, 8) == (8, 8)
    assert images.working_size(1000, 30, 512, 16) == (512, 16)
