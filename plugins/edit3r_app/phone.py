"""A link that opens the app on a phone of the same network, as a code to scan."""

import re
import socket
import urllib.parse
from contextlib import suppress
from typing import Any

from edit3r.contract.errors import MissingDependencyError

HOW = (
    "This app answers this computer only. To open it on a phone of the same network, start it with "
    "edit3r app --host 0.0.0.0, and come back here."
)
ANYWHERE = ("0.0.0.0", "::")
PAGE = re.compile(r"/(s/[^/?#\\]{1,400}(\?[\w=&%.~+-]{0,800})?)?")
"""Paths of pages that a link may lead to."""


def phone_link(host: str, port: int, token: str | None, page: str) -> dict[str, Any]:
    """The address of a page with the token, and its code as SVG; or how to get one.

    Only a server that others may reach has a token. Raises MissingDependencyError without segno.
    """
    if token is None:
        return {"how": HOW, "address": "", "code": ""}
    try:
        import segno
    except ImportError:
        raise MissingDependencyError(
            'the code to scan needs segno: pip install "edit3r[app]"'
        ) from None
    path = page if PAGE.fullmatch(page) else "/"
    joint = "&" if "?" in path else "?"
    name = own_address(host) if host in ANYWHERE else host
    name = f"[{name}]" if ":" in name else name
    address = f"http://{name}:{port}{path}{joint}token={urllib.parse.quote(token)}"
    code = segno.make(address, error="m", micro=False)
    svg = code.svg_inline(scale=1, border=4, omitsize=True, light="#fff", dark="#000")
    return {"how": "", "address": address, "code": svg}


def own_address(host: str) -> str:
    """This machine's address in its network; of several that of the usual way out."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    nowhere = "2001:db8::1" if ":" in host else "192.0.2.1"  # RFC 3849, RFC 5737
    with socket.socket(family, socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.connect((nowhere, 9))  # of a datagram socket: nothing is sent
        return str(probe.getsockname()[0])
    return socket.gethostname()
