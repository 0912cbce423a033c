"""A method of the benchmark: an editor with a reconstructor, and how they are run."""

import re
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from edit3r.contract.errors import SettingsError
from edit3r.contract.settings import PartChoice, Settings, make_settings, merge
from edit3r_bench.oracle import ORACLE

LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]*")
DEFAULT_PARTS = {"editor": ORACLE, "reconstructor": "edit3r", "rasterizer": "auto"}


class Method(Settings):
    """One column of the comparison."""

    # of the column and of its folder; default: editor and reconstructor
    label: str = ""
    editor: PartChoice
    reconstructor: PartChoice
    rasterizer: PartChoice  # draws the images that are measured
    # Edit every view, or the reference only.
    edit_views: Literal["all", "first"] = "all"
    # Reconstruct the photos, and edit its renderings one by one: no edited scene is made.
    edit_renders: bool = False
    # first: show only those of the reference (single-view lifting).
    gaussians_of: Literal["all", "first"] = "all"
    # Settings of the run, such as refine: 0.
    run: dict[str, Any] = Field(default_factory=dict)
    # Hand true poses, where they are known, to reconstructors that read them.
    poses: bool = True
    # Judge by the edited truth where it is known; default: for the oracle, whose edit it is.
    truth: bool | None = None
    note: str = ""  # what a reader of the table must know about this column

    @field_validator("label")
    @classmethod
    def _usable_as_a_folder(cls, value: str) -> str:
        if value and not LABEL.fullmatch(value):
            raise ValueError(
                "may contain only letters, digits, spaces, dots, dashes, plus signs and "
                "underscores"
            )
        return value

    @model_validator(mode="before")
    @classmethod
    def _settings_without_a_name_are_of_the_default(cls, values: Any) -> Any:
        return merge(DEFAULT_PARTS, values)

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


class _Configuration(Settings):
    methods: tuple[dict[str, Any], ...] = Field(min_length=1)


def read_methods(
    content: Mapping[str, Any], changes: Mapping[str, Mapping[str, Any]]
) -> tuple[Method, ...]:
    """The `methods` of a configuration, with `changes` by label. Labels must differ."""
    methods = {}
    for values in make_settings(_Configuration, content, "configuration").methods:
        label = make_settings(Method, values, where="methods").label
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
