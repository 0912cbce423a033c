"""How components are asked: each call with what the core holds the answer to, so that a fault is
named where it was made.

Runs ask through these functions, and so do the contract tests, which thereby say the same sentence.
A component that raises, or returns another size, dtype or range than its interface promises, ends
the run with one sentence that names it.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any, get_args

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.component import component_name
from edit3r.contract.errors import InputError
from edit3r.contract.instructions import Instruction, Target
from edit3r.contract.interfaces import (
    Backbone,
    Box,
    Click,
    Critic,
    Dataset,
    Detection,
    Detector,
    Editor,
    EditToJudge,
    FindsGeometry,
    GaussianHead,
    Geometry,
    HidesThings,
    Loss,
    LossInputs,
    MaskLogits,
    Matcher,
    MatchesCorrected,
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
    Selection,
    Selector,
    StartsFromImages,
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
    EditRequest,
    Features,
    Gaussians,
    Reconstruction,
    Rendering,
    Views,
)
from edit3r.contract.verdicts import LABELS, EditLabel, EditVerdict, Verdict
from edit3r.kit.checks import (
    errors_named_after,
    require,
    require_gaussians,
    require_range,
    require_share,
    require_shares,
    require_tensor,
    require_type,
    where,
)

FARTHEST = 1e6  # depths that a camera may stand from the first
REACH = 1e-6, 1e6
"""Between which depths lie: float32 has seven digits, and squares of these. A sanity limit."""
LONGEST = 20  # focal length [image widths]; a sanity limit: pixels are hundreds
SHARES = ("coverage", "filled", "guessed_between", "unlike_between")

Image = Float[Tensor, "3 height width"]
Images = Float[Tensor, "batch view 3 height width"]
Regions = Float[Tensor, "instruction batch view height width"]


# ---- what is asked for ----


def read(reader: Reader, prompt: str) -> tuple[Instruction, ...]:
    """At least one, each of which says what shall happen to what."""
    with errors_named_after(reader):
        found = reader.read(prompt)
    require_type(reader, found, tuple)
    require(reader, len(found) > 0, "return an instruction, or raise PromptError")
    for one in found:
        require_type(reader, one, Instruction)
        fault = one.fault()
        promise = f"return instructions that hold together; one {fault}: {one!r}"
        require(reader, not fault, promise)
    return found


def read_target(reader: Reader, words: str) -> Target:
    with errors_named_after(reader):
        target = reader.read_target(words)
    require_type(reader, target, Target)
    return target


def hint(reader: Reader, instruction: Instruction) -> str:
    with errors_named_after(reader):
        told = reader.hint(instruction)
    require_type(reader, told, str)
    return told


def after_undo(reader: Reader, prompt: str) -> str | None:
    with errors_named_after(reader):
        rest = reader.after_undo(prompt)
    if rest is not None:
        require_type(reader, rest, str)
    return rest


# ---- editing ----


def understands(editor: Editor, instruction: Instruction) -> bool:
    with errors_named_after(editor):
        return bool(editor.understands(instruction))


def hides(editor: Editor, instruction: Instruction) -> bool:
    if not isinstance(editor, HidesThings):
        return False
    with errors_named_after(editor):
        return bool(editor.hides(instruction))


def widened(editor: Editor, regions: Regions, images: Images) -> Regions:
    with errors_named_after(editor, regions, images):
        wide = editor.widened(regions, images)
    require_shares(editor, "widened regions", wide, regions.shape, regions.dtype)
    return wide


def edit(editor: Editor, views: Views, request: EditRequest) -> Views:
    with errors_named_after(editor, views.images):
        answer = editor.edit(views, request)
    return _edited(editor, views, answer)


def edit_from(
    editor: StartsFromImages,
    views: Views,
    start: Images,
    request: EditRequest,
    strength: float,
) -> Views:
    with errors_named_after(editor):
        answer = editor.edit_from(views, start, request, strength)
    return _edited(editor, views, answer)


def _edited(editor: Any, views: Views, answer: Views) -> Views:
    """Views in the number, size, dtype and range of those given."""
    require_type(editor, answer, Views)
    given = views.images
    require_shares(editor, "images", answer.images, given.shape, given.dtype)
    return answer


# ---- finding things ----


def masks(
    segmenter: Segmenter,
    image: Image,
    clicks: Sequence[Click],
    box: Box | None = None,
    before: Float[Tensor, "h w"] | None = None,
) -> MaskLogits:
    """Finite logits `[n, h, w]` of at least one mask, and the quality of each `[n]` if told."""
    with errors_named_after(segmenter, image):
        answer = segmenter.masks(image, clicks, box, before)
    require_type(segmenter, answer, MaskLogits)
    told: dict[str, Tensor] = {"logits": answer.logits}
    if answer.quality is not None:
        told["quality"] = answer.quality
    for name, one in told.items():
        require_type(segmenter, one, Tensor)
        require(segmenter, bool(one.isfinite().all()), f"return finite {name}")
    shapes = [list(one.shape) for one in told.values()]
    held = len(shapes[0]) == 3 and all(shapes[0]) and shapes[-1][:1] == shapes[0][:1]
    held &= all(len(shape) == 1 for shape in shapes[1:])
    promise = "return logits [n, h, w] and their quality [n]"
    require(segmenter, held, f"{promise}, got shapes {shapes}")
    return answer


def words(segmenter: Segmenter, image: Image, text: str) -> tuple[Proposal, ...] | None:
    """Soft masks of the image's size and dtype, in [0, 1], and confidences."""
    with errors_named_after(segmenter, image):
        answer = segmenter.words(image, text)
    if answer is None:
        return None
    several = isinstance(answer, Sequence) and not isinstance(answer, str)
    given = type(answer).__name__
    require(segmenter, several, f"return a tuple of {where(Proposal)}, got {given}")
    for one in answer:
        require_type(segmenter, one, Proposal)
        size = image.shape[-2:]
        require_shares(segmenter, "soft_mask", one.soft_mask, size, image.dtype)
        require_share(segmenter, "confidence", one.confidence)
    return tuple(answer)


