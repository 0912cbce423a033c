"""A depth-conditioned editor that draws all views together, after GaussCtrl (Wu et al. 2024).

photos --> DDIM inversion (depth ControlNet) --> noise
       --> denoise with the edit's prompt and the same depth, self-attention looking across views
       --> edited photos
"""

from dataclasses import replace
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.errors import InputError, PromptError
from edit3r.contract.interfaces import ConditionedOnDepth, Editor, Matcher
from edit3r.contract.reporting import warn
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.cache import remembered
from edit3r.kit.geometry.maps import resampled, size_of
from edit3r.kit.weights.load import ChosenWeights, foreign, load_pretrained, pick_device
from edit3r_diffusers import WEIGHTS, images, latents, loading
from edit3r_diffusers.attention import look_across_views
from edit3r_diffusers.loading import DiffusionSettings

FAR, NEAR = 0.02, 0.98  # quantiles of disparity drawn black and white; no figure kept


class ControlNetDepthEditor(Editor, ConditionedOnDepth):
    """Redraws photos towards a description, geometry held by depth, views by attention."""

    class Settings(DiffusionSettings):
        model: str = "stable-diffusion-v1-5/stable-diffusion-v1-5"
        """model id, or a saved folder"""
        controlnet: str = "lllyasviel/control_v11f1p_sd15_depth"
        """depth ControlNet for that model"""
        matcher: PartChoice = PartChoice(name="classical")
        """measures depth from the photos"""
        source_prompt: str = ""
        """what the photos show; guides the inversion"""
        guidance: float = Field(7.5, ge=1, le=50)
        """how strongly the description is followed"""
        control_scale: float = Field(1.0, ge=0, le=2)
        """how strongly depth holds the geometry; 0: not"""
        strength: float = Field(1.0, gt=0, le=1)
        """share of the steps that are redrawn; lower keeps more"""
        invert: bool = True
        """start from the photos' own noise (DDIM inversion) instead of random"""
        eta: float = Field(0.1, ge=0, le=1)
        """fresh noise per step; at 0 an inverted edit ignores the seed"""
        cross_view: float = Field(0.4, ge=0, le=1)
        """weight of the reference views in self-attention"""
        references: int = Field(4, ge=1, le=64)
        """how many views, from the first, the others look at"""

    settings: Settings

    def __init__(self, settings: Settings, matcher: Matcher) -> None:
        self.settings, self.matcher = settings, matcher
        self._pipeline: Any = None
        self.references = settings.references if settings.cross_view > 0 else 0

    @remembered
    def edit(self, views: Views, request: EditRequest) -> Views:
        if not request.prompt.strip():
            raise PromptError(
                "controlnet-depth needs a description of the edited scene; give one with --prompt."
            )
        pipeline = self._loaded(views.images.device)
        scenes = [
            self._edit_scene(pipeline, views, request, scene)
            for scene in range(len(views.images))
        ]
        return replace(views, images=torch.stack(scenes))

    def _loaded(self, photos_on: torch.device) -> Any:
        if self._pipeline is None:
            chosen, half = self.settings, torch.float16
            device = pick_device(chosen.device, photos_on, "editor.device")
            dtype = loading.pick_dtype(chosen.dtype, device, half)
            weights = ChosenWeights(
                chosen.controlnet,
                "editor.controlnet",
                local_files_only=chosen.local_files_only,
                known=WEIGHTS,
            )
            network = foreign("diffusers", "ControlNetModel")
            controlnet = load_pretrained(network, weights, dtype=dtype)
            parts = {**loading.NO_SAFETY_CHECKER, "controlnet": controlnet}
            name = "StableDiffusionControlNetImg2ImgPipeline"
            pipeline = loading.load(name, chosen, photos_on, half, **parts)
            # Inversion and denoising must step over the same noise levels, whatever sampler the
            # weights came with.
            pipeline.scheduler = foreign("diffusers", "DDIMScheduler").from_config(
                pipeline.scheduler.config,
                clip_sample=False,
                set_alpha_to_one=False,
                timestep_spacing="leading",
            )
            self._pipeline = pipeline
        return self._pipeline

    def _edit_scene(
        self, pipeline: Any, views: Views, request: EditRequest, scene: int
    ) -> Float[Tensor, "view 3 height width"]:
        photos = views.images[scene]
        multiple = 8 * pipeline.vae_scale_factor
        size = images.working_size(*size_of(photos), self.settings.resolution, multiple)
        control = control_images(
            matched_disparity(self.matcher, views.scene(scene)), size
        )
        mask = request.masks[scene][:, None] if request.masks is not None else None
        doing = f"editing {len(photos)} views together at {size[1]}x{size[0]}"
        with torch.no_grad(), loading.out_of_memory_told(doing):
            device, dtype = pipeline._execution_device, pipeline.dtype
            resized = resampled(photos.float(), size).to(device, dtype)
            edited = self._denoise(
                pipeline, resized, control.to(device, dtype), mask, request, doing
            )
        return images.checked(edited, photos, "the views")

    def _denoise(
        self,
        pipeline: Any,
        photos: Float[Tensor, "view 3 height width"],
        control: Float[Tensor, "view 3 height width"],
        mask: Float[Tensor, "view 1 H W"] | None,
        request: EditRequest,
        text: str,
    ) -> Float[Tensor, "view 3 height width"]:
        """Redraw all views of a scene together at the working size; `text` names the progress."""
        chosen, count = self.settings, len(photos)
        seeds = [request.seed] * count
        generators = [torch.Generator("cpu").manual_seed(seed) for seed in seeds]
        clean = latents.encode(pipeline.vae, photos)
        noise = latents.noise_like_latents(pipeline, photos, generators)
        photo_at = latents.noised(clean, noise)
        if chosen.invert:
            steps, prompt = chosen.steps, chosen.source_prompt
            trajectory = latents.invert(
                pipeline, clean, control, prompt, steps, chosen.control_scale
            )
            photo_at = latents.along(trajectory, clean)
        redrawn = max(1, int(chosen.steps * chosen.strength))
        pipeline.scheduler.set_timesteps(chosen.steps)
        begins = pipeline.scheduler.timesteps[chosen.steps - redrawn]
        start = photo_at(pipeline.scheduler, begins)
        own_attention = pipeline.unet.attn_processors
        look_across_views(pipeline.unet, count, chosen.references, chosen.cross_view)
        try:
            return pipeline(
                prompt=[request.prompt] * count,
                negative_prompt=[chosen.negative_prompt] * count,
                image=photos,
                control_image=control,
                latents=start,
                # the pipeline rounds down
                strength=min(1.0, (redrawn + 0.5) / chosen.steps),
                num_inference_steps=chosen.steps,
                guidance_scale=chosen.guidance,
                controlnet_conditioning_scale=chosen.control_scale,
                eta=chosen.eta,
                generator=generators,
                output_type="pt",
                callback_on_step_end=latents.StepEnd(text, redrawn, mask, photo_at),
            ).images
        finally:
            # the inversion of the next scene looks at each view alone
            pipeline.unet.set_attn_processor(own_attention)


