"""What the core holds every component to while it runs, so that a fault is named where it was made.

Called by the pipeline after each stage. A component that raises, or returns another size, dtype or
range than its interface promises, ends the run with one sentence that names it.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import isfinite
from numbers import Real
from pathlib import Path
from typing import Any, get_args

import torch
from jaxtyping import Bool, Float

from edit3r.contract.component import component_name
from edit3r.contract.errors import (
    Edit3rError,
    InputError,
    MatchingError,
    PluginError,
    SettingsError,
    is_out_of_memory,
)
from edit3r.contract.instructions import Instruction
from edit3r.contract.interfaces import (
    INTERFACES,
    Critic,
    Editor,
    Geometry,
    MaskLogits,
    Proposal,
    Rasterizer,
    Reader,
    Reconstructor,
    Refiner,
    SceneToWrite,
    Segmenter,
    Selected,
    Selector,
    Tracks,
    Writer,
)
from edit3r.contract.types import (
    RENDERED,
    Cameras,
    Gaussians,
    Reconstruction,
    Rendering,
    Views,
)
from edit3r.contract.verdicts import LABELS, EditLabel, EditVerdict, Verdict

FARTHEST = 1e6  # depths that a camera may stand from the first


@contextmanager
def errors_named_after(component: Any, *given: torch.Tensor) -> Iterator[None]:
    """Name the component in any error of its code that was not meant for the user.

    It must leave what it is `given` as it was, since others work with the same tensors.
    """
    before = [tensor.clone() for tensor in given]
    try:
        yield
    except Edit3rError:
        raise
    except SystemExit as error:
        raise PluginError(
            f"{named_after(component)} ended the program (sys.exit({error.code!r}))."
        ) from error
    except Exception as error:
        if is_out_of_memory(error):
            raise
        raise PluginError(
            f"{named_after(component)} raised {type(error).__name__}: {error}."
        ) from error
    unchanged = all(torch.equal(tensor, copy) for tensor, copy in zip(given, before))
    promise = (
        "leave its arguments as they are, and changed one in place; clone it first"
    )
    _require(component, unchanged, promise)


def check_edit(editor: Editor, views: Views, answer: Views) -> None:
    """Number, size, dtype and range of the edited views."""
    _require_type(editor, answer, Views)
    given = views.images
    _require_tensor(editor, "images", answer.images, list(given.shape), given.dtype)
    _require_range(editor, "images", answer.images)


def check_needs(writer: Writer, scene: SceneToWrite) -> None:
    """What the writer needs of a scene must be known."""
    lacking = [name for name in writer.needs if getattr(scene, name) in (None, "", ())]
    if lacking:
        raise InputError(
            f"{component_name(writer)} needs {' and '.join(lacking)}, which this scene does not "
            "have; give the folder of a run."
        )


def check_instructions(reader: Reader, instructions: tuple[Instruction, ...]) -> None:
    """At least one, each of which says what shall happen to what."""
    _require_type(reader, instructions, tuple)
    _require(
        reader, len(instructions) > 0, "return an instruction, or raise PromptError"
    )
    for instruction in instructions:
        _require_type(reader, instruction, Instruction)
        fault = instruction.fault()
        _require(
            reader,
            not fault,
            f"return instructions that hold together; one {fault}: {instruction!r}",
        )


def check_written(writer: Writer, path: Path) -> None:
    """One file, or one folder with something in it, as its suffix says."""
    if writer.offer.component.makes_folder:
        is_there = path.is_dir() and any(path.iterdir())
        promise = "make the folder that it is given, since its suffix has no dot"
    else:
        is_there = path.is_file()
        promise = "write the file that it is given, since its suffix has a dot"
    _require(writer, is_there, f"{promise}: {path.name}")


def check_selected(selector: Selector, views: Views, answer: Selected) -> None:
    """A soft mask for each view, and how each was found."""
    _require_type(selector, answer, Selected)
    size = [views.count, 1, *views.image_size]
    _require_tensor(selector, "masks", answer.masks, size, views.images.dtype)
    _require_range(selector, "masks", answer.masks)
    _require(
        selector,
        len(answer.how) == views.count,
        f"say how it was found on each view, {views.count} words",
    )


def check_edit_verdict(critic: Critic, answer: EditVerdict) -> None:
    """A known label and a sentence."""
    _require_type(critic, answer, EditVerdict)
    _require_reasoned(critic, answer, "an edit", get_args(EditLabel))


def check_verdict(critic: Critic, answer: Verdict) -> None:
    """A known label and a sentence."""
    _require_type(critic, answer, Verdict)
    _require_reasoned(critic, answer, "a scene", LABELS)


def _require_reasoned(
    critic: Critic, answer: EditVerdict | Verdict, what: str, labels: Sequence[str]
) -> None:
    _require(critic, answer.label in labels, f"label {what} {' or '.join(labels)}")
    _require(critic, bool(answer.reason), "say why, in one sentence")


def check_geometry(matcher: Any, views: Views, answer: Geometry) -> None:
    """Shapes, dtypes and finiteness of what a matcher found, real cameras, depths above 0."""
    _require_type(matcher, answer, Geometry)
    dtype, views_of = views.images.dtype, list(views.images.shape[:2])
    sides = list(getattr(answer.depths, "shape", ()))[2:]
    grid = [*views_of, *(sides if len(sides) == 2 else ("height", "width"))]
    _require_tensor(matcher, "c2w", answer.c2w, [*views_of, 4, 4], dtype)
    _require_tensor(matcher, "depths", answer.depths, grid, dtype)
    _require_tensor(matcher, "confidence", answer.confidence, grid, dtype)
    _require_tensor(matcher, "registered", answer.registered, views_of, torch.bool)
    least = float(answer.depths.amin())
    _require(matcher, least > 0, f"return depths above 0, got {least:.4g}")
    _require_range(matcher, "confidence", answer.confidence)
    placed = answer.registered
    joined = placed[:, 0] & (placed.sum(1) >= 2)
    promise = "place view 0 and another one, or raise MatchingError"
    _require(matcher, bool(joined.all()), promise)
    _require_poses(matcher, answer.c2w, placed)
    first = answer.c2w[:, 0].double()
    is_own = torch.allclose(first, torch.eye(4).to(first).expand_as(first), atol=1e-3)
    _require(matcher, is_own, "return c2w in the frame of view 0, its own the identity")
    reach = float(answer.depths.median()) * FARTHEST
    away = float(answer.c2w[placed][:, :3, 3].abs().amax())
    promise = f"place its cameras where depths reach; one is {away:.3g} away"
    _require(matcher, away < reach, promise)
    if answer.intrinsics is not None:
        _require_tensor(
            matcher, "intrinsics", answer.intrinsics, [*views_of, 3, 3], dtype
        )
        focal = answer.intrinsics.diagonal(dim1=-2, dim2=-1)
        promise = f"return focal lengths above 0, got {float(focal.amin()):.4g}"
        _require(matcher, bool((focal > 0).all()), promise)
    pair = isinstance(answer.lenses, tuple) and len(answer.lenses) == 2
    promise = f"return lenses as two angles, or None, got {answer.lenses!r}"
    _require(matcher, pair or answer.lenses is None, promise)


def _require_poses(
    component: Any,
    c2w: Float[torch.Tensor, "batch view 4 4"],
    placed: Bool[torch.Tensor, "batch view"],
) -> None:
    """Cameras turn and move: they neither mirror nor scale."""
    poses = c2w[placed].double()
    turns = poses[:, :3, :3]
    off = (turns @ turns.mT - torch.eye(3).to(turns)).abs().amax()
    promise = "return c2w whose first three columns are a rotation"
    _require(component, float(off) < 0.05, f"{promise}; one scales or is singular")
    _require(component, bool((turns.det() > 0).all()), f"{promise}; one mirrors")
    last = poses.new_tensor([0, 0, 0, 1])
    is_last = torch.allclose(poses[:, 3], last, atol=1e-4)
    _require(component, is_last, "return c2w whose last row is 0, 0, 0, 1")


def check_proposal(
    segmenter: Segmenter, answer: Proposal, image: Float[torch.Tensor, "3 height width"]
) -> None:
    """A soft mask of the image's size and dtype, in [0, 1], and a confidence."""
    _require_type(segmenter, answer, Proposal)
    size = list(image.shape[-2:])
    _require_tensor(segmenter, "soft_mask", answer.soft_mask, size, image.dtype)
    _require_range(segmenter, "soft_mask", answer.soft_mask)
    value = answer.confidence
    is_number = isinstance(value, Real) and isfinite(value)
    _require(segmenter, is_number, f"return confidence as a number, got {value!r}")


