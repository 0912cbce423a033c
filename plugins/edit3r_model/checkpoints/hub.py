"""Weights by hub id with a pinned revision: `owner/name@revision` or `owner/name@revision:file`."""

import re
from pathlib import Path

from edit3r.errors import InputError, MissingDependencyError

_HUB_ID = re.compile(r"(?P<repo>[\w.-]+/[\w.-]+)(?:@(?P<revision>[\w./-]+?))?(?::(?P<file>[\w./-]+))?")


def is_hub_id(source: str) -> bool:
    """True for text of the form owner/name..., unless a file or folder of that name exists."""
    found = _HUB_ID.fullmatch(source)
    looks_local = Path(source).exists() or Path(source).suffix in (".ckpt", ".pth", ".pt", ".safetensors")
    return found is not None and not (looks_local and "@" not in source)


def download(source: str) -> Path:
    """Fetch (or find in the local cache) the weights of a hub id; returns a file or folder."""
    found = _HUB_ID.fullmatch(source)
    repo, revision, file = found["repo"], found["revision"], found["file"]
    if revision is None:
        raise InputError(
            f"{source}: no such file, and as a hub id it needs a pinned revision, for example {repo}@main or, better, "
            f"{repo}@<commit>."
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
        patterns = ["config.json", "model.safetensors"]
        return Path(huggingface_hub.snapshot_download(repo, revision=revision, allow_patterns=patterns))
    except Exception as error:  # the library raises many kinds: network, permission, missing revision
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{source}: could not be fetched from the hub ({type(error).__name__}: {reason}).") from error
