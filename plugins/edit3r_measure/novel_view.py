"""What a reconstructor makes of scenes whose truth is known: novel views, poses, depth, and edits carried over.

Two photos go in without their poses. The target is rendered at its true relative pose, in the unit of length that
makes the predicted baseline the true one.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float

from edit3r.errors import MatchingError, PluginError
from edit3r.interfaces import Rasterizer, Reconstructor
from edit3r.io.posed_folder import Photo
from edit3r.types import Cameras, Gaussians, Reconstruction, Views
from edit3r_measure.metrics import best_blurred_copy, change_uptake, covered_psnr, psnr, ssim, within_share
from edit3r_measure.scene_sources import Scene, rotation_degrees

COVERED = 0.5
"""Alpha above which a pixel of a rendering counts as covered."""

CHANGED = 2 / 255
"""Mean change of colour above which a pixel belongs to a true edit."""

NAN = float("nan")


@dataclass(frozen=True)
class RenderedView:
    """A rendering and where the scene covers it."""

    image: Float[np.ndarray, "height width 3"]  # sRGB in [0, 1]
    covered: Bool[np.ndarray, "height width"]


def views_of(photos: Sequence[Photo]) -> Views:
    """Return one scene (batch 1) of photos that share a size, without their poses."""
    images = torch.from_numpy(np.stack([photo.image for photo in photos])).permute(0, 3, 1, 2)
    intrinsics = torch.from_numpy(np.stack([photo.intrinsics for photo in photos])).float()
    return Views(images[None].contiguous(), intrinsics[None])


def relative_pose(photo: Photo, first: Photo) -> Float[np.ndarray, "4 4"]:
    """Return the camera-to-world matrix of `photo` in the frame of `first`."""
    return np.linalg.inv(first.c2w) @ photo.c2w


def predict(
    reconstruction: Reconstruction, rasterizer: Rasterizer, first: Photo, second: Photo, target: Photo
) -> RenderedView:
    """Render the target, at its own size, from the scene that was made of `first` and `second`."""
    camera = _target_camera(reconstruction, first, second, target)
    return _render(reconstruction.gaussians, rasterizer, camera)


def _target_camera(reconstruction: Reconstruction, first: Photo, second: Photo, target: Photo) -> Cameras:
    baseline = np.linalg.norm(_predicted_pose(reconstruction)[:3, 3])
    pose = relative_pose(target, first)
    pose[:3, 3] *= baseline / np.linalg.norm(relative_pose(second, first)[:3, 3])
    like = reconstruction.gaussians.means
    c2w, intrinsics = (torch.from_numpy(matrix).to(like)[None, None] for matrix in (pose, target.intrinsics))
    return Cameras(c2w, intrinsics, target.image.shape[:2])


def _predicted_pose(reconstruction: Reconstruction) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the second input photo in the frame of the first."""
    if reconstruction.cameras is None:
        raise PluginError("evaluation needs a reconstructor that predicts its photos' cameras; this one does not.")
    return reconstruction.cameras.c2w[0, 1].double().cpu().numpy()


def _render(gaussians: Gaussians, rasterizer: Rasterizer, camera: Cameras) -> RenderedView:
    """Render one camera of batch 1."""
    with torch.no_grad():
        rendering = rasterizer.render(gaussians, camera)
    image = rendering.images[0, 0].permute(1, 2, 0).clamp(0, 1).cpu().numpy().astype(np.float32)
    return RenderedView(image, (rendering.alphas[0, 0, 0] > COVERED).cpu().numpy())


@torch.no_grad()
def score_scene(
    scene: Scene, reconstructor: Reconstructor, rasterizer: Rasterizer, edits: bool = False
) -> "NovelViewScore | DepthScore | CarriedEdit | None":
    """Score what is known of the scene: its target, or else its depth; with `edits` its true edit alone."""
    if edits:
        return score_carried_edit(scene, reconstructor, rasterizer) if scene.edited else None
    score = score_novel_view if scene.target is not None else score_depth
    return score(scene, reconstructor, rasterizer)


# Novel views and poses.


