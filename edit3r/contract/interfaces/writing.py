"""Writers: a finished scene as one file or one folder, for people or for other programs."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from edit3r.contract.component import Configured
from edit3r.contract.types import Cameras, Gaussians, Rendering, Views

Frame = UInt8[np.ndarray, "height width 3"]
"""One image of a flight, in sRGB."""


@dataclass(frozen=True)
class NamedObjects:
    """Objects of a scene that can be chosen on its page."""

    names: Mapping[str, int] = field(default_factory=dict)  # `object_index` by name
    # To copy, for going on with the chosen one: in it {run} becomes the page's folder and {name}
    # the object's name, quoted as a shell wants them.
    command: str = ""


@dataclass(frozen=True)
class SecondLook:
    """Other colours of the same Gaussians, which a page shows from the same place."""

    colours: Float[Tensor, "gaussian 3"]  # sRGB
    names: tuple[str, str] = ("after", "before")  # of the scene's own look, and of this


@dataclass(frozen=True)
class OtherCandidates:
    """What else words or clicks may mean on one view, where that was unsure."""

    photo: Float[Tensor, "3 height width"]
    name: str  # of the view
    masks: Mapping[str, Float[Tensor, "height width"]]  # by what chooses each


@dataclass(frozen=True)
class SceneToWrite:
    """One scene (batch 1) and what is known about it. What is not known is None or empty."""

    gaussians: Gaussians
    cameras: Cameras | None = None  # of the input views, in the frame of the Gaussians
    names: tuple[str, ...] = ()  # of these views: file names without a suffix
    photos: Views | None = None  # what the cameras took
    edited: Views | None = None  # the photos after the 2D edit
    masks: Float[Tensor, "view height width"] | None = None  # what was to be edited
    candidates: tuple[OtherCandidates, ...] = ()  # of the things that were unsure
    rendered: Rendering | None = None  # the Gaussians from the input views
    title: str = ""  # the prompt of a run
    subtitle: str = ""  # a sentence for the reader of a page
    about: str = ""  # how it was made and how well it came out, in one line
    second_look: Callable[[], SecondLook] | None = None  # computed when called
    objects: NamedObjects = NamedObjects()
    # images of the Gaussians from any cameras; only for a writer that `needs` it
    render: Callable[[Cameras], Rendering] | None = None
    # a flight around the scene, drawn frame by frame; only for a writer that `needs` it
    frames: Callable[[], Iterator[Frame]] | None = None
    # what points up in the frame of the Gaussians, where somebody told
    up: tuple[float, float, float] | None = None
    unit: str = ""  # of length: "m" where somebody told one


class Writer(Configured, ABC):
    """Writes a scene. Its Component says `suffix`, `keeps` and `loses`."""

    needs: ClassVar[tuple[str, ...]] = ()
    """Fields of `SceneToWrite` that must be there. Whoever writes fills them in or says what is
    missing. Writers that need `render` or `frames` take turns, since drawing takes the machine.
    """

    @abstractmethod
    def write(self, path: Path, scene: SceneToWrite) -> None:
        """Write `scene` as the file `path`, or as a folder where the suffix has no dot.

        Nothing is at `path`. The caller moves it into place when it is whole, so it is written
        plainly. The same scene gives the same bytes. Raises InputError for a scene that cannot be
        written so.
        """


DRAWING = ("render", "frames")
"""Fields of `SceneToWrite` that draw when they are called."""
