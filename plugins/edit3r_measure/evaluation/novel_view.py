"""Novel views between real posed photos: how good is a reconstructor on photos whose truth is known?

Two photos go in without their poses; the photo between them is predicted at its true relative pose, in the unit of
length that makes the predicted baseline the true one.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from edit3r.errors import MatchingError, PluginError
from edit3r.interfaces import Rasterizer, Reconstructor
from edit3r.io.posed_folder import Photo, PosedFolder
from edit3r.reporting import track
from edit3r.types import Cameras, Reconstruction, Views
from edit3r_measure.evaluation.metrics import best_blurred_copy, covered_psnr, psnr, ssim
from edit3r_measure.evaluation.pairs import Triple, choose_triples, rotation_degrees

__all__ = ["NovelViewScore", "evaluate_folder", "predict", "score_triple", "views_of"]

COVERED = 0.5
"""Alpha above which a pixel of the prediction counts as covered."""


@dataclass(frozen=True)
class NovelViewScore:
    """What one pair of photos gave. After a failure only the first five fields and `failure` mean anything."""

    scene: str
    first: str
    second: str
    target: str
    degrees: float  # angle between the input cameras
    failure: str = ""  # why the photos could not be reconstructed; "" when they could
    psnr: float = float("nan")  # of the whole predicted picture [dB]; what is not covered is the background's colour
    blurred_psnr: float = float("nan")  # of the better input photo at its best blur
    covered_psnr: float = float("nan")  # over the covered pixels alone
    covered_blurred_psnr: float = float("nan")  # of the best-blurred photo over the same pixels
    ssim: float = float("nan")  # of the whole predicted picture
    blurred_ssim: float = float("nan")
    coverage: float = float("nan")  # share of the target's pixels that are covered
    rotation_error: float = float("nan")  # between the input cameras [degrees]
    direction_error: float = float("nan")  # of the baseline [degrees]
    seconds: float = float("nan")  # CPU time of the reconstruction

    @property
    def psnr_gain(self) -> float:
        """PSNR above the best-blurred photo, whole picture [dB]."""
        return self.psnr - self.blurred_psnr

    @property
    def covered_gain(self) -> float:
        """PSNR above the best-blurred photo, covered pixels [dB]."""
        return self.covered_psnr - self.covered_blurred_psnr

    @property
    def ssim_gain(self) -> float:
        """SSIM above the best-blurred photo."""
        return self.ssim - self.blurred_ssim


def evaluate_folder(
    folder: PosedFolder, reconstructor: Reconstructor, rasterizer: Rasterizer, pairs: int = 6, size: int = 256
) -> Iterator[NovelViewScore]:
    """Scores of up to `pairs` pairs of the folder, at `size` x `size` pixels, as they are done."""
    for triple in track(choose_triples(folder.cameras, pairs), f"pairs of {folder.name}"):
        yield score_triple(folder, triple, reconstructor, rasterizer, size)


def score_triple(
    folder: PosedFolder, triple: Triple, reconstructor: Reconstructor, rasterizer: Rasterizer, size: int
) -> NovelViewScore:
    """Reconstruct from the two photos of `triple` and compare the predicted target with the real one."""
    indices = (triple.first, triple.second, triple.target)
    first, second, target = (folder.load(index, size) for index in indices)
    named = (folder.name, *(folder.cameras[index].file for index in indices), triple.degrees)
    start = time.process_time()
    try:
        reconstruction = reconstructor(views_of([first, second]))
    except MatchingError as error:
        return NovelViewScore(*named, failure=str(error))
    seconds = time.process_time() - start
    image, covered = predict(reconstruction, rasterizer, first, second, target)
    photos = (first.image, second.image)
    blurred = best_blurred_copy(photos, target.image)
    rotation_error, direction_error = _pose_errors(reconstruction, first, second)
    return NovelViewScore(
        *named,
        psnr=psnr(image, target.image),
        blurred_psnr=blurred.psnr,
        covered_psnr=covered_psnr(image, target.image, covered),
        covered_blurred_psnr=best_blurred_copy(photos, target.image, covered).psnr,
        ssim=ssim(image, target.image),
        blurred_ssim=blurred.ssim,
        coverage=float(covered.mean()),
        rotation_error=rotation_error,
        direction_error=direction_error,
        seconds=seconds,
    )


def views_of(photos: Sequence[Photo]) -> Views:
    """One scene of photos that share a size."""
    images = torch.from_numpy(np.stack([photo.image for photo in photos])).permute(0, 3, 1, 2)
    intrinsics = torch.from_numpy(np.stack([photo.intrinsics for photo in photos])).float()
    return Views(images[None].contiguous(), intrinsics[None])


def relative_pose(photo: Photo, first: Photo) -> np.ndarray:
    """Camera-to-world of `photo` in the frame of `first`."""
    return np.linalg.inv(first.c2w) @ photo.c2w


def _predicted_pose(reconstruction: Reconstruction) -> np.ndarray:
    """Of the second input photo, in the frame of the first."""
    if reconstruction.cameras is None:
        raise PluginError("evaluation needs a reconstructor that predicts its photos' cameras; this one does not.")
    return reconstruction.cameras.c2w[0, 1].double().cpu().numpy()


def predict(
    reconstruction: Reconstruction, rasterizer: Rasterizer, first: Photo, second: Photo, target: Photo
) -> tuple[np.ndarray, np.ndarray]:
    """The predicted target picture, and which of its pixels are covered."""
    baseline = np.linalg.norm(_predicted_pose(reconstruction)[:3, 3])
    pose = relative_pose(target, first)
    pose[:3, 3] *= baseline / np.linalg.norm(relative_pose(second, first)[:3, 3])
    like = reconstruction.gaussians.means
    c2w, intrinsics = (torch.from_numpy(matrix).to(like)[None, None] for matrix in (pose, target.intrinsics))
    with torch.no_grad():
        rendering = rasterizer.render(reconstruction.gaussians, Cameras(c2w, intrinsics, target.image.shape[:2]))
    image = rendering.images[0, 0].permute(1, 2, 0).clamp(0, 1).cpu().numpy().astype(np.float32)
    return image, (rendering.alphas[0, 0, 0] > COVERED).cpu().numpy()


def _pose_errors(reconstruction: Reconstruction, first: Photo, second: Photo) -> tuple[float, float]:
    """Errors of rotation and of baseline direction [degrees]."""
    predicted, true = _predicted_pose(reconstruction), relative_pose(second, first)
    lengths = np.linalg.norm(predicted[:3, 3]) * np.linalg.norm(true[:3, 3])
    cosine = predicted[:3, 3] @ true[:3, 3] / max(lengths, 1e-12)
    direction = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return rotation_degrees(predicted[:3, :3], true[:3, :3]), direction
