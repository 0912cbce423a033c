"""Foreign hosts, foreign origins, missing tokens and endless bodies get an answer, but not from the
app.
"""

import asyncio

import pytest
import uvicorn
from edit3r_app import guard
from edit3r_app.guard import COOKIE, Connection, Guard
from uvicorn.server import ServerState


def ask(token=None, path="/", query="", root="", **headers):
    """Status that a request gets, and the headers of the answer."""
    sent = []

    async def app(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    scope = {"type": "http", "path": path, "query_string": query.encode()}
    scope["headers"] = [
        (key.replace("_", "-").encode(), value.encode())
        for key, value in headers.items()
    ]
    asyncio.run(Guard(app, token=token, max_bytes=1000, root=root)(scope, None, send))
    return sent[0]["status"], dict(sent[0]["headers"])


@pytest.mark.parametrize(
    "host", ["localhost:8090", "127.0.0.1:8090", "[::1]:8090", "localhost", "127.0.0.1"]
)
def test_this_machine_may(host):
    assert ask(host=host)[0] == 200
    assert ask(host=host, origin=f"http://{host}")[0] == 200


@pytest.mark.parametrize(
    "host",
    [
        "",
        "evil.com",
        "evil.com:8090",
        "localhost.evil.com:8090",
        "192.168.0.7:8090",
        "0.0.0.0:8090",
    ],
)
def test_other_hosts_may_not_as_after_dns_rebinding(host):
    assert ask(host=host)[0] == 421


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.com",
        "null",
        "http://localhost:9",
        "http://localhost:8090.evil.com",
        "file://",
        "http://[",
        "",
    ],
)
def test_other_pages_may_not(origin):
    assert ask(host="localhost:8090", origin=origin)[0] == 403
    token = {"token": "s3cret", "cookie": f"{COOKIE}=s3cret"}
    assert ask(host="h", origin=origin, **token)[0] == 403


@pytest.mark.parametrize(
    ("site", "dest", "status"),
    [
        ("cross-site", "image", 403),
        ("same-site", "image", 403),  # another port of this machine
        ("cross-site", "iframe", 403),
        ("cross-site", "script", 403),
        ("cross-site", "document", 200),  # a link that was followed
        ("same-origin", "image", 200),
        ("none", "document", 200),  # typed
    ],
)
def test_images_are_for_our_own_pages(site, dest, status):
    told = {"sec_fetch_site": site, "sec_fetch_dest": dest}
    answer, headers = ask(host="localhost:8090", **told)
    assert answer == status
    if status == 200:
        assert headers[b"cross-origin-resource-policy"] == b"same-origin"


def test_elsewhere_a_token_is_asked_for():
    assert ask(token="s3cret", host="192.168.0.7:8090")[0] == 401
    assert ask(token="s3cret", host="h", cookie=f"{COOKIE}=wrong")[0] == 401
    assert ask(token="s3cret", host="h", query="token=ünfug")[0] == 401
    assert ask(token="s3cret", host="h", cookie=f"{COOKIE}=s3cret")[0] == 200


def test_the_token_of_the_address_becomes_a_cookie_and_leaves_the_address():
    status, headers = ask(
        token="s3cret", host="h", path="//evil.com/x", query="token=s3cret&at=bear-1"
    )
    assert status == 303 and headers[b"location"] == b"/evil.com/x?at=bear-1"
    assert (
        b"HttpOnly" in headers[b"set-cookie"]
        and b"SameSite=strict" in headers[b"set-cookie"]
    )


def test_below_a_root_path_the_address_keeps_it_whether_a_proxy_took_it_away_or_not():
    for path in ("/x", "/edit3r/x"):
        _, headers = ask(
            token="s3cret", host="h", path=path, query="token=s3cret", root="/edit3r"
        )
        assert headers[b"location"] == b"/edit3r/x"


@pytest.mark.parametrize(("root", "status"), [("", 403), ("/edit3r", 200)])
def test_behind_a_proxy_with_another_host_the_browsers_word_counts(root, status):
    asked = {"token": "s3cret", "host": "localhost:8090", "root": root}
    asked |= {"origin": "https://lab.org", "cookie": f"{COOKIE}=s3cret"}
    assert ask(**asked, sec_fetch_site="same-origin")[0] == status
    assert ask(**asked)[0] == ask(**asked, sec_fetch_site="cross-site")[0] == 403


@pytest.mark.parametrize(
    ("length", "status"),
    [("1000", 200), ("1001", 413), ("1073741824", 413), ("-1", 413), ("x", 413)],
)
def test_bodies_are_limited_by_their_own_word(length, status):
    assert ask(host="localhost", content_length=length)[0] == status


def test_pages_fetch_nothing_from_elsewhere_and_are_shown_in_no_foreign_frame():
    policy = ask(host="localhost")[1][b"content-security-policy"].decode()
    assert (
        policy.startswith("default-src 'self'")
        and "frame-ancestors 'self'" in policy
        and "frame-src 'self';" in policy
        and "base-uri 'none'" in policy
        and "http" not in policy
    )


def test_a_header_that_drips_is_not_waited_for(monkeypatch):
    monkeypatch.setattr(guard, "PATIENCE", 0.2)

    async def app(scope, receive, send):
        await asyncio.sleep(0.4)  # an answer may take longer than a header
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"here"})

    async def exchange():
        config = uvicorn.Config(app, lifespan="off", log_level="critical")
        listening = await asyncio.get_running_loop().create_server(
            lambda: Connection(config, ServerState(), {}), "127.0.0.1", 0
        )
        place = listening.sockets[0].getsockname()

        async def answer(*parts):
            reader, writer = await asyncio.open_connection(*place)
            for part in parts:
                writer.write(part)
                await asyncio.sleep(0.1)
            try:
                return await asyncio.wait_for(reader.read(4000), 3)
            except ConnectionError:  # closed while more was sent
                return b""
            finally:
                writer.close()

        dripping = [b"GET / HTTP/1.1\r\n", b"a: b\r\n", b"c: d\r\n", b"e: f\r\n"]
        return await asyncio.gather(
            answer(b"GET / HTTP/1.1\r\nhost: x\r\n\r\n"), answer(*dripping)
        )

    whole, dripped = asyncio.run(exchange())
    assert b"200" in whole and dripped == b""
