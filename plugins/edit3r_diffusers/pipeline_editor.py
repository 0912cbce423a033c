"""Any editing pipeline of diffusers: its call's signature says what it takes, and the settings are
mapped onto that.
"""

import inspect
from functools import partial
from typing import Any

import torch
from jaxtyping import Float
from PIL import Image
from pydantic import Field, create_model, model_validator
from pydantic.fields import FieldInfo
from torch import Tensor

from edit3r.contract.errors import PromptError, RunError, SettingsError
from edit3r.contract.interfaces import Editor
from edit3r.contract.reporting import note
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.cache import remembered
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.photos.images import to_bytes
from edit3r.kit.weights.load import foreign
from edit3r_diffusers import loading
from edit3r_diffusers.consistency import Consistency, References, edit_consistently
from edit3r_diffusers.images import ViewJob, edit_one_by_one, mask_on_grid
from edit3r_diffusers.latents import StepEnd
from edit3r_diffusers.loading import DiffusionSettings

TAKES_SEVERAL = {
    "QwenImageEditPlusPipeline",
    "Flux2Pipeline",
    "Flux2KleinPipeline",
    "Flux2KleinKVPipeline",
}
"""Classes that read a list of pictures as one job; for others, whose annotations look alike, a list
is a batch.
"""

ARGUMENT_OF = {
    "guidance": "guidance_scale",
    "true_guidance": "true_cfg_scale",
    "negative_prompt": "negative_prompt",
    "strength": "strength",
}
"""Settings and the argument each becomes; a class may lack any of them."""


class PipelineEditor(Editor):
    """Edits each view with the same instruction from the same noise by one class of diffusers.

    With masks, or a strength below 1, the job goes to `masked_pipeline`, made of the same parts.
    Where there is none, the whole picture is edited and edit3r cuts the edit out afterwards.
    """

    class Settings(DiffusionSettings):
        model: str = ""
        """model id on the hub, or a saved folder"""
        pipeline: str = ""
        """class of diffusers, such as FluxKontextPipeline"""
        masked_pipeline: str = ""
        """class for edits with a mask, of the same parts; empty: none"""
        guidance: float | None = Field(None, ge=0, le=50)
        """guidance_scale; default: the class's own"""
        true_guidance: float | None = Field(None, ge=1, le=50)
        """true_cfg_scale, away from negative_prompt; 1: off, faster"""
        strength: float = Field(1.0, gt=0, le=1)
        """below 1 starts from the noised photo: keeps more of it"""
        arguments: dict[str, Any] = Field({})
        """further arguments of the class's call, by name"""
        consistency: Consistency = "independent"
        """independent: each view alone; reference-first: view 0, then each other view beside photo
        and edit of view 0; grid: all views as one picture
        """

        @model_validator(mode="after")
        def _negative_prompt_needs_guidance(self):
            if self.negative_prompt and self.true_guidance == 1:
                raise ValueError(
                    "negative_prompt has an effect only with true_guidance above 1"
                )
            return self

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._plain: Any = None
        self._masked: Any = None

    @remembered
    def edit(self, views: Views, request: EditRequest) -> Views:
        name = self.offer.component.name
        if not request.prompt.strip():
            raise PromptError(f"{name} needs an instruction; give one with --prompt.")
        examples = {"pipeline": "ClassName", "model": "OWNER/NAME or =FOLDER"}
        for key, example in examples.items():
            if not getattr(self.settings, key):
                raise SettingsError(
                    f"{name} needs a {key}; give one with --set editor.{key}={example}."
                )
        self._load(views.images.device)
        several = self.settings.pipeline in TAKES_SEVERAL
        return edit_consistently(
            self.settings.consistency, several, self._edit, views, request
        )

    def _edit(
        self, views: Views, request: EditRequest, references: References
    ) -> Views:
        wants_mask = request.masks is not None or self.settings.strength < 1
        takes_mask = self._masked is not None and not references
        pipeline = self._masked if wants_mask and takes_mask else self._plain
        if request.masks is not None:
            obeyed = "mask_image" in _arguments(type(pipeline))
            cut_out = "the whole picture is edited, then cut out"
            note("editor.mask", "obeyed by the model" if obeyed else cut_out)
        packed = 2 if hasattr(pipeline, "transformer") else 1  # in 2x2 cells
        multiple = pipeline.vae_scale_factor * packed
        pictures = [_pil(image) for image in references]
        denoise = partial(self._denoise, pipeline, multiple, pictures)
        side = self.settings.resolution
        return edit_one_by_one(views, request, pipeline, side, multiple, denoise)

    def _load(self, photos_on: torch.device) -> None:
        """Load the weights when they are first needed, after the classes were checked."""
        chosen = self.settings
        if self._plain is None:
            plain = foreign("diffusers", chosen.pipeline)
            masked = None
            if chosen.masked_pipeline:
                masked = foreign("diffusers", chosen.masked_pipeline)
            self._check(plain, masked)
            made_of = inspect.signature(plain.__init__).parameters
            half = torch.bfloat16 if "transformer" in made_of else torch.float16
            parts = loading.NO_SAFETY_CHECKER if "safety_checker" in made_of else {}
            parts = {**parts, **loading.picture_processors(plain, chosen)}
            self._plain = loading.load(
                chosen.pipeline, chosen, photos_on, half, **parts
            )
            if masked is not None:
                self._masked = loading.same_parts(masked, self._plain)

    def _check(self, plain: type, masked: type | None) -> None:
        """Raise SettingsError for a class that does not edit, and for settings that it lacks."""
        taken = _arguments(plain) | (_arguments(masked) if masked else set())
        if not {"image", "prompt"} <= _arguments(plain):
            raise SettingsError(
                f"editor.pipeline: {plain.__name__} does not take an image and a prompt, so it "
                "cannot edit photos."
            )
        asked = {
            name
            for name in self.settings.model_fields_set & ARGUMENT_OF.keys()
            if getattr(self.settings, name) not in (None, "", 1.0)
        }
        arguments = {name: ARGUMENT_OF[name] for name in sorted(asked)}
        arguments |= {
            f"arguments.{one}": one for one in sorted(self.settings.arguments)
        }
        for key, argument in arguments.items():
            if argument not in taken:
                raise SettingsError(
                    f"editor.{key}: {plain.__name__} has no argument {argument}; leave the setting "
                    f"out. It takes: {', '.join(sorted(taken))}."
                )

    def _denoise(
        self, pipeline: Any, multiple: int, references: list[Image.Image], job: ViewJob
    ) -> Float[Tensor, "1 3 height width"]:
        """Draw one view; what the class has no argument for is left out, see `_check`."""
        chosen, size = self.settings, size_of(job.image)
        taken = _arguments(type(pipeline))
        mask = torch.ones(1, 1, *size)
        if job.mask is not None:
            mask = mask_on_grid(job.mask.cpu(), size, multiple)
        photo = _pil(job.image[0])
        steps = chosen.steps * chosen.strength
        guided = chosen.true_guidance is not None and chosen.true_guidance > 1
        wanted = {
            "image": [photo, *references] if references else photo,
            "mask_image": _pil(mask[0].expand(3, -1, -1)).convert("L"),
            "prompt": job.prompt,
            "negative_prompt": chosen.negative_prompt or (" " if guided else None),
            "true_cfg_scale": chosen.true_guidance,
            "guidance_scale": chosen.guidance,
            "strength": chosen.strength,
            "num_inference_steps": chosen.steps,
            "height": size[0],
            "width": size[1],
            "max_area": size[0] * size[1],
            "_auto_resize": False,  # else FluxKontextPipeline blows small photos up to a megapixel
            "generator": job.generator(),
            "output_type": "pt",
            "callback_on_step_end": StepEnd(job.text, max(1, int(steps))),
            **chosen.arguments,
        }
        wanted = {name: one for name, one in wanted.items() if one is not None}
        given = {name: one for name, one in wanted.items() if name in taken}
        try:
            return pipeline(**given).images
        except (ValueError, TypeError) as error:
            raise RunError(
                f"{job.text}: {type(pipeline).__name__} refused: {' '.join(str(error).split())}"
            ) from error


