"""What a reconstructor makes of scenes whose truth is known: novel views, poses, and edits carried
over.

Two photos go in without their poses. The target is rendered at its true relative pose, in the unit
of length that makes the predicted baseline the true one.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Bool, Float

from edit3r.compute.changes import change_error, change_uptake
from edit3r.contract.interfaces import Rasterizer, Reconstructor
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.errors import MatchingError, PluginError
from edit3r.geometry.cameras import project
from edit3r.io.posed_folder import Photo
from edit3r_measure.metrics import best_blurred_copy, psnr, ssim
from edit3r_measure.scene_sources import Scene, rotation_degrees

COVERED = 0.5  # alpha above which a pixel of a rendering counts as covered
CHANGED = 2 / 255  # mean change of colour above which a pixel belongs to a true edit
SAME_SURFACE = (
    0.05  # relative difference of depth below which two views show one surface
)

FIGURES = {
    "novel view": {
        "psnr": "of the whole predicted image [dB]; what is not covered has the background's "
        "colour",
        "blurred_psnr": "of the better input photo at its best blur [dB]",
        "covered_psnr": "over the covered pixels alone [dB]",
        "covered_blurred_psnr": "of the best-blurred photo over the same pixels [dB]",
        "ssim": "of the whole predicted image",
        "blurred_ssim": "of the best-blurred photo",
        "coverage": "share of the target's pixels that are covered",
        "rotation_error": "between the input cameras [degrees]",
        "direction_error": "of the baseline [degrees]",
        "seconds": "CPU time of the reconstruction",
    },
    "edit": {
        "uptake": "first photo edited alone: of view 1's own Gaussians, seen from view 1",
        "error": "of the same",
        "leak": "of the same [sRGB]",
        "disagreement": "opposite edits: |change of view 0's Gaussians - of view 1's| over that "
        "of the two edits",
        "kept": "opposite edits: uptake of the first photo's edit by all Gaussians, in the novel "
        "view",
        "conflict_error": "opposite edits: mean |novel view - truth of the first photo's edit| "
        "where it is [sRGB]",
        "conflict_opacity": "opposite edits: of view 1's Gaussians where view 0 shows the place, "
        "over that unedited",
        "edited_psnr": "novel view of the edited scene against its truth [dB], first photo "
        "edited alone",
        "unedited_psnr": "the same without an edit [dB]",
    },
    "protocol": {
        f"{prefix}{name}": f"mean over the targets, {where}"
        for prefix, where in (
            ("", "from their true places"),
            ("aligned_", "from where the scene looks most like them"),
        )
        for name in (
            "psnr",
            "ssim",
            "lpips",
            "perceptual",
        )  # SSIM in Gaussian windows of 11 pixels
    }
    | {
        "pose_error": "larger of the errors of rotation and of baseline direction between the "
        "inputs [degrees]",
        "refined_pose_error": "after the last input camera was aligned with its photo",
    },
}
"""What can be measured on a scene, and the figures of each, in the order of reports."""


@dataclass(frozen=True)
class SceneScore:
    """What was measured on one scene."""

    kind: str  # a key of FIGURES
    scene: str  # folder or data set
    first: str
    second: str
    target: str
    degrees: float  # angle between the input cameras
    failure: str = ""  # why nothing could be measured; "" when it could
    figures: Mapping[str, float] = field(
        default_factory=dict
    )  # as FIGURES names them; none after a failure
    overlap: str = ""  # class of the inputs' overlap, where an index file tells it


@dataclass(frozen=True)
class RenderedView:
    """A rendering and where the scene covers it."""

    image: Float[np.ndarray, "height width 3"]  # sRGB in [0, 1]
    covered: Bool[np.ndarray, "height width"]
    depth: Float[np.ndarray, "height width"] | None = None  # camera z


def views_of(photos: Sequence[Photo]) -> Views:
    """Return one scene (batch 1) of photos that share a size, without their poses."""
    images = torch.from_numpy(np.stack([photo.image for photo in photos])).permute(
        0, 3, 1, 2
    )
    intrinsics = torch.from_numpy(
        np.stack([photo.intrinsics for photo in photos])
    ).float()
    return Views(images[None].contiguous(), intrinsics[None])


def relative_pose(photo: Photo, first: Photo) -> Float[np.ndarray, "4 4"]:
    """Return the camera-to-world matrix of `photo` in the frame of `first`."""
    return np.linalg.inv(first.c2w) @ photo.c2w


def predict(
    reconstruction: Reconstruction,
    rasterizer: Rasterizer,
    first: Photo,
    second: Photo,
    target: Photo,
) -> RenderedView:
    """Render the target, at its own size, from the scene that was made of `first` and `second`."""
    return _render(
        reconstruction.gaussians,
        rasterizer,
        target_camera(reconstruction, first, second, target),
    )


def target_camera(
    reconstruction: Reconstruction, first: Photo, second: Photo, target: Photo
) -> Cameras:
    """Return the true camera of `target`, in the unit that makes the predicted distance of the
    inputs the true one.
    """
    pose = relative_pose(target, first)
    predicted, true = predicted_pose(reconstruction), relative_pose(second, first)
    pose[:3, 3] *= np.linalg.norm(predicted[:3, 3]) / np.linalg.norm(true[:3, 3])
    return _camera(pose, target, reconstruction.gaussians)


def _camera(
    c2w: Float[np.ndarray, "4 4"], photo: Photo, gaussians: Gaussians
) -> Cameras:
    """Return a camera with the intrinsics and the size of `photo`, batch 1."""
    pose, intrinsics = (
        torch.from_numpy(m).to(gaussians.means)[None, None]
        for m in (c2w, photo.intrinsics)
    )
    return Cameras(pose, intrinsics, photo.image.shape[:2])


def predicted_pose(reconstruction: Reconstruction) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the last input photo in the frame of the first."""
    if reconstruction.cameras is None:
        raise PluginError(
            "evaluation needs a reconstructor that predicts its photos' cameras; this one does not."
        )
    return reconstruction.cameras.c2w[0, -1].double().cpu().numpy()


