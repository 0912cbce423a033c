"""Seeded damage to bytes, texts and JSON data, as broken disks, other programs and attackers make
it.
"""

import copy
import json
import random
from typing import Any

TEXTS = (
    *(
        "",
        " ",
        ".",
        "..",
        "/",
        "../../escaped",
        "/tmp/edit3r-escaped/x",
        "a/b",
        "a\\b",
        "C:\\x",
        "con",
        "nul.txt",
    ),
    *(
        "a\0b",
        "\n",
        "a\r\nb",
        "\udcff\udc80",
        "é" * 90,
        "x" * 5000,
        "名前",
        "‮abc",
        "-rf",
        "--out",
        "$(touch x)",
        "`x`",
    ),
    *(
        "__META__",
        "__DATA__",
        "__TITLE__",
        "</script><script>alert(1)</script>",
        "<!--",
        "%s%n",
        "{0}",
        "{name}",
        "~",
    ),
    *(
        "!!python/object/apply:os.system [x]",
        "null",
        "true",
        "1e999",
        "2001-99-99",
        "0x",
        "9" * 5000,
        "a: b: c",
    ),
    *(
        "path_0000",
        "p-1",
        "kind",
        "parts",
        "self",
        "name",
        "settings",
        "__class__",
        "*",
        "&a [*a]",
        "[" * 3000,
    ),
)
NUMBERS = (
    *(
        0,
        -1,
        1,
        2,
        -0.0,
        0.5,
        1e-300,
        1e30,
        1e300,
        -1e300,
        float("nan"),
        float("inf"),
        float("-inf"),
    ),
    *(2**31, 2**63, 2**64, -(2**63), 10**12, 10**400, 255, 256, 65536, 1000, -1000),
)


def nasty(rng: random.Random) -> Any:
    """One value of JSON data that nobody expects there."""
    deep: Any = 0
    for _ in range(rng.choice((3, 60))):
        deep = [deep]
    pool = (
        rng.choice(TEXTS),
        rng.choice(NUMBERS),
        None,
        True,
        [],
        {},
        [[]],
        deep,
        {"name": 3},
        [1, "a", None],
    )
    return rng.choice(pool)


def mangled_text(rng: random.Random, text: str) -> str:
    """A text with something nasty in it, in its place, or with a part gone or doubled."""
    start, end = sorted(rng.randrange(len(text) + 1) for _ in range(2))
    return rng.choice(
        (
            rng.choice(TEXTS),
            text[:start] + rng.choice(TEXTS) + text[start:],
            text[:start] + text[end:],
            text[:end] + text[start:end] * rng.choice((1, 3, 200)) + text[end:],
            text[:start]
            + rng.choice("\0\n\t{}[]:#&*!|>'\"%@`,?-9é\ud800")
            + text[start + 1 :],
        )
    )


def mangled_bytes(rng: random.Random, content: bytes) -> bytes:
    """Bytes cut off, flipped, overwritten, shuffled, doubled or replaced."""
    start, end = sorted(rng.randrange(len(content) + 1) for _ in range(2))
    flipped = bytearray(content)
    for _ in range(rng.choice((1, 3, 30))):
        if flipped:
            flipped[rng.randrange(min(len(flipped), rng.choice((64, 1 << 30))))] = (
                rng.randrange(256)
            )
    foreign = (
        b"",
        b"\0" * 64,
        b"%!PS-Adobe-3.0 EPSF-3.0\n",
        b"GIF89a",
        b"ply\n",
        b"PK\x03\x04",
        b"{}",
        b"\x80\x04N.",
    )
    return rng.choice(
        (
            content[:start],
            bytes(flipped),
            bytes(flipped),
            content[:start] + content[end:],
            content[:start] + b"\xff" * (end - start) + content[end:],
            content[:end] + content[start:],
            rng.choice(foreign) + content[start:],
            rng.choice(foreign),
        )
    )


def mangled_tree(rng: random.Random, tree: Any) -> Any:
    """JSON data in which one to three values, keys or items are wrong, missing, doubled or
    swapped.
    """
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = [place for place in _places(tree) if place is not None]
        if not places:
            return nasty(rng)
        parent, key = rng.choice(places)
        action = rng.randrange(5)
        if action <= 2:
            parent[key] = _near(rng, parent[key]) if action == 0 else nasty(rng)
        elif action == 3:
            del parent[key]
        elif isinstance(parent, dict):
            parent[rng.choice(TEXTS)] = parent.pop(key)
        else:
            parent.insert(key, copy.deepcopy(parent[rng.randrange(len(parent))]))
    return tree if rng.random() > 0.03 else nasty(rng)


def _near(rng: random.Random, value: Any) -> Any:
    """A value of the same type."""
    if isinstance(value, bool) or value is None:
        return not value
    if isinstance(value, int | float):
        return rng.choice((-value, value * 1000, value + 1, rng.choice(NUMBERS)))
    if isinstance(value, str):
        return mangled_text(rng, value)
    return type(value)()


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """(container, key) of every value in the data."""
    keys = (
        list(tree)
        if isinstance(tree, dict)
        else range(len(tree))
        if isinstance(tree, list)
        else ()
    )
    return [(tree, key) for key in keys] + [
        place for key in keys for place in _places(tree[key])
    ]


def json_bytes(rng: random.Random, tree: Any) -> bytes:
    """The data as a file, now and then damaged as text too."""
    content = json.dumps(mangled_tree(rng, tree)).encode(errors="surrogatepass")
    return mangled_bytes(rng, content) if rng.random() < 0.15 else content
