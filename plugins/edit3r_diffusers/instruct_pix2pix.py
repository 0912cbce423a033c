"""InstructPix2Pix (Brooks et al. 2023): the paper's default 2D editor."""

from functools import partial
from typing import Any

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.errors import PromptError
from edit3r.interfaces import Editor
from edit3r.types import EditRequest, Views
from edit3r_diffusers import blending, loading, pictures
from edit3r_diffusers.settings import DiffusionSettings


class InstructPix2PixEditor(Editor):
    """Edits each view with the same instruction and the same noise (paper section 3.4: seed and prompt are shared)."""

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
        return pictures.edit_each(views, partial(self._edit_view, pipeline, views, request))

    def _loaded(self, photos_on: torch.device) -> Any:
        if self._pipeline is None:
            with loading.quiet():
                from diffusers import StableDiffusionInstructPix2PixPipeline

            device = loading.pick_device(self.settings.device, photos_on)
            dtype = loading.pick_dtype(self.settings.dtype, device, torch.float16)
            # The safety checker turns photos black on a false alarm; a user who wants one filters the results.
            self._pipeline = loading.load(
                StableDiffusionInstructPix2PixPipeline,
                self.settings,
                device,
                dtype,
                safety_checker=None,
                requires_safety_checker=False,
            )
        return self._pipeline

    def _edit_view(
        self, pipeline: Any, views: Views, request: EditRequest, scene: int, view: int
    ) -> Float[Tensor, "3 height width"]:
        photo = views.images[scene, view]
        name = pictures.view_name(views, view)
        size = pictures.working_size(*photo.shape[-2:], self.settings.resolution, pipeline.vae_scale_factor)
        with loading.out_of_memory_told(f"editing {name} at {size[1]}x{size[0]}"):
            image = pictures.resize(photo[None].float(), size).to(pipeline._execution_device, pipeline.dtype)
            edited = self._denoise(pipeline, image, request, scene, view, f"editing {name}")
        return pictures.checked(edited, photo, name)[0]

    def _denoise(self, pipeline: Any, image: Tensor, request: EditRequest, scene: int, view: int, text: str) -> Tensor:
        """One run of the pipeline; every view starts from the same noise, drawn afresh from the seed on the CPU."""
        mask = request.masks[scene, view][None, None] if request.masks is not None else None
        channels, factor = pipeline.vae.config.latent_channels, pipeline.vae_scale_factor
        noise_size = (1, channels, image.shape[-2] // factor, image.shape[-1] // factor)
        generator = torch.Generator("cpu").manual_seed(request.seed)
        noise = torch.randn(noise_size, generator=generator).to(image)
        clean = blending.encode(pipeline.vae, image) if mask is not None else noise
        step_end = blending.StepEnd(text, self.settings.steps, mask, blending.noised(clean, noise))
        with torch.no_grad():
            return pipeline(
                prompt=request.prompt,
                image=image,
                num_inference_steps=self.settings.steps,
                guidance_scale=self.settings.guidance,
                image_guidance_scale=self.settings.image_guidance,
                negative_prompt=self.settings.negative_prompt,
                generator=generator,
                latents=noise,
                output_type="pt",
                callback_on_step_end=step_end,
            ).images
