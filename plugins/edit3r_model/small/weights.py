"""Weights of the small network: fp16 safetensors with a JSON card beside them."""

import hashlib
import json
from pathlib import Path

import safetensors.torch
import torch

from edit3r import reporting
from edit3r.errors import InputError
from edit3r_model.small.network import MatchedEditNetwork

SHIPPED = Path(__file__).parent / "weights" / "edit3r-small.safetensors"


def load_network(weights: str) -> MatchedEditNetwork:
    """The network with shipped weights, with those of a file, or 'untrained' (which is announced)."""
    if weights == "untrained":
        reporting.warn("edit3r: the network is untrained; repairs and fused edits are those of a random start.")
        return MatchedEditNetwork().eval()
    path = SHIPPED if weights == "shipped" else Path(weights)
    network = MatchedEditNetwork(width=int(read_card(path).get("width", 32)))
    state = _read(path)
    missing = set(network.state_dict()) ^ set(state)
    if missing:
        raise InputError(f"{path}: not weights of this network (such as {sorted(missing)[0]!r} does not fit).")
    network.load_state_dict({name: tensor.float() for name, tensor in state.items()})
    reporting.note("edit3r.weights", path.name)
    reporting.note("weights.edit3r", _record(path))
    return network.eval()


def _record(path: Path) -> dict[str, str]:
    """What a run's manifest says of the file."""
    licence = read_card(path).get("licence", "not stated")
    return {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "licence": licence}


def save_network(network: MatchedEditNetwork, path: Path, card: dict) -> None:
    """Write fp16 weights and their card (JSON data: steps, data, measured quality) beside them."""
    state = {name: tensor.detach().half().contiguous() for name, tensor in network.state_dict().items()}
    safetensors.torch.save_file(state, path)
    path.with_suffix(".json").write_text(
        json.dumps({"width": network.width, **card}, indent=2) + "\n", encoding="utf-8"
    )


def read_card(path: Path) -> dict:
    """What is written beside the weights; {} when nothing is."""
    card = path.with_suffix(".json")
    return json.loads(card.read_text(encoding="utf-8")) if card.is_file() else {}


def _read(path: Path) -> dict[str, torch.Tensor]:
    if not path.is_file():
        raise InputError(f"{path}: no such weights file; give a .safetensors file, 'shipped' or 'untrained'.")
    try:
        return safetensors.torch.load_file(path)
    except Exception as error:
        raise InputError(f"{path}: not a safetensors file ({error}).") from None
