"""What the core holds every component to while it runs, so that a fault is named where it was made.

Called by the pipeline after each stage. A component that raises, or returns another size, dtype or
range than its interface promises, ends the run with one sentence that names it.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
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
    Backbone,
    Critic,
    Dataset,
    Detection,
    Detector,
    Editor,
    GaussianHead,
    Geometry,
    Loss,
    LossInputs,
    MaskLogits,
    Proposal,
    Rasterizer,
    Reader,
    Reconstructor,
    RefineInputs,
    Refiner,
    SceneSample,
    SceneToJudge,
    SceneToWrite,
    Segmenter,
    Selected,
    Selector,
    Tracks,
    Trainer,
    TrainingJob,
    Writer,
)
from edit3r.contract.interfaces.selection import WAYS
from edit3r.contract.types import (
    PER_GAUSSIAN,
    RENDERED,
    Cameras,
    Features,
    Gaussians,
    Reconstruction,
    Rendering,
    Views,
)
from edit3r.contract.verdicts import LABELS, EditLabel, EditVerdict, Verdict

FARTHEST = 1e6  # depths that a camera may stand from the first
REACH = 1e-6, 1e6
"""Between which depths lie: float32 has seven digits, and squares of these. A sanity limit."""
LONGEST = 20  # focal length [image widths]; a sanity limit: pixels are hundreds
SHARES = ("coverage", "filled", "guessed_between", "unlike_between")


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
        told = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".:")
        raise PluginError(f"{named_after(component)} raised {told}.") from error
    unchanged = all(torch.equal(tensor, copy) for tensor, copy in zip(given, before))
    promise = (
        "leave its arguments as they are, and changed one in place; clone it first"
    )
    _require(component, unchanged, promise)


def check_edit(editor: Editor, views: Views, answer: Views) -> None:
    """Number, size, dtype and range of the edited views."""
    require_type(editor, answer, Views)
    given = views.images
    _require_tensor(editor, "images", answer.images, list(given.shape), given.dtype)
    _require_range(editor, "images", answer.images)


def check_maps(
    component: Any, name: str, answer: torch.Tensor, given: torch.Tensor
) -> None:
    """Maps of the shape and dtype of those given, in [0, 1]."""
    _require_tensor(component, name, answer, list(given.shape), given.dtype)
    _require_range(component, name, answer)


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
    require_type(reader, instructions, tuple)
    _require(
        reader, len(instructions) > 0, "return an instruction, or raise PromptError"
    )
    for instruction in instructions:
        require_type(reader, instruction, Instruction)
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
    require_type(selector, answer, Selected)
    size = [views.count, 1, *views.image_size]
    _require_tensor(selector, "masks", answer.masks, size, views.images.dtype)
    _require_range(selector, "masks", answer.masks)
    known = (*WAYS, "not found")
    told = len(answer.how) == views.count and {*answer.how} <= {*known}
    words = f"{views.count} words of {', '.join(known)}"
    promise = f"say how it was found on each view, {words}, got {answer.how}"
    _require(selector, told, promise)
    if answer.confidence is not None:
        _require_share(selector, "confidence", answer.confidence)
    for one in answer.candidates:
        promise = f"return candidates on views 0 to {views.count - 1}, got {one.view}"
        _require(selector, 0 <= one.view < views.count, promise)
        _require_share(selector, "a candidate's score", one.score)


def check_edit_verdict(critic: Critic, answer: EditVerdict) -> None:
    """A known label, a sentence, and figures that a file can hold."""
    require_type(critic, answer, EditVerdict)
    _require_reasoned(critic, answer, "an edit", get_args(EditLabel))
    require_type(critic, answer.measures, dict)
    try:
        json.dumps(answer.measures, allow_nan=False)
    except (TypeError, ValueError) as error:
        _require(critic, False, f"return measures that go into run.json: {error}")


def check_verdict(critic: Critic, scene: SceneToJudge, answer: Verdict) -> None:
    """A known label, a sentence, and for each photo a finite figure, or None."""
    require_type(critic, answer, Verdict)
    _require_reasoned(critic, answer, "a scene", LABELS)
    there = scene.placed
    promise = f"hand on `placed` of the scene, {there}, got {answer.placed}"
    _require(critic, answer.placed == there, promise)
    for name, values in asdict(answer).items():
        if name in ("label", "reason", "part", "placed") or values == ():
            continue
        each = isinstance(values, tuple) and len(values) == len(there)
        held = each and all(
            value is None
            or (placed and isfinite(value) and (name not in SHARES or 0 <= value <= 1))
            for value, placed in zip(values, there)
        )
        kind = "share" if name in SHARES else "finite figure"
        promise = f"return {name} as a {kind} for each of {len(there)} photos"
        _require(critic, held, f"{promise}, None where nothing is known, got {values}")


def _require_reasoned(
    critic: Critic, answer: EditVerdict | Verdict, what: str, labels: Sequence[str]
) -> None:
    _require(critic, answer.label in labels, f"label {what} {' or '.join(labels)}")
    _require(critic, bool(answer.reason), "say why, in one sentence")


def check_geometry(matcher: Any, views: Views, answer: Geometry) -> None:
    """Shapes, dtypes and finiteness of what a matcher found, real cameras, depths above 0."""
    require_type(matcher, answer, Geometry)
    dtype, views_of = views.images.dtype, list(views.images.shape[:2])
    sides = list(getattr(answer.depths, "shape", ()))[2:]
    grid = [*views_of, *(sides if len(sides) == 2 else ("height", "width"))]
    _require_tensor(matcher, "c2w", answer.c2w, [*views_of, 4, 4], dtype)
    _require_tensor(matcher, "depths", answer.depths, grid, dtype)
    _require_tensor(matcher, "confidence", answer.confidence, grid, dtype)
    _require_tensor(matcher, "registered", answer.registered, views_of, torch.bool)
    least = float(answer.depths.amin())
    _require(matcher, least > 0, f"return depths above 0, got {least:.4g}")
    low, high = least, float(answer.depths.amax())
    held = low >= REACH[0] and high <= REACH[1]
    promise = (
        f"return depths in a unit that keeps them from {REACH[0]:g} to {REACH[1]:g}"
    )
    _require(matcher, held, f"{promise}, got {low:.4g} to {high:.4g}")
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
    pair = isinstance(answer.fov_range, tuple) and len(answer.fov_range) == 2
    promise = f"return fov_range as two angles, or None, got {answer.fov_range!r}"
    _require(matcher, pair or answer.fov_range is None, promise)


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


def check_proposals(
    segmenter: Segmenter, image: Float[torch.Tensor, "3 height width"], answer: Any
) -> None:
    """Soft masks of the image's size and dtype, in [0, 1], and confidences."""
    several = isinstance(answer, Sequence) and not isinstance(answer, str)
    given = type(answer).__name__
    _require(segmenter, several, f"return a tuple of {where(Proposal)}, got {given}")
    size = list(image.shape[-2:])
    for one in answer:
        require_type(segmenter, one, Proposal)
        _require_tensor(segmenter, "soft_mask", one.soft_mask, size, image.dtype)
        _require_range(segmenter, "soft_mask", one.soft_mask)
        _require_share(segmenter, "confidence", one.confidence)


