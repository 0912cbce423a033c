"""What the page asks of `edit3r objects`: one action, as the words of its command line."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from edit3r.contract.errors import InputError
from edit3r.running import read_metres
from edit3r_app.jobs import JobsFolder, manifest_of

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

Number = Annotated[float, Field(ge=-1000, le=1000, allow_inf_nan=False)]
Text = Annotated[str, Field(max_length=80)]


class ObjectAction(BaseModel):
    """One action on an object; what it takes is checked here, what it does is `edit3r objects`'."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    action: Literal[tuple(IN_WORDS)]  # type: ignore[valid-type]  # of IN_WORDS
    name: Text = ""
    numbers: tuple[Number, ...] = ()
    text: Text = ""

    @property
    def in_words(self) -> str:
        return IN_WORDS[self.action].format(name=self.name, text=self.text.strip())

    @property
    def call(self) -> tuple[str, ...]:
        """What stands on the command line after the folder of the run."""
        named = [] if self.action in NAMELESS else [self.name]
        texts = [self.text.strip()] if self.action in TEXTS else []
        return (self.action, *named, *texts, *(f"{one:.6g}" for one in self.numbers))


def read_action(asked: dict[str, Any]) -> ObjectAction:
    """The action that a page asks for; raises InputError for what is none."""
    try:
        found = ObjectAction(**asked)
    except (ValidationError, TypeError):
        raise InputError("not something that can be done with a thing.") from None
    if found.action not in NAMELESS and not found.name.strip():
        raise InputError("give the thing a name first.")
    texts = found.name, found.text
    if any(one.startswith("-") or not one.isprintable() for one in texts):
        raise InputError(
            "a name begins with no dash, and holds what can be printed alone."
        )
    if found.action in TEXTS and not found.text.strip():
        raise InputError(f"say {TEXTS[found.action]}.")
    if found.action == MEASURE:
        read_metres("the true length", found.text.partition("=")[2])
    if len(found.numbers) != NUMBERS.get(found.action, 0):
        raise InputError("not something that can be done with a thing.")
    return found


def checked_words(words: tuple[str, ...]) -> tuple[str, ...]:
    """The words of a call, from a record that may be a stranger's; raises InputError for those that
    `ObjectAction.call` never makes.
    """
    action, *rest = words
    takes = len(rest) - NUMBERS.get(action, 0)
    try:
        texts, numbers = rest[:takes], [float(one) for one in rest[takes:]]
        name, text, *_ = ([""] * (action in NAMELESS)) + texts + ["", ""]
        asked = {"name": name, "text": text}
        found = read_action({"action": action, "numbers": numbers, **asked})
        if len(found.call) == len(words):
            return found.call
    except ValueError:
        pass
    raise InputError("not something that can be done with a thing.")


def objects_of(folder: JobsFolder, run: str) -> list[str]:
    """Names of a run's objects; none of what is no run, or says nothing that can be read."""
    found = manifest_of(folder.root / run).get("objects")
    return [str(name) for name in found] if isinstance(found, dict) else []