def track(
    segmenter: Segmenter,
    images: Float[Tensor, "view 3 height width"],
    given: Float[Tensor, "object height width"],
) -> Tracks | None:
    """Logits of each object on each image, and where it was seen."""
    with errors_named_after(segmenter, images, given):
        answer = segmenter.track(images, given)
    if answer is None:
        return None
    require_type(segmenter, answer, Tracks)
    seen, size = (len(images), len(given)), images.shape[-2:]
    require_tensor(segmenter, "logits", answer.logits, (*seen, *size), images.dtype)
    require_tensor(segmenter, "present", answer.present, seen, torch.bool)
    return answer


def detect(detector: Detector, image: Image, text: str) -> tuple[Detection, ...]:
    """Boxes on the image with their scores, the best first."""
    with errors_named_after(detector, image):
        found = detector.detect(image, text)
    require_type(detector, found, tuple)
    height, width = image.shape[-2:]
    for one in found:
        require_type(detector, one, Detection)
        require_share(detector, "score", one.score)
        numbers = len(one.box) == 4 and all(map(isfinite, one.box))
        x, y, across, down = one.box if numbers else (0.0,) * 4
        # half a pixel for rounding
        inside = min(x, y) >= -0.5 and x + across < width + 1 and y + down < height + 1
        promise = f"return boxes (x, y, width, height) in pixels of {width}x{height}"
        held = numbers and inside and across > 0 and down > 0
        require(detector, held, f"{promise}, got {one.box}")
    scores = [one.score for one in found]
    falling = scores == sorted(scores, reverse=True)
    require(detector, falling, f"return the best first, got scores {scores}")
    return found


