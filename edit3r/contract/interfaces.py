"""The interface of every kind of component.

Each concrete class has a nested `Settings` (a subclass of `edit3r.Settings`, every field with
default, range and description) and is constructed by the registry as `Class(settings, **parts)`.
Interfaces are abstract, concrete classes are final: compose, do not subclass. Progress, facts for
the manifest and warnings go through `edit3r.reporting` (`track`, `note`, `warn`).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import interpolate

from edit3r.config import Settings
from edit3r.contract.command import Command
from edit3r.contract.types import (
    Cameras,
    EditRequest,
    Features,
    Gaussians,
    Reconstruction,
    Rendering,
    Views,
)
from edit3r.errors import InputError
from edit3r.reporting import warn

if TYPE_CHECKING:
    from edit3r.io.framing import Lens
    from edit3r.plugins.load import Offer

# The first logarithm that MKL computes on several threads of a process is sometimes less accurate
# in one of them, and then the same seed does not give the same bytes. After one small logarithm on
# one thread it never is.
torch.log(torch.ones(1))


class Configured:
    """What everything that the registry builds has."""

    settings: Settings
    offer: "Offer"
    parts: Mapping[str, Any]  # the components it was built with, by kind

    def __init__(self, settings: Settings | None = None) -> None:
        super().__init__()
        if settings is not None:  # a network calls this without any, and sets its own
            self.settings = settings


class Editor(Configured, ABC):
    """Changes photos as an instruction says.

    Keeps number, size and cameras of the views; same seed, same result. It need not honour
    `request.masks`: the pipeline composites the result with them, so pixels outside stay bit-equal
    whatever the editor does.
    """

    starts_from_images: bool = False  # True: it has `edit_from`
    gives_attention: bool = False  # True: it has `attention`
    # how many views, from the first, its other views look at; 0: each is edited by itself
    references: int = 0
    # True: it reads depth from its part `matcher`, which another may take the place of
    takes_depth: bool = False
    needs_masks: bool = False  # True: what it changes is told by masks alone
    # True: things come or go, so the edited views are matched, not the photos
    changes_shape: bool = False

    @abstractmethod
    def edit(self, views: Views, request: EditRequest) -> Views:
        """Return the edited views, images in [0, 1]. Raises PromptError for an instruction it
        cannot carry out.
        """

    def edit_from(
        self,
        views: Views,
        start: Float[Tensor, "batch view 3 height width"],
        request: EditRequest,
        strength: float,
    ) -> Views:
        """Edit `views`, beginning from other images `start` of them; `strength` in [0, 1] says how
        little of it stays.

        A diffusion editor adds noise to `start` at `strength` of the way and removes it with
        `views` and the prompt as conditions (Instruct-NeRF2NeRF, section 4.2).
        """
        raise NotImplementedError(f"{type(self).__name__} cannot start from images")

    def attention(
        self, views: Views, request: EditRequest
    ) -> Float[Tensor, "batch view height width"]:
        """Tell where the edit looks: cross-attention of the prompt's words, any scale >= 0."""
        raise NotImplementedError(f"{type(self).__name__} gives no attention")


@dataclass(frozen=True)
class Proposal:
    """One object on one picture, with the fields SAM2's automatic mask generator gives.

    A segmenter without learned weights fills `stability` and `predicted_iou` with proxies and says
    so in its summary.
    """

    soft_mask: Float[Tensor, "height width"]  # in [0, 1]
    area: float  # share of the picture covered by soft_mask > 0.5, in [0, 1]
    stability: float  # in [0, 1]: overlap of the mask under two thresholds
    predicted_iou: float  # in [0, 1]: how good the mask believes it is
    box: tuple[float, float, float, float]  # x, y, width, height [pixels]


@dataclass(frozen=True)
class Tracks:
    """Objects followed through views: index r is the same object everywhere."""

    logits: Float[Tensor, "view object height width"]  # > 0: inside
    present: Bool[
        Tensor, "view object"
    ]  # False: lost in that view, its logits are all <= 0


