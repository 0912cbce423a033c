"""The data that passes between stages, and the conventions, written once.

| thing      | convention                                                                    |
|------------|-------------------------------------------------------------------------------|
| images     | float32 sRGB in [0, 1], `[B, V, 3, H, W]`                                     |
| intrinsics | normalised 3x3: fx, cx in image widths, fy, cy in heights; centres at +0.5    |
| poses      | camera-to-world 4x4 `c2w`, OpenCV axes (x right, y down, z forward)           |
| Gaussians  | linear scales (standard deviations), wxyz quaternions, opacities in [0, 1],   |
|            | harmonics of 3D Gaussian Splatting                                            |
| world      | the frame of view 0's camera                                                  |

B scenes, V input views, C cameras, G Gaussians, K = (degree + 1)^2 harmonics per colour. Files and
foreign libraries are converted at the door (`edit3r.kit`); everything inside trusts this page. All
classes are frozen; change one with `dataclasses.replace`.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import interpolate

from edit3r.contract.errors import PromptError
from edit3r.contract.instructions import Instruction

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MAX_DEGREE = 4

DC = 0.28209479177387814
"""The constant basis function Y_00; a Gaussian of plain colour c has the harmonic (c - 0.5) / DC.
"""
DISC_THICKNESS = 1e-3
"""Thickness of a disc with two scales, as 2DGS has them, in its smaller one."""
Moved = TypeVar("Moved")
Record = TypeVar("Record", bound="DataclassInstance")


@dataclass(frozen=True, repr=False)
class Tensors:
    """Data whose tensors move together."""

    def to(self: Moved, *args: Any, **kwargs: Any) -> Moved:
        """`Tensor.to` on floating-point fields; integer fields follow to the device."""

        def to(tensor: Tensor) -> Tensor:
            moved = tensor.to(*args, **kwargs)
            return moved if tensor.is_floating_point() else tensor.to(moved.device)

        return _moved(self, to)

    def __repr__(self) -> str:
        """Name and fields; of tensors the shape alone."""
        shown = []
        for one in fields(self):
            value = getattr(self, one.name)
            text = list(value.shape) if isinstance(value, Tensor) else repr(value)
            shown.append(f"{one.name}={text}")
        return f"{type(self).__name__}({', '.join(shown)})"


def along(
    record: Record, axis: str, index: slice | list[int] | Tensor, **changes: Any
) -> Record:
    """A record with `index` alone of an axis that the shapes of its fields name, and `changes`."""
    for one in fields(record):
        value = getattr(record, one.name)
        shape = next(filter(None, map(_shape_of, (one.type, *get_args(one.type)))), [])
        if isinstance(value, Tensor) and axis in shape:
            place = [*[slice(None)] * shape.index(axis), index]
            changes.setdefault(one.name, value[tuple(place)])
    return replace(record, **changes)


def _shape_of(annotation: Any) -> list[str]:
    return getattr(annotation, "dim_str", "").split()


def _moved(value: Any, to: Callable[[Tensor], Tensor]) -> Any:
    """`value` with all tensors in it moved."""
    if isinstance(value, Tensor):
        return to(value)
    if isinstance(value, Tensors):
        changes = {
            one.name: _moved(getattr(value, one.name), to) for one in fields(value)
        }
        return replace(value, **changes)
    if isinstance(value, Mapping):
        return {name: _moved(inner, to) for name, inner in value.items()}
    if isinstance(value, tuple):
        return tuple(_moved(inner, to) for inner in value)
    return value


@dataclass(frozen=True, repr=False)
class Views(Tensors):
    """Input images of B scenes with their intrinsics; poses only where somebody knows them."""

    images: Float[Tensor, "batch view 3 height width"]  # sRGB in [0, 1]
    intrinsics: Float[Tensor, "batch view 3 3"]  # normalised
    # one per view, for messages and file names; () when unnamed
    names: tuple[str, ...] = ()
    # known poses in any common frame; None: not known
    c2w: Float[Tensor, "batch view 4 4"] | None = None
    # per view: nobody knows its intrinsics, they may be estimated; (): all are known
    assumed: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        _check("Views.images", self.images, (None, None, 3, None, None))
        batch, views = self.images.shape[:2]
        _check("Views.intrinsics", self.intrinsics, (batch, views, 3, 3))
        if self.c2w is not None:
            _check("Views.c2w", self.c2w, (batch, views, 4, 4))
        for name in ("names", "assumed"):
            count = len(getattr(self, name))
            if count not in (0, views):
                raise ValueError(f"Views.{name}: expected {views}, got {count}")

    @property
    def count(self) -> int:
        """Number of views V."""
        return self.images.shape[1]

    @property
    def called(self) -> tuple[str, ...]:
        """What messages call each view: its name, or "view 0" and so on where they have none."""
        return self.names or tuple(f"view {view}" for view in range(self.count))

    @property
    def image_size(self) -> tuple[int, int]:
        """(height, width) [pixels]."""
        return self.images.shape[3], self.images.shape[4]

    def at(self, size: tuple[int, int]) -> "Views":
        """The views with images of another (height, width) [pixels]."""
        if size == self.image_size:
            return self
        small = interpolate(
            self.images.flatten(0, 1), size, mode="bilinear", antialias=True
        )
        # The weights of a pixel sum up to 1 but for rounding, which may lead above it.
        images = small.unflatten(0, self.images.shape[:2]).clamp(0, 1)
        return replace(self, images=images)

    def scene(self, index: int) -> "Views":
        """One scene of the batch, as a batch of one."""
        return along(self, "batch", slice(index, index + 1))

    def select(self, indices: Iterable[int]) -> "Views":
        """The views at `indices`, in that order."""
        index = list(indices)
        if index == list(range(self.count)):  # images of many views are not kept twice
            return self
        names = tuple(self.names[i] for i in index) if self.names else ()
        assumed = tuple(self.assumed[i] for i in index) if self.assumed else ()
        return along(self, "view", index, names=names, assumed=assumed)


@dataclass(frozen=True, repr=False)
class EditRequest(Tensors):
    """What an editor is asked to do with a set of views."""

    prompt: str
    seed: int = 0  # one for all views, so that every view gets the same edit
    # in [0, 1]; 1: may change; None: everywhere
    masks: Float[Tensor, "batch view height width"] | None = None
    # the prompt as the run read it; () where nobody did
    instructions: tuple[Instruction, ...] = ()
    # where each instruction applies, in [0, 1]; None: nobody looked, so everywhere
    regions: Float[Tensor, "instruction batch view height width"] | None = None

    def __post_init__(self) -> None:
        if self.masks is not None:
            _check("EditRequest.masks", self.masks, (None, None, None, None))

    def asked(self) -> tuple[Instruction, ...]:
        """The instructions, for an editor that needs some. Raises PromptError if there are none."""
        if not self.instructions:
            raise PromptError(
                f"{self.prompt!r} comes without instructions; hand over what a reader makes of it: "
                "EditRequest(prompt, instructions=edit3r.running.usual_reader().read(prompt))."
            )
        return self.instructions

    def of_scene(self, index: int) -> "EditRequest":
        """The same request for one scene of the batch."""
        return along(self, "batch", slice(index, index + 1))

    def of_views(self, indices: Iterable[int]) -> "EditRequest":
        """The same request for the views at `indices` only."""
        return along(self, "view", list(indices))


@dataclass(frozen=True, repr=False)
class Cameras(Tensors):
    """Posed pinhole cameras that share an image size."""

    c2w: Float[Tensor, "batch camera 4 4"]  # camera to world, OpenCV axes
    intrinsics: Float[Tensor, "batch camera 3 3"]  # normalised
    image_size: tuple[int, int]  # (height, width) [pixels]

    def __post_init__(self) -> None:
        _check("Cameras.c2w", self.c2w, (None, None, 4, 4))
        _check("Cameras.intrinsics", self.intrinsics, (*self.c2w.shape[:2], 3, 3))
        height, width = self.image_size
        if height < 1 or width < 1:
            raise ValueError(
                f"Cameras.image_size: expected at least (1, 1), got {tuple(self.image_size)}"
            )

    @property
    def count(self) -> int:
        """Number of cameras C."""
        return self.c2w.shape[1]

    def select(self, indices: Iterable[int]) -> "Cameras":
        """The cameras at `indices`, in that order."""
        return along(self, "camera", list(indices))

    def at(self, size: tuple[int, int]) -> "Cameras":
        """The cameras with images of another (height, width) [pixels]."""
        return replace(self, image_size=size)


@dataclass(frozen=True, repr=False)
class Features(Tensors):
    """What a backbone hands to a head: token maps of several depths on one patch grid.

    `grid` is (rows, columns) of patches; `levels[l]` is `[B, V, rows * columns, C_l]`, row-major,
    `C_l` being the backbone's `feature_widths[l]`.
    """

    levels: tuple[Float[Tensor, "batch view token channel"], ...]
    grid: tuple[int, int]
    # of the views as the backbone predicts them, in the frame of view 0; None: it predicts none
    cameras: Cameras | None = None
    # tokens of no patch by name, such as "camera" or "register"
    tokens: Mapping[str, Float[Tensor, "batch view _token _channel"]] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        tokens = self.grid[0] * self.grid[1]
        for index, level in enumerate(self.levels):
            _check(f"Features.levels[{index}]", level, (None, None, tokens, None))
        views = self.levels[0].shape[:2] if self.levels else (None, None)
        for name, named in self.tokens.items():
            _check(f"Features.tokens[{name!r}]", named, (*views, None, None))
        if self.cameras is not None:
            _check("Features.cameras", self.cameras.c2w, (*views, 4, 4))


@dataclass(frozen=True, repr=False)
class Gaussians(Tensors):
    """3D Gaussians of B scenes in the frame of view 0 (OpenCV axes)."""

    means: Float[Tensor, "batch gaussian 3"]  # centres [scene units]
    # standard deviations along the axes [scene units], > 0; given as two, those of a disc (2DGS):
    # the third, along its normal, becomes DISC_THICKNESS of the smaller
    scales: Float[Tensor, "batch gaussian 3"]
    # wxyz, axes to world; any norm, consumers normalise
    quats: Float[Tensor, "batch gaussian 4"]
    opacities: Float[Tensor, "batch gaussian"]  # in [0, 1]
    # 3DGS basis; colour = max(0, SH(direction) + 0.5)
    harmonics: Float[Tensor, "batch gaussian coefficient 3"]
    # input view each came from, -1: none; not given: all -1
    view_index: Int[Tensor, "gaussian"] = None  # type: ignore[assignment]
    # object each belongs to, -1: none; None: the scene has no objects
    object_index: Int[Tensor, "gaussian"] | None = None
    # in [0, 1]: the probability that its colour is wrong in a new view; None: nobody estimated it
    uncertainty: Float[Tensor, "batch gaussian"] | None = None

    def __post_init__(self) -> None:
        _check("Gaussians.means", self.means, (None, None, 3))
        batch, count = self.means.shape[:2]
        if self.scales.shape[-1] == 2:
            thin = DISC_THICKNESS * self.scales.amin(-1, keepdim=True)
            object.__setattr__(self, "scales", torch.cat((self.scales, thin), -1))
        _check("Gaussians.scales", self.scales, (batch, count, 3))
        _check("Gaussians.quats", self.quats, (batch, count, 4))
        _check("Gaussians.opacities", self.opacities, (batch, count))
        _check("Gaussians.harmonics", self.harmonics, (batch, count, None, 3))
        allowed = [(degree + 1) ** 2 for degree in range(MAX_DEGREE + 1)]
        if self.harmonics.shape[2] not in allowed:
            raise ValueError(
                f"Gaussians.harmonics: expected K in {allowed}, got {self.harmonics.shape[2]}"
            )
        if self.view_index is None:
            index = torch.full((count,), -1, device=self.means.device)
            object.__setattr__(self, "view_index", index)
        _check("Gaussians.view_index", self.view_index, (count,))
        if self.object_index is not None:
            _check("Gaussians.object_index", self.object_index, (count,))
        if self.uncertainty is not None:
            _check("Gaussians.uncertainty", self.uncertainty, (batch, count))

    @property
    def count(self) -> int:
        """Number of Gaussians G per scene."""
        return self.means.shape[1]

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 4."""
        return round(self.harmonics.shape[2] ** 0.5) - 1

    @property
    def objects(self) -> Int[Tensor, "gaussian"]:
        """`object_index`, all -1 in a scene without objects."""
        if self.object_index is None:
            return torch.full_like(self.view_index, -1)
        return self.object_index

    def select(self, index: Tensor) -> "Gaussians":
        """The Gaussians at a boolean or integer (from 0) `index` along G.

        It is the same for every scene of the batch.
        """
        index = index.to(self.means.device)
        if index.dtype == torch.bool:
            index = index.nonzero()[:, 0]
        # A third of the time of indexing with [:, index].
        selected = {
            name: getattr(self, name).index_select(1, index) for name in PER_GAUSSIAN
        }
        objects = self.object_index
        unsure = self.uncertainty
        return Gaussians(
            **selected,
            view_index=self.view_index.index_select(0, index),
            object_index=None if objects is None else objects.index_select(0, index),
            uncertainty=None if unsure is None else unsure.index_select(1, index),
        )

    def from_view(self, view: int) -> "Gaussians":
        """Only those that came from input view `view`."""
        return self.select(torch.eq(self.view_index, view))

    def without_view(self, view: int) -> "Gaussians":
        """All but those that came from input view `view`."""
        return self.select(torch.ne(self.view_index, view))

    @staticmethod
    def cat(parts: "Iterable[Gaussians]") -> "Gaussians":
        """Join along G; all parts share batch size and harmonics degree.

        A part without objects joins one that has some as background, one without uncertainty as
        wholly uncertain (1).
        """
        parts = list(parts)
        view_index = torch.cat([part.view_index for part in parts])
        objects = None
        if any(part.object_index is not None for part in parts):
            objects = torch.cat([part.objects for part in parts])
        uncertainty = None
        if any(part.uncertainty is not None for part in parts):
            unsure = [
                torch.ones_like(part.opacities)
                if part.uncertainty is None
                else part.uncertainty
                for part in parts
            ]
            uncertainty = torch.cat(unsure, 1)
        return Gaussians(
            **_joined(parts, 1),
            view_index=view_index,
            object_index=objects,
            uncertainty=uncertainty,
        )

    @staticmethod
    def stack(scenes: "Iterable[Gaussians]") -> "Gaussians":
        """Join scenes as one batch; views, objects and uncertainty are forgotten.

        A scene with fewer Gaussians repeats its last, transparent.
        """
        scenes = list(scenes)
        count = max(scene.count for scene in scenes)
        place = torch.arange(count, device=scenes[0].means.device)
        filled = []
        for scene in scenes:
            full = scene.select(place.clamp(max=scene.count - 1))
            shown = place < scene.count
            filled.append(replace(full, opacities=full.opacities * shown))
        return Gaussians(**_joined(filled, 0))


