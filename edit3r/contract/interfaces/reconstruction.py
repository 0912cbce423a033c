"""Reconstructors and their parts: backbone, head and matcher."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import interpolate

from edit3r.contract.component import Configured
from edit3r.contract.types import (
    EditRequest,
    Features,
    Gaussians,
    GivenScene,
    Reconstruction,
    Tensors,
    Views,
    along,
)

if TYPE_CHECKING:
    from edit3r.contract.lens import Lens


class Reconstructor(Configured, ABC):
    """Turns edited views into 3D Gaussians in one pass, in the frame of view 0."""

    min_views: int = 2
    # above it the pipeline takes evenly spaced views and says so
    max_views: int | None = None

    uses_geometry: bool = False
    """Whether it needs `geometry`; an object may set it by its parts.

    A run asks its matcher only where somebody needs geometry, and brings photos to one exposure
    only for a reconstructor that uses it.
    """

    @abstractmethod
    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        geometry: "Geometry | None" = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        """Reconstruct `views`.

        `source` is the same photos before editing, which agree with each other; None: the views
        do. `geometry` is what was read from `source`, at its resolution; None where `uses_geometry`
        is False. `grid` is the (height, width) of the grid on which Gaussians are made [pixels];
        None: that of the views. A reconstructor may ignore it; cameras that it returns have the
        size it used. Poses that somebody knows are `views.c2w`; it may ignore them and give its
        own. Differentiable by `network` in training mode.

        Raises MatchingError when the photos cannot be placed relative to each other.
        """

    fuses_by_itself: bool = False
    """Whether its Gaussians already settle disagreeing edits.

    Refining towards each view's own edit would undo that, so no default refiner follows. An object
    may set it by its parts.
    """

    @property
    def network(self) -> nn.Module | None:
        """The trainable part; None for a reconstructor without one."""
        return None

    def weights_metadata(self) -> dict[str, str]:
        """What a file of the network's weights says of itself, so that loading builds the same.

        By default nothing: the settings of who loads it say what to build.
        """
        return {}


class EditsViews(ABC):
    """A reconstructor that edits while it reconstructs, with its part of kind editor."""

    @abstractmethod
    def edit_and_reconstruct(
        self,
        views: Views,
        source: Views,
        request: EditRequest,
        geometry: "Geometry | None" = None,
    ) -> Reconstruction:
        """Reconstruct the photos `source`, edited as `request` says.

        `views` are those photos as the run's editor changed them, a first edit to begin with;
        `geometry` is that of `source`, None where `uses_geometry` is False.
        """


@dataclass(frozen=True, repr=False)
class Geometry(Tensors):
    """Relative poses and depths of B scenes, read from photos that agree with each other.

    The unit of length is arbitrary but common to poses and depths.
    """

    c2w: Float[Tensor, "batch view 4 4"]  # view 0 is the identity
    # camera z > 0, filled where nothing matched
    depths: Float[Tensor, "batch view height width"]
    # in [0, 1]; 0: filled in, not measured
    confidence: Float[Tensor, "batch view height width"]
    registered: Bool[Tensor, "batch view"]  # False: the view could not be placed
    # normalised, as read from the photos; None: as given
    intrinsics: Float[Tensor, "batch view 3 3"] | None = None
    # where the photos do not tell their lens: the narrowest and the widest field of view across the
    # longer side that explain them alike [degrees]
    fov_range: tuple[float, float] | None = None
    # the field of view that photos tell where it surely is not the one that they came with
    # [degrees, across the longer side]
    contradicting_fov: float | None = None

    @property
    def is_measured(self) -> Bool[Tensor, "batch view height width"]:
        """Pixels whose depth was measured, not filled in."""
        return self.confidence >= 0.5

    @property
    def measured(self) -> Float[Tensor, "batch view"]:
        """Share of each view's pixels whose depth was measured."""
        return self.is_measured.to(self.depths.dtype).mean((2, 3))

    def calibrated(self, views: Views) -> Views:
        """`views` with the intrinsics that this geometry was read with."""
        return (
            views
            if self.intrinsics is None
            else replace(views, intrinsics=self.intrinsics)
        )

    def scene(self, index: int) -> "Geometry":
        """The geometry of one scene of the batch, as a batch of one."""
        return along(self, "batch", slice(index, index + 1))

    def select(self, indices: list[int]) -> "Geometry":
        """The geometry of the views at `indices`, of which the first is view 0."""
        return along(self, "view", indices)

    def at(self, size: tuple[int, int]) -> "Geometry":
        """This geometry for views of another (height, width) [pixels]."""
        # Nearest: depths are never mixed across an edge.
        depths = interpolate(self.depths, size, mode="nearest-exact")
        confidence = interpolate(self.confidence, size, mode="nearest-exact")
        return replace(self, depths=depths, confidence=confidence)