@dataclass(frozen=True)
class NovelViewScore:
    """What one pair of photos gave. After a failure only the first five fields and `failure` mean anything."""

    scene: str  # folder or data set
    first: str
    second: str
    target: str
    degrees: float  # angle between the input cameras
    failure: str = ""  # why the photos could not be reconstructed; "" when they could
    psnr: float = NAN  # of the whole predicted image [dB]; what is not covered has the background's colour
    blurred_psnr: float = NAN  # of the better input photo at its best blur
    covered_psnr: float = NAN  # over the covered pixels alone
    covered_blurred_psnr: float = NAN  # of the best-blurred photo over the same pixels
    ssim: float = NAN  # of the whole predicted image
    blurred_ssim: float = NAN
    coverage: float = NAN  # share of the target's pixels that are covered
    rotation_error: float = NAN  # between the input cameras [degrees]
    direction_error: float = NAN  # of the baseline [degrees]
    seconds: float = NAN  # CPU time of the reconstruction

    @property
    def psnr_gain(self) -> float:
        """PSNR above the best-blurred photo, whole image [dB]."""
        return self.psnr - self.blurred_psnr

    @property
    def covered_gain(self) -> float:
        """PSNR above the best-blurred photo, covered pixels [dB]."""
        return self.covered_psnr - self.covered_blurred_psnr

    @property
    def ssim_gain(self) -> float:
        """SSIM above the best-blurred photo."""
        return self.ssim - self.blurred_ssim


def score_novel_view(scene: Scene, reconstructor: Reconstructor, rasterizer: Rasterizer) -> NovelViewScore:
    """Reconstruct from the scene's outer two inputs and compare the predicted target with the real one."""
    first, second, target = scene.inputs[0], scene.inputs[-1], scene.target
    degrees = rotation_degrees(first.c2w[:3, :3], second.c2w[:3, :3])
    named = (scene.source, scene.files[0], scene.files[-2], scene.files[-1], degrees)
    start = time.process_time()
    try:
        reconstruction = reconstructor(views_of([first, second]))
    except MatchingError as error:
        return NovelViewScore(*named, failure=str(error))
    seconds = time.process_time() - start
    shown = predict(reconstruction, rasterizer, first, second, target)
    photos = (first.image, second.image)
    blurred = best_blurred_copy(photos, target.image)
    rotation_error, direction_error = _pose_errors(reconstruction, first, second)
    return NovelViewScore(
        *named,
        psnr=psnr(shown.image, target.image),
        blurred_psnr=blurred.psnr,
        covered_psnr=covered_psnr(shown.image, target.image, shown.covered),
        covered_blurred_psnr=best_blurred_copy(photos, target.image, shown.covered).psnr,
        ssim=ssim(shown.image, target.image),
        blurred_ssim=blurred.ssim,
        coverage=float(shown.covered.mean()),
        rotation_error=rotation_error,
        direction_error=direction_error,
        seconds=seconds,
    )


def _pose_errors(reconstruction: Reconstruction, first: Photo, second: Photo) -> tuple[float, float]:
    """Return the errors of rotation and of baseline direction [degrees]."""
    predicted, true = _predicted_pose(reconstruction), relative_pose(second, first)
    lengths = np.linalg.norm(predicted[:3, 3]) * np.linalg.norm(true[:3, 3])
    cosine = predicted[:3, 3] @ true[:3, 3] / max(lengths, 1e-12)
    direction = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return rotation_degrees(predicted[:3, :3], true[:3, :3]), direction


# Depth.


@dataclass(frozen=True)
class DepthScore:
    """How much of the first photo's depth is right."""

    scene: str  # folder or data set
    right: float = NAN  # share of the known pixels within 10 % of the true depth after one common scale
    failure: str = ""  # why the photos could not be reconstructed; "" when they could


def score_depth(scene: Scene, reconstructor: Reconstructor, rasterizer: Rasterizer) -> DepthScore:
    """Reconstruct from the scene's outer two inputs and compare the depth rendered at the first with the true one."""
    first = scene.inputs[0]
    try:
        gaussians = reconstructor(views_of([first, scene.inputs[-1]])).gaussians
    except MatchingError as error:
        return DepthScore(scene.source, failure=str(error))
    c2w, intrinsics = (torch.from_numpy(m).to(gaussians.means)[None, None] for m in (np.eye(4), first.intrinsics))
    with torch.no_grad():
        rendering = rasterizer.render(gaussians, Cameras(c2w, intrinsics, first.image.shape[:2]))
    return DepthScore(scene.source, within_share(rendering.depths[0, 0, 0].cpu().numpy(), scene.depth))


# Edits.


