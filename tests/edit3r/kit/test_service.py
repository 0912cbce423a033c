"""Answers of services are read up to bounds, and quoted up to some."""

import time

import pytest

from edit3r.kit import service
from edit3r.kit.service import MAX_QUOTE, quoted


def test_an_answer_is_read_until_it_is_too_large_or_too_late(monkeypatch):
    httpx2 = pytest.importorskip("httpx2")
    monkeypatch.setattr(service, "MAX_ANSWER", 10)
    now, parts = time.monotonic(), [b"12345", b"67890"]
    assert list(service._bounded_chunks(parts, now + 60)) == parts
    with pytest.raises(OSError, match="larger"):
        list(service._bounded_chunks([*parts, b"1"], now + 60))
    with pytest.raises(httpx2.ReadTimeout):
        list(service._bounded_chunks(parts, now - 1))


@pytest.mark.parametrize(("more", "end"), [(0, "b"), (1, "...")])
def test_a_quote_is_one_line_and_shortened_where_it_is_longer(more, end):
    shown = quoted("a\n\x1b " + "b" * (MAX_QUOTE - 2 + more))
    assert shown.startswith("a b") and shown.endswith(end)
    assert len(shown) == MAX_QUOTE + 3 * more
