"""The settings that every diffusion editor shares, and how a diffusers pipeline is loaded by
them.
"""

import importlib.util
import inspect
from contextlib import AbstractContextManager
from typing import Any, Literal

import torch
from pydantic import Field

from edit3r.contract.errors import SettingsError
from edit3r.contract.reporting import note
from edit3r.contract.settings import Settings
from edit3r.kit.weights import load as pretrained
from edit3r.kit.weights.load import ChosenWeights
from edit3r_diffusers import WEIGHTS

NO_SAFETY_CHECKER = {"safety_checker": None, "requires_safety_checker": False}
"""For Stable Diffusion 1.x pipelines: theirs turns a photo black on a false alarm, and a black view
ruins the scene.
"""


class DiffusionSettings(Settings):
    """Which weights, where they run, and how much memory they may take."""

    model: str
    """model id on the Hugging Face hub, or a folder written by save_pretrained"""
    revision: str = ""
    """branch, tag or commit of the model; empty: the newest"""
    variant: str = ""
    """weight file variant such as fp16; empty: the full-precision files"""
    local_files_only: bool = False
    """never download: use the folder or what is already in the cache"""
    steps: int = Field(20, ge=1, le=1000)
    """denoising steps; more is slower and sometimes cleaner"""
    resolution: int = Field(512, ge=0, le=4096)
    """longer side the model works at [pixels]; the result is resized back; 0: as is"""
    negative_prompt: str = ""
    """what the edit should not look like"""
    device: str = "auto"
    """cpu, cuda, cuda:1, mps, ...; auto: where the photos are (--device)"""
    dtype: Literal["auto", "float32", "float16", "bfloat16"] = "auto"
    """precision of the weights; auto: float32 on a CPU, half precision elsewhere"""
    offload: Literal["none", "model", "sequential"] = "none"
    """keep parts in main memory while they are idle: model (a little slower), sequential (much)"""
    low_memory: bool = False
    """encode and decode one picture and tile at a time: a smaller peak"""


def pick_dtype(name: str, device: torch.device, half: torch.dtype) -> torch.dtype:
    """Return the precision called `name`; 'auto' is float32 on a CPU and `half` elsewhere."""
    if name == "auto":
        return torch.float32 if device.type == "cpu" else half
    return getattr(torch, name)


def load(
    pipeline: str,
    settings: DiffusionSettings,
    photos_on: torch.device,
    half: torch.dtype,
    **parts: Any,
) -> Any:
    """Load a class of diffusers with the settings' weights; `parts` replace its own."""
    device = pretrained.pick_device(settings.device, photos_on, "editor.device")
    dtype = pick_dtype(settings.dtype, device, half)
    weights = main_weights(settings)
    loaded = pretrained.load_pretrained(
        pretrained.foreign("diffusers", pipeline), weights, dtype=dtype, **parts
    )
    loaded.set_progress_bar_config(disable=True)
    _place(loaded, settings, device)
    note("editor.weights", {**pretrained.identity(weights), "dtype": str(dtype)})
    return loaded


def picture_processors(pipeline: type, settings: DiffusionSettings) -> dict[str, Any]:
    """The parts of class Qwen2VLProcessor for pictures alone: its own loading demands torchvision,
    for videos.

    Empty for pipelines without such a part, and where torchvision is installed.
    """
    names = [
        name
        for name, taken in inspect.signature(pipeline).parameters.items()
        if getattr(taken.annotation, "__name__", "") == "Qwen2VLProcessor"
    ]
    if not names or importlib.util.find_spec("torchvision"):
        return {}

    processor = pretrained.foreign("transformers", "Qwen2VLProcessor")

    class PictureProcessor(processor):  # type: ignore[valid-type, misc]  # a variable
        def check_argument_for_proper_class(self, name: str, given: Any) -> Any:
            return (
                None
                if given is None
                else super().check_argument_for_proper_class(name, given)
            )

    def made(name: str) -> PictureProcessor:
        parts = [
            pretrained.load_pretrained(
                pretrained.foreign("transformers", cls),
                main_weights(settings),
                subfolder=folder,
            )
            for cls, folder in (
                ("Qwen2VLImageProcessor", name),
                ("Qwen2Tokenizer", "tokenizer"),
            )
        ]
        return PictureProcessor(*parts, None)

    return {name: made(name) for name in names}


def same_parts(pipeline: type, of: Any) -> Any:
    """Another class of diffusers of a loaded pipeline's parts and flags, without a second copy."""
    parts = {
        name: vars(of).get(name, of.config.get(name))
        for name in inspect.signature(pipeline).parameters
        if name in (*vars(of), *of.config)
    }
    variant = pipeline(**parts)
    variant.set_progress_bar_config(disable=True)
    return variant


def main_weights(settings: DiffusionSettings) -> ChosenWeights:
    """Name the weights that the settings ask for."""
    return ChosenWeights(
        settings.model,
        "editor.model",
        settings.revision,
        settings.variant,
        settings.local_files_only,
        WEIGHTS,
    )


def _place(pipeline: Any, settings: DiffusionSettings, device: torch.device) -> None:
    """Move a pipeline to the device, or leave the moving to accelerate."""
    if settings.offload != "none" and device.type == "cpu":
        raise SettingsError(
            f"editor.offload: {settings.offload!r} moves parts between main memory and a GPU, but "
            "the editor runs on the CPU; use --set editor.offload=none, or --device cuda."
        )
    with out_of_memory_told("loading the weights"):
        if settings.offload == "model":
            pipeline.enable_model_cpu_offload(device=device)
        elif settings.offload == "sequential":
            pipeline.enable_sequential_cpu_offload(device=device)
        else:
            pipeline.to(device)
    if settings.low_memory:
        pipeline.vae.enable_slicing()
        pipeline.vae.enable_tiling()


def out_of_memory_told(doing: str) -> AbstractContextManager[None]:
    """Turn running out of memory into a sentence with the settings that help."""
    advice = (
        "try --set editor.offload=model, then editor.low_memory=true, a smaller editor.resolution, "
        "and last editor.offload=sequential"
    )
    return pretrained.out_of_memory_told(doing, advice)