@dataclass(frozen=True)
class EditScore:
    """What became of a true edit in one view; changes are against the same scene without the edit."""

    uptake: float | None  # projection of the shown change on the true one, where the edit is; 1 is all; None: unseen
    error: float | None  # |shown change - true change| over |true change| there; None: unseen
    leak: float | None  # mean absolute change elsewhere [sRGB]; None: there is no elsewhere
    psnr: float  # of the edited view against its truth [dB]


def score_edit(plain: RenderedView, edited: RenderedView, before: Photo, after: Photo) -> EditScore:
    """Compare what two renderings show of the edit that turned the photo `before` into `after`."""
    true, shown = after.image - before.image, edited.image - plain.image
    covered = plain.covered & edited.covered
    inside = covered & (np.abs(true).mean(-1) > CHANGED)
    outside = covered & (true == 0).all(-1)
    seen = bool(inside.any())
    return EditScore(
        uptake=change_uptake(shown, true, inside) if seen else None,
        error=float(np.abs(shown - true)[inside].sum() / np.abs(true)[inside].sum()) if seen else None,
        leak=float(np.abs(shown[outside]).mean()) if outside.any() else None,
        psnr=psnr(edited.image, after.image),
    )


@dataclass(frozen=True)
class CarriedEdit:
    """How a reconstructor carries an edit of the first photo to the second, and fuses two edits that disagree."""

    scene: str  # folder or data set
    first: str
    second: str
    failure: str = ""  # why nothing could be measured; "" when it could
    uptake: float = NAN  # first photo edited alone: of view 1's own Gaussians, seen from view 1
    error: float = NAN  # of the same
    leak: float = NAN  # of the same [sRGB]
    disagreement: float = NAN  # opposite edits: |change of view 0's Gaussians - of view 1's| over that of the two edits
    kept: float = NAN  # opposite edits: uptake of the first photo's edit by all Gaussians, in the novel view
    edited_psnr: float = NAN  # novel view of the edited scene against its truth [dB], first photo edited alone
    unedited_psnr: float = NAN  # the same without an edit [dB]


def score_carried_edit(scene: Scene, reconstructor: Reconstructor, rasterizer: Rasterizer) -> CarriedEdit:
    """Reconstruct the scene unedited, with its first photo edited, and with the second edited the opposite way too."""
    first, second, target = scene.inputs[0], scene.inputs[-1], scene.target
    edited_first, edited_second, edited_target = scene.edited[0], scene.edited[-2], scene.edited[-1]
    named = (scene.source, scene.files[0], scene.files[-2])
    source = views_of([first, second])
    alone, both = views_of([edited_first, second]), views_of([edited_first, _opposite(second, edited_second)])
    try:
        plain, carried, fused = (reconstructor(views, source) for views in (source, alone, both))
    except MatchingError as error:
        return CarriedEdit(*named, str(error))
    own = plain.cameras.select([1])
    between = _target_camera(plain, first, second, target)

    def shown(reconstruction: Reconstruction, camera: Cameras, view: int | None = None) -> RenderedView:
        """Render all Gaussians, or those of one view."""
        gaussians = reconstruction.gaussians
        return _render(gaussians if view is None else gaussians.from_view(view), rasterizer, camera)

    edit = score_edit(shown(plain, own, 1), shown(carried, own, 1), second, edited_second)
    unedited, edited = ([shown(scene, between, view) for view in (0, 1)] for scene in (plain, fused))
    changes = [after.image - before.image for before, after in zip(unedited, edited)]
    true, opposite = (photo.image - target.image for photo in (edited_target, _opposite(target, edited_target)))
    region = unedited[0].covered & unedited[1].covered & (np.abs(true).mean(-1) > CHANGED)
    if edit.uptake is None or not region.any():
        return CarriedEdit(*named, "the edit is not seen by both photos.")
    whole = score_edit(shown(plain, between), shown(fused, between), target, edited_target)
    return CarriedEdit(
        *named,
        uptake=edit.uptake,
        error=edit.error,
        leak=NAN if edit.leak is None else edit.leak,
        disagreement=float(np.abs(changes[0] - changes[1])[region].mean() / np.abs(true - opposite)[region].mean()),
        kept=whole.uptake,
        edited_psnr=psnr(shown(carried, between).image, edited_target.image),
        unedited_psnr=psnr(shown(plain, between).image, target.image),
    )


def _opposite(before: Photo, after: Photo) -> Photo:
    """Return the photo with the opposite of the change from `before` to `after`."""
    return replace(before, image=np.clip(2 * before.image - after.image, 0, 1))