@dataclass(frozen=True)
class Marks:
    """What a user pointed at on one image; places are x and y in [0, 1]."""

    positive: tuple[tuple[float, float], ...] = ()  # on the object
    negative: tuple[tuple[float, float], ...] = ()  # on what is not the object
    box: tuple[float, float, float, float] | None = (
        None  # x, y, width, height around it
    )
    prior: Float[Tensor, "height width"] | None = (
        None  # where it is expected, in [0, 1], as from another view
    )


class Segmenter(Configured, ABC):
    """Finds objects on one picture and follows them through other views of the scene."""

    prompt: str = ""  # what it is asked for by words, instead of what the edit's prompt names; "": the latter

    @abstractmethod
    def propose(self, image: Float[Tensor, "3 height width"]) -> tuple[Proposal, ...]:
        """All candidate objects, most salient first."""

    def segment(
        self,
        image: Float[Tensor, "3 height width"],
        points: Sequence[tuple[float, float]] = (),
        box: tuple[float, float, float, float] | None = None,
    ) -> Proposal:
        """The object at `points` (x, y normalised to [0, 1]) or in `box` (x, y, w, h, normalised).

        A segmenter implements this or, to read more than that, `segment_marks`.
        """
        if type(self).segment_marks is Segmenter.segment_marks:
            raise NotImplementedError(
                f"{type(self).__name__} implements neither segment nor segment_marks"
            )
        if not points and box is None:
            raise InputError(
                "segment: give at least one point or a box that says which object is meant."
            )
        return self.segment_marks(image, Marks(tuple(points), box=box))

    @abstractmethod
    def track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks:
        """Follow objects given by soft masks on view 0 through all views; an object not found is
        reported lost.
        """

    def segment_marks(
        self, image: Float[Tensor, "3 height width"], marks: Marks
    ) -> Proposal:
        """The object that `marks` describe; at least a positive point, a box or a prior is there.

        A segmenter that does not implement this reads positive points and the box only: a prior
        alone is the answer.
        """
        if not marks.positive and marks.box is None:
            return as_proposal(marks.prior)
        if marks.negative:
            warn(
                f"segmenter {type(self).__name__} reads no negative points; brush them out of "
                "the mask instead."
            )
        return self.segment(image, marks.positive, marks.box)

    def segment_text(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        """What `text` (such as "the bike") names, best first; empty when it is not there, None:
        cannot read text.
        """
        return None


def as_proposal(mask: Float[Tensor, "height width"]) -> Proposal:
    """A mask that somebody gave, as a proposal that is sure of itself."""
    inside = mask > 0.5
    rows, columns = inside.any(1).nonzero()[:, 0], inside.any(0).nonzero()[:, 0]
    box = (0.0, 0.0, 0.0, 0.0)
    if len(rows):
        x, y = int(columns[0]), int(rows[0])
        box = (
            float(x),
            float(y),
            float(int(columns[-1]) + 1 - x),
            float(int(rows[-1]) + 1 - y),
        )
    return Proposal(mask, float(inside.float().mean()), 1.0, 1.0, box)


@dataclass(frozen=True)
class Detection:
    """One box that a text names."""

    label: str
    score: float  # in [0, 1]
    box: tuple[float, float, float, float]  # x, y, width, height [pixels]


class Detector(Configured, ABC):
    """Finds what a text names."""

    @abstractmethod
    def detect(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Detection, ...]:
        """Boxes of `text` (such as "the bike"), best first; empty when there is none."""


class Reconstructor(Configured, ABC):
    """Turns edited views into 3D Gaussians in one pass, in the frame of view 0."""

    min_views: int = 2
    max_views: int | None = None  # the pipeline subsamples evenly above it and says so
    # True: edits while it reconstructs, by its part of kind editor and the request
    edits_views: bool = False
    # True: `from_geometry` reconstructs from geometry that somebody else measured
    takes_geometry: bool = False

    @abstractmethod
    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        request: EditRequest | None = None,
    ) -> Reconstruction:
        """Reconstruct `views`; `source` is the same photos before editing, which agree with each
        other.

        `request` is what the views were edited by; a reconstructor that edits by itself
        (`edits_views`) needs it, others may heed its `grid` alone: the cameras they return then
        have the grid's `image_size`. Poses that somebody knows are `views.c2w`; it may ignore them,
        and give its own.

        Raises MatchingError when the photos cannot be placed relative to each other.
        """

    def from_geometry(
        self, views: Views, source: Views, geometry: "MatchedGeometry"
    ) -> Reconstruction:
        """Reconstruct `views` from poses and depths of `source` instead of matching; only where
        `takes_geometry`.

        `source` is the same photos before editing, `geometry` at their resolution. Differentiable
        by `network`.
        """
        raise NotImplementedError(f"{type(self).__name__} takes no geometry")

    @property
    def network(self) -> nn.Module | None:
        """The trainable part, None for a reconstructor without one."""
        return None