def preset(model: str, pipeline: str, **defaults: Any) -> type[PipelineEditor]:
    """A pipeline editor whose settings have other defaults."""
    defaults |= {"model": model, "pipeline": pipeline, "resolution": 1024}
    fields = PipelineEditor.Settings.model_fields
    changed: dict[str, Any] = {}
    for name, value in defaults.items():
        field = FieldInfo.merge_field_infos(fields[name], default=value)
        changed[name] = fields[name].annotation, field
    settings = create_model(
        "Settings", __base__=PipelineEditor.Settings, __module__=__name__, **changed
    )
    own = {"Settings": settings, "__doc__": PipelineEditor.__doc__}
    return type("PresetEditor", (PipelineEditor,), own)


def _arguments(pipeline: type) -> set[str]:
    """The names that the call of a class takes."""
    return set(inspect.signature(pipeline.__call__).parameters) - {"self"}


def _pil(image: Float[Tensor, "3 height width"]) -> Image.Image:
    """The form in which every class takes pictures; several take no other, whatever they say."""
    return Image.fromarray(to_bytes(image.float()))


# The numbers of this block: no figures kept.
FluxKontextEditor = preset(
    "black-forest-labs/FLUX.1-Kontext-dev",
    "FluxKontextPipeline",
    masked_pipeline="FluxKontextInpaintPipeline",
    steps=28,
    guidance=2.5,
    true_guidance=1.0,
)
QwenImageEditEditor = preset(
    "Qwen/Qwen-Image-Edit-2511",
    "QwenImageEditPlusPipeline",
    steps=40,
    true_guidance=4.0,
)
Flux2KleinEditor = preset(
    "black-forest-labs/FLUX.2-klein-4B",
    "Flux2KleinPipeline",
    masked_pipeline="Flux2KleinInpaintPipeline",
    steps=4,
    guidance=1.0,
)
LongCatImageEditEditor = preset(
    "meituan-longcat/LongCat-Image-Edit",
    "LongCatImageEditPipeline",
    steps=50,
    guidance=4.5,
)
