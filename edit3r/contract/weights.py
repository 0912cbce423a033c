"""Learned weights that a component declares: where they come from and what a user should know.

The files are found and fetched by `edit3r.kit.weights.find` and `edit3r weights get`.
"""

import re
from dataclasses import dataclass
from pathlib import PurePosixPath

COMMERCIAL = ("yes", "no", "unclear")

NAME = re.compile(r"[a-z0-9]+([-_][a-z0-9]+)*")
"""Names of components and of weights."""

ESSENTIALS = "essentials"
"""Name that stands for all weights that make a CPU complete."""

WORDS = "words"
"""The same for what finds any word."""

BUNDLES = (ESSENTIALS, WORDS)

_SOURCE = re.compile(r"hub:[\w.-]+/[\w.-]+|package:[\w.-]+|npm:(@[\w.-]+/)?[\w.-]+")

_SHA256 = re.compile(r"[0-9a-f]{64}")


def check_declared(holds: object, told: str) -> None:
    """Raise ValueError, in a declaration, with what does not hold."""
    if not holds:
        raise ValueError(told)


def check_name(what: str, name: object) -> None:
    told = f"{what} name {name!r} must be lower-case letters, digits and dashes"
    check_declared(isinstance(name, str) and NAME.fullmatch(name), told)


@dataclass(frozen=True)
class Weights:
    """One set of files that a component loads, and what a user should know before fetching it."""

    name: str  # kebab-case; one name means the same files whoever declares it
    purpose: str  # what for, in a few words
    size: int  # of all files [bytes]; about, where the files are patterns
    licence: str  # of the files, which may differ from that of the code
    commercial: str  # use: "yes", "no" or "unclear"
    # "hub:OWNER/NAME" on the Hugging Face hub, "package:NAME" in Python's package index, or
    # "npm:NAME" in npm's
    source: str
    # commit on the hub, version of the package; "": not pinned, and said so
    revision: str = ""
    # (path or pattern at the source, SHA-256 or "" where it is not known)
    files: tuple[tuple[str, str], ...] = ()
    gated: bool = False  # the hub asks for an account that accepted the licence
    bundle: str = ""  # one of `BUNDLES`: `edit3r weights get BUNDLE` fetches them too
    caution: str = ""  # a sentence that whoever fetches them must have read

    def __post_init__(self) -> None:
        check_name("weights", self.name)
        who = f"weights {self.name!r}"
        one_of = {"bundle": ("", *BUNDLES), "commercial": COMMERCIAL}
        for field, allowed in one_of.items():
            value = getattr(self, field)
            listed = ", ".join(filter(None, allowed))
            told = f"{who}: {field} must be one of {listed}, got {value!r}"
            check_declared(value in allowed, told)
        sources = "'hub:OWNER/NAME', 'package:NAME' or 'npm:NAME'"
        told = f"{who}: source must read {sources}, got {self.source!r}"
        check_declared(_SOURCE.fullmatch(self.source), told)
        check_declared(self.files, f"{who}: names no files")
        pairs = f"{who}: files must be pairs of a relative path and a SHA-256"
        for path, sha256 in self.files:
            inside = path and not path.startswith("/") and "\\" not in path
            inside = inside and ".." not in PurePosixPath(path).parts
            known = not sha256 or _SHA256.fullmatch(sha256)
            check_declared(inside and known, f"{pairs}, got {(path, sha256)!r}")
        told = f"{who}: from a package, the version and every SHA-256 must be given"
        pinned = self.revision and all(sha256 for _, sha256 in self.files)
        check_declared(pinned or not self.packed, told)

    @property
    def packed(self) -> bool:
        """Whether the files come out of a package, and not one by one."""
        return not self.source.startswith("hub:")

    def stored(self, path: str) -> str:
        """Where a file of the source lies here; files of a package lie side by side."""
        return PurePosixPath(path).name if self.packed else path

    @property
    def get(self) -> str:
        """The command that fetches them."""
        return f"edit3r weights get {self.name}"

    @property
    def terms(self) -> str:
        """Licence, commercial use, size and whether it takes an account, in a few words."""
        size = f"{self.size / 1e6:,.1f} MB"
        terms = f"{self.licence}; commercial use: {self.commercial}; {size}"
        if self.gated:
            terms += "; gated: needs an account on the hub that accepted the licence"
        return terms
