"""Critics: how well an edit was carried out, and whether a scene holds."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.component import Configured
from edit3r.contract.instructions import Instruction
from edit3r.contract.interfaces.reconstruction import Geometry
from edit3r.contract.interfaces.selection import Selected
from edit3r.contract.types import Cameras, Gaussians, Rendering, Views
from edit3r.contract.verdicts import EditVerdict, Verdict


@dataclass(frozen=True, repr=False)
class HalfWay:
    """The finished scene from places that no photo shows: half-way between two neighbours."""

    rendered: Rendering  # smaller than the photos
    cameras: Cameras  # batch 1
    # between which two placed photos each camera stands
    pairs: tuple[tuple[int, int], ...]
    # the edited photos in the exposure that the scene has; None: as they are
    photos: Views | None = None


@dataclass(frozen=True, repr=False)
class Reference:
    """The cheapest scene that the run's geometry makes, one round Gaussian of each pixel of the
    edited photos, drawn by the run's rasterizer: what a sound reconstructor reaches at least.
    """

    first: Rendering  # from the place of the first placed photo, smaller than it
    depths: Float[Tensor, "height width"]  # what the geometry says of it: camera z
    # from eight places at most; None: there is one photo alone
    half_way: HalfWay | None


@dataclass(frozen=True, repr=False)
class EditToJudge:
    """An edit in 2D and, once there is a scene, in 3D; of a batch the first scene counts."""

    before: Views
    after: Views  # the same photos, edited and held to the masks
    edited: range  # the views that were edited
    instructions: tuple[Instruction, ...]  # what was asked for
    selected: tuple[Selected, ...]  # the things that were looked for
    # in [0, 1]; 1: might change; None: everywhere
    masks: Float[Tensor, "batch view height width"] | None
    # where each instruction applies, in [0, 1]
    regions: Float[Tensor, "instruction batch view height width"] | None
    # what shows that pictures of the editor are not edits of their photos, a clause each
    faults: tuple[str, ...] = ()
    # what was undone of pictures that had moved against their photos, a clause each
    moved: tuple[str, ...] = ()
    in_2d: EditVerdict | None = None  # the verdict before there was a scene
    rendered: Rendering | None = None  # the scene from the photos' places
    cameras: Cameras | None = None  # the photos', in the scene's frame
    half_way: HalfWay | None = None


@dataclass(frozen=True, repr=False)
class SceneToJudge:
    """A finished scene beside the photos that it was made of.

    `photos`, `placed` and `geometry` have one entry for each photo used, all else for each that was
    placed.
    """

    photos: Views  # unedited
    placed: tuple[bool, ...]
    geometry: Geometry | None  # of the photos; None: the scene stands on none
    edited: Views
    cameras: Cameras  # the photos', in the scene's frame
    gaussians: Gaussians  # before any refiner
    first: Rendering  # the scene before any refiner, from the photos' places
    rendered: Rendering  # the final one
    measured: Float[Tensor, "batch view"] | None  # share of pixels with measured depth
    # nobody knows the lens, and all that the photos share lies on one plane
    flat: bool = False
    # fields of view [degrees] that explain the photos alike, where they do not tell their lens
    fov_range: tuple[float, float] | None = None
    edit: EditVerdict | None = None  # what is said of the edit in 2D
    half_way: HalfWay | None = None  # None: there is one photo alone
    # from the reference's places, before any refiner; None: as `half_way`, or there is no reference
    first_half_way: HalfWay | None = None
    # None: the scene stands on no geometry of the run
    reference: Reference | None = None
    # names of the run's components by kind, such as "reconstructor"; who read the geometry is the
    # "geometry"
    components: Mapping[str, str] = field(default_factory=dict)


class Critic(Configured, ABC):
    """Says what can be measured of a run: never what a person meant."""

    @abstractmethod
    def judge_edit(self, edit: EditToJudge) -> EditVerdict:
        """How the edit was carried out; asked for the 2D edit, and again with the scene."""

    @abstractmethod
    def judge_scene(self, scene: SceneToJudge) -> Verdict:
        """Whether the scene shows its photos, and other views too."""
