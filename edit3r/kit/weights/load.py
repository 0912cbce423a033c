"""Weights in the layout of `save_pretrained`, for plugins that load foreign networks.

Nothing here imports a foreign library; the plugin brings the class. Whatever goes wrong is one
sentence that names the setting and the way out.
"""

import importlib
import importlib.util
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from edit3r.contract.errors import (
    Edit3rError,
    InputError,
    MissingDependencyError,
    RunError,
    is_out_of_memory,
    one_line,
)
from edit3r.contract.torch_state import require_device
from edit3r.contract.weights import Weights
from edit3r.kit.files.names import expanded
from edit3r.kit.weights.find import at_hand, find, record_of

LIBRARIES = ("diffusers", "transformers")
LOGS_OF = {"diffusers": LIBRARIES, "transformers": ("transformers",)}
"""Libraries that speak up while one's classes are imported."""


@dataclass(frozen=True)
class ChosenWeights:
    """Which weights to load, and under which setting the user names them."""

    model: str  # id on the Hugging Face hub, or a folder
    key: str  # the setting, such as 'editor.model'
    # branch, tag or commit; '': the declared one, or the newest of what nobody declares
    revision: str = ""
    variant: str = ""  # such as 'fp16'; '': the full-precision files
    local_files_only: bool = False  # never download
    # what the plugin declares: those of the hub are looked for where `weights get` puts them
    known: tuple[Weights, ...] = ()


def foreign(library: str, name: str) -> Any:
    """A class of an optional library; MissingDependencyError where that does not import.

    Most often a torchvision that was built for another torch is to blame: its mere presence breaks
    both libraries.
    """
    try:
        # light; what `quiet` turns down must be there first
        for module in LOGS_OF.get(library, ()):
            importlib.import_module(f"{module}.utils.logging")
        with quiet():
            return getattr(importlib.import_module(library), name)
    except (ImportError, RuntimeError, OSError, AttributeError) as error:
        reason = one_line(error)
        cure = f"pip install --upgrade {library}"
        if "torchvision" in reason or "torchvision" in str(error.__cause__):
            cure = (
                "pip uninstall torchvision (edit3r does not need it), or install the one for "
                "your torch"
            )
        raise MissingDependencyError(
            f"{library}.{name} does not import here ({reason}); try: {cure}"
        ) from error


def load_pretrained(cls: Any, weights: ChosenWeights, **given: Any) -> Any:
    """`cls.from_pretrained`; InputError for a wrong folder, else MissingDependencyError.

    Weights that a component declares are read from where `edit3r weights get` puts them and never
    downloaded here.
    """
    _check_folder(weights)
    declared = _declared(weights)
    chosen = (
        {"revision": weights.revision, "variant": weights.variant}
        if declared is None
        else {}
    )
    given.update({name: value for name, value in chosen.items() if value})
    model = str(expanded(weights.model) if declared is None else find(declared))
    with quiet():
        try:
            return cls.from_pretrained(
                model, local_files_only=weights.local_files_only, **given
            )
        except (
            OSError,
            ValueError,
            KeyError,
            TypeError,
            AttributeError,
            RuntimeError,
        ) as error:
            raise loading_error(error, cls, weights) from error


def require_at_hand(weights: ChosenWeights) -> None:
    """Raise MissingDependencyError for declared weights that are not here, with the way to them."""
    if declared := _declared(weights):
        find(declared)


def sized(large: Weights, small: Weights) -> str:
    """The model of the hub that is here; else the large one for a GPU, the small one for a CPU."""
    chosen = large if torch.cuda.is_available() else small
    here = next((weights for weights in (large, small) if at_hand(weights)), chosen)
    return here.source.removeprefix("hub:")


def identity(weights: ChosenWeights) -> dict[str, str]:
    """What run.json says of them: model, revision asked for, and the commit of a download."""
    known = {"model": weights.model, "revision": weights.revision or "newest"}
    if declared := _declared(weights):
        fetched = record_of(find(declared)).get("revision", declared.revision)
        return {**known, "revision": fetched or "newest", "name": declared.name}
    if not expanded(weights.model).is_dir() and importlib.util.find_spec(
        "huggingface_hub"
    ):
        from huggingface_hub import try_to_load_from_cache

        for file in ("model_index.json", "config.json"):
            cached = try_to_load_from_cache(
                weights.model, file, revision=weights.revision or None
            )
            if isinstance(cached, str):
                return {**known, "commit": Path(cached).parent.name}
    return known


def _declared(weights: ChosenWeights) -> Weights | None:
    """The declared weights that are meant; None for a folder, another revision or variant."""
    if weights.variant or expanded(weights.model).is_dir():
        return None
    source = f"hub:{weights.model}"
    meant = (known for known in weights.known if known.source == source)
    return next(
        (known for known in meant if weights.revision in ("", known.revision)), None
    )


def _check_folder(weights: ChosenWeights) -> None:
    """Something that can only be meant as a folder must be one."""
    model = weights.model
    looks_local = (
        model.startswith(("/", "~", ".")) or model.count("/") > 1 or "\\" in model
    )
    if looks_local and not expanded(model).is_dir():
        raise InputError(
            f"{weights.key}: no folder {model!r}; give one written by save_pretrained, or a "
            "model id."
        )


def loading_error(error: Exception, cls: type, weights: ChosenWeights) -> Edit3rError:
    """The sentence for what `from_pretrained` raised."""
    reason = one_line(error)
    model, key = weights.model, weights.key
    if "gated" in f"{type(error).__name__} {reason}".lower():
        return MissingDependencyError(
            f"{key}: {model!r} is gated; accept its licence on its model page and log in with: "
            "hf auth login"
        )
    if expanded(model).is_dir():
        return InputError(
            f"{key}: {model!r} does not hold a {cls.__name__} ({reason})."
        )
    return MissingDependencyError(
        f"{key}: {model!r} is not on this machine and could not be downloaded ({reason}); fetch "
        "it where there is a "
        f"network with `hf download {model}`, or give a folder with --set {key}=FOLDER."
    )


def pick_device(name: str, photos_on: torch.device, key: str) -> torch.device:
    """The device called `name`, 'auto' being the photos'; SettingsError where it is not."""
    return photos_on if name == "auto" else require_device(name, key)


@contextmanager
def out_of_memory_told(doing: str, advice: str) -> Iterator[None]:
    """Turn running out of memory while `doing` something into a sentence with `advice`."""
    try:
        yield
    except (
        RuntimeError
    ) as error:  # torch.OutOfMemoryError is one; a CPU raises the plain class
        if not is_out_of_memory(error):
            raise
        raise RunError(f"out of memory while {doing}; {advice}.") from error


@contextmanager
def quiet() -> Iterator[None]:
    """Hold back the libraries' own loading bars and warnings, which we tell better."""
    imported = [name for name in LIBRARIES if f"{name}.utils.logging" in sys.modules]
    loggers = [logging.getLogger(name) for name in imported]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    bars = [sys.modules[f"{name}.utils.logging"] for name in imported]
    for bar in bars:
        bar.disable_progress_bar()
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels):
            logger.setLevel(level)
        for bar in bars:
            bar.enable_progress_bar()