PER_GAUSSIAN = ("means", "scales", "quats", "opacities", "harmonics")
"""Fields of `Gaussians` with a batch axis and then one of Gaussians."""


def _joined(parts: Iterable[Gaussians], axis: int) -> dict[str, Tensor]:
    return {
        name: torch.cat([getattr(part, name) for part in parts], axis)
        for name in PER_GAUSSIAN
    }


@dataclass(frozen=True, repr=False)
class GivenScene(Tensors):
    """A scene that was there before the run (batch 1), and pictures of it."""

    gaussians: Gaussians  # in the frame of view 0
    cameras: Cameras  # of the pictures; that of view 0 is the identity
    # sRGB in [0, 1], over a background
    images: Float[Tensor, "batch view 3 height width"]
    background: float  # grey behind it all, in [0, 1]
    # expected camera z of the pictures' pixels, 0 where nothing is
    depths: Float[Tensor, "batch view height width"]
    # how much of each pixel the scene covers, in [0, 1]; the rest is background
    alphas: Float[Tensor, "batch view height width"]

    def __post_init__(self) -> None:
        maps = (*self.cameras.c2w.shape[:2], *self.cameras.image_size)
        _check("GivenScene.images", self.images, (*maps[:2], 3, *maps[2:]))
        _check("GivenScene.depths", self.depths, maps)
        _check("GivenScene.alphas", self.alphas, maps)


