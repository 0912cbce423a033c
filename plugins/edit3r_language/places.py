"""Places of the picture: "the left half", "the lower third", "the top of the picture"."""

from itertools import pairwise

from edit3r.contract.instructions import Box, Target
from edit3r_language.vocabulary import WORDS, words_of

_DOWN = {"top": "top", "upper": "top", "bottom": "bottom", "lower": "bottom"}
_ACROSS = {"left": "left", "right": "right"}
_MIDDLE = words_of("middle centre central")
_SIDES = frozenset((*_DOWN, *_ACROSS)) | _MIDDLE
_COUNTS = frozenset(("two", "three"))

_PARTS = {
    **{
        "half": 1 / 2,
        "side": 1 / 2,
        "quarter": 1 / 4,
        "quarters": 3 / 4,
        "thirds": 2 / 3,
    },
    **dict.fromkeys(("third", "part", "area", "corner"), 1 / 3),
}
_ANY = _SIDES | set(_PARTS) | WORDS.background | {"foreground"}
_NAMES = {"side": "half", "part": "third", "area": "third", "": "third"}


def read_region(tokens: list[str]) -> Target | None:
    """The place of the picture that the words name; None for other words, and for unclear ones."""
    rest, of_picture = _inside(tokens)
    named = _plain(rest)
    if not named or not set(named) <= _SIDES | set(_PARTS) | _COUNTS:
        return None
    parts = [word for word in named if word in _PARTS]
    alone = set(named) <= _MIDDLE and not {*tokens} & {"one", "ones"}
    if not of_picture and not parts and not alone:  # "the left", of things of one name
        return None
    across = [_ACROSS[word] for word in named if word in _ACROSS]
    down = [_DOWN[word] for word in named if word in _DOWN]
    if len(parts) > 1 or len(across) > 1 or len(down) > 1:
        return None
    return _region(*down, *across, part="".join(parts), middle=bool(_MIDDLE & {*named}))


def unclear_place(tokens: list[str]) -> tuple[str, ...]:
    """The words for what no box of the picture is and no name finds.

    A share of something ("half of the wall", "the bear half", "the rest of it"), a number alone
    ("warmth 20"), what has no name but stands
    somewhere ("everything on the table", which is not the table), and what belongs to a thing that
    is known by another ("the man with the hat's jacket").
    """
    if read_region(tokens) is not None:
        return ()
    owner = next((i for i, t in enumerate(tokens[:-1]) if t.endswith("'s")), 0)
    joints = [t for t in tokens[1:owner] if t in WORDS.joining]
    if joints:
        return (joints[-1], tokens[owner])
    for word, joint in pairwise(tokens):
        nameless = word in WORDS.whatever and joint in WORDS.standing
        if nameless and tokens[-1] not in _ANY and "parts" not in tokens:
            return (word, joint)
        if (word, joint) == ("rest", "of") and tokens[-1] not in WORDS.scenes:
            return (word,)
    if "except" in tokens:  # "all chairs but one"
        return ("except",)
    inside, of_picture = _inside(tokens)
    head = inside[: inside.index("of")] if "of" in inside else inside
    named = _plain(head)
    shares = tuple(word for word in named if word in WORDS.shares)
    only_places = bool(named) and set(named) <= _SIDES | set(_PARTS) | _COUNTS
    halved = bool(named) and named[-1] == "half"
    if shares and (only_places or halved):
        return shares
    if named and all(word.isdigit() for word in named):
        return tuple(named)
    whole_picture = of_picture or "of" not in inside
    return ("corner",) if only_places and "corner" in named and whole_picture else ()


def _region(*sides: str, part: str, middle: bool) -> Target | None:
    """The box at some sides; the middle is half as wide and high as the picture."""
    if middle:
        free = not sides and part in ("", "part", "area")
        return _thing("middle", (0.25, 0.25, 0.5, 0.5)) if free else None
    if not sides:
        return None
    if part == "corner" and len(sides) == 1:  # of a room: from top to bottom
        part = "third"
    share = _PARTS[part or "part"]
    if part == "quarter" and len(sides) == 2:
        share = 1 / 2
    left, width = _stretch(sides, "left", "right", share)
    top, height = _stretch(sides, "top", "bottom", share)
    count = {"thirds": "two ", "quarters": "three "}.get(part, "")
    name = f"{' '.join(sides)} {count}{_NAMES.get(part, part)}"
    return _thing(name, (left, top, width, height))


def _thing(name: str, box: Box) -> Target:
    return Target("region", name, box=box)


def _stretch(
    sides: tuple[str, ...], first: str, last: str, share: float
) -> tuple[float, float]:
    """Where the box begins along one axis, and how long it is."""
    if first in sides:
        return 0.0, share
    return (1 - share, share) if last in sides else (0.0, 1.0)


def _inside(tokens: list[str]) -> tuple[list[str], bool]:
    """The words without "of the picture", and whether they said it."""
    for start, token in enumerate(tokens):
        ignored = WORDS.determiners | WORDS.weak | WORDS.strong
        tail = [t for t in tokens[start + 1 :] if t not in ignored]
        if token in ("of", "in") and tail and set(tail) <= WORDS.picture:
            return tokens[:start], True
    return tokens, False


def _plain(tokens: list[str]) -> list[str]:
    ignored = WORDS.fillers | WORDS.determiners | WORDS.weak | WORDS.strong
    ignored = (ignored - _SIDES) | {"everything", "all"}
    return [t for t in tokens if t not in ignored]
