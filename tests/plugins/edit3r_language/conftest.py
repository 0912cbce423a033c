"""A service that answers what a test tells it, and a tiny network that says a given text."""

import json
import threading
from collections import deque
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

KEY = "sk-very-secret-0123456789"


class FakeChat:
    """Answers with the texts of `answers`, the last one again and again; a number is a status."""

    def __init__(self) -> None:
        self.answers: deque = deque()
        self.requests: list[dict] = []
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        threading.Thread(
            target=self.server.serve_forever,
            kwargs={"poll_interval": 0.02},
            daemon=True,
        ).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server.server_port}/v1"

    def _handler(self):
        chat = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                chat.requests.append(json.loads(body))
                answers = chat.answers
                said = answers.popleft() if len(answers) > 1 else answers[0]
                status = said if isinstance(said, int) else 200
                message = {"role": "assistant", "content": said}
                answer = {"choices": [{"index": 0, "message": message}]}
                if status != 200:
                    answer = {"error": {"message": f"no, your key was {KEY}"}}
                content = json.dumps(answer).encode()
                self.send_response(status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(content)))
                self.send_header("retry-after-ms", "5")
                self.send_header("Connection", "close")
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, *_):
                pass

        return Handler


@pytest.fixture
def chat(monkeypatch):
    pytest.importorskip("openai")
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    service = FakeChat()
    yield service
    service.server.shutdown()
    service.server.server_close()
