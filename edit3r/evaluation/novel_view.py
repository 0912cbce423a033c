"""Novel views between real posed photos: how good is a reconstructor on photos whose truth is known?

Two photos go in without their poses; the photo between them is predicted at its true relative pose, in the unit of
length that makes the predicted baseline the true one.
"""

import time
from dataclasses import dataclass

import numpy as np
import torch

from edit3r.errors import MatchingError
from edit3r.evaluation.metrics import best_blurred_copy, psnr, ssim
from edit3r.evaluation.pairs import Triple, choose_triples, rotation_degrees
from edit3r.evaluation.posed_folder import Photo, PosedFolder
from edit3r.interfaces import Rasterizer, Reconstructor
from edit3r.types import Cameras, Reconstruction, Views

__all__ = ["NovelViewScore", "evaluate_folder", "score_triple"]


@dataclass(frozen=True)
class NovelViewScore:
    """What one pair of photos gave. After a failure only the first four fields and `failure` mean anything."""

    scene: str
    first: str
    second: str
    target: str
    degrees: float  # angle between the input cameras
    failure: str = ""  # why the photos could not be reconstructed; "" when they could
    psnr: float = float("nan")  # of the predicted target [dB]
    ssim: float = float("nan")
    coverage: float = float("nan")  # share of the target's pixels with alpha > 0.5
    blurred_psnr: float = float("nan")  # of the better input photo at its best blur
    blurred_ssim: float = float("nan")
    rotation_error: float = float("nan")  # between the input cameras [degrees]
    direction_error: float = float("nan")  # of the baseline [degrees]
    seconds: float = float("nan")  # CPU time of the reconstruction

    @property
    def psnr_gain(self) -> float:
        """PSNR above the best-blurred copy [dB]."""
        return self.psnr - self.blurred_psnr

    @property
    def ssim_gain(self) -> float:
        """SSIM above the best-blurred copy."""
        return self.ssim - self.blurred_ssim


def evaluate_folder(
    folder: PosedFolder, reconstructor: Reconstructor, rasterizer: Rasterizer, pairs: int = 6, size: int = 256
):
    """Yield a NovelViewScore for each of up to `pairs` pairs of the folder, at `size` x `size` pixels."""
    for triple in choose_triples(folder.photos, pairs):
        yield score_triple(folder, triple, reconstructor, rasterizer, size)


def score_triple(
    folder: PosedFolder, triple: Triple, reconstructor: Reconstructor, rasterizer: Rasterizer, size: int
) -> NovelViewScore:
    """Reconstruct from the two photos of `triple` and compare the predicted target with the real one."""
    indices = (triple.first, triple.second, triple.target)
    first, second, target = (folder.photos[index].load(size) for index in indices)
    names = [folder.photos[index].path.name for index in indices]
    start = time.process_time()
    try:
        reconstruction = reconstructor(views_of([first, second]))
    except MatchingError as error:
        return NovelViewScore(folder.name, *names, triple.degrees, failure=str(error))
    seconds = time.process_time() - start
    image, coverage = _render_target(reconstruction, rasterizer, first, second, target)
    blurred = best_blurred_copy((first.image, second.image), target.image)
    rotation_error, direction_error = _pose_errors(reconstruction, first, second)
    return NovelViewScore(
        folder.name,
        *names,
        triple.degrees,
        psnr=psnr(image, target.image),
        ssim=ssim(image, target.image),
        coverage=coverage,
        blurred_psnr=blurred.psnr,
        blurred_ssim=blurred.ssim,
        rotation_error=rotation_error,
        direction_error=direction_error,
        seconds=seconds,
    )


def views_of(photos: list[Photo]) -> Views:
    """One scene of photos that share a size."""
    images = torch.from_numpy(np.stack([photo.image for photo in photos])).permute(0, 3, 1, 2)
    intrinsics = torch.from_numpy(np.stack([photo.intrinsics for photo in photos])).float()
    return Views(images[None].contiguous(), intrinsics[None])


def relative_pose(photo: Photo, first: Photo) -> np.ndarray:
    """Camera-to-world of `photo` in the frame of `first`."""
    return np.linalg.inv(first.c2w) @ photo.c2w


def _predicted_poses(reconstruction: Reconstruction) -> np.ndarray:
    if reconstruction.cameras is None:
        raise ValueError("evaluation needs a reconstructor that predicts the input cameras (Reconstruction.cameras)")
    return reconstruction.cameras.c2w[0].double().numpy()


def _render_target(
    reconstruction: Reconstruction, rasterizer: Rasterizer, first: Photo, second: Photo, target: Photo
) -> tuple[np.ndarray, float]:
    """The predicted target picture and its coverage."""
    predicted_baseline = np.linalg.norm(_predicted_poses(reconstruction)[1][:3, 3])
    true_baseline = np.linalg.norm(relative_pose(second, first)[:3, 3])
    pose = relative_pose(target, first)
    pose[:3, 3] *= predicted_baseline / true_baseline
    cameras = Cameras(
        torch.from_numpy(pose).float()[None, None],
        torch.from_numpy(target.intrinsics).float()[None, None],
        target.image.shape[:2],
    )
    with torch.no_grad():
        rendering = rasterizer.render(reconstruction.gaussians, cameras)
    image = rendering.images[0, 0].permute(1, 2, 0).numpy().astype(np.float32)
    return image, float((rendering.alphas > 0.5).float().mean())


def _pose_errors(reconstruction: Reconstruction, first: Photo, second: Photo) -> tuple[float, float]:
    """Errors of rotation and of baseline direction [degrees]."""
    predicted, true = _predicted_poses(reconstruction)[1], relative_pose(second, first)
    cosine = predicted[:3, 3] @ true[:3, 3] / np.linalg.norm(predicted[:3, 3]) / np.linalg.norm(true[:3, 3])
    direction = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return rotation_degrees(predicted[:3, :3], true[:3, :3]), direction