@dataclass(frozen=True, repr=False)
class Reconstruction(Tensors):
    """A reconstructor's answer."""

    gaussians: Gaussians
    # the input views' predicted poses in the Gaussians' frame; None: not predicted
    cameras: Cameras | None = None
    # False: could not be placed; None: all were
    placed: Bool[Tensor, "batch view"] | None = None
    # share of pixels whose depth was measured; None: unknown
    measured: Float[Tensor, "batch view"] | None = None
    # Gaussians that each pixel of the views has, which come first, view by view, row by row, those
    # of a pixel together; 0: they are not made pixel by pixel
    per_pixel: int = 1
    # what was added to the views' colours [sRGB] so that their edits agree, at a size of its own;
    # None: nothing
    fusion: Float[Tensor, "batch view 3 height width"] | None = None
    # of an edit in place: which of the given scene's Gaussians come first here, in their order;
    # None: the Gaussians were made anew
    kept: Bool[Tensor, "given_gaussian"] | None = None


_Images = Float[Tensor, "batch camera 3 height width"]
_Maps = Float[Tensor, "batch camera 1 height width"]
if not TYPE_CHECKING:
    # None in the answer of a rasterizer that does not give them; whoever needs them has asked its
    # `gives` before, so types say that they are there.
    _Images, _Maps = _Images | None, _Maps | None


