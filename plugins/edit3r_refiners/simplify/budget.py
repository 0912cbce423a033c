"""How many Gaussians a user asks for: `auto`, `all` or a number."""

from typing import Any, Literal

Budget = Literal["auto", "all"] | int


def parse_budget(value: Any) -> Budget:
    """`"auto"`, `"all"`, or a number of at least 1, also as text. Raises ValueError for anything else."""
    if value in ("auto", "all"):
        return value
    try:
        number = int(str(value))
    except ValueError:
        number = 0
    if number < 1 or isinstance(value, bool):
        raise ValueError("expected auto, all or a number of at least 1")
    return number


def passes(wish: Budget, most: int | None = None) -> list[int | None]:
    """What to simplify to, one after the other: None for what the scene requires, a number for at most so many.

    `most` is a limit on top of the wish.
    """
    wished = {"all": [], "auto": [None]}.get(wish, [wish])
    return wished if most is None else [*wished, most]
