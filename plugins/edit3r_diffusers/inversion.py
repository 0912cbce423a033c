"""DDIM inversion: the noise from which the model would redraw the photos, through diffusers' own inverse scheduler."""

from typing import Any

from jaxtyping import Float
from torch import Tensor

from edit3r.reporting import progress
from edit3r_diffusers.blending import LatentsAt
from edit3r_diffusers.loading import NO_SAFETY_CHECKER

Trajectory = dict[int, Tensor]
"""The photos' latents by the timestep whose noise level they have."""


def invert(
    pipeline: Any,
    clean: Float[Tensor, "view c h w"],
    control: Float[Tensor, "view 3 height width"],
    prompt: str,
    steps: int,
    control_scale: float,
) -> Trajectory:
    """Run the denoising ODE backwards from the photos, without guidance, as far as the last of `steps` timesteps."""
    from diffusers import DDIMInverseScheduler, StableDiffusionControlNetPipeline

    scheduler = DDIMInverseScheduler.from_config(pipeline.scheduler.config)
    parts = {**pipeline.components, **NO_SAFETY_CHECKER, "scheduler": scheduler}
    inverse = StableDiffusionControlNetPipeline(**parts)
    inverse.set_progress_bar_config(disable=True)
    trajectory: Trajectory = {}

    def keep(_: Any, step: int, timestep: Tensor, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
        trajectory[int(timestep)] = tensors["latents"]
        progress("inverting the photos", step + 1, steps)
        return tensors

    inverse(
        prompt=[prompt] * len(clean),
        image=control,
        latents=clean,
        num_inference_steps=steps,
        guidance_scale=1.0,
        controlnet_conditioning_scale=control_scale,
        output_type="latent",
        callback_on_step_end=keep,
    )
    return trajectory


def along(trajectory: Trajectory, clean: Float[Tensor, "view c h w"]) -> LatentsAt:
    """The photos' latents at any timestep of their inversion."""
    return lambda scheduler, timestep: clean if timestep is None else trajectory[int(timestep)]
