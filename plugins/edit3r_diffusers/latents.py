"""Latents of photos: encoded, noised, inverted, put back outside a mask, and as a late start of the
denoising.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from jaxtyping import Float, Num
from torch import Tensor

from edit3r.contract.reporting import progress
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.weights.load import foreign
from edit3r_diffusers.images import resize_mask
from edit3r_diffusers.loading import NO_SAFETY_CHECKER

LatentsAt = Callable[[Any, Tensor | None], Tensor]
"""The photo's latents at the noise of a timestep (None: clean): `(scheduler, timestep) -> latents`.
"""

Trajectory = dict[int, Tensor]
"""The photos' latents by the timestep whose noise level they have."""


class StepEnd:
    """A pipeline's `callback_on_step_end`: tells the progress and, with a mask, blends the photo
    back in.

    Diffusion inpainting by replacement (RePaint's known region): the area outside the mask follows
    the photo's own noised latents, so what is drawn inside grows to fit what stays outside. A soft
    edge counts as inside here: mixed in at every step it would count many times, and the pipeline
    mixes the finished image by it once.
    """

    def __init__(
        self,
        text: str,
        steps: int,
        mask: Float[Tensor, "n 1 h w"] | None = None,
        photo_at: LatentsAt | None = None,
    ) -> None:
        self.text, self.steps, self.mask, self.photo_at = text, steps, mask, photo_at

    def __call__(
        self,
        pipeline: Any,
        step: int,
        timestep: Num[Tensor, ""],
        tensors: dict[str, Tensor],
    ) -> dict[str, Tensor]:
        """Replace the `latents` `[n, c, h, w]` of `tensors`, as pipelines ask after every step."""
        progress(self.text, step + 1, self.steps)
        if self.mask is None or self.photo_at is None:
            return tensors
        latents = tensors["latents"]
        inside = resize_mask(self.mask.to(latents), size_of(latents)) > 0
        photo = self.photo_at(
            pipeline.scheduler, next_timestep(pipeline.scheduler, timestep)
        ).to(latents)
        return {**tensors, "latents": torch.where(inside, latents, photo)}


def next_timestep(scheduler: Any, timestep: Num[Tensor, ""]) -> Num[Tensor, ""] | None:
    """Find the timestep after `timestep` in the scheduler's order; None after the last."""
    positions = (scheduler.timesteps == timestep).nonzero().flatten()
    following = int(positions[-1]) + 1
    return (
        scheduler.timesteps[following] if following < len(scheduler.timesteps) else None
    )


def noised(
    clean: Float[Tensor, "n c h w"], noise: Float[Tensor, "n c h w"]
) -> LatentsAt:
    """The photo's latents under one fixed noise, the edit's own, of any timestep's strength."""

    def at(
        scheduler: Any, timestep: Num[Tensor, ""] | None
    ) -> Float[Tensor, "n c h w"]:
        if timestep is None:
            return clean
        return scheduler.add_noise(clean, noise, timestep.expand(len(clean)))

    return at


def encode(
    vae: Any, images: Float[Tensor, "n 3 height width"]
) -> Float[Tensor, "n c h w"]:
    """Encode images in [0, 1] to latents: the distribution's mode, scaled."""
    with torch.no_grad():
        shift = vae.config.shift_factor or 0.0
        return (
            vae.encode(2 * images - 1).latent_dist.mode() - shift
        ) * vae.config.scaling_factor


def noise_like_latents(
    pipeline: Any,
    images: Float[Tensor, "n 3 height width"],
    generators: list[torch.Generator],
) -> Float[Tensor, "n c h w"]:
    """Draw noise for each image's latents, each from its own generator."""
    factor = pipeline.vae_scale_factor
    size = (
        pipeline.vae.config.latent_channels,
        images.shape[-2] // factor,
        images.shape[-1] // factor,
    )
    return torch.stack(
        [torch.randn(size, generator=generator) for generator in generators]
    ).to(images)


def steps_left(steps: int, strength: float) -> int:
    """Steps that put about `strength` in [0, 1] of the noise in and out; 1 to `steps`."""
    return max(1, min(steps, round(steps * strength)))


def noisy_start(
    scheduler: Any,
    clean: Float[Tensor, "n c h w"],
    noise: Float[Tensor, "n c h w"],
    steps: int,
    skipped: int,
) -> Float[Tensor, "n c h w"]:
    """`clean` with the noise of step `skipped` of `steps`, scaled as pipelines expect `latents`."""
    scheduler.set_timesteps(steps, device=clean.device)
    noisy = scheduler.add_noise(
        clean, noise, scheduler.timesteps[skipped].expand(len(clean))
    )
    # pipelines multiply by it, as if it were pure noise
    return noisy / scheduler.init_noise_sigma


@contextmanager
def skipping(scheduler: Any, skipped: int) -> Iterator[None]:
    """Make `scheduler.set_timesteps` leave out the first `skipped` steps inside the block.

    For pipelines without a strength of their own (InstructPix2Pix): they take whatever timesteps
    they then find.
    """
    whole = scheduler.set_timesteps

    def set_timesteps(*args: Any, **kwargs: Any) -> None:
        whole(*args, **kwargs)
        scheduler.timesteps = scheduler.timesteps[skipped:]
        if hasattr(scheduler, "set_begin_index"):
            scheduler.set_begin_index(skipped)  # noise levels are looked up by place

    scheduler.set_timesteps = set_timesteps
    try:
        yield
    finally:
        del scheduler.set_timesteps  # the class's own shows again


def invert(
    pipeline: Any,
    clean: Float[Tensor, "view c h w"],
    control: Float[Tensor, "view 3 height width"],
    prompt: str,
    steps: int,
    control_scale: float,
) -> Trajectory:
    """Run the denoising ODE backwards from the photos, without guidance, as far as the last of
    `steps` timesteps.

    This is DDIM inversion by diffusers' own inverse scheduler: it finds the noise from which the
    model would redraw the photos, whose images of depth are `control`.
    """
    inverse_scheduler = foreign("diffusers", "DDIMInverseScheduler")
    scheduler = inverse_scheduler.from_config(pipeline.scheduler.config)
    parts = {**pipeline.components, **NO_SAFETY_CHECKER, "scheduler": scheduler}
    inverse = foreign("diffusers", "StableDiffusionControlNetPipeline")(**parts)
    inverse.set_progress_bar_config(disable=True)
    trajectory: Trajectory = {}

    def keep(
        _: Any, step: int, timestep: Num[Tensor, ""], tensors: dict[str, Tensor]
    ) -> dict[str, Tensor]:
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
    """Give the photos' latents at any timestep of their inversion."""
    return lambda scheduler, timestep: (
        clean if timestep is None else trajectory[int(timestep)]
    )
