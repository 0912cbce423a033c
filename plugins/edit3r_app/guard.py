"""Who may talk to the server: requests and sockets are checked before the page library sees
them.
"""

import hmac
import urllib.parse

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

COOKIE = "edit3r-token"
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
HEADERS = {
    # Nothing is fetched from elsewhere, and no other page may show this one in a frame.
    "content-security-policy": "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; "
    "frame-ancestors 'self'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
}


class Guard:
    """ASGI middleware: refuses foreign hosts (DNS rebinding), foreign origins, missing tokens, and
    endless bodies.
    """

    def __init__(self, app: ASGIApp, *, token: str | None, most_bytes: int) -> None:
        self.app, self.token, self.most_bytes = app, token, most_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        asked, is_page = HTTPConnection(scope), scope["type"] == "http"
        if refused := self._refusal(asked):
            if is_page:
                await PlainTextResponse(refused[1], refused[0])(scope, receive, send)
            else:
                await send({"type": "websocket.close", "code": 4403})
        elif is_page and self.token and asked.query_params.get("token"):
            await _entry(asked)(scope, receive, send)
        else:
            await self.app(scope, receive, _with_headers(send) if is_page else send)

    def _refusal(self, asked: HTTPConnection) -> tuple[int, str] | None:
        """Status and sentence of what is refused; None for what may pass."""
        host, origin = asked.headers.get("host", ""), asked.headers.get("origin")
        name, _, port = host.rpartition(":")
        if self.token is None and (name if port.isdigit() else host) not in LOOPBACK:
            return 421, "This server answers to localhost only."
        if (
            origin is not None and urllib.parse.urlsplit(origin).netloc != host
        ):  # "null" has none
            return 403, "Requests of other pages are refused."
        if self.token is not None:
            given = asked.query_params.get("token") or asked.cookies.get(COOKIE, "")
            if not hmac.compare_digest(given.encode(), self.token.encode()):
                return 401, "Open the address with the token that `edit3r app` printed."
        length = asked.headers.get("content-length", "0")
        if not length.isdigit() or int(length) > self.most_bytes:
            return 413, f"At most {self.most_bytes >> 20} MB are taken at once."
        return None


def _entry(asked: HTTPConnection) -> Response:
    """Turn the token of the address into a cookie, and the address into one without it."""
    rest = urllib.parse.urlencode(
        [(k, v) for k, v in asked.query_params.multi_items() if k != "token"]
    )
    path = urllib.parse.quote(
        "/" + asked.scope["path"].lstrip("/\\")
    )  # never an address of another host
    answer = RedirectResponse(path + (f"?{rest}" if rest else ""), 303)
    answer.set_cookie(
        COOKIE, asked.query_params["token"], httponly=True, samesite="Strict"
    )
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