class Backbone(Configured, nn.Module, ABC):
    """Network from views to features; any number of views >= 2."""

    patch_size: int  # height and width of its input must be multiples of this [pixels]
    feature_widths: tuple[int, ...]  # channels of each level it returns
    takes_geometry: bool = (
        False  # True: `forward` takes `geometry` too; others are not given any
    )

    @abstractmethod
    def forward(
        self,
        images: Float[Tensor, "batch view 3 height width"],
        intrinsics: Float[Tensor, "batch view 3 3"],
        geometry: "MatchedGeometry | None" = None,
    ) -> Features:
        """Features of images in [0, 1] with normalised intrinsics.

        `geometry` is what a matcher read from these images, at their size, in a unit that makes
        depths about 1.
        """


class GaussianHead(Configured, nn.Module, ABC):
    """Network from features to one Gaussian per pixel, ordered view-major, then row-major."""

    # True: `forward` takes `source` and `geometry` too; others are not given them
    takes_geometry: bool = False
    takes_photos: bool = (
        False  # True: `images` and `source` come at the photos' size, not the grid's
    )

    @abstractmethod
    def forward(
        self,
        features: Features,
        images: Float[Tensor, "batch view 3 height width"],
        source: Views | None = None,
        geometry: "MatchedGeometry | None" = None,
    ) -> Gaussians:
        """Gaussians with `view_index` set, for images in [0, 1].

        A head that takes geometry gets what a matcher read from `source`, on the grid of the
        Gaussians, which need not be the backbone's. They are in its unit of length. `images`, after
        the edit, and `source`, before it, have that size, unless the head `takes_photos`.
        """


@dataclass(frozen=True)
class MatchedGeometry:
    """Relative poses and depths of B scenes, read from photos that agree with each other.

    The unit of length is arbitrary but common to poses and depths.
    """

    c2w: Float[Tensor, "batch view 4 4"]  # view 0 is the identity
    depths: Float[
        Tensor, "batch view height width"
    ]  # camera z > 0, filled where nothing matched
    confidence: Float[
        Tensor, "batch view height width"
    ]  # in [0, 1]; 0: filled in, not measured
    registered: Bool[Tensor, "batch view"]  # False: the view could not be placed
    intrinsics: Float[Tensor, "batch view 3 3"] | None = (
        None  # normalised, as read from the photos; None: as given
    )

    @property
    def measured(self) -> Float[Tensor, "batch view"]:
        """Share of each view's pixels whose depth was measured, not filled in."""
        return (self.confidence >= 0.5).to(self.depths.dtype).mean((2, 3))

    def calibrated(self, views: Views) -> Views:
        """`views` with the intrinsics that this geometry was read with."""
        return (
            views
            if self.intrinsics is None
            else replace(views, intrinsics=self.intrinsics)
        )

    def at(self, size: tuple[int, int]) -> "MatchedGeometry":
        """This geometry for views of another (height, width) [pixels]."""
        depths, confidence = (  # nearest: depths are never mixed across an edge
            interpolate(maps, size, mode="nearest-exact")
            for maps in (self.depths, self.confidence)
        )
        return replace(self, depths=depths, confidence=confidence)


class Matcher(Configured, ABC):
    """Reads relative pose and depth from unedited photos."""

    @abstractmethod
    def match(self, views: Views) -> MatchedGeometry:
        """Geometry at the views' own resolution. Raises MatchingError when view 0 matches no other
        view.
        """

    def lens(self, views: Views) -> "Lens | None":
        """What bends straight lines in all views, where nobody knows the lens and the photos tell
        beyond doubt.
        """
        return None