class FindsGeometry(ABC):
    """A reconstructor that finds poses and depths by itself, as VGGT does.

    The run asks it, in place of a matcher, for whoever needs geometry: selecting, exposure, the
    check of what was measured; it is handed back as `geometry` when the scene is made.
    """

    @abstractmethod
    def find_geometry(self, views: Views) -> Geometry:
        """Geometry of unedited photos, at their resolution.

        Raises MatchingError when view 0 cannot be placed relative to any other view.
        """


class StartsFromScene(ABC):
    """A reconstructor or selector that uses the scene that is there, where a run is given one."""

    @abstractmethod
    def starting_from(self, scene: GivenScene) -> Any:
        """The same component for views that are pictures of `scene`.

        A reconstructor answers with the scene's cameras, and with `kept` where it changes the
        scene's own Gaussians.
        """


class Backbone(Configured, nn.Module, ABC):
    """Network from views to features; any number of views >= 2."""

    patch_size: int  # height and width of its input must be multiples of this [pixels]
    feature_widths: tuple[int, ...]  # channels of each level it returns
    uses_geometry: bool = False
    """Whether it cannot do without `geometry`; it goes with a head that uses geometry, then."""

    @abstractmethod
    def forward(
        self,
        images: Float[Tensor, "batch view 3 height width"],
        intrinsics: Float[Tensor, "batch view 3 3"],
        geometry: Geometry | None = None,
    ) -> Features:
        """Features of images in [0, 1] with normalised intrinsics.

        `geometry` is that of these images, at their size, in a unit that makes depths about 1;
        None: nothing is known, as in a single pass. A backbone that predicts poses returns them as
        `Features.cameras`.
        """


class GaussianHead(Configured, nn.Module, ABC):
    """Network from features to Gaussians in the frame of view 0."""

    uses_geometry: bool = False
    """Whether it cannot do without `geometry`; the reconstructor then gets the run's."""
    per_pixel: int = 1
    """How many Gaussians it makes of each pixel, ordered view by view, row by row, those of a pixel
    together; 0: it does not make them pixel by pixel. An object may set it by its settings.
    """

    @abstractmethod
    def forward(
        self,
        features: Features,
        images: Float[Tensor, "batch view 3 height width"],
        source: Views,
        geometry: Geometry | None,
    ) -> Gaussians:
        """Gaussians of images in [0, 1], with `view_index` set.

        `images` are the views after the edit and `source` those before it, with their intrinsics;
        in a single pass both are the same, of the backbone's size, and `geometry` is None. A head
        that uses geometry gets both at the photos' size, and makes its Gaussians on the grid and in
        the unit of `geometry`, whose grid need be neither the photos' nor the backbone's.
        """


class Matcher(Configured, ABC):
    """Reads relative pose and depth from unedited photos."""

    @abstractmethod
    def match(self, views: Views) -> Geometry:
        """Geometry at the views' own resolution.

        Raises MatchingError when view 0 matches no other view.
        """

    def lens(self, views: Views) -> "Lens | None":
        """What bends straight lines in all views; None unless the photos tell beyond doubt.

        Asked only where nobody knows the lens.
        """
        return None


class MatchesCorrected(ABC):
    """A matcher that places photos as they were taken and measures depth in one exposure.

    Exposure moves no point, but it changes what the colours of two photos say about depth.
    """

    @abstractmethod
    def match_corrected(self, views: Views, corrected: Views) -> Geometry:
        """As `match` of `views`, with depth measured on `corrected`: the same in one exposure."""
