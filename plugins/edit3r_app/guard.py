"""Who may talk to the server: requests are checked before the page library sees them."""

import asyncio
import hmac
import urllib.parse
from typing import Any

import h11
from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

COOKIE = "edit3r-token"
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
HEADERS = {
    # Nothing is fetched from elsewhere, the frame of a scene is led nowhere else, and no other page
    # may show this one in a frame.
    "content-security-policy": "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; "
    "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'self'",
    # An image here tells another page nothing, not even that it is there.
    "cross-origin-resource-policy": "same-origin",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
}


PATIENCE = 20.0
"""[s] that a request may take until its header is there; no figure kept."""


class Connection(H11Protocol):
    """One that is closed where the header of a request does not arrive in time."""

    _late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        if self._late is not None:
            self._late.cancel()

    def _wait(self) -> None:
        """Begin to wait where a header is due, however little of it has come; else end it."""
        is_due = self.conn.their_state is h11.IDLE
        if is_due and self._late is None:
            self._late = self.loop.call_later(PATIENCE, self.transport.close)
        elif not is_due and self._late is not None:
            self._late.cancel()
            self._late = None


class Guard:
    """ASGI middleware: refuses foreign hosts and origins, missing tokens, and endless bodies."""

    def __init__(
        self, app: ASGIApp, *, token: str | None, max_bytes: int, root: str = ""
    ) -> None:
        self.app = app
        self.token, self.root = token, root
        self.max_bytes = max_bytes  # of one request

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":  # there are no other addresses
            await self.app(scope, receive, send)
            return
        asked = HTTPConnection(scope)
        refusal = self._refusal(asked)
        if refusal is not None:
            await refusal(scope, receive, send)
        elif self.token and asked.query_params.get("token"):
            await _entry(asked, self.root)(scope, receive, send)
        else:
            await self.app(scope, receive, _with_headers(send))

    def _refusal(self, asked: HTTPConnection) -> Response | None:
        """The answer to what is refused; None for what may pass."""
        host = asked.headers.get("host", "")
        origin = asked.headers.get("origin")
        name, _, port = host.rpartition(":")
        if self.token is None and (name if port.isdecimal() else host) not in LOOPBACK:
            return PlainTextResponse("This server answers to localhost only.", 421)
        # A proxy may have put another host there: then the browser's word counts.
        vouched = self.root and asked.headers.get("sec-fetch-site") == "same-origin"
        if origin is not None and _host_of(origin) != host and not vouched:
            return PlainTextResponse("Requests of other pages are refused.", 403)
        if _is_of_another_page(asked):
            return PlainTextResponse("Requests of other pages are refused.", 403)
        if self.token is not None:
            given = asked.query_params.get("token") or asked.cookies.get(COOKIE, "")
            if not hmac.compare_digest(given.encode(), self.token.encode()):
                told = "Open the address with the token that `edit3r app` printed."
                return PlainTextResponse(told, 401)
        length = asked.headers.get("content-length", "0")
        if not length.isdecimal() or float(length) > self.max_bytes:
            told = f"At most {self.max_bytes >> 20} MB are taken at once."
            return PlainTextResponse(told, 413)
        return None


def _is_of_another_page(asked: HTTPConnection) -> bool:
    """Whether a browser says that a page from elsewhere asks; a link that leads here may."""
    site = asked.headers.get("sec-fetch-site", "none")
    is_document = asked.headers.get("sec-fetch-dest") == "document"
    is_link = is_document and asked.scope.get("method", "GET") in ("GET", "HEAD")
    return site not in ("same-origin", "none") and not is_link


def _host_of(origin: str) -> str:
    """Host and port of an origin; "" for "null" and for what is no address."""
    try:
        return urllib.parse.urlsplit(origin).netloc
    except ValueError:
        return ""


def _entry(asked: HTTPConnection, root: str) -> Response:
    """Turn the token of the address into a cookie, and the address into one without it."""
    kept = [pair for pair in asked.query_params.multi_items() if pair[0] != "token"]
    # Never an address of another host.
    path = asked.scope["path"].removeprefix(root).lstrip("/\\")
    path = urllib.parse.quote(f"{root}/{path}")
    query = urllib.parse.urlencode(kept)
    answer = RedirectResponse(f"{path}?{query}" if query else path, 303)
    token = asked.query_params["token"]
    answer.set_cookie(COOKIE, token, httponly=True, samesite="strict")
    return answer


def _with_headers(send: Send) -> Send:
    """Add `HEADERS` to a response, but where it has its own."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for key, value in HEADERS.items():
                headers.setdefault(key, value)
        await send(message)

    return sending
