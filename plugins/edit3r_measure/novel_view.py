"""What a reconstructor makes of scenes whose truth is known: novel views, poses, and edits carried
over.

Two photos go in without their poses. The target is rendered at its true relative pose, in the unit
of length that makes the predicted baseline the true one.
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from edit3r.contract.errors import MatchingError, PluginError
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Reconstruction, Views
from edit3r.kit.compute.changes import change_error, change_uptake
from edit3r.kit.compute.lpips import lpips_distance, lpips_weights
from edit3r.kit.compute.metrics import Image, Region, psnr, ssim
from edit3r.kit.photos.posed_folder import PosedPhoto
from edit3r.kit.photos.triples import Pose, rotation_degrees
from edit3r.kit.reconstructing import WithMatcher
from edit3r_measure.scene_sources import EvaluationScene

# The numbers of this block: no figures kept.
# Standard deviations tried for the best-blurred copy [pixels]
BLURS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
COVERED = 0.5  # alpha above which a pixel of a rendering counts as covered
CHANGED = 2 / 255  # mean change of colour above which a pixel belongs to a true edit

Measure = Callable[[EvaluationScene], Mapping[str, float]]


@dataclass(frozen=True)
class SceneScore:
    """What was measured on one scene."""

    kind: str  # "novel view", "edit" or "protocol"
    scene: str  # folder or data set
    first: str
    second: str
    target: str
    degrees: float  # angle between the input cameras
    overlap: str = ""  # class of the inputs' overlap, where an index file tells it
    failure: str = ""  # why nothing could be measured; "" when it could
    # as the measuring function names them; none after a failure
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RenderedView:
    """A rendering and where the scene covers it."""

    image: Float[np.ndarray, "height width 3"]  # sRGB in [0, 1]
    covered: Region


def views_of(photos: Sequence[PosedPhoto]) -> Views:
    """Return one scene (batch 1) of photos that share a size, without their poses."""
    images = torch.from_numpy(np.stack([photo.image for photo in photos]))
    intrinsics = torch.from_numpy(np.stack([photo.intrinsics for photo in photos]))
    channels_first = images.permute(0, 3, 1, 2).contiguous()
    return Views(channels_first[None], intrinsics.float()[None])


def relative_pose(photo: PosedPhoto, first: PosedPhoto) -> Pose:
    """Return the camera-to-world matrix of `photo` in the frame of `first`."""
    return np.linalg.inv(first.c2w) @ photo.c2w


@dataclass(frozen=True)
class PredictedScene:
    """What was made of photos, to be seen from true places in its own unit of length."""

    reconstruction: Reconstruction
    rasterizer: Rasterizer
    # the first is the reference, the last the farthest from it
    inputs: Sequence[PosedPhoto]

    @property
    def cameras(self) -> Cameras:
        """The predicted cameras of the inputs."""
        if self.reconstruction.cameras is None:
            raise PluginError(
                "evaluation needs a reconstructor that predicts its photos' cameras; this one "
                "does not."
            )
        return self.reconstruction.cameras

    @property
    def predicted_pose(self) -> Pose:
        """Of the last input in the frame of the first."""
        return self.cameras.c2w[0, -1].double().cpu().numpy()

    @property
    def true_pose(self) -> Pose:
        """Of the last input in the frame of the first."""
        return relative_pose(self.inputs[-1], self.inputs[0])

    def camera_of(self, photo: PosedPhoto) -> Cameras:
        """True camera of a photo, in the unit in which the inputs' distance is the true one."""
        pose = relative_pose(photo, self.inputs[0])
        predicted = np.linalg.norm(self.predicted_pose[:3, 3])
        pose[:3, 3] *= predicted / np.linalg.norm(self.true_pose[:3, 3])
        like = self.reconstruction.gaussians.means
        return Cameras(
            torch.from_numpy(pose).to(like)[None, None],
            torch.from_numpy(photo.intrinsics).to(like)[None, None],
            photo.image.shape[:2],
        )

    @torch.no_grad()
    def show(self, camera: Cameras, view: int | None = None) -> RenderedView:
        """Render all Gaussians, or those of one view, for one camera."""
        gaussians = self.reconstruction.gaussians
        if view is not None:
            gaussians = gaussians.from_view(view)
        rendering = self.rasterizer.render(gaussians, camera)
        image = rendering.images[0, 0].permute(1, 2, 0).clamp(0, 1)
        return RenderedView(
            image.cpu().numpy().astype(np.float32),
            rendering.alphas[0, 0, 0].cpu().numpy() > COVERED,
        )


def score_scene(scene: EvaluationScene, kind: str, measure: Measure) -> SceneScore:
    """Score a scene with the function that gives the figures of this kind."""
    count = len(scene.inputs)
    first, last = scene.inputs[0], scene.inputs[-1]
    failure = ""
    figures: Mapping[str, float] = {}
    try:
        figures = measure(scene)
    except MatchingError as error:
        failure = str(error)
    return SceneScore(
        kind=kind,
        scene=scene.source,
        first=scene.files[0],
        second=scene.files[count - 1],
        target=" ".join(scene.files[count:]),
        degrees=rotation_degrees(first.c2w, last.c2w),
        overlap=scene.overlap,
        failure=failure,
        figures=figures,
    )


