"""InstructPix2Pix (Brooks et al. 2023): the paper's default 2D editor."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.errors import PromptError
from edit3r.contract.interfaces import Editor, GivesAttention, StartsFromImages
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.cache import remembered
from edit3r_diffusers import attention, latents, loading
from edit3r_diffusers.consistency import References, edit_consistently
from edit3r_diffusers.images import ViewJob, edit_one_by_one
from edit3r_diffusers.loading import DiffusionSettings

GUIDANCE_COPIES = 3
"""Copies of an image in a guided pipeline's batch: with words and photo, with the photo alone, with
neither.
"""


class InstructPix2PixEditor(Editor, StartsFromImages, GivesAttention):
    """Edits each view with the same instruction from the same noise (paper: seed and prompt are
    shared by all views).

    Masks are obeyed in the latents: outside, every step puts the photo's own noised latents back.
    """

    class Settings(DiffusionSettings):
        model: str = "timbrooks/instruct-pix2pix"
        """model id on the hub, or a saved folder"""
        guidance: float = Field(7.5, ge=1, le=50)
        """how strongly the instruction is followed; 1: not raised"""
        consistency: Literal["independent", "grid"] = "independent"
        """independent: each view alone; grid: all views as one picture"""
        image_guidance: float = Field(1.5, ge=1, le=50)
        """how closely the photo is kept"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._pipeline: Any = None

    @remembered
    def edit(self, views: Views, request: EditRequest) -> Views:
        def alone(views: Views, request: EditRequest, _: References) -> Views:
            return self._edited(views, request, None, 1.0)

        return edit_consistently(
            self.settings.consistency, False, alone, views, request
        )

    def edit_from(
        self,
        views: Views,
        start: Float[Tensor, "batch view 3 height width"],
        request: EditRequest,
        strength: float,
    ) -> Views:
        """Edit `views` begun from the images `start`, noised at `strength` in [0, 1] of the way.

        The photos stay the condition, as Instruct-NeRF2NeRF (section 4.2) edits its renders.
        """
        return self._edited(views, request, start, strength)

    def attention(
        self, views: Views, request: EditRequest
    ) -> Float[Tensor, "batch view height width"]:
        """How much each pixel looks at the instruction's words, in [0, 1]; costs another edit."""
        pipeline, maps = self._loaded(views.images.device), []
        words = attention.word_count(pipeline.tokenizer, request.prompt)
        copies = GUIDANCE_COPIES if self.settings.guidance > 1 else 1

        def denoise(job: ViewJob) -> Float[Tensor, "1 3 height width"]:
            with attention.listening(pipeline.unet, words, copies) as listener:
                result = self._denoise(pipeline, self.settings.steps, job)
            maps.append(listener.image(views.image_size))
            return result

        size = self.settings.resolution, pipeline.vae_scale_factor
        edit_one_by_one(views, replace(request, masks=None), pipeline, *size, denoise)
        return (
            torch.stack(maps)
            .view(*views.images.shape[:2], *views.image_size)
            .to(views.images)
        )

    def _edited(
        self,
        views: Views,
        request: EditRequest,
        start: Float[Tensor, "batch view 3 height width"] | None,
        strength: float,
    ) -> Views:
        if not request.prompt.strip():
            raise PromptError(
                "instruct-pix2pix needs an instruction; give one with --prompt."
            )
        pipeline = self._loaded(views.images.device)
        denoise = partial(
            self._denoise, pipeline, latents.steps_left(self.settings.steps, strength)
        )
        size = self.settings.resolution, pipeline.vae_scale_factor
        return edit_one_by_one(views, request, pipeline, *size, denoise, start)

    def _loaded(self, photos_on: torch.device) -> Any:
        if self._pipeline is None:
            name = "StableDiffusionInstructPix2PixPipeline"
            self._pipeline = loading.load(
                name,
                self.settings,
                photos_on,
                torch.float16,
                **loading.NO_SAFETY_CHECKER,
            )
        return self._pipeline

    def _denoise(
        self, pipeline: Any, left: int, job: ViewJob
    ) -> Float[Tensor, "1 3 height width"]:
        """Draw one view; `left` of the steps are taken when the job begins from an image."""
        steps, generator = self.settings.steps, job.generator()
        noise = latents.noise_like_latents(pipeline, job.image, [generator])
        photo_at = (
            latents.noised(latents.encode(pipeline.vae, job.image), noise)
            if job.mask is not None
            else None
        )
        first = noise
        skipped: AbstractContextManager[None] = nullcontext()
        if job.start is not None:
            clean = latents.encode(pipeline.vae, job.start)
            first = latents.noisy_start(
                pipeline.scheduler, clean, noise, steps, steps - left
            )
            skipped = latents.skipping(pipeline.scheduler, steps - left)
        with skipped:
            return pipeline(
                prompt=job.prompt,
                image=job.image,
                num_inference_steps=steps,
                guidance_scale=self.settings.guidance,
                image_guidance_scale=self.settings.image_guidance,
                negative_prompt=self.settings.negative_prompt,
                generator=generator,
                latents=first,
                output_type="pt",
                callback_on_step_end=latents.StepEnd(
                    job.text, left, job.mask, photo_at
                ),
            ).images
