"""Who may talk to the server: requests and sockets are checked before the page library sees them."""

import hmac
import http.cookies
import urllib.parse
from collections.abc import Awaitable, Callable
from typing import Any

Scope = dict[str, Any]
Receive = Callable[[], Awaitable[dict[str, Any]]]
Send = Callable[[dict[str, Any]], Awaitable[None]]

COOKIE = "edit3r-token"
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
HEADERS = {
    # Nothing is fetched from elsewhere, and no other page may show this one in a frame.
    "content-security-policy": "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; frame-ancestors 'self'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
}


class Guard:
    """ASGI middleware: refuses foreign hosts (DNS rebinding), foreign origins, missing tokens, and endless bodies."""

    def __init__(self, app: Any, *, token: str | None, most_bytes: int) -> None:
        self.app, self.token, self.most_bytes = app, token, most_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {key.decode("latin-1").lower(): value.decode("latin-1") for key, value in scope["headers"]}
        refused = self._refusal(scope, headers)
        if refused is not None:
            await _answer(scope, send, *refused)
        elif scope["type"] == "http" and (token := _query(scope).get("token")) and self.token:
            await _answer(scope, send, 303, "", _entry(scope, token))
        else:
            await self.app(scope, receive, _with_headers(send) if scope["type"] == "http" else send)

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str] | None:
        """Status and sentence of what is refused; None for what may pass."""
        host, origin = headers.get("host", ""), headers.get("origin")
        if self.token is None and _without_port(host) not in LOOPBACK:
            return 421, "This server answers to localhost only."
        if origin is not None and urllib.parse.urlsplit(origin).netloc != host:  # "null" has none
            return 403, "Requests of other pages are refused."
        if self.token is not None:
            given = _query(scope).get("token") or _cookie(headers)
            if not hmac.compare_digest(given.encode(), self.token.encode()):
                return 401, "Open the address with the token that `edit3r app` printed."
        length = headers.get("content-length", "0")
        if not length.isdigit() or int(length) > self.most_bytes:
            return 413, f"At most {self.most_bytes >> 20} MB are taken at once."
        return None


def _query(scope: Scope) -> dict[str, str]:
    return dict(urllib.parse.parse_qsl(scope.get("query_string", b"").decode("latin-1")))


def _cookie(headers: dict[str, str]) -> str:
    try:
        found = http.cookies.SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except http.cookies.CookieError:
        return ""
    return found.value if found else ""


def _without_port(host: str) -> str:
    return host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host


def _entry(scope: Scope, token: str) -> list[tuple[bytes, bytes]]:
    """Headers that turn the token of the address into a cookie, and the address into one without it."""
    rest = urllib.parse.urlencode([(k, v) for k, v in _query(scope).items() if k != "token"])
    path = "/" + scope["path"].lstrip("/\\")  # never an address of another host
    where = urllib.parse.quote(path) + (f"?{rest}" if rest else "")
    cookie = f"{COOKIE}={urllib.parse.quote(token)}; Path=/; HttpOnly; SameSite=Strict"
    return [(b"location", where.encode()), (b"set-cookie", cookie.encode())]


async def _answer(
    scope: Scope, send: Send, status: int, text: str, headers: list[tuple[bytes, bytes]] | None = None
) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 4403})
        return
    plain = [(b"content-type", b"text/plain; charset=utf-8"), *(headers or [])]
    await send({"type": "http.response.start", "status": status, "headers": plain})
    await send({"type": "http.response.body", "body": text.encode()})


def _with_headers(send: Send) -> Send:
    """Add `HEADERS` to a response, but where it has its own."""

    async def sending(message: dict[str, Any]) -> None:
        if message["type"] == "http.response.start":
            own = {key.lower() for key, _ in message.get("headers", ())}
            more = [(key.encode(), value.encode()) for key, value in HEADERS.items() if key.encode() not in own]
            message = {**message, "headers": [*message.get("headers", ()), *more]}
        await send(message)

    return sending
