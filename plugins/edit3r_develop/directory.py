"""The directory of plugins: packages that add to edit3r, from `directory.yaml` beside this file."""

import itertools
from importlib import metadata
from pathlib import Path

from pydantic import Field, field_validator

from edit3r.contract.component import KINDS
from edit3r.contract.errors import did_you_mean
from edit3r.contract.settings import Count, Settings, make_settings
from edit3r.kit.files.configs import read_yaml

FILE = Path(__file__).with_name("directory.yaml")


class Listed(Settings):
    """One package of the directory."""

    name: str = Field(min_length=1)
    """of its distribution"""
    offers: dict[str, tuple[str, ...]] = Field(min_length=1)
    """names of its components by kind"""
    does: str = Field(min_length=1, max_length=100)
    """one line"""
    install: str = Field(pattern=r"^pip install \S")
    """the command that installs it"""
    home: str = Field(min_length=1)
    """where its source is: an address, or a folder of this repository"""
    licence: str = Field(min_length=1)
    """of its code, and of weights that it loads"""
    api: Count
    """the EDIT3R_API it was written for"""
    tested_with: str = Field(pattern=r"^\d+\.\d+")
    """the edit3r it was last tested with"""

    @field_validator("offers")
    @classmethod
    def _of_known_kinds(cls, value: dict[str, tuple[str, ...]]) -> dict:
        for kind in value:
            if kind not in KINDS:
                raise ValueError(f"no kind {kind!r}.{did_you_mean(kind, KINDS)}")
        return value

    @property
    def installed(self) -> str:
        """The version that is installed; "" where it is not."""
        try:
            return metadata.version(self.name)
        except Exception:  # absent, or half installed
            return ""


class Directory(Settings):
    """The content of the file."""

    plugins: tuple[Listed, ...]

    @field_validator("plugins")
    @classmethod
    def _sorted_and_once(cls, value: tuple[Listed, ...]) -> tuple[Listed, ...]:
        names = [one.name for one in value]
        for before, name in itertools.pairwise(names):
            if before == name:
                raise ValueError(f"{name!r} is listed twice")
            if before > name:
                after = next(one for one in names if one > name)
                raise ValueError(
                    f"packages are listed by the alphabet; put {name!r} before {after!r}"
                )
        return value


def listed(kind: str | None = None) -> tuple[Listed, ...]:
    """The packages of the directory, of one kind of component where it is given."""
    plugins = make_settings(Directory, read_yaml(FILE), "directory").plugins
    return tuple(one for one in plugins if kind is None or kind in one.offers)
