"""A fake image service on loopback that speaks both protocols and misbehaves on order."""

import base64
import io
import json
import struct
import threading
import time
import zlib
from collections import deque
from email import message_from_bytes
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
import torch
from PIL import Image

import edit3r

KEY = "sk-very-secret-0123456789"


class FakeService:
    """Answers with the picture it was sent, inverted, unless `script` says what to do next ('ok' is
    the default).
    """

    def __init__(self, host: str = "127.0.0.1") -> None:
        self.host = host
        self.script: deque[str] = deque()
        self.requests: list[dict] = []
        self.lock = threading.Lock()
        self.busy = self.busiest = 0
        self.server = ThreadingHTTPServer((host, 0), self._handler())
        self.server.daemon_threads = True
        self.thread = threading.Thread(
            target=self.server.serve_forever,
            kwargs={"poll_interval": 0.02},
            daemon=True,
        )
        self.thread.start()

    @property
    def url(self) -> str:
        return f"http://{self.host}:{self.server.server_port}"

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()
        self.thread.join(5)

    def _handler(self):
        service = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                with service.lock:
                    service.busy += 1
                    service.busiest = max(service.busiest, service.busy)
                    behaviour = service.script.popleft() if service.script else "ok"
                try:
                    request = read(self.path, self.headers, body)
                    service.requests.append(request)
                    respond(self, request, behaviour)
                except (BrokenPipeError, ConnectionResetError):
                    pass  # the client gave up, as some tests want
                finally:
                    with service.lock:
                        service.busy -= 1

            def do_GET(self):
                service.requests.append({"path": self.path})
                send(self, b"{}")

            def log_message(self, *_):
                pass

        return Handler


def read(path: str, headers, body: bytes) -> dict:
    """What a client sent, by field name."""
    found = {
        "path": path,
        "headers": {name.lower(): value for name, value in headers.items()},
        "body": body,
    }
    if "/images/edits" in path:
        message = message_from_bytes(
            b"Content-Type: " + headers["Content-Type"].encode() + b"\r\n\r\n" + body
        )
        for part in message.get_payload():
            found[part.get_param("name", header="content-disposition")] = (
                part.get_payload(decode=True)
            )
        found["size"] = tuple(
            int(side) for side in reversed(found["size"].decode().split("x"))
        )
    else:
        found["json"] = json.loads(body)
        parts = [
            part for content in found["json"]["contents"] for part in content["parts"]
        ]
        found["prompt"] = next(
            part["text"] for part in parts if "text" in part
        ).encode()
        data = next(
            part["inlineData"]["data"] for part in parts if "inlineData" in part
        )
        found["image"] = base64.b64decode(data + "=" * (-len(data) % 4), altchars=b"-_")
        width, height = Image.open(io.BytesIO(found["image"])).size
        found["size"] = (height, width)
    return found


def inverted(picture: bytes, size=None) -> bytes:
    image = Image.fromarray(
        255 - np.array(Image.open(io.BytesIO(picture)).convert("RGB"))
    )
    if size is not None:
        image = image.resize((size[1], size[0]))
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()


