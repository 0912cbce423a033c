"""FLUX.1 Kontext (Black Forest Labs 2025): an instruction editor of the flow-matching family."""

from functools import partial
from typing import Any

import torch
from jaxtyping import Float
from pydantic import Field, model_validator
from torch import Tensor

from edit3r.cache import remembered
from edit3r.errors import PromptError
from edit3r.interfaces import Editor
from edit3r.types import EditRequest, Views
from edit3r_diffusers import loading
from edit3r_diffusers.images import ViewJob, edit_one_by_one, mask_on_grid
from edit3r_diffusers.latents import StepEnd
from edit3r_diffusers.loading import DiffusionSettings


class FluxKontextEditor(Editor):
    """Edits each view with the same instruction from the same noise, masked edits through Kontext's inpaint form.

    The inpaint form with a mask that is 1 everywhere and strength 1 is `FluxKontextPipeline` itself, so one pipeline
    serves both.
    """

    class Settings(DiffusionSettings):
        model: str = Field("black-forest-labs/FLUX.1-Kontext-dev", description="model id on the hub, or a saved folder")
        steps: int = Field(28, ge=1, le=1000, description="denoising steps")
        resolution: int = Field(1024, ge=0, le=4096, description="longer side the model works at [pixels]; 0: as is")
        guidance: float = Field(2.5, ge=0, le=50, description="guidance distilled into the model")
        true_guidance: float = Field(1.0, ge=1, le=50, description="guidance away from negative_prompt; 1: off, faster")
        strength: float = Field(1.0, gt=0, le=1, description="below 1 starts from the noised photo: keeps more of it")

        @model_validator(mode="after")
        def _negative_prompt_needs_guidance(self):
            if self.negative_prompt and self.true_guidance == 1:
                raise ValueError("negative_prompt has an effect only with true_guidance above 1")
            return self

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._pipeline: Any = None

    @remembered
    def edit(self, views: Views, request: EditRequest) -> Views:
        if not request.prompt.strip():
            raise PromptError("flux-kontext needs an instruction; give one with --prompt.")
        pipeline = self._loaded(views.images.device)
        multiple = 2 * pipeline.vae_scale_factor  # latents are packed in 2x2 cells
        return edit_one_by_one(
            views, request, pipeline, self.settings.resolution, multiple, partial(self._denoise, pipeline)
        )

    def _loaded(self, photos_on: torch.device) -> Any:
        if self._pipeline is None:
            self._pipeline = loading.load("FluxKontextInpaintPipeline", self.settings, photos_on, torch.bfloat16)
        return self._pipeline

    def _denoise(self, pipeline: Any, job: ViewJob) -> Float[Tensor, "1 3 height width"]:
        size = job.image.shape[-2:]
        whole = torch.ones(1, 1, *size)
        mask = whole if job.mask is None else mask_on_grid(job.mask, size, 2 * pipeline.vae_scale_factor)
        steps = max(1, int(self.settings.steps * self.settings.strength))
        return pipeline(
            image=job.image,
            mask_image=mask.to(job.image),
            prompt=job.prompt,
            negative_prompt=self.settings.negative_prompt or None,
            true_cfg_scale=self.settings.true_guidance,
            height=size[0],
            width=size[1],
            max_area=size[0] * size[1],
            _auto_resize=False,  # else small photos are blown up to a megapixel
            strength=self.settings.strength,
            num_inference_steps=self.settings.steps,
            guidance_scale=self.settings.guidance,
            generator=job.generator(),
            output_type="pt",
            callback_on_step_end=StepEnd(job.text, steps),
        ).images