def check_masks(segmenter: Segmenter, answer: MaskLogits) -> None:
    """Finite logits `[n, h, w]` of at least one mask, and the quality of each `[n]` if told."""
    _require_type(segmenter, answer, MaskLogits)
    told: dict[str, torch.Tensor] = {"logits": answer.logits}
    if answer.quality is not None:
        told["quality"] = answer.quality
    for name, one in told.items():
        _require_type(segmenter, one, torch.Tensor)
        _require(segmenter, bool(one.isfinite().all()), f"return finite {name}")
    shapes = [list(one.shape) for one in told.values()]
    held = len(shapes[0]) == 3 and all(shapes[0]) and shapes[-1][:1] == shapes[0][:1]
    held &= all(len(shape) == 1 for shape in shapes[1:])
    promise = "return logits [n, h, w] and their quality [n]"
    _require(segmenter, held, f"{promise}, got shapes {shapes}")


def check_tracks(
    segmenter: Segmenter,
    answer: Tracks,
    images: Float[torch.Tensor, "view 3 height width"],
    objects: int,
) -> None:
    """Logits of each object on each image, and where it was seen."""
    _require_type(segmenter, answer, Tracks)
    views, _, *size = images.shape
    shape = [views, objects, *size]
    _require_tensor(segmenter, "logits", answer.logits, shape, images.dtype)
    shape = [views, objects]
    _require_tensor(segmenter, "present", answer.present, shape, torch.bool)


