"""InstructPix2Pix (Brooks et al. 2023): the paper's default 2D editor."""

from functools import partial
from typing import Any

import torch
from pydantic import Field
from torch import Tensor

from edit3r.errors import PromptError
from edit3r.interfaces import Editor
from edit3r.io.pretrained import foreign, pick_device
from edit3r.types import EditRequest, Views
from edit3r_diffusers import blending, loading
from edit3r_diffusers.one_by_one import ViewJob, edit_one_by_one
from edit3r_diffusers.settings import DiffusionSettings


class InstructPix2PixEditor(Editor):
    """Edits each view with the same instruction from the same noise (paper: seed and prompt are shared by all views).

    Masks are obeyed in the latents: outside, every step puts the photo's own noised latents back.
    """

    class Settings(DiffusionSettings):
        model: str = Field("timbrooks/instruct-pix2pix", description="model id on the hub, or a saved folder")
        guidance: float = Field(7.5, ge=1, le=50, description="how strongly the instruction is followed; 1: not raised")
        image_guidance: float = Field(1.5, ge=1, le=50, description="how closely the photo is kept")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._pipeline: Any = None

    def edit(self, views: Views, request: EditRequest) -> Views:
        if not request.prompt.strip():
            raise PromptError("instruct-pix2pix needs an instruction; give one with --prompt.")
        pipeline = self._loaded(views.images.device)
        denoise = partial(self._denoise, pipeline)
        return edit_one_by_one(views, request, pipeline, self.settings.resolution, pipeline.vae_scale_factor, denoise)

    def _loaded(self, photos_on: torch.device) -> Any:
        if self._pipeline is None:
            device = pick_device(self.settings.device, photos_on, "editor.device")
            dtype = loading.pick_dtype(self.settings.dtype, device, torch.float16)
            pipeline_class = foreign("diffusers", "StableDiffusionInstructPix2PixPipeline")
            self._pipeline = loading.load(pipeline_class, self.settings, device, dtype, **loading.NO_SAFETY_CHECKER)
        return self._pipeline

    def _denoise(self, pipeline: Any, job: ViewJob) -> Tensor:
        generator = job.generator()
        noise = blending.noise_like_latents(pipeline, job.image, [generator])
        photo_at = blending.noised(blending.encode(pipeline.vae, job.image), noise) if job.mask is not None else None
        return pipeline(
            prompt=job.prompt,
            image=job.image,
            num_inference_steps=self.settings.steps,
            guidance_scale=self.settings.guidance,
            image_guidance_scale=self.settings.image_guidance,
            negative_prompt=self.settings.negative_prompt,
            generator=generator,
            latents=noise,
            output_type="pt",
            callback_on_step_end=blending.StepEnd(job.text, self.settings.steps, job.mask, photo_at),
        ).images
