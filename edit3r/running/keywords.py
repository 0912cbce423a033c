"""The settings of `edit3r.run` as keywords, for editors and type checkers.

`RunConfig` defines them: default, range and a sentence each. A test holds that both name the same.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

from edit3r.contract.interfaces import (
    Critic,
    Matcher,
    Rasterizer,
    Reader,
    Segmenter,
    Selector,
)
from edit3r.contract.settings import PartChoice

Choice = str | Mapping[str, Any] | PartChoice
"""A component by its name, or by its name and settings."""


class RunKeywords(TypedDict, total=False):
    """What `edit3r.run` takes beside its own parameters; see `edit3r run --help`."""

    reader: Choice | Reader
    matcher: Choice | Matcher
    rasterizer: Choice | Rasterizer
    selector: Choice | Selector
    segmenter: Choice | Segmenter | None
    critic: Choice | Critic
    refiners: Sequence[Choice]
    guess: bool
    candidate: int
    larger: int
    grow: float
    invert: bool
    edit_views: Literal["all", "first"]
    strength: float
    feather: float
    moved_edits: Literal["undo", "keep"]
    seed: int
    up: str
    size: int
    fov: float
    measure: str
    views: int
    device: str
    frames: int
    outputs: Sequence[str | Mapping[str, Any]]
    export: Sequence[str | Mapping[str, Any]]
    writer: Mapping[str, Mapping[str, Any]]
    gaussians: int | Literal["all", "auto"]
    max_gaussians: int
    refine: int
    grid: float
    exposure: Literal["one", "own"]
    quality: Literal["fast", "balanced", "best"]
