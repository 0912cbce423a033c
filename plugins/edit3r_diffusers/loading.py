"""Load a diffusers pipeline as the settings say, and turn what can go wrong into one sentence."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from edit3r.errors import Edit3rError, InputError, MissingDependencyError, RunError, SettingsError
from edit3r.reporting import note
from edit3r_diffusers.settings import DiffusionSettings

NO_SAFETY_CHECKER = {"safety_checker": None, "requires_safety_checker": False}
"""For Stable Diffusion 1.x pipelines: theirs turns a photo black on a false alarm, and a black view ruins the scene."""


def pick_device(name: str, photos_on: torch.device) -> torch.device:
    """The device called `name`; 'auto' is where the photos are. Raises SettingsError when it is not there."""
    if name == "auto":
        return photos_on
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).strip().splitlines()[0].rstrip(".")
        raise SettingsError(
            f"editor.device: {name!r} cannot be used on this machine ({reason}); use --set editor.device=cpu."
        ) from None
    return device


def pick_dtype(name: str, device: torch.device, half: torch.dtype) -> torch.dtype:
    """The precision called `name`; 'auto' is float32 on a CPU and `half` elsewhere."""
    if name == "auto":
        return torch.float32 if device.type == "cpu" else half
    return getattr(torch, name)


def load(pipeline_class: type, settings: DiffusionSettings, device: torch.device, dtype: torch.dtype, **parts) -> Any:
    """A pipeline with the settings' weights on `device`, its memory measures switched on; `parts` replace its own."""
    pipeline = pretrained(pipeline_class, settings.model, settings, dtype, **parts)
    pipeline.set_progress_bar_config(disable=True)
    _place(pipeline, settings, device)
    note("editor.weights", {"model": settings.model, "revision": settings.revision or "newest", "dtype": str(dtype)})
    return pipeline


def pretrained(cls: type, model: str, settings: DiffusionSettings, dtype: torch.dtype, key: str = "model", **parts):
    """`cls.from_pretrained`, its failures told as sentences about `editor.<key>`."""
    _check_folder(model, key)
    chosen = {"revision": settings.revision, "variant": settings.variant} if key == "model" else {}
    given = {name: value for name, value in chosen.items() if value}
    with quiet():
        try:
            return cls.from_pretrained(model, dtype=dtype, local_files_only=settings.local_files_only, **given, **parts)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError) as error:
            raise _loading_error(error, cls, model, key) from error


def _check_folder(model: str, key: str) -> None:
    """Something that can only be meant as a folder must be one."""
    looks_local = model.startswith(("/", "~", ".")) or model.count("/") > 1 or "\\" in model
    if looks_local and not Path(model).expanduser().is_dir():
        raise InputError(f"editor.{key}: no folder {model!r}; give one written by save_pretrained, or a model id.")


def _loading_error(error: Exception, cls: type, model: str, key: str) -> Edit3rError:
    reason = " ".join(str(error).split())[:300].rstrip(".")
    if "gated" in f"{type(error).__name__} {reason}".lower():
        return MissingDependencyError(
            f"editor.{key}: {model!r} is gated; accept its licence on its model page and log in with: hf auth login"
        )
    if Path(model).is_dir():
        return InputError(f"editor.{key}: {model!r} does not hold a {cls.__name__} ({reason}).")
    return MissingDependencyError(
        f"editor.{key}: {model!r} is not on this machine and could not be downloaded ({reason}); fetch it where there "
        f"is a network with `hf download {model}`, or give a folder with --set editor.{key}=FOLDER."
    )


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


@contextmanager
def out_of_memory_told(doing: str) -> Iterator[None]:
    """Turn running out of memory into a sentence with the settings that help."""
    try:
        yield
    except RuntimeError as error:  # torch.OutOfMemoryError is one; a CPU raises the plain class
        text = str(error).lower()
        if "out of memory" not in text and "not enough memory" not in text and "can't allocate memory" not in text:
            raise
        raise RunError(
            f"out of memory while {doing}; try --set editor.offload=model, then editor.low_memory=true, a smaller "
            f"editor.resolution, and last editor.offload=sequential."
        ) from error


@contextmanager
def quiet() -> Iterator[None]:
    """Hold back the libraries' own loading bars and warnings (about torchvision, and failures we tell better)."""
    loggers = [logging.getLogger(name) for name in ("diffusers", "transformers")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    from diffusers.utils import logging as diffusers_logging
    from transformers.utils import logging as transformers_logging

    for bars in (diffusers_logging, transformers_logging):
        bars.disable_progress_bar()
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels):
            logger.setLevel(level)
        for bars in (diffusers_logging, transformers_logging):
            bars.enable_progress_bar()
