"""The link for a phone: only of a server that others may reach, and only to its own pages."""

import pytest
from edit3r_app.phone import own_address, phone_link


def test_a_server_of_this_machine_alone_says_how():
    told = phone_link("127.0.0.1", 8090, None, "/s/bike")
    assert "--host 0.0.0.0" in told["how"] and not told["address"]


@pytest.mark.parametrize(
    ("page", "path"),
    [
        ("/s/bike?at=bike-1", "/s/bike?at=bike-1&token=a%20b"),
        ("/s/my%20bike", "/s/my%20bike?token=a%20b"),
        ("/", "/?token=a%20b"),
        ("//evil.example/s/x", "/?token=a%20b"),
        ("/s/../api/home", "/?token=a%20b"),
        ("javascript:alert(1)", "/?token=a%20b"),
    ],
)
def test_the_code_leads_to_a_page_of_ours_with_the_token(page, path):
    pytest.importorskip("segno", reason='needs the app: pip install "edit3r[app]"')
    told = phone_link("192.168.1.7", 8090, "a b", page)
    assert told["address"] == f"http://192.168.1.7:8090{path}"
    assert told["code"].startswith("<svg") and "evil" not in told["code"]


def test_a_server_that_listens_everywhere_is_called_by_its_address():
    name = own_address("0.0.0.0")
    assert name and name not in ("0.0.0.0", "")