def matched_disparity(
    matcher: Matcher, views: Views
) -> Float[Tensor, "view height width"]:
    """1 / depth [1 / scene units] of one scene's views by the matcher, so that views agree."""
    if views.count < 2:
        raise InputError(
            "controlnet-depth needs two or more photos to measure depth, but is to edit one; "
            "leave out --edit-views first."
        )
    geometry = matcher.match(views)
    placed = geometry.registered[0].tolist()
    lost = [view for view, is_placed in enumerate(placed) if not is_placed]
    if lost:
        warn(
            f"controlnet-depth: views {lost} could not be placed; their depth is filled in, not "
            "measured."
        )
    return 1 / geometry.depths[0]


def control_images(
    disparity: Float[Tensor, "view h w"], size: tuple[int, int]
) -> Float[Tensor, "view 3 height width"]:
    """Grey images in [0, 1], near white: disparity stretched between two of its quantiles."""
    values = disparity.double().flatten()
    some = values[:: max(1, len(values) // 1_000_000)]
    far, near = torch.quantile(some, values.new_tensor([FAR, NEAR]))
    grey = (disparity - far) / (near - far).clamp(min=1e-12)
    grey = grey.clamp(0, 1).to(disparity.dtype)
    sized = F.interpolate(grey[:, None], size, mode="bilinear", antialias=True)
    return sized.expand(-1, 3, -1, -1)