def select(
    selector: Selector, views: Views, selection: Selection, geometry: Geometry | None
) -> Selected:
    """A soft mask for each view, and how each was found."""
    with errors_named_after(selector, views.images):
        found = selector.select(views, selection, geometry)
    require_type(selector, found, Selected)
    size, dtype = (views.count, 1, *views.image_size), views.images.dtype
    require_shares(selector, "masks", found.masks, size, dtype)
    known = (*WAYS, "not found")
    told = len(found.how) == views.count and {*found.how} <= {*known}
    ways = f"{views.count} words of {', '.join(known)}"
    promise = f"say how it was found on each view, {ways}, got {found.how}"
    require(selector, told, promise)
    if found.confidence is not None:
        require_share(selector, "confidence", found.confidence)
    for one in found.candidates:
        promise = f"return candidates on views 0 to {views.count - 1}, got {one.view}"
        require(selector, 0 <= one.view < views.count, promise)
        require_share(selector, "a candidate's score", one.score)
    return found


# ---- geometry ----


def find_geometry(
    source: Matcher | FindsGeometry, views: Views, corrected: Views | None = None
) -> Geometry:
    """Of `views`; `corrected` are the same in one exposure, for a matcher that can use them.

    Raises MatchingError for photos that cannot be placed.
    """
    with errors_named_after(source, views.images):
        if isinstance(source, FindsGeometry):
            found = source.find_geometry(views)
        elif corrected is not None and isinstance(source, MatchesCorrected):
            found = source.match_corrected(views, corrected)
        else:
            found = source.match(views)
    require_type(source, found, Geometry)
    dtype, views_of = views.images.dtype, views.images.shape[:2]
    sides = list(getattr(found.depths, "shape", ()))[2:]
    grid = (*views_of, *(sides if len(sides) == 2 else ("height", "width")))
    require_tensor(source, "c2w", found.c2w, (*views_of, 4, 4), dtype)
    require_tensor(source, "depths", found.depths, grid, dtype)
    require_shares(source, "confidence", found.confidence, grid, dtype)
    require_tensor(source, "registered", found.registered, views_of, torch.bool)
    _require_reach(source, found)
    _require_places(source, found)
    if found.intrinsics is not None:
        shape = (*views_of, 3, 3)
        require_tensor(source, "intrinsics", found.intrinsics, shape, dtype)
        focal = found.intrinsics.diagonal(dim1=-2, dim2=-1)
        promise = f"return focal lengths above 0, got {float(focal.amin()):.4g}"
        require(source, bool((focal > 0).all()), promise)
    pair = isinstance(found.fov_range, tuple) and len(found.fov_range) == 2
    promise = f"return fov_range as two angles, or None, got {found.fov_range!r}"
    require(source, pair or found.fov_range is None, promise)
    return found


def _require_reach(source: Any, found: Geometry) -> None:
    """Depths above 0, in a unit that float32 holds."""
    low, high = map(float, found.depths.aminmax())
    require(source, low > 0, f"return depths above 0, got {low:.4g}")
    reach = f"{REACH[0]:g} to {REACH[1]:g}"
    promise = f"return depths in a unit that keeps them from {reach}"
    held = low >= REACH[0] and high <= REACH[1]
    require(source, held, f"{promise}, got {low:.4g} to {high:.4g}")


def _require_places(source: Any, found: Geometry) -> None:
    """View 0 at the origin, and another one where depths reach, as cameras stand."""
    placed = found.registered
    joined = placed[:, 0] & (placed.sum(1) >= 2)
    promise = "place view 0 and another one, or raise MatchingError"
    require(source, bool(joined.all()), promise)
    _require_poses(source, found.c2w, placed)
    first = found.c2w[:, 0].double()
    is_own = torch.allclose(first, torch.eye(4).to(first).expand_as(first), atol=1e-3)
    require(source, is_own, "return c2w in the frame of view 0, its own the identity")
    away = float(found.c2w[placed][:, :3, 3].abs().amax())
    promise = f"place its cameras where depths reach; one is {away:.3g} away"
    require(source, away < float(found.depths.median()) * FARTHEST, promise)


