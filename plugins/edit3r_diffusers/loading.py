"""Load a diffusers pipeline as the settings say, its memory measures switched on."""

from contextlib import AbstractContextManager
from typing import Any

import torch

from edit3r.errors import SettingsError
from edit3r.io import pretrained
from edit3r.io.pretrained import Weights
from edit3r.reporting import note
from edit3r_diffusers.settings import DiffusionSettings

NO_SAFETY_CHECKER = {"safety_checker": None, "requires_safety_checker": False}
"""For Stable Diffusion 1.x pipelines: theirs turns a photo black on a false alarm, and a black view ruins the scene."""


def pick_dtype(name: str, device: torch.device, half: torch.dtype) -> torch.dtype:
    """The precision called `name`; 'auto' is float32 on a CPU and `half` elsewhere."""
    if name == "auto":
        return torch.float32 if device.type == "cpu" else half
    return getattr(torch, name)


def load(pipeline_class: type, settings: DiffusionSettings, device: torch.device, dtype: torch.dtype, **parts) -> Any:
    """A pipeline with the settings' weights on `device`; `parts` replace its own."""
    weights = Weights(settings.model, "editor.model", settings.revision, settings.variant, settings.local_files_only)
    pipeline = pretrained.load_pretrained(pipeline_class, weights, dtype=dtype, **parts)
    pipeline.set_progress_bar_config(disable=True)
    _place(pipeline, settings, device)
    note("editor.weights", {**pretrained.identity(weights), "dtype": str(dtype)})
    return pipeline


def part_weights(model: str, key: str, settings: DiffusionSettings) -> Weights:
    """Weights of a part beside the main model, named by the setting `key`."""
    return Weights(model, f"editor.{key}", local_files_only=settings.local_files_only)


def _place(pipeline: Any, settings: DiffusionSettings, device: torch.device) -> None:
    """Move to the device, or leave the moving to accelerate."""
    if settings.offload != "none" and device.type == "cpu":
        raise SettingsError(
            f"editor.offload: {settings.offload!r} moves parts between main memory and a GPU, but the editor runs on "
            f"the CPU; use --set editor.offload=none, or --device cuda."
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
        "try --set editor.offload=model, then editor.low_memory=true, a smaller editor.resolution, and last "
        "editor.offload=sequential"
    )
    return pretrained.out_of_memory_told(doing, advice)