def respond(handler, request: dict, behaviour: str) -> None:
    kind, _, value = behaviour.partition(":")
    height, width = request["size"]
    if kind == "status":
        message = f"synthetic trouble, your key was {KEY}"
        error = {"message": message, "code": int(value), "status": "TROUBLE"}
        return send(handler, json.dumps({"error": error}).encode(), int(value))
    if kind == "elsewhere":
        status, _, address = value.partition(" ")
        return send(handler, b"{}", int(status), address=address + request["path"])
    if kind == "slow":
        time.sleep(float(value))
    if kind == "refusal":
        return send(handler, *refusal(request))
    pictures = {
        "garbage": b"this is no picture",
        "key": f"ab {KEY}".encode(),
        "gigapixels": gigapixels() if kind == "gigapixels" else b"",
        "wrong-size": inverted(request["image"], (height // 2, width // 2))
        if kind == "wrong-size"
        else b"",
        "wrong-shape": inverted(request["image"], (height, width // 2))
        if kind == "wrong-shape"
        else b"",
    }
    picture = pictures.get(kind) or inverted(request["image"])
    body = success(request, picture)
    if kind == "usage":
        body = body.replace(b": 100", b": " + value.encode()).replace(
            b": 200", b": " + value.encode()
        )
    if kind == "no-usage":
        body = body.replace(b'"usage": {', b'"usage": "none", "x": {').replace(
            b'"usageMetadata": {', b'"x": {'
        )
    if kind == "half-json":
        body = body[: len(body) // 2]
    send(handler, body, announced=2 * len(body) if kind == "truncated" else len(body))


def gigapixels() -> bytes:
    """A PNG whose header says 60000 x 40000."""
    header = struct.pack(">IIBBBBB", 60000, 40000, 8, 2, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(b"")), (b"IEND", b"")]
    parts = [
        struct.pack(">I", len(c)) + n + c + struct.pack(">I", zlib.crc32(n + c))
        for n, c in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def success(request: dict, picture: bytes) -> bytes:
    encoded = base64.b64encode(picture).decode()
    if "/images/edits" in request["path"]:
        details = {"image_tokens": 100, "text_tokens": 0}
        usage = {
            "input_tokens": 100,
            "output_tokens": 200,
            "total_tokens": 300,
            "input_tokens_details": details,
        }
        return json.dumps(
            {"created": 1, "data": [{"b64_json": encoded}], "usage": usage}
        ).encode()
    parts = [
        {"text": "Here you are."},
        {"inlineData": {"mimeType": "image/png", "data": encoded}},
    ]
    candidate = {"content": {"role": "model", "parts": parts}, "finishReason": "STOP"}
    return json.dumps(
        {
            "candidates": [candidate],
            "usageMetadata": {"promptTokenCount": 100, "candidatesTokenCount": 200},
        }
    ).encode()


def refusal(request: dict) -> tuple[bytes, int]:
    words = "I will not paint that."
    if "/images/edits" in request["path"]:
        return json.dumps(
            {"error": {"message": words, "code": "moderation_blocked"}}
        ).encode(), 400
    candidate = {
        "content": {"role": "model", "parts": [{"text": words}]},
        "finishReason": "IMAGE_SAFETY",
    }
    return json.dumps({"candidates": [candidate]}).encode(), 200


def send(
    handler,
    body: bytes,
    status: int = 200,
    announced: int | None = None,
    address: str = "",
) -> None:
    handler.send_response(status)
    if address:
        handler.send_header("Location", address)
    handler.send_header("Content-Type", "application/json")
    handler.send_header("Content-Length", str(announced or len(body)))
    handler.send_header("retry-after-ms", "5")
    handler.send_header("Connection", "close")
    handler.end_headers()
    handler.wfile.write(body)
    handler.close_connection = True


@pytest.fixture
def fake(monkeypatch):
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    for name in ("OPENAI_API_KEY", "GEMINI_API_KEY"):
        monkeypatch.setenv(name, KEY)
    service = FakeService()
    yield service
    service.close()


@pytest.fixture
def elsewhere():
    """A service on another host."""
    service = FakeService("127.0.0.2")
    yield service
    service.close()


@pytest.fixture(params=["gpt-image", "gemini-image"])
def editor_name(request) -> str:
    pytest.importorskip(
        {"gpt-image": "openai", "gemini-image": "google.genai"}[request.param]
    )
    return request.param


@pytest.fixture
def build(fake, editor_name, tmp_path):
    """The editor under test, aimed at the fake service."""

    def build(**settings):
        base_url = f"{fake.url}/v1" if editor_name == "gpt-image" else fake.url
        quick = {"retry_delay_s": 0.01} if editor_name == "gemini-image" else {}
        settings = {
            "base_url": base_url,
            "cache": str(tmp_path / "cache"),
            "concurrent": 1,
            **quick,
            **settings,
        }
        return edit3r.build("editor", editor_name, **settings)

    return build


@pytest.fixture
def two_views() -> edit3r.Views:
    """Two smooth 24 x 32 pictures."""
    y, x = torch.meshgrid(
        torch.linspace(0.1, 0.9, 24), torch.linspace(0.1, 0.9, 32), indexing="ij"
    )
    images = torch.stack((torch.stack((x, y, x)), torch.stack((y, x, y))))
    return edit3r.Views(
        images[None], torch.eye(3).expand(1, 2, 3, 3), ("left.png", "right.png")
    )