def _render(
    gaussians: Gaussians, rasterizer: Rasterizer, camera: Cameras
) -> RenderedView:
    """Render one camera of batch 1."""
    with torch.no_grad():
        rendering = rasterizer.render(gaussians, camera)
    image = (
        rendering.images[0, 0]
        .permute(1, 2, 0)
        .clamp(0, 1)
        .cpu()
        .numpy()
        .astype(np.float32)
    )
    alpha, depth = (
        x[0, 0, 0].cpu().numpy() for x in (rendering.alphas, rendering.depths)
    )
    return RenderedView(image, alpha > COVERED, depth)


@torch.no_grad()
def score_scene(
    scene: Scene,
    reconstructor: Reconstructor,
    rasterizer: Rasterizer,
    edits: bool = False,
) -> SceneScore | None:
    """Score the scene's target; with `edits` its true edit instead, or None where it is not
    known.
    """
    if edits and not scene.edited:
        return None
    kind, measure = ("edit", _carried_edit) if edits else ("novel view", _novel_view)
    failure, figures = "", {}
    try:
        figures = measure(scene, reconstructor, rasterizer)
    except MatchingError as error:
        failure = str(error)
    degrees = rotation_degrees(
        scene.inputs[0].c2w[:3, :3], scene.inputs[-1].c2w[:3, :3]
    )
    return SceneScore(
        kind,
        scene.source,
        scene.files[0],
        scene.files[-2],
        scene.files[-1],
        degrees,
        failure,
        figures,
    )


def _novel_view(
    scene: Scene, reconstructor: Reconstructor, rasterizer: Rasterizer
) -> dict[str, float]:
    """Reconstruct from the scene's outer two inputs and compare the predicted target with the real
    one.
    """
    first, second, target = scene.inputs[0], scene.inputs[-1], scene.target
    start = time.process_time()
    reconstruction = reconstructor(views_of([first, second]))
    seconds = time.process_time() - start
    shown = predict(reconstruction, rasterizer, first, second, target)
    photos = (first.image, second.image)
    blurred_psnr, blurred_ssim = best_blurred_copy(photos, target.image)
    rotation_error, direction_error = pose_errors(
        predicted_pose(reconstruction), relative_pose(second, first)
    )
    return {
        "psnr": psnr(shown.image, target.image),
        "blurred_psnr": blurred_psnr,
        "covered_psnr": psnr(shown.image, target.image, shown.covered),
        "covered_blurred_psnr": best_blurred_copy(photos, target.image, shown.covered)[
            0
        ],
        "ssim": ssim(shown.image, target.image),
        "blurred_ssim": blurred_ssim,
        "coverage": float(shown.covered.mean()),
        "rotation_error": rotation_error,
        "direction_error": direction_error,
        "seconds": seconds,
    }


def pose_errors(
    predicted: Float[np.ndarray, "4 4"], true: Float[np.ndarray, "4 4"]
) -> tuple[float, float]:
    """Return the errors of rotation and of baseline direction [degrees]."""
    lengths = np.linalg.norm(predicted[:3, 3]) * np.linalg.norm(true[:3, 3])
    cosine = predicted[:3, 3] @ true[:3, 3] / max(lengths, 1e-12)
    direction = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return rotation_degrees(predicted[:3, :3], true[:3, :3]), direction


@dataclass(frozen=True)
class EditScore:
    """What became of a true edit in one view; changes are against the same scene without the
    edit.
    """

    uptake: (
        float | None
    )  # projection of the shown change on the true one, where the edit is; 1 is all; None: unseen
    error: (
        float | None
    )  # |shown change - true change| over |true change| there; None: unseen
    leak: (
        float | None
    )  # mean absolute change elsewhere [sRGB]; None: there is no elsewhere
    psnr: float  # of the edited view against its truth [dB]


