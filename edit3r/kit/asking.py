"""How components are asked: each call with its checks, so that a fault is named where it was made.

Runs ask through these functions, and so do the contract tests, which thereby say the same sentence.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

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
    Tracks,
    Trainer,
    TrainingJob,
    Writer,
)
from edit3r.contract.types import (
    Cameras,
    EditRequest,
    Features,
    Gaussians,
    Reconstruction,
    Rendering,
    Views,
)
from edit3r.contract.verdicts import EditVerdict, Verdict
from edit3r.kit import checks
from edit3r.kit.checks import errors_named_after

Image = Float[Tensor, "3 height width"]


# ---- what is asked for ----


def read(reader: Reader, prompt: str) -> tuple[Instruction, ...]:
    with errors_named_after(reader):
        instructions = reader.read(prompt)
    checks.check_instructions(reader, instructions)
    return instructions


def read_target(reader: Reader, words: str) -> Target:
    with errors_named_after(reader):
        target = reader.read_target(words)
    checks.require_type(reader, target, Target)
    return target


def hint(reader: Reader, instruction: Instruction) -> str:
    with errors_named_after(reader):
        told = reader.hint(instruction)
    checks.require_type(reader, told, str)
    return told


def after_undo(reader: Reader, prompt: str) -> str | None:
    with errors_named_after(reader):
        rest = reader.after_undo(prompt)
    if rest is not None:
        checks.require_type(reader, rest, str)
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


def widened(
    editor: Editor,
    regions: Float[Tensor, "instruction batch view height width"],
    images: Float[Tensor, "batch view 3 height width"],
) -> Float[Tensor, "instruction batch view height width"]:
    with errors_named_after(editor, regions, images):
        wide = editor.widened(regions, images)
    checks.check_maps(editor, "widened regions", wide, regions)
    return wide


def edit(editor: Editor, views: Views, request: EditRequest) -> Views:
    with errors_named_after(editor, views.images):
        answer = editor.edit(views, request)
    checks.check_edit(editor, views, answer)
    return answer


# ---- finding things ----


def masks(
    segmenter: Segmenter,
    image: Image,
    clicks: Sequence[Click],
    box: Box | None = None,
    before: Float[Tensor, "h w"] | None = None,
) -> MaskLogits:
    with errors_named_after(segmenter, image):
        answer = segmenter.masks(image, clicks, box, before)
    checks.check_masks(segmenter, answer)
    return answer


def words(segmenter: Segmenter, image: Image, text: str) -> tuple[Proposal, ...] | None:
    with errors_named_after(segmenter, image):
        answer = segmenter.words(image, text)
    if answer is None:
        return None
    checks.check_proposals(segmenter, image, answer)
    return tuple(answer)


def track(
    segmenter: Segmenter,
    images: Float[Tensor, "view 3 height width"],
    given: Float[Tensor, "object height width"],
) -> Tracks | None:
    with errors_named_after(segmenter, images, given):
        answer = segmenter.track(images, given)
    if answer is not None:
        checks.check_tracks(segmenter, answer, images, len(given))
    return answer


def detect(detector: Detector, image: Image, text: str) -> tuple[Detection, ...]:
    with errors_named_after(detector, image):
        found = detector.detect(image, text)
    checks.check_detections(detector, image, found)
    return found


def select(
    selector: Selector, views: Views, selection: Selection, geometry: Geometry | None
) -> Selected:
    with errors_named_after(selector, views.images):
        found = selector.select(views, selection, geometry)
    checks.check_selected(selector, views, found)
    return found


# ---- the scene ----


def find_geometry(
    source: Matcher | FindsGeometry, views: Views, corrected: Views | None = None
) -> Geometry:
    """Of `views`; `corrected` are the same in one exposure, for a matcher that can use them.

    Raises MatchingError for photos that cannot be placed.
    """
    with errors_named_after(source, views.images):
        if isinstance(source, FindsGeometry):
            geometry = source.find_geometry(views)
        elif corrected is not None and isinstance(source, MatchesCorrected):
            geometry = source.match_corrected(views, corrected)
        else:
            geometry = source.match(views)
    checks.check_geometry(source, views, geometry)
    return geometry


def reconstruct(
    recon: Reconstructor, views: Views, compute: Callable[[], Reconstruction]
) -> Reconstruction:
    """What `compute` makes of `views` by the reconstructor."""
    with errors_named_after(recon, views.images):
        answer = compute()
    checks.check_reconstruction(recon, views, answer)
    return answer


def features(
    backbone: Backbone,
    images: Float[Tensor, "batch view 3 height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    geometry: Geometry | None = None,
) -> Features:
    with errors_named_after(backbone):
        found = backbone(images, intrinsics, geometry)
    checks.check_features(backbone, images, found)
    return found


def gaussians(
    head: GaussianHead,
    found: Features,
    images: Float[Tensor, "batch view 3 height width"],
    source: Views,
    geometry: Geometry | None,
) -> Gaussians:
    with errors_named_after(head):
        made = head(found, images, source, geometry)
    pixels = images if geometry is None else geometry.depths
    checks.check_head(head, pixels, made)
    return made


def refine(refiner: Refiner, before: Gaussians, inputs: RefineInputs) -> Gaussians:
    with errors_named_after(refiner):
        answer = refiner(before, inputs)
    checks.check_refinement(refiner, before, inputs, answer)
    return answer


def render(rasterizer: Rasterizer, scene: Gaussians, cameras: Cameras) -> Rendering:
    with errors_named_after(rasterizer):
        rendering = rasterizer.render(scene, cameras)
    checks.check_rendering(rasterizer, scene, cameras, rendering)
    return rendering


# ---- the end ----


def judge_edit(critic: Critic, asked: EditToJudge) -> EditVerdict:
    with errors_named_after(critic):
        verdict = critic.judge_edit(asked)
    checks.check_edit_verdict(critic, verdict)
    return verdict


def judge_scene(critic: Critic, scene: SceneToJudge) -> Verdict:
    with errors_named_after(critic):
        verdict = critic.judge_scene(scene)
    checks.check_verdict(critic, scene, verdict)
    return verdict


def write(writer: Writer, path: Path, scene: SceneToWrite) -> None:
    """Raises InputError for a scene that lacks what the writer needs."""
    checks.check_needs(writer, scene)
    with errors_named_after(writer):
        writer.write(path, scene)
    checks.check_written(writer, path)


# ---- training ----


def sample(dataset: Dataset, get: Callable[[], SceneSample]) -> SceneSample:
    """What `get` takes of the dataset."""
    with errors_named_after(dataset):
        taken = get()
    checks.check_sample(dataset, taken)
    return taken


def loss(asked: Loss, inputs: LossInputs) -> Float[Tensor, ""]:
    with errors_named_after(asked):
        value = asked(inputs)
    checks.check_loss(asked, inputs, value)
    return value


def train(trainer: Trainer, job: TrainingJob) -> Path:
    """The folder of the best checkpoint."""
    with errors_named_after(trainer):
        best = trainer.train(job)
    checks.check_trained(trainer, job, best)
    return best
