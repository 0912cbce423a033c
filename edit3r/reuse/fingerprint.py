"""What "the same input" means: equal bytes give equal fingerprints, whatever computed them."""

import hashlib
import inspect
import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import edit3r
from edit3r.types import Views


def fingerprint(*things: Any) -> str:
    """Hex digest of tensors, views, texts, numbers, None, and sequences of them."""
    digest = hashlib.blake2b(digest_size=16)
    for thing in things:
        _add(digest, thing)
    return digest.hexdigest()


def identity(component: Any) -> str:
    """Digest of all that a component's answers depend on besides its input.

    Name, plugin and version, its source file, settings, parts, and the weights of its network. Editing another file of
    a plugin without raising its version goes unnoticed.
    """
    offer = getattr(component, "offer", None)
    who = (offer.qualified_name, offer.version) if offer is not None else (type(component).__qualname__, "")
    settings = getattr(component, "settings", None)
    values = settings.model_dump_json() if settings is not None else ""
    parts = sorted((getattr(component, "parts", None) or {}).items())
    inner = [(kind, identity(part)) for kind, part in parts]
    return fingerprint(edit3r.__version__, who, _source(component), values, inner, _weights(component))


def _add(digest: "hashlib._Hash", thing: Any) -> None:
    if isinstance(thing, Tensor):
        values = thing.detach().cpu().contiguous()
        digest.update(f"{values.dtype}{list(values.shape)}".encode())
        digest.update(values.flatten().view(torch.uint8).numpy() if values.numel() else b"")
    elif isinstance(thing, Views):
        _add(digest, (thing.images, thing.intrinsics, thing.c2w))  # names do not change what is computed
    elif isinstance(thing, (list, tuple)):
        digest.update(f"({len(thing)}".encode())
        for item in thing:
            _add(digest, item)
    else:
        digest.update(json.dumps(thing).encode() + b"\n")


def _source(component: Any) -> str:
    component = getattr(component, "remembers", component)
    try:
        return hashlib.blake2b(Path(inspect.getfile(type(component))).read_bytes(), digest_size=16).hexdigest()
    except (OSError, TypeError):  # made in a console
        return ""


def _weights(component: Any) -> list[tuple[str, float, float]]:
    """Two sums per tensor of the network: training changes them, and a large network is read in a second."""
    network = getattr(component, "network", None)
    if network is None:
        return []
    floats = ((name, value.detach()) for name, value in network.state_dict().items() if value.is_floating_point())
    return [(name, float(v.sum(dtype=torch.float64)), float(v.double().square().sum())) for name, v in floats]