def check_reconstruction(
    recon: Reconstructor, views: Views, answer: Reconstruction
) -> None:
    """Batch, dtype, finiteness and ranges of the Gaussians, and the number of cameras."""
    _require_type(recon, answer, Reconstruction)
    _require_type(recon, answer.gaussians, Gaussians)
    check_gaussians(recon, answer.gaussians, views.images.shape[0], views.images.dtype)
    _require(recon, answer.gaussians.count > 0, "return Gaussians, got an empty scene")
    scenes, count = views.images.shape[:2]
    for name, expected in (
        ("placed", [scenes, count]),
        ("measured", [scenes, count]),
        ("fusion", [scenes, count, 3]),
    ):
        tensor = getattr(answer, name)
        given = expected if tensor is None else list(tensor.shape[: len(expected)])
        _require(
            recon,
            given == expected,
            f"return {name} for each of its views, {expected}, got {given}",
        )
    placed = answer.placed
    if placed is None:
        placed = torch.ones(scenes, count, dtype=torch.bool)
    _require(recon, bool(placed.any(1).all()), "place a view, or raise MatchingError")
    if answer.cameras is not None:
        expected, given = [scenes, count], list(answer.cameras.c2w.shape[:2])
        promise = f"return one camera per view, {expected}, got {given}"
        _require(recon, given == expected, promise)
        _require_poses(recon, answer.cameras.c2w, placed.to(answer.cameras.c2w.device))


def check_refinement(refiner: Refiner, given: Gaussians, answer: Gaussians) -> None:
    """Batch, dtype, finiteness and ranges of the refined Gaussians."""
    _require_type(refiner, answer, Gaussians)
    check_gaussians(refiner, answer, given.means.shape[0], given.means.dtype)


def check_gaussians(
    component: Any, gaussians: Gaussians, scenes: int, dtype: torch.dtype
) -> None:
    """Raise PluginError unless these are finite Gaussians of so many scenes, all in range."""
    given = gaussians.means.shape[0]
    sizes = f"gave it {scenes} scenes, got back {given}"
    _require(
        component, given == scenes, f"return one set of Gaussians per scene: {sizes}"
    )
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        _require_numbers(component, name, getattr(gaussians, name), dtype)
    if gaussians.count:
        least = float(gaussians.scales.amin())
        _require(component, least > 0, f"return scales above 0, got {least:.4g}")
        _require_range(component, "opacities", gaussians.opacities)


def check_rendering(
    rasterizer: Rasterizer, gaussians: Gaussians, cameras: Cameras, answer: Rendering
) -> None:
    """Shapes, dtype and finiteness of what the rasterizer `gives`, and nothing else."""
    _require_type(rasterizer, answer, Rendering)
    given, views = answer.given, cameras.c2w.shape[:2]
    for name in rasterizer.gives:
        tensor: Any = given.pop(name, None)
        sizes = list(getattr(tensor, "shape", ()))
        channels = RENDERED.get(name, sizes[2] if len(sizes) == 5 else "channels")
        shape = [*views, channels, *cameras.image_size]
        _require_tensor(rasterizer, name, tensor, shape, gaussians.means.dtype)
    more = ", ".join(given)
    _require(rasterizer, not given, f"name in its `gives` what it gives: {more}")


