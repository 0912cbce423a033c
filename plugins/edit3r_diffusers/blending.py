"""Confine an edit in the latents: after every step, put the photo back where it must not change."""

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.reporting import progress
from edit3r_diffusers.pictures import resize_mask

LatentsAt = Callable[[Any, Tensor | None], Tensor]
"""The photo's latents at the noise of a timestep (None: clean): `(scheduler, timestep) -> latents`."""


class StepEnd:
    """A pipeline's `callback_on_step_end`: tells the progress and, with a mask, blends the photo back in.

    Diffusion inpainting by replacement (RePaint's known region): the area outside the mask follows the photo's own
    noised latents, so what is drawn inside grows to fit what stays outside. A soft edge counts as inside here: mixed in
    at every step it would count many times, and the pipeline mixes the finished picture by it once.
    """

    def __init__(
        self, text: str, steps: int, mask: Float[Tensor, "n 1 h w"] | None = None, photo_at: LatentsAt | None = None
    ) -> None:
        self.text, self.steps, self.mask, self.photo_at = text, steps, mask, photo_at

    def __call__(self, pipeline: Any, step: int, timestep: Tensor, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
        progress(self.text, step + 1, self.steps)
        if self.mask is None or self.photo_at is None:
            return tensors
        latents = tensors["latents"]
        inside = resize_mask(self.mask.to(latents), latents.shape[-2:]) > 0
        photo = self.photo_at(pipeline.scheduler, next_timestep(pipeline.scheduler, timestep)).to(latents)
        return {**tensors, "latents": torch.where(inside, latents, photo)}


def next_timestep(scheduler: Any, timestep: Tensor) -> Tensor | None:
    """The timestep after `timestep` in the scheduler's order, None after the last."""
    positions = (scheduler.timesteps == timestep).nonzero().flatten()
    following = int(positions[-1]) + 1
    return scheduler.timesteps[following] if following < len(scheduler.timesteps) else None


def noised(clean: Tensor, noise: Tensor) -> LatentsAt:
    """The photo's latents under one fixed noise, the edit's own, at whatever strength a timestep has."""

    def at(scheduler: Any, timestep: Tensor | None) -> Tensor:
        if timestep is None:
            return clean
        return scheduler.add_noise(clean, noise, timestep.expand(len(clean)))

    return at


def encode(vae: Any, images: Float[Tensor, "n 3 height width"]) -> Float[Tensor, "n c h w"]:
    """Latents (the distribution's mode, scaled) of pictures in [0, 1]."""
    with torch.no_grad():
        shift = vae.config.shift_factor or 0.0
        return (vae.encode(2 * images - 1).latent_dist.mode() - shift) * vae.config.scaling_factor


def noise_like_latents(
    pipeline: Any, images: Float[Tensor, "n 3 height width"], generators: list[torch.Generator]
) -> Float[Tensor, "n c h w"]:
    """Noise for each picture's latents, each drawn from its own generator."""
    factor = pipeline.vae_scale_factor
    size = (pipeline.vae.config.latent_channels, images.shape[-2] // factor, images.shape[-1] // factor)
    return torch.stack([torch.randn(size, generator=generator) for generator in generators]).to(images)