def check_detections(
    detector: Detector, image: Float[torch.Tensor, "3 height width"], answer: Any
) -> None:
    """Boxes on the image with their scores, the best first."""
    require_type(detector, answer, tuple)
    height, width = image.shape[-2:]
    for one in answer:
        require_type(detector, one, Detection)
        _require_share(detector, "score", one.score)
        numbers = len(one.box) == 4 and all(map(isfinite, one.box))
        x, y, across, down = one.box if numbers else (0.0,) * 4
        # half a pixel for rounding
        inside = min(x, y) >= -0.5 and x + across < width + 1 and y + down < height + 1
        promise = f"return boxes (x, y, width, height) in pixels of {width}x{height}"
        held = numbers and inside and across > 0 and down > 0
        _require(detector, held, f"{promise}, got {one.box}")
    scores = [one.score for one in answer]
    falling = scores == sorted(scores, reverse=True)
    _require(detector, falling, f"return the best first, got scores {scores}")


def check_masks(segmenter: Segmenter, answer: MaskLogits) -> None:
    """Finite logits `[n, h, w]` of at least one mask, and the quality of each `[n]` if told."""
    require_type(segmenter, answer, MaskLogits)
    told: dict[str, torch.Tensor] = {"logits": answer.logits}
    if answer.quality is not None:
        told["quality"] = answer.quality
    for name, one in told.items():
        require_type(segmenter, one, torch.Tensor)
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
    require_type(segmenter, answer, Tracks)
    views, _, *size = images.shape
    shape = [views, objects, *size]
    _require_tensor(segmenter, "logits", answer.logits, shape, images.dtype)
    shape = [views, objects]
    _require_tensor(segmenter, "present", answer.present, shape, torch.bool)


