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
        if not (isinstance(self.name, str) and NAME.fullmatch(self.name)):
            raise ValueError(
                f"weights name {self.name!r} must be lower-case letters, digits and dashes"
            )
        who = f"weights {self.name!r}"
        if self.bundle not in ("", *BUNDLES):
            raise ValueError(
                f"{who}: bundle must be one of {', '.join(BUNDLES)}, got {self.bundle!r}"
            )
        if self.commercial not in COMMERCIAL:
            raise ValueError(
                f"{who}: commercial must be one of {', '.join(COMMERCIAL)}, got {self.commercial!r}"
            )
        if not _SOURCE.fullmatch(self.source):
            raise ValueError(
                f"{who}: source must read 'hub:OWNER/NAME', 'package:NAME' or 'npm:NAME', got "
                f"{self.source!r}"
            )
        if not self.files:
            raise ValueError(f"{who}: names no files")
        for path, sha256 in self.files:
            inside = (
                path
                and not path.startswith("/")
                and "\\" not in path
                and ".." not in PurePosixPath(path).parts
            )
            if not inside or (sha256 and not _SHA256.fullmatch(sha256)):
                raise ValueError(
                    f"{who}: files must be pairs of a relative path and a SHA-256, got "
                    f"{(path, sha256)!r}"
                )
        if self.packed and not (
            self.revision and all(sha256 for _, sha256 in self.files)
        ):
            raise ValueError(
                f"{who}: from a package, the version and every SHA-256 must be given"
            )

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
