"""Errors a user can act on: what was given, what was expected, where, and what to do.

The command line prints the message as one sentence and exits with `exit_code`; a traceback needs
`--debug`.
"""

import difflib
import errno
from collections.abc import Iterable
from typing import Any


class Edit3rError(Exception):
    """Base of every error meant for the user. Exit code 2: the input or the request was wrong."""

    exit_code = 2


class InputError(Edit3rError):
    """A photo, mask, scene or folder that cannot be used."""


class SettingsError(Edit3rError):
    """A setting that is unknown, out of range or of the wrong type."""


class UnknownComponentError(Edit3rError):
    """No installed plugin offers a component of that kind and name, or two do."""


class MissingDependencyError(Edit3rError):
    """A component is installed but a package, model or key it needs is not."""


class PluginError(Edit3rError):
    """A plugin broke its side of the contract (wrong shape, not finite, raised while loading)."""


class PromptError(Edit3rError):
    """The editor cannot carry out this instruction."""


class QuestionError(Edit3rError):
    """Nobody can tell surely enough which thing is meant; exit code 3. Nothing was edited.

    `candidates` are what may be meant (`edit3r.contract.interfaces.Candidate`), the likeliest
    first: their masks on one photo, and the numbers that take them (`candidate=`, --candidate).
    """

    exit_code = 3

    def __init__(
        self, message: str, candidates: tuple[Any, ...] = (), preview: Any = None
    ) -> None:
        super().__init__(message)
        self.candidates = candidates
        self.preview = preview  # of a run: what `edit3r.running` draws as a sheet


class MatchingError(Edit3rError):
    """The photos do not show enough of the same scene to place them relative to each other."""

    exit_code = 1


class RunError(Edit3rError):
    """The request was fine, but memory, a device or a service failed."""

    exit_code = 1


def one_line(reason: object, most: int = 300) -> str:
    """What an error of a library says, as a clause for a sentence: on one line of at most `most`
    characters, without a full stop. An error that says nothing has the name of its type.
    """
    said = " ".join(str(reason).split())[:most].rstrip(".")
    return said or type(reason).__name__


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """' Did you mean X?' for a near miss, else ''."""
    near = difflib.get_close_matches(given, list(known), n=1, cutoff=0.6)
    return f" Did you mean {near[0]!r}?" if near else ""


def is_out_of_memory(error: BaseException) -> bool:
    """Whether memory ran out; torch raises several types for it."""
    text = str(error).lower()
    signs = ("out of memory", "can't allocate", "not enough memory")
    return isinstance(error, MemoryError) or any(words in text for words in signs)


_DISK_FULL = {
    errno.ENOSPC: "no space is left on the disk",
    errno.EDQUOT: "the quota of the disk is used up",
    errno.EFBIG: "the file became larger than this disk or its limits allow",
}


def as_known(error: Exception) -> Edit3rError:
    """The error itself where it is ours, else one with a sentence for it."""
    if isinstance(error, Edit3rError):
        return error
    if is_out_of_memory(error):
        return RunError(
            "out of memory; lower --size, give fewer views, or choose a smaller --set "
            "reconstructor.* configuration."
        )
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        if error.errno in _DISK_FULL:
            return RunError(
                f"{where}{_DISK_FULL[error.errno]}; free some, or give --out a folder on another "
                "disk."
            )
        if where:
            return Edit3rError(f"{where}{error.strerror}.")
    return RunError(
        f"unexpected {type(error).__name__}: {error}. Run again with --debug for the traceback."
    )