def check_reconstruction(
    recon: Reconstructor, views: Views, answer: Reconstruction
) -> None:
    """Batch, dtype, finiteness and ranges of the Gaussians, and the number of cameras."""
    require_type(recon, answer, Reconstruction)
    require_type(recon, answer.gaussians, Gaussians)
    check_gaussians(recon, answer.gaussians, views.images.shape[0], views.images.dtype)
    _require(recon, answer.gaussians.count > 0, "return Gaussians, got an empty scene")
    scenes, count = views.images.shape[:2]
    _require_of_views(recon, answer.gaussians, count)
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


def check_refinement(
    refiner: Refiner, given: Gaussians, inputs: RefineInputs, answer: Gaussians
) -> None:
    """Batch, dtype, finiteness and ranges of the refined Gaussians; some must be left."""
    require_type(refiner, answer, Gaussians)
    check_gaussians(refiner, answer, given.means.shape[0], given.means.dtype)
    left = answer.count > 0 or given.count == 0
    _require(refiner, left, f"leave some of {given.count} Gaussians, and left none")
    _require_of_views(refiner, answer, inputs.cameras.count)


def _require_of_views(component: Any, gaussians: Gaussians, count: int) -> None:
    """Each Gaussian is of one of `count` views, or of none."""
    if not gaussians.count:
        return
    low, high = map(int, gaussians.view_index.aminmax())
    promise = f"return view_index from -1 to {count - 1}, got {low} to {high}"
    _require(component, low >= -1 and high < count, promise)