@dataclass(frozen=True, repr=False)
class Rendering(Tensors):
    """A rasterizer's answer for C cameras: what it `gives`, the rest is None."""

    # sRGB, >= 0, not clipped above 1
    images: _Images = None  # type: ignore[assignment]
    alphas: _Maps = None  # type: ignore[assignment]  # in [0, 1]
    # expected camera z; 0 where nothing is hit
    depths: _Maps = None  # type: ignore[assignment]
    # more by name, such as "normals" (world, unit length) or "features"
    extra: Mapping[str, Float[Tensor, "batch camera _channel height width"]] = field(
        default_factory=dict
    )

    @property
    def given(self) -> dict[str, Tensor]:
        """All that is there by name, `extra` among it."""
        usual = {name: getattr(self, name) for name in RENDERED}
        there = {name: value for name, value in usual.items() if value is not None}
        return {**there, **self.extra}

    @staticmethod
    def of(given: Mapping[str, Tensor]) -> "Rendering":
        """The rendering of which `given` is all that is there."""
        usual = {name: value for name, value in given.items() if name in RENDERED}
        extra = {name: value for name, value in given.items() if name not in RENDERED}
        return Rendering(**usual, extra=extra)


RENDERED = {"images": 3, "alphas": 1, "depths": 1}
"""What rasterizers usually give, and the channels of each."""


def _check(name: str, tensor: Tensor, shape: tuple[int | None, ...]) -> None:
    """Raise ValueError unless `tensor` has `shape` (None: any size, also 0)."""
    given = tuple(tensor.shape)
    pairs = zip(given, shape)
    if len(given) != len(shape) or any(
        want not in (None, have) for have, want in pairs
    ):
        expected = ", ".join("*" if size is None else str(size) for size in shape)
        raise ValueError(f"{name}: expected shape [{expected}], got {list(given)}")