def require_gives(
    rasterizer: Rasterizer | type[Rasterizer], name: str, *needed: str, who: str
) -> None:
    """Raise SettingsError where the rasterizer called `name` does not give all that `who` needs."""
    if any(one not in rasterizer.gives for one in needed):
        raise SettingsError(
            f"rasterizer {name!r} gives {' and '.join(rasterizer.gives) or 'nothing'}, and {who} "
            f"needs {', '.join(needed)}; choose another (edit3r list-plugins --kind rasterizer)."
        )


def named_after(component: Any) -> str:
    """'editor 'sepia'', with the plugin's name where there is one of another name."""
    kind = next(
        (
            kind
            for kind, interface in INTERFACES.items()
            if isinstance(component, interface)
        ),
        "component",
    )
    offer = getattr(component, "offer", None)
    plugin = (
        f" of plugin {offer.plugin!r}"
        if offer is not None and offer.plugin != offer.component.name
        else ""
    )
    return f"{kind} {component_name(component)!r}{plugin}"


def _require(component: Any, held: bool, promise: str) -> None:
    """Raise PluginError, '... must `promise`.', unless it is held."""
    if not held:
        raise PluginError(f"{named_after(component)} must {promise}.")


def where(cls: type) -> str:
    """A class as a plugin imports it: edit3r.contract.types.Views."""
    if cls.__module__ == "builtins":
        return cls.__name__
    # interfaces are a package that names them all
    contract = cls.__module__.split(".")[:3]
    return ".".join((*contract, cls.__name__))


def _require_type(component: Any, answer: Any, expected: type) -> None:
    given = type(answer).__name__
    _require(
        component,
        isinstance(answer, expected),
        f"return {where(expected)}, got {given}",
    )


def _require_tensor(
    component: Any, name: str, answer: Any, shape: list, dtype: torch.dtype
) -> None:
    """A tensor of that shape and dtype, without values that are not finite."""
    given = type(answer).__name__
    is_tensor = isinstance(answer, torch.Tensor)
    _require(component, is_tensor, f"return {name} as a tensor, got {given}")
    promise = f"return {name} of shape {shape}, got {list(answer.shape)}"
    _require(component, list(answer.shape) == shape, promise)
    _require_numbers(component, name, answer, dtype)


def _require_numbers(
    component: Any, name: str, tensor: torch.Tensor, dtype: torch.dtype
) -> None:
    """Of the promised type, and finite."""
    promise = f"return {name} in {dtype}, got {tensor.dtype}"
    _require(component, tensor.dtype == dtype, promise)
    if torch.isfinite(tensor.sum()):  # the quick way; a sum may also overflow
        return
    bad = int((~torch.isfinite(tensor)).sum())
    if bad:
        raise PluginError(
            f"{named_after(component)} returned {name} with {bad} of {tensor.numel()} values not "
            "finite."
        )


def _require_range(component: Any, what: str, tensor: torch.Tensor) -> None:
    low, high = float(tensor.amin()), float(tensor.amax())  # NaN is in no range
    _require(
        component,
        low >= 0 and high <= 1,
        f"return {what} in [0, 1], got {low:.4g} to {high:.4g}",
    )


def require_matchable(views: Views, least_size: int) -> None:
    """For matchers: raise MatchingError for one photo, or sides below `least_size` [pixels]."""
    if views.count < 2:
        raise MatchingError(
            f"matching needs at least two photos of the scene, got {views.count}."
        )
    if min(views.image_size) < least_size:
        height, width = views.image_size
        raise MatchingError(
            f"the photos have {width} x {height} pixels, too small to match; "
            f"give photos of at least {least_size} pixels a side."
        )


def require_geometry(
    reconstructor: Reconstructor, geometry: Geometry | None
) -> Geometry:
    """For reconstructors that use geometry: raise InputError where the caller gives none."""
    if geometry is None:
        raise InputError(
            f"reconstructor {component_name(reconstructor)!r} needs geometry, and none was given; "
            'pass that of a matcher: edit3r.build("matcher", "auto").match(source).'
        )
    return geometry
