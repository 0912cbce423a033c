"""Begin denoising part of the way: from a given picture's latents with the noise of a later step."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from jaxtyping import Float
from torch import Tensor

__all__ = ["noisy_start", "skipping", "steps_left"]


def steps_left(steps: int, strength: float) -> int:
    """How many of `steps` are taken so that about `strength` in [0, 1] of the noise is put in and out; at least 1."""
    return max(1, min(steps, round(steps * strength)))


def noisy_start(
    scheduler: Any, clean: Float[Tensor, "n c h w"], noise: Float[Tensor, "n c h w"], steps: int, skipped: int
) -> Float[Tensor, "n c h w"]:
    """`clean` with the noise of step `skipped` of `steps`, in the scale that pipelines expect of their `latents`."""
    scheduler.set_timesteps(steps, device=clean.device)
    noisy = scheduler.add_noise(clean, noise, scheduler.timesteps[skipped].expand(len(clean)))
    return noisy / scheduler.init_noise_sigma  # pipelines multiply by it, as if it were pure noise


@contextmanager
def skipping(scheduler: Any, skipped: int) -> Iterator[None]:
    """Inside the block `scheduler.set_timesteps` leaves out the first `skipped` steps.

    For pipelines without a strength of their own (InstructPix2Pix): they take whatever timesteps they then find.
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