@torch.no_grad()
def novel_view(
    reconstructor: Callable[[Views], Reconstruction],
    rasterizer: Rasterizer,
    scene: EvaluationScene,
) -> dict[str, float]:
    """Reconstruct from the scene's outer two inputs and compare the predicted target with the real
    one.

    `blurred` figures are of the better input photo at its best blur. PSNR [dB], `lpips` NaN where
    its weights are not installed, errors of rotation and of the baseline's direction between the
    inputs [degrees], CPU time of the reconstruction [seconds].
    """
    inputs = [scene.inputs[0], scene.inputs[-1]]
    target = scene.target.image
    start = time.process_time()
    reconstruction = reconstructor(views_of(inputs))
    seconds = time.process_time() - start
    predicted = PredictedScene(reconstruction, rasterizer, inputs)
    shown = predicted.show(predicted.camera_of(scene.target))
    photos = [photo.image for photo in inputs]
    blurred_psnr, blurred_ssim = best_blurred_copy(photos, target)
    rotation_error, direction_error = pose_errors(
        predicted.predicted_pose, predicted.true_pose
    )
    return {
        "psnr": psnr(shown.image, target),
        "blurred_psnr": blurred_psnr,
        "ssim": ssim(shown.image, target),
        "blurred_ssim": blurred_ssim,
        "lpips": lpips_distance(shown.image, target) if lpips_weights() else np.nan,
        "coverage": float(shown.covered.mean()),
        "rotation_error": rotation_error,
        "direction_error": direction_error,
        "seconds": seconds,
    }


def pose_errors(predicted: Pose, true: Pose) -> tuple[float, float]:
    """Return the errors of rotation and of baseline direction [degrees]."""
    lengths = np.linalg.norm(predicted[:3, 3]) * np.linalg.norm(true[:3, 3])
    cosine = predicted[:3, 3] @ true[:3, 3] / max(lengths, 1e-12)
    direction = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return rotation_degrees(predicted, true), direction


@torch.no_grad()
def carried_edit(
    reconstructor: WithMatcher, rasterizer: Rasterizer, scene: EvaluationScene
) -> dict[str, float]:
    """Reconstruct the scene unedited, with its first photo edited, and with the second edited the
    opposite way too.

    With the first photo edited alone, of view 1's own Gaussians seen from view 1: `uptake` is the
    projection of the shown change on the true one, where the edit is (1 is all), `error` |shown -
    true| over |true| there, `leak` the mean absolute change elsewhere [sRGB], NaN where nothing of
    it is seen; `edited_psnr` is of the novel view [dB]. With opposite edits, `disagreement` is that
    of the views' changes over that of the edits. Changes are against the scene without the edit.
    """
    photos = [scene.inputs[0], scene.inputs[-1]]
    edited = [scene.edited[0], scene.edited[-2]]
    target, edited_target = scene.target, scene.edited[-1]
    source = views_of(photos)

    def reconstructed(*views: PosedPhoto) -> PredictedScene:
        reconstruction = reconstructor(views_of(views), source)
        return PredictedScene(reconstruction, rasterizer, photos)

    plain = reconstructed(*photos)
    carried = reconstructed(edited[0], photos[1])
    opposed = reconstructed(edited[0], _opposite(photos[1], edited[1]))
    own = plain.cameras.select([1])
    between = plain.camera_of(target)

    before, after = (scene.show(own, 1) for scene in (plain, carried))
    shown, true = after.image - before.image, edited[1].image - photos[1].image
    covered = before.covered & after.covered
    inside = (covered & _is_edited(photos[1], edited[1]))[..., None]
    outside = covered & (true == 0).all(-1)
    unedited = [plain.show(between, view) for view in (0, 1)]
    contrary = [opposed.show(between, view) for view in (0, 1)]
    region = unedited[0].covered & unedited[1].covered
    region &= _is_edited(target, edited_target)
    if not (inside.any() and region.any()):
        raise MatchingError("the edit is not visible in both photos.")
    changes = [after.image - before.image for before, after in zip(unedited, contrary)]
    disagreement = _mean_size(changes[0] - changes[1], region)
    asked = edited_target.image - _opposite(target, edited_target).image
    return {
        "uptake": change_uptake(shown, true, inside),
        "error": change_error(shown, true, inside),
        "leak": _mean_size(shown, outside) if outside.any() else np.nan,
        "disagreement": disagreement / _mean_size(asked, region),
        "edited_psnr": psnr(carried.show(between).image, edited_target.image),
        "unedited_psnr": psnr(plain.show(between).image, target.image),
    }


def _mean_size(change: Float[np.ndarray, "height width 3"], region: Region) -> float:
    return float(np.abs(change[region]).mean())


def _is_edited(before: PosedPhoto, after: PosedPhoto) -> Region:
    return np.abs(after.image - before.image).mean(-1) > CHANGED


def _opposite(before: PosedPhoto, after: PosedPhoto) -> PosedPhoto:
    """Return the photo with the opposite of the change from `before` to `after`."""
    return replace(before, image=np.clip(2 * before.image - after.image, 0, 1))


def best_blurred_copy(photos: Iterable[Image], target: Image) -> tuple[float, float]:
    """The highest PSNR [dB] that any photo reaches under any Gaussian blur, and the SSIM of that
    copy: the baseline without geometry.
    """
    copies = (
        gaussian_filter(photo, (sigma, sigma, 0)) for photo in photos for sigma in BLURS
    )
    best = max(copies, key=lambda copy: psnr(copy, target))
    return psnr(best, target), ssim(best, target)