def check_features(
    backbone: Backbone,
    images: Float[torch.Tensor, "batch view 3 height width"],
    answer: Features,
) -> None:
    """A level of tokens for each of its widths, on its grid of patches."""
    require_type(backbone, answer, Features)
    side = backbone.patch_size
    grid = tuple(length // side for length in images.shape[-2:])
    promise = f"return grid {grid} for patches of {side}, got {tuple(answer.grid)}"
    _require(backbone, tuple(answer.grid) == grid, promise)
    found = [tuple(level.shape) for level in answer.levels]
    first = (*images.shape[:2], grid[0] * grid[1])
    wanted = [(*first, width) for width in backbone.feature_widths]
    promise = f"return levels {wanted}, as feature_widths say, got {found}"
    _require(backbone, found == wanted, promise)


def check_head(
    head: GaussianHead,
    pixels: Float[torch.Tensor, "batch view *channels height width"],
    answer: Gaussians,
) -> None:
    """Its number of Gaussians of each pixel, each of a view; in range where nothing is learnt."""
    require_type(head, answer, Gaussians)
    views, height, width = pixels.shape[1], *pixels.shape[-2:]
    count = head.per_pixel * views * height * width
    promise = (
        f"return {count} Gaussians, {head.per_pixel} (per_pixel) of each pixel of "
        f"{views} views, got {answer.count}"
    )
    _require(head, answer.count == count or head.per_pixel == 0, promise)
    _require_of_views(head, answer, views)
    if torch.is_grad_enabled() or not answer.count:
        return
    # What is not finite may be the precision's fault, which the reconstructor tells.
    least = float(answer.scales.amin())
    _require(head, not least <= 0, f"return scales above 0, got {least:.4g}")
    low, high = map(float, answer.opacities.aminmax())
    promise = f"return opacities in [0, 1], got {low:.4g} to {high:.4g}"
    _require(head, not (low < 0 or high > 1), promise)


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
    require_type(rasterizer, answer, Rendering)
    given, views = answer.given, cameras.c2w.shape[:2]
    for name in rasterizer.gives:
        tensor: Any = given.pop(name, None)
        sizes = list(getattr(tensor, "shape", ()))
        channels = RENDERED.get(name, sizes[2] if len(sizes) == 5 else "channels")
        shape = [*views, channels, *cameras.image_size]
        _require_tensor(rasterizer, name, tensor, shape, gaussians.means.dtype)
    more = ", ".join(given)
    _require(rasterizer, not given, f"name in its `gives` what it gives: {more}")
    drawn = answer.given
    for name in {"alphas", "depths"} & drawn.keys():
        low, high = map(float, drawn[name].detach().aminmax())
        # rounding may lead above 1
        held = low >= 0 and (name == "depths" or high <= 1.001)
        allowed = "in [0, 1]" if name == "alphas" else "of at least 0"
        promise = f"return {name} {allowed}, got {low:.4g} to {high:.4g}"
        _require(rasterizer, held, promise)
    learns = torch.is_grad_enabled() and any(
        getattr(gaussians, name).requires_grad for name in PER_GAUSSIAN
    )
    if learns and ("alphas" not in drawn or bool(drawn["alphas"].any())):
        differentiable = any(tensor.requires_grad for tensor in drawn.values())
        promise = "render differentiably, and no gradient reaches the Gaussians"
        _require(rasterizer, differentiable, promise)


def check_sample(dataset: Dataset, answer: SceneSample) -> None:
    """Images in [0, 1] with masks, depths and cameras of their size, view 0 at the origin."""
    require_type(dataset, answer, SceneSample)
    size, dtype = list(answer.context.shape[-2:]), torch.float32
    context, target = len(answer.context), len(answer.target)
    told = (answer.context_masks, answer.target_masks)
    objects = next((len(masks) for masks in told if masks is not None), 0)
    for part, count in (("context", context), ("target", target)):
        for name in (part, f"edited_{part}"):
            if (images := getattr(answer, name)) is not None:
                _require_tensor(dataset, name, images, [count, 3, *size], dtype)
                if images.numel():
                    _require_range(dataset, name, images)
        if (masks := getattr(answer, f"{part}_masks")) is not None:
            name, shape = f"{part}_masks", [objects, count, *size]
            _require_tensor(dataset, name, masks, shape, dtype)
            if masks.numel():
                _require_range(dataset, name, masks)
        name, cameras = f"{part}_cameras", getattr(answer, f"{part}_cameras")
        require_type(dataset, cameras, Cameras)
        given = [*cameras.c2w.shape[:2], *cameras.image_size]
        expected = [1, count, *size]
        promise = f"return {name} [batch, view, height, width] {expected}, got {given}"
        _require(dataset, given == expected, promise)
        focal = cameras.intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2]
        longest = float(focal.max()) if focal.numel() else 1.0
        promise = f"normalise the focal lengths of {name}, by image width and height"
        held = 0 < longest <= LONGEST
        _require(dataset, held, f"{promise}, got {longest:.4g}")
    if (depths := answer.context_depths) is not None:
        _require_tensor(dataset, "context_depths", depths, [context, *size], dtype)
    first = answer.context_cameras.c2w[0, 0]
    is_own = torch.allclose(first, torch.eye(4).to(first), atol=1e-3)
    _require(dataset, is_own, "return cameras in the frame of context view 0")


def check_loss(loss: Loss, inputs: LossInputs, answer: Any) -> None:
    """One number, with gradients where something is learnt."""
    require_type(loss, answer, torch.Tensor)
    promise = f"return one number, of shape [], got {list(answer.shape)}"
    _require(loss, answer.ndim == 0, promise)
    made = [getattr(inputs.gaussians, name, None) for name in PER_GAUSSIAN]
    learns = [one for one in (inputs.rendered, *made) if one is not None]
    if torch.is_grad_enabled() and any(one.requires_grad for one in learns):
        promise = "carry gradients; compute it from inputs.rendered or .gaussians"
        _require(loss, answer.requires_grad, promise)


def check_trained(trainer: Trainer, job: TrainingJob, answer: Any) -> None:
    """A folder with something in it, inside that of the job."""
    require_type(trainer, answer, Path)
    inside = answer.resolve().is_relative_to(job.out.resolve())
    held = inside and answer.is_dir() and any(answer.iterdir())
    promise = "return the folder of a checkpoint in job.out"
    _require(trainer, held, f"{promise}, got {answer.name}")


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


def require_type(component: Any, answer: Any, expected: type) -> None:
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


def _require_share(component: Any, name: str, value: Any) -> None:
    held = isinstance(value, Real) and 0 <= float(value) <= 1  # NaN is in no range
    _require(component, held, f"return {name} in [0, 1], got {value!r}")


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
