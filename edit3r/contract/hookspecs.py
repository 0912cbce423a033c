"""Every hook: all that can be plugged in, on one screen.

A plugin is a module with any of these functions, marked `@edit3r.hookimpl` and listed under the
entry point group `edit3r`. Each returns the components it offers; nothing heavy is imported until
one of them is built. The interface a component's class must follow is in
`edit3r.contract.interfaces`, under the name in brackets.
"""

from collections.abc import Iterable

import pluggy

from edit3r.contract.component import Component

API_VERSION = 1
"""Version of this hook set and of the interfaces. A plugin may state the one it was written for as
a module-level `EDIT3R_API = 1`; the loader refuses another with a sentence instead of failing
somewhere inside.
"""

# mypy: disable-error-code="empty-body"
# What a hook returns is said by its type; the specification itself returns nothing.

hookspec = pluggy.HookspecMarker("edit3r")
hookimpl = pluggy.HookimplMarker("edit3r")


@hookspec
def register_readers() -> Iterable[Component]:
    """Sentences read into instructions: what shall happen to which thing (Reader)."""


@hookspec
def register_editors() -> Iterable[Component]:
    """2D editors: change the photos as the prompt says (Editor)."""


@hookspec
def register_segmenters() -> Iterable[Component]:
    """Object masks on one picture, followed through the other views (Segmenter)."""


@hookspec
def register_detectors() -> Iterable[Component]:
    """Boxes of what a text names (Detector)."""


@hookspec
def register_selectors() -> Iterable[Component]:
    """What is marked or named, on all photos (Selector)."""


@hookspec
def register_reconstructors() -> Iterable[Component]:
    """Edited views to 3D Gaussians in one pass (Reconstructor)."""


@hookspec
def register_backbones() -> Iterable[Component]:
    """Networks from views to features, a part of a reconstructor (Backbone)."""


@hookspec
def register_heads() -> Iterable[Component]:
    """Networks from features to Gaussians, a part of a reconstructor (GaussianHead)."""


@hookspec
def register_matchers() -> Iterable[Component]:
    """Relative poses and depths of the unedited photos, (Matcher)."""


@hookspec
def register_rasterizers() -> Iterable[Component]:
    """Gaussians and cameras to pictures (Rasterizer)."""


@hookspec
def register_refiners() -> Iterable[Component]:
    """Steps after reconstruction: Gaussians to better or fewer Gaussians (Refiner)."""


@hookspec
def register_critics() -> Iterable[Component]:
    """Verdicts on a finished run: was the edit carried out, does the scene hold (Critic)."""


@hookspec
def register_writers() -> Iterable[Component]:
    """Scenes as files or folders, for people and for other programs (Writer)."""


@hookspec
def register_losses() -> Iterable[Component]:
    """Terms of a training objective (Loss)."""


@hookspec
def register_datasets() -> Iterable[Component]:
    """Multi-view samples to train and evaluate on (Dataset)."""


@hookspec
def register_trainers() -> Iterable[Component]:
    """Training recipes (Trainer)."""


@hookspec
def register_commands() -> Iterable[Component]:
    """Commands of the program: `edit3r NAME` (Command)."""