def _require_poses(
    component: Any,
    c2w: Float[Tensor, "batch view 4 4"],
    placed: Bool[Tensor, "batch view"],
) -> None:
    """Cameras turn and move: they neither mirror nor scale."""
    poses = c2w[placed].double()
    turns = poses[:, :3, :3]
    off = (turns @ turns.mT - torch.eye(3).to(turns)).abs().amax()
    promise = "return c2w whose first three columns are a rotation"
    require(component, float(off) < 0.05, f"{promise}; one scales or is singular")
    require(component, bool((turns.det() > 0).all()), f"{promise}; one mirrors")
    last = poses.new_tensor([0, 0, 0, 1])
    is_last = torch.allclose(poses[:, 3], last, atol=1e-4)
    require(component, is_last, "return c2w whose last row is 0, 0, 0, 1")


# ---- the scene ----


def reconstruct(
    recon: Reconstructor, views: Views, compute: Callable[[], Reconstruction]
) -> Reconstruction:
    """What `compute` makes of `views` by the reconstructor."""
    with errors_named_after(recon, views.images):
        answer = compute()
    require_type(recon, answer, Reconstruction)
    require_type(recon, answer.gaussians, Gaussians)
    scenes, count = views.images.shape[:2]
    require_gaussians(recon, answer.gaussians, scenes, views.images.dtype)
    require(recon, answer.gaussians.count > 0, "return Gaussians, got an empty scene")
    _require_of_views(recon, answer.gaussians, count)
    for name, channels in (("placed", []), ("measured", []), ("fusion", [3])):
        tensor, expected = getattr(answer, name), [scenes, count, *channels]
        given = expected if tensor is None else list(tensor.shape[: len(expected)])
        promise = f"return {name} for each of its views, {expected}, got {given}"
        require(recon, given == expected, promise)
    placed = answer.placed
    if placed is None:
        placed = torch.ones(scenes, count, dtype=torch.bool)
    require(recon, bool(placed.any(1).all()), "place a view, or raise MatchingError")
    if answer.cameras is not None:
        expected, given = [scenes, count], list(answer.cameras.c2w.shape[:2])
        promise = f"return one camera per view, {expected}, got {given}"
        require(recon, given == expected, promise)
        _require_poses(recon, answer.cameras.c2w, placed.to(answer.cameras.c2w.device))
    return answer


