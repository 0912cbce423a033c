"""Our own format: a folder with `model.safetensors` (our parameter names) and `config.json` (what to build)."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from edit3r.errors import InputError
from edit3r_model.checkpoints.loaded import NetworkConfig, PartConfig

WEIGHTS, CONFIG = "model.safetensors", "config.json"
FORMAT = 1


def save_weights(
    folder: str | Path,
    state: Mapping[str, Tensor],
    config: NetworkConfig,
    licence: str,
    provenance: Mapping[str, Any] | None = None,
) -> Path:
    """Write `state` and what is needed to rebuild its network into `folder`; each file appears only when whole.

    `provenance` is any JSON data worth keeping: the file converted from and its hash, training data, steps.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    about = {"format": FORMAT, **asdict(config), "licence": licence, "provenance": dict(provenance or {})}
    described = folder / (CONFIG + ".partial")
    described.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    partial = folder / (WEIGHTS + ".partial")
    save_file({name: tensor.contiguous() for name, tensor in state.items()}, partial, {"format": "pt"})
    partial.chmod(described.stat().st_mode)  # safetensors makes files that only their owner can read
    os.replace(partial, folder / WEIGHTS)
    os.replace(described, folder / CONFIG)
    return folder


def read_config(path: Path) -> tuple[NetworkConfig, dict[str, Any]]:
    """The network of a `config.json`, and the whole file."""
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        if about["format"] != FORMAT:
            raise InputError(f"{path}: format {about['format']} is newer than this edit3r knows ({FORMAT}).")
        config = NetworkConfig(
            PartConfig(**about["backbone"]), PartConfig(**about["head"]), int(about.get("resolution", 256))
        )
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); our weights need it beside {WEIGHTS}.") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not a configuration of edit3r weights ({type(error).__name__}: {error}).") from None
    return config, about


def read_safetensors(path: Path) -> dict[str, Tensor]:
    """Tensors of a safetensors file, left on disk until used."""
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            return {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: not a readable safetensors file ({error}).") from None
