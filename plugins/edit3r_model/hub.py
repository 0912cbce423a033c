"""Weights by their id on the Hugging Face hub: owner/name@revision, or owner/name@revision:file."""

import re
from pathlib import Path

from edit3r.contract.errors import InputError, MissingDependencyError, one_line

SUFFIXES = (".ckpt", ".pth", ".pt", ".safetensors")
FILES = ["config.json", "model.safetensors"]

_HUB_ID = re.compile(
    r"(?P<repo>[\w.-]+/[\w.-]+)(?:@(?P<revision>[\w./-]+?))?(?::(?P<file>[\w./-]+))?"
)


def is_hub_id(source: str) -> bool:
    """Tell whether `source` has the form owner/name..., unless a file or folder is called so."""
    path = Path(source)
    looks_local = path.exists() or path.suffix in SUFFIXES
    return _HUB_ID.fullmatch(source) is not None and not (
        looks_local and "@" not in source
    )


def download(source: str) -> Path:
    """Fetch the weights of a hub id, or find them in the local cache; a file or a folder."""
    parts = _HUB_ID.fullmatch(source)
    if parts is None:
        raise InputError(f"{source}: no such file, and no hub id owner/name@revision.")
    repo, revision, file = parts["repo"], parts["revision"], parts["file"]
    if revision is None:
        raise InputError(
            f"{source}: no such file, and as a hub id it needs a pinned revision, for example "
            f"{repo}@main or, better, {repo}@<commit>."
        )
    try:
        import huggingface_hub
    except ImportError:
        raise MissingDependencyError(
            f"weights {source!r} need huggingface_hub; install with: pip install huggingface_hub"
        ) from None
    try:
        if file is not None:
            return Path(huggingface_hub.hf_hub_download(repo, file, revision=revision))
        folder = huggingface_hub.snapshot_download(
            repo, revision=revision, allow_patterns=FILES
        )
        return Path(folder)
    except Exception as error:  # many kinds: network, permission, missing revision
        raise InputError(
            f"{source}: could not be fetched from the hub ({type(error).__name__}: "
            f"{one_line(error, 200)})."
        ) from error