def features(
    backbone: Backbone,
    images: Images,
    intrinsics: Float[Tensor, "batch view 3 3"],
    geometry: Geometry | None = None,
) -> Features:
    """A level of tokens for each of its widths, on its grid of patches."""
    with errors_named_after(backbone):
        answer = backbone(images, intrinsics, geometry)
    require_type(backbone, answer, Features)
    side = backbone.patch_size
    grid = tuple(length // side for length in images.shape[-2:])
    promise = f"return grid {grid} for patches of {side}, got {tuple(answer.grid)}"
    require(backbone, tuple(answer.grid) == grid, promise)
    found = [tuple(level.shape) for level in answer.levels]
    first = (*images.shape[:2], grid[0] * grid[1])
    wanted = [(*first, width) for width in backbone.feature_widths]
    promise = f"return levels {wanted}, as feature_widths say, got {found}"
    require(backbone, found == wanted, promise)
    return answer


def gaussians(
    head: GaussianHead,
    found: Features,
    images: Images,
    source: Views,
    geometry: Geometry | None,
) -> Gaussians:
    """Its number of Gaussians of each pixel, each of a view; in range where nothing is learnt."""
    with errors_named_after(head):
        made = head(found, images, source, geometry)
    require_type(head, made, Gaussians)
    pixels = images if geometry is None else geometry.depths
    views, height, width = pixels.shape[1], *pixels.shape[-2:]
    count = head.per_pixel * views * height * width
    promise = (
        f"return {count} Gaussians, {head.per_pixel} (per_pixel) of each pixel of "
        f"{views} views, got {made.count}"
    )
    require(head, made.count == count or head.per_pixel == 0, promise)
    _require_of_views(head, made, views)
    if not torch.is_grad_enabled() and made.count:
        # What is not finite may be the precision's fault, which the reconstructor tells.
        least = float(made.scales.amin())
        require(head, not least <= 0, f"return scales above 0, got {least:.4g}")
        low, high = map(float, made.opacities.aminmax())
        promise = f"return opacities in [0, 1], got {low:.4g} to {high:.4g}"
        require(head, not (low < 0 or high > 1), promise)
    return made


def refine(refiner: Refiner, before: Gaussians, inputs: RefineInputs) -> Gaussians:
    """Gaussians of the same scenes; some must be left."""
    with errors_named_after(refiner):
        answer = refiner(before, inputs)
    require_type(refiner, answer, Gaussians)
    require_gaussians(refiner, answer, before.means.shape[0], before.means.dtype)
    left = answer.count > 0 or before.count == 0
    require(refiner, left, f"leave some of {before.count} Gaussians, and left none")
    _require_of_views(refiner, answer, inputs.cameras.count)
    return answer


def _require_of_views(component: Any, made: Gaussians, count: int) -> None:
    """Each Gaussian is of one of `count` views, or of none."""
    if made.count:
        low, high = map(int, made.view_index.aminmax())
        promise = f"return view_index from -1 to {count - 1}, got {low} to {high}"
        require(component, low >= -1 and high < count, promise)


def render(rasterizer: Rasterizer, scene: Gaussians, cameras: Cameras) -> Rendering:
    """What the rasterizer `gives`, and nothing else."""
    with errors_named_after(rasterizer):
        answer = rasterizer.render(scene, cameras)
    require_type(rasterizer, answer, Rendering)
    drawn, views = answer.given, cameras.c2w.shape[:2]
    for name in rasterizer.gives:
        sizes: tuple[int, ...] = getattr(drawn.get(name), "shape", ())
        channels = RENDERED.get(name, sizes[2] if len(sizes) == 5 else "channels")
        shape = (*views, channels, *cameras.image_size)
        require_tensor(rasterizer, name, drawn.get(name), shape, scene.means.dtype)
    more = [name for name in drawn if name not in rasterizer.gives]
    promise = f"name in its `gives` what it gives: {', '.join(more)}"
    require(rasterizer, not more, promise)
    for name in {"alphas", "depths"} & drawn.keys():
        low, high = map(float, drawn[name].detach().aminmax())
        # rounding may lead above 1
        held = low >= 0 and (name == "depths" or high <= 1.001)
        allowed = "in [0, 1]" if name == "alphas" else "of at least 0"
        promise = f"return {name} {allowed}, got {low:.4g} to {high:.4g}"
        require(rasterizer, held, promise)
    given = [getattr(scene, name) for name in PER_GAUSSIAN]
    is_seen = "alphas" not in drawn or bool(drawn["alphas"].any())
    if _learns(given) and is_seen:
        promise = "render differentiably, and no gradient reaches the Gaussians"
        require(rasterizer, _learns(drawn.values()), promise)
    return answer


def _learns(tensors: Any) -> bool:
    return torch.is_grad_enabled() and any(
        one is not None and one.requires_grad for one in tensors
    )


# ---- the end ----


def judge_edit(critic: Critic, asked: EditToJudge) -> EditVerdict:
    """A known label, a sentence, and figures that a file can hold."""
    with errors_named_after(critic):
        verdict = critic.judge_edit(asked)
    require_type(critic, verdict, EditVerdict)
    _require_reasoned(critic, verdict, "an edit", get_args(EditLabel))
    require_type(critic, verdict.measures, dict)
    try:
        json.dumps(verdict.measures, allow_nan=False)
    except (TypeError, ValueError) as error:
        require(critic, False, f"return measures that go into run.json: {error}")
    return verdict


def judge_scene(critic: Critic, scene: SceneToJudge) -> Verdict:
    """A known label, a sentence, and for each photo a finite figure, or None."""
    with errors_named_after(critic):
        verdict = critic.judge_scene(scene)
    require_type(critic, verdict, Verdict)
    _require_reasoned(critic, verdict, "a scene", LABELS)
    there = scene.placed
    promise = f"hand on `placed` of the scene, {there}, got {verdict.placed}"
    require(critic, verdict.placed == there, promise)
    for name, values in asdict(verdict).items():
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
        require(critic, held, f"{promise}, None where nothing is known, got {values}")
    return verdict


def _require_reasoned(
    critic: Critic, answer: EditVerdict | Verdict, what: str, labels: Sequence[str]
) -> None:
    require(critic, answer.label in labels, f"label {what} {' or '.join(labels)}")
    require(critic, bool(answer.reason), "say why, in one sentence")


def write(writer: Writer, path: Path, scene: SceneToWrite) -> None:
    """The file or folder of its suffix. Raises InputError for a scene that lacks what it needs."""
    lacking = [name for name in writer.needs if getattr(scene, name) in (None, "", ())]
    if lacking:
        raise InputError(
            f"{component_name(writer)} needs {' and '.join(lacking)}, which this scene does not "
            "have; give the folder of a run."
        )
    with errors_named_after(writer):
        writer.write(path, scene)
    if writer.offer.component.makes_folder:
        is_there = path.is_dir() and any(path.iterdir())
        promise = "make the folder that it is given, since its suffix has no dot"
    else:
        is_there = path.is_file()
        promise = "write the file that it is given, since its suffix has a dot"
    require(writer, is_there, f"{promise}: {path.name}")


# ---- training ----


def sample(dataset: Dataset, get: Callable[[], SceneSample]) -> SceneSample:
    """What `get` takes of the dataset: images, masks, depths and cameras of one size."""
    with errors_named_after(dataset):
        taken = get()
    require_type(dataset, taken, SceneSample)
    size, dtype = taken.context.shape[-2:], torch.float32
    told = (taken.context_masks, taken.target_masks)
    objects = next((len(masks) for masks in told if masks is not None), 0)
    for part in ("context", "target"):
        count = len(getattr(taken, part))
        maps = {
            part: (count, 3, *size),
            f"edited_{part}": (count, 3, *size),
            f"{part}_masks": (objects, count, *size),
        }
        for name, shape in maps.items():
            values = getattr(taken, name)
            if values is not None:
                require_tensor(dataset, name, values, shape, dtype)
                if values.numel():
                    require_range(dataset, name, values)
        _require_cameras(dataset, f"{part}_cameras", taken, [1, count, *size])
    if (depths := taken.context_depths) is not None:
        shape = (len(taken.context), *size)
        require_tensor(dataset, "context_depths", depths, shape, dtype)
    first = taken.context_cameras.c2w[0, 0]
    is_own = torch.allclose(first, torch.eye(4).to(first), atol=1e-3)
    require(dataset, is_own, "return cameras in the frame of context view 0")
    return taken


def _require_cameras(
    dataset: Dataset, name: str, taken: SceneSample, expected: list[int]
) -> None:
    cameras = getattr(taken, name)
    require_type(dataset, cameras, Cameras)
    given = [*cameras.c2w.shape[:2], *cameras.image_size]
    promise = f"return {name} [batch, view, height, width] {expected}, got {given}"
    require(dataset, given == expected, promise)
    focal = cameras.intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2]
    longest = float(focal.max()) if focal.numel() else 1.0
    promise = f"normalise the focal lengths of {name}, by image width and height"
    require(dataset, 0 < longest <= LONGEST, f"{promise}, got {longest:.4g}")


def loss(asked: Loss, inputs: LossInputs) -> Float[Tensor, ""]:
    """One number, with gradients where something is learnt."""
    with errors_named_after(asked):
        value = asked(inputs)
    require_type(asked, value, Tensor)
    promise = f"return one number, of shape [], got {list(value.shape)}"
    require(asked, value.ndim == 0, promise)
    made = [getattr(inputs.gaussians, name, None) for name in PER_GAUSSIAN]
    if _learns([inputs.rendered, *made]):
        promise = "carry gradients; compute it from inputs.rendered or .gaussians"
        require(asked, value.requires_grad, promise)
    return value


def train(trainer: Trainer, job: TrainingJob) -> Path:
    """The folder of the best checkpoint, inside that of the job."""
    with errors_named_after(trainer):
        best = trainer.train(job)
    require_type(trainer, best, Path)
    inside = best.resolve().is_relative_to(job.out.resolve())
    held = inside and best.is_dir() and any(best.iterdir())
    promise = "return the folder of a checkpoint in job.out"
    require(trainer, held, f"{promise}, got {best.name}")
    return best
