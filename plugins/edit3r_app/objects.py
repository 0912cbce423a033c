"""What the page asks of `edit3r objects`: one action, as the words of its command line."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from edit3r.contract.errors import InputError
from edit3r.running import read_metres

NUMBERS = {"move": 3, "turn": 1, "scale": 1, "copy": 3}
"""How many numbers an action takes; the others take none."""
MEASURE = "measure"
TEXTS = {
    "recolor": "a colour, such as: dark green",
    "rename": "a new name",
    "copy": "a name for the copy",
    MEASURE: "how long it is, such as: 69.4 cm",
}
MARKED = "add"  # takes what is marked on the photos
DRAWN = {"cut": "remove what is drawn", "crop": "keep only what is drawn"}
"""Actions on what is drawn over the scene, which need no name."""
NAMELESS = ("find", "clean", MEASURE, *DRAWN)
IN_WORDS = {
    **DRAWN,
    "clean": "take out floaters",
    "find": "find the things",
    MEASURE: "measure {text}",
    "add": "take hold of {name}",
    "remove": "remove {name}",
    "recolor": "paint {name} {text}",
    "rename": "call {name} {text}",
    "move": "move {name}",
    "turn": "turn {name}",
    "scale": "resize {name}",
    "copy": "copy {name}",
}
NO_ACTION = "not something that can be done with a thing."

Number = Annotated[float, Field(ge=-1000, le=1000, allow_inf_nan=False)]
Text = Annotated[str, Field(max_length=80)]


@dataclass(frozen=True)
class ObjectAction:
    """One action on an object; what it takes is checked here, what it does is `edit3r objects`'.

    Raises InputError for what the user can mend.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    action: Literal[tuple(IN_WORDS)]  # type: ignore[valid-type]  # of IN_WORDS
    name: Text = ""
    numbers: tuple[Number, ...] = ()
    text: Text = ""

    def __post_init__(self) -> None:
        if self.action not in NAMELESS and not self.name.strip():
            raise InputError("give the thing a name first.")
        texts = self.name, self.text
        if any(one.startswith("-") or not one.isprintable() for one in texts):
            raise InputError(
                "a name begins with no dash, and holds what can be printed alone."
            )
        if self.action in TEXTS and not self.text.strip():
            raise InputError(f"say {TEXTS[self.action]}.")
        if self.action == MEASURE:
            read_metres("the true length", self.text.partition("=")[2])
        if len(self.numbers) != NUMBERS.get(self.action, 0):
            raise InputError(NO_ACTION)

    @property
    def in_words(self) -> str:
        return IN_WORDS[self.action].format(name=self.name, text=self.text.strip())

    @property
    def call(self) -> tuple[str, ...]:
        """What stands on the command line after the folder of the run."""
        named = [] if self.action in NAMELESS else [self.name]
        texts = [self.text.strip()] if self.action in TEXTS else []
        return (self.action, *named, *texts, *(f"{one:.6g}" for one in self.numbers))


_ACTION = TypeAdapter(ObjectAction)


def read_action(asked: dict[str, Any]) -> ObjectAction:
    """The action that a page asks for; raises InputError for what is none."""
    try:
        return _ACTION.validate_python(asked)
    except ValidationError:
        raise InputError(NO_ACTION) from None