def score_edit(
    plain: RenderedView, edited: RenderedView, before: Photo, after: Photo
) -> EditScore:
    """Compare what two renderings show of the edit that turned the photo `before` into `after`."""
    true, shown = after.image - before.image, edited.image - plain.image
    covered = plain.covered & edited.covered
    inside = covered & (np.abs(true).mean(-1) > CHANGED)
    outside = covered & (true == 0).all(-1)
    seen = bool(inside.any())
    return EditScore(
        uptake=change_uptake(shown, true, inside[..., None]) if seen else None,
        error=change_error(shown, true, inside[..., None]) if seen else None,
        leak=float(np.abs(shown[outside]).mean()) if outside.any() else None,
        psnr=psnr(edited.image, after.image),
    )


def _carried_edit(
    scene: Scene, reconstructor: Reconstructor, rasterizer: Rasterizer
) -> dict[str, float]:
    """Reconstruct the scene unedited, with its first photo edited, and with the second edited the
    opposite way too.
    """
    first, second, target = scene.inputs[0], scene.inputs[-1], scene.target
    edited_first, edited_second, edited_target = (
        scene.edited[0],
        scene.edited[-2],
        scene.edited[-1],
    )
    source = views_of([first, second])
    alone, both = (
        views_of([edited_first, second]),
        views_of([edited_first, _opposite(second, edited_second)]),
    )
    plain, carried, fused = (
        reconstructor(views, source) for views in (source, alone, both)
    )
    own = plain.cameras.select([1])
    between = target_camera(plain, first, second, target)

    def shown(
        reconstruction: Reconstruction, camera: Cameras, view: int | None = None
    ) -> RenderedView:
        """Render all Gaussians, or those of one view."""
        gaussians = reconstruction.gaussians
        return _render(
            gaussians if view is None else gaussians.from_view(view), rasterizer, camera
        )

    edit = score_edit(
        shown(plain, own, 1), shown(carried, own, 1), second, edited_second
    )
    unedited, edited = (
        [shown(scene, between, view) for view in (0, 1)] for scene in (plain, fused)
    )
    changes = [after.image - before.image for before, after in zip(unedited, edited)]
    true, opposite = (
        photo.image - target.image
        for photo in (edited_target, _opposite(target, edited_target))
    )
    region = (
        unedited[0].covered & unedited[1].covered & (np.abs(true).mean(-1) > CHANGED)
    )
    if edit.uptake is None or not region.any():
        raise MatchingError("the edit is not seen by both photos.")
    whole = score_edit(
        shown(plain, between), shown(fused, between), target, edited_target
    )
    return {
        "uptake": edit.uptake,
        "error": edit.error,
        "leak": float("nan") if edit.leak is None else edit.leak,
        "disagreement": float(
            np.abs(changes[0] - changes[1])[region].mean()
            / np.abs(true - opposite)[region].mean()
        ),
        "kept": whole.uptake,
        "conflict_error": float(
            np.abs(shown(fused, between).image - edited_target.image)[region].mean()
        ),
        "conflict_opacity": _share_of_opacity(
            plain, fused, shown(plain, own, 0), second, edited_second
        ),
        "edited_psnr": psnr(shown(carried, between).image, edited_target.image),
        "unedited_psnr": psnr(shown(plain, between).image, target.image),
    }


def _share_of_opacity(
    plain: Reconstruction,
    edited: Reconstruction,
    other: RenderedView,
    before: Photo,
    after: Photo,
) -> float:
    """Return the opacity of view 1's Gaussians where its photo shows the edit over that without
    one; NaN: unseen.

    Counted are those at the depth of `other`, what the rest of the scene shows in view 1's camera.
    """
    region = other.covered & (np.abs(after.image - before.image).mean(-1) > CHANGED)
    sums = []
    for reconstruction in (edited, plain):
        gaussians, camera = (
            reconstruction.gaussians.from_view(1),
            reconstruction.cameras.select([1]),
        )
        places, depths = (
            x[0].cpu()
            for x in project(gaussians.means, camera.intrinsics[:, 0], camera.c2w[:, 0])
        )
        size = places.new_tensor(region.shape[::-1])
        columns, rows = (
            (places * size).long().clamp(min=0).minimum(size.long() - 1).unbind(-1)
        )
        same = (
            depths / torch.from_numpy(other.depth)[rows, columns] - 1
        ).abs() < SAME_SURFACE
        inside = (
            torch.from_numpy(region)[rows, columns]
            & same
            & ((places > 0) & (places < 1)).all(-1)
        )
        sums.append(float(gaussians.opacities[0].cpu()[inside].sum()))
    return sums[0] / sums[1] if sums[1] else float("nan")


def _opposite(before: Photo, after: Photo) -> Photo:
    """Return the photo with the opposite of the change from `before` to `after`."""
    return replace(before, image=np.clip(2 * before.image - after.image, 0, 1))