class Rasterizer(Configured, ABC):
    """Renders Gaussians; differentiable in means, quats, scales, opacities and harmonics."""

    @abstractmethod
    def render(self, gaussians: Gaussians, cameras: Cameras) -> Rendering:
        """Pictures, alphas and expected depths of every camera of every scene."""


class Refiner(Configured, ABC):
    """One step after reconstruction: makes the Gaussians fewer, sharper, or equal to what must not
    change.
    """

    needs_before: bool = (
        False  # True: `request.before` must hold the scene as it was before the edit
    )

    @abstractmethod
    def __call__(
        self,
        gaussians: Gaussians,
        cameras: Cameras,
        views: Views,
        request: EditRequest,
        rasterizer: Rasterizer,
    ) -> Gaussians:
        """Return the refined Gaussians, in the same frame.

        `cameras` are the poses of all input views. `views` are those whose images show the edit:
        the first `views.count` of the cameras are theirs. `request.masks`, where given, cover all
        cameras.
        """


@dataclass(frozen=True)
class LossInputs:
    """All that a loss may compare. What a training step does not have is None."""

    rendered: Float[Tensor, "batch view 3 height width"] | None = (
        None  # pictures of the prediction
    )
    target: Float[Tensor, "batch view 3 height width"] | None = (
        None  # what they should show
    )
    gaussians: Gaussians | None = None  # the prediction
    reference: Gaussians | None = (
        None  # frozen reconstructor's answer for the unedited photos, Gaussian by Gaussian
    )


class Loss(Configured, ABC):
    """One term of a training objective; its weight is applied by the trainer."""

    @abstractmethod
    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        """A finite scalar, 0 at the target."""


@dataclass(frozen=True)
class SceneSample:
    """One multi-view training sample, without a batch axis: V context views and T target views."""

    context: Float[Tensor, "view 3 height width"]  # unedited
    target: Float[Tensor, "target 3 height width"]  # unedited
    context_cameras: Cameras  # batch 1; view 0 at the origin
    target_cameras: Cameras  # batch 1
    context_depths: Float[Tensor, "view height width"] | None = (
        None  # camera z, 0 unknown
    )
    context_masks: Float[Tensor, "object view height width"] | None = (
        None  # instance masks
    )
    target_masks: Float[Tensor, "object target height width"] | None = None
    edited_context: Float[Tensor, "view 3 height width"] | None = (
        None  # where the data knows the edited truth
    )
    edited_target: Float[Tensor, "target 3 height width"] | None = None
    name: str = ""


class Dataset(Configured, torch.utils.data.Dataset, ABC):
    """Multi-view samples by index; the same index and settings give the same sample, in any
    worker.
    """

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def __getitem__(self, index: int) -> SceneSample: ...

    def at_progress(self, index: int, progress: float) -> SceneSample:
        """The sample as a training that is `progress` in [0, 1] of its way should see it; by
        default always the same.

        For data that begins easy and gets harder; `data[index]` is the sample at the end.
        """
        return self[index]


@dataclass(frozen=True)
class TrainingJob:
    """Everything a trainer is given, already built."""

    reconstructor: Reconstructor
    rasterizer: Rasterizer
    train_data: Dataset
    validation_data: Dataset | None
    losses: Mapping[str, tuple[float, Loss]]  # name: (weight, loss)
    out: Path  # folder for checkpoints, logs and sample sheets
    resume: bool = False
    config: Mapping[str, Any] | None = (
        None  # the whole resolved configuration, saved with every checkpoint
    )
    reference: Reconstructor | None = (
        None  # frozen: its answer for the unedited photos is what 3D losses hold to
    )


class Trainer(Configured, ABC):
    """A training recipe."""

    @abstractmethod
    def train(self, job: TrainingJob) -> Path:
        """Train until the recipe's last step; returns the folder of the best checkpoint."""


INTERFACES: dict[str, type] = {
    "editor": Editor,
    "segmenter": Segmenter,
    "detector": Detector,
    "reconstructor": Reconstructor,
    "backbone": Backbone,
    "head": GaussianHead,
    "matcher": Matcher,
    "rasterizer": Rasterizer,
    "loss": Loss,
    "dataset": Dataset,
    "trainer": Trainer,
    "refiner": Refiner,
    "command": Command,
}
"""The interface of each kind, for checks and documentation."""
