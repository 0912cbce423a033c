"""A method of the benchmark: an editor with a reconstructor, and how they are run."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from edit3r.contract.errors import SettingsError
from edit3r.contract.settings import (
    OfKind,
    OrCalled,
    PartChoice,
    Settings,
    make_settings,
    merge,
)
from edit3r_bench.oracle import ORACLE, OracleSettings

LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]*")


class Method(Settings):
    """One column of the comparison."""

    label: str = ""
    """of the column and of its folder; default: editor and reconstructor"""
    editor: Annotated[PartChoice, OrCalled(ORACLE, OracleSettings)] = PartChoice(
        name=ORACLE
    )
    """2D editor"""
    reconstructor: PartChoice = PartChoice(name="edit3r")
    """makes the scene"""
    rasterizer: PartChoice = PartChoice(name="auto")
    """draws the images that are measured"""
    edit_views: Literal["all", "first"] = "all"
    """edit every view, or the reference only"""
    edit_renders: bool = False
    """reconstruct the photos, and edit its renderings one by one: no edited scene is made"""
    gaussians_of: Literal["all", "first"] = "all"
    """first: show only those of the reference (single-view lifting)"""
    run: Annotated[dict[str, Any], OfKind("run")] = Field(default_factory=dict)
    """settings of the run, such as refine: 0"""
    poses: bool = True
    """hand true poses, where they are known, to reconstructors that read them"""
    truth: bool | None = None
    """judge by the edited truth where it is known; default: for the oracle, whose edit it is"""
    note: str = ""
    """what a reader of the table must know about this column"""

    @field_validator("label")
    @classmethod
    def _usable_as_a_folder(cls, value: str) -> str:
        if value and not LABEL.fullmatch(value):
            raise ValueError(
                "may contain only letters, digits, spaces, dots, dashes, plus signs and "
                "underscores"
            )
        return value

    @model_validator(mode="after")
    def _label_by_default(self) -> "Method":
        if not self.label:
            label = f"{self.editor.name}+{self.reconstructor.name}".replace(":", "-")
            # The class is frozen for everybody else.
            object.__setattr__(self, "label", label)
        return self

    @property
    def judged_by_truth(self) -> bool:
        return self.editor.name == ORACLE if self.truth is None else self.truth


class BenchConfig(Settings):
    """The keys of a configuration file of `edit3r bench run`."""

    methods: tuple[Method, ...] = Field(min_length=1)
    """the columns of the comparison"""


def read_methods(
    content: Mapping[str, Any], changes: Mapping[str, Mapping[str, Any]]
) -> tuple[Method, ...]:
    """The `methods` of a configuration, with `changes` by label. Labels must differ."""
    methods = {}
    config = make_settings(BenchConfig, content, "configuration")
    for values, label in zip(content["methods"], [one.label for one in config.methods]):
        if label in methods:
            raise SettingsError(
                f"methods: two are called {label!r}; give each its own label."
            )
        changed = {"label": label, **merge(values, changes.get(label, {}))}
        methods[label] = make_settings(Method, changed, where=label)
    for unknown in sorted(set(changes) - set(methods)):
        raise SettingsError(
            f"--set {unknown}: no such method in the configuration; it has {', '.join(methods)}."
        )
    return tuple(methods.values())
