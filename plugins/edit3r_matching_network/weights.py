"""Weights of the correlation network: safetensors, the network's sizes in their metadata."""

import json
from collections.abc import Mapping
from pathlib import Path

import safetensors
import safetensors.torch
import torch
from torch import Tensor

from edit3r import reporting
from edit3r.errors import InputError, RunError
from edit3r_matching_network.front import imagenet_front
from edit3r_matching_network.network import CorrelationNetwork

SHIPPED = Path(__file__).parent / "weights" / "correlation.safetensors"


def load_network(weights: str) -> CorrelationNetwork:
    """The network with shipped weights, with those of a file, 'untrained' (which is announced), or, to begin a
    training, 'imagenet-front': all but the front untrained.
    """
    if weights == "imagenet-front":
        network = CorrelationNetwork()
        network.encoder.front = imagenet_front().to(memory_format=torch.channels_last)
        return network.eval()
    if weights == "untrained":
        reporting.warn("matcher network: the network is untrained; pose and depth are those of a random start.")
        return CorrelationNetwork().eval()
    path = SHIPPED if weights == "shipped" else Path(weights)
    sizes, state = _read(path)
    try:
        network = CorrelationNetwork(**sizes)
        network.load_state_dict({name: tensor.float() for name, tensor in state.items()})
    except (TypeError, RuntimeError) as error:
        raise InputError(f"{path}: not weights of this network ({str(error).splitlines()[0]}).") from None
    reporting.note("matcher.weights", path.name)
    return network.eval()


def save_weights(
    path: Path, state: Mapping[str, Tensor], sizes: Mapping[str, int], dtype: torch.dtype = torch.float32
) -> None:
    """Write whole or not at all; raises RunError when the disk is full."""
    partial = path.with_suffix(".partial")
    content = {name: tensor.detach().to(dtype).contiguous() for name, tensor in state.items()}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        safetensors.torch.save_file(content, partial, metadata={"sizes": json.dumps(dict(sizes))})
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise RunError(f"{path}: the weights could not be written ({error}); free some disk space.") from error


def _read(path: Path) -> tuple[dict[str, int], dict[str, Tensor]]:
    if not path.is_file():
        raise InputError(f"{path}: no such weights file; give a .safetensors file, 'shipped' or 'untrained'.")
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            sizes = json.loads((file.metadata() or {}).get("sizes", "{}"))
            return sizes, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    except Exception as error:
        raise InputError(f"{path}: not a safetensors file ({error}).") from None
