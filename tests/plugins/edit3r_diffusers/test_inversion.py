"""DDIM inversion leads back to the photos."""

from contextlib import contextmanager

import pytest
import torch
from edit3r_diffusers import latents
from edit3r_diffusers.loading import NO_SAFETY_CHECKER


@pytest.fixture(scope="module")
def pipeline(tiny):
    from diffusers import ControlNetModel, StableDiffusionControlNetImg2ImgPipeline

    controlnet = ControlNetModel.from_pretrained(
        tiny.controlnet(), local_files_only=True
    )
    pipeline = StableDiffusionControlNetImg2ImgPipeline.from_pretrained(
        tiny.stable_diffusion(),
        controlnet=controlnet,
        local_files_only=True,
        **NO_SAFETY_CHECKER,
    )
    pipeline.set_progress_bar_config(disable=True)
    return pipeline


@contextmanager
def predicting(pipeline, scale: float):
    """Scale down the random network's noise: untrained, it changes much faster than a trained
    one's.
    """
    with torch.no_grad():
        weights = [
            parameter.clone() for parameter in pipeline.unet.conv_out.parameters()
        ]
        for parameter in pipeline.unet.conv_out.parameters():
            parameter.mul_(scale)
        yield
        for parameter, weight in zip(pipeline.unet.conv_out.parameters(), weights):
            parameter.copy_(weight)


def round_trip_error(
    pipeline, views, steps: int, start: torch.Tensor | None = None
) -> float:
    """Relative error of the latents after inverting them (or from `start`) and denoising without
    guidance.
    """
    images, control = views.images[0], torch.full_like(views.images[0], 0.5)
    with torch.no_grad():
        clean = latents.encode(pipeline.vae, images)
        trajectory = latents.invert(pipeline, clean, control, "a bike", steps, 1.0)
        pipeline.scheduler.set_timesteps(steps)
        back = pipeline(
            prompt=["a bike"] * len(images),
            image=images,
            control_image=control,
            latents=trajectory[int(pipeline.scheduler.timesteps[0])]
            if start is None
            else start,
            strength=1.0,
            num_inference_steps=steps,
            guidance_scale=1.0,
            controlnet_conditioning_scale=1.0,
            output_type="latent",
        ).images
    return float((back - clean).norm() / clean.norm())


@pytest.mark.slow
def test_denoising_an_inversion_leads_back_exactly_where_the_noise_is_constant(
    pipeline, two_views
):
    with predicting(pipeline, 0.0):
        assert round_trip_error(pipeline, two_views, 4) < 1e-5


@pytest.mark.slow
def test_denoising_an_inversion_leads_back_where_random_noise_does_not(
    pipeline, two_views
):
    with predicting(pipeline, 0.1):
        random = torch.randn(2, 4, 16, 16, generator=torch.Generator().manual_seed(0))
        assert round_trip_error(pipeline, two_views, 8) < 0.2 * round_trip_error(
            pipeline, two_views, 8, random
        )


def test_every_timestep_of_the_denoising_has_its_latents(pipeline, two_views):
    images = two_views.images[0]
    with torch.no_grad():
        clean = latents.encode(pipeline.vae, images)
        trajectory = latents.invert(pipeline, clean, images, "", 4, 1.0)
    pipeline.scheduler.set_timesteps(4)
    assert sorted(trajectory) == sorted(int(t) for t in pipeline.scheduler.timesteps)
    assert all(latents.shape == clean.shape for latents in trajectory.values())
