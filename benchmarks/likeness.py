"""How alike a rendering and its photo are, as the benchmarks that decide say it: four figures.

PSNR and SSIM ask each pixel; LPIPS (edit3r/kit/compute/lpips.py, shift-tolerant) and the share of
detail say what a person sees. Needs `pip install "edit3r[stlpips]"`. Photos that no run was given
are shown from where they stand beside the nearest one that it placed.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from itertools import pairwise

import cv2
import numpy as np
import torch
from edit3r_geometry.relative_pose import agreeing
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from torch import Tensor

import edit3r
from edit3r.kit.compute.lpips import lpips_distance
from edit3r.kit.compute.metrics import Image, psnr, ssim
from edit3r.kit.photos.images import to_bytes

FEWEST_MATCHES = 12
PATCH = 5  # pixels that colours are averaged over, so that a match may be off by one
FINE = 1.0  # detail is what a Gaussian blur of so many pixels takes away


@dataclass(frozen=True)
class Likeness:
    """Of one image, or means over several."""

    psnr: float  # [dB]
    ssim: float
    lpips: float  # 0: alike
    detail: float  # its energy as a share of the photo's

    def __str__(self) -> str:
        return f"{self.psnr:.2f}, {self.ssim:.3f}, {self.lpips:.3f}, {self.detail:.2f}"


TITLE = "dB, SSIM, LPIPS, detail"


def likeness(image: Image, photo: Image) -> Likeness:
    """Compare an image with its photo, both sRGB in [0, 1]."""
    return Likeness(
        psnr(image, photo),
        ssim(image, photo),
        lpips_distance(image, photo),
        _energy(image) / max(_energy(photo), 1e-12),
    )


def mean(several: Sequence[Likeness]) -> Likeness:
    return Likeness(*(float(v) for v in np.mean([astuple(o) for o in several], axis=0)))


def _energy(image: Image) -> float:
    grey = image.mean(2)
    return float(np.square(grey - gaussian_filter(grey, FINE)).mean())


def between(centres: np.ndarray, chosen: list[int]) -> list[int | None]:
    """For each two neighbours of a set the other photo most nearly half-way between them; None:
    none lies between.
    """
    free, found = [i for i in range(len(centres)) if i not in chosen], []
    for a, b in pairwise(chosen):
        distance = np.linalg.norm(centres[free, None] - centres[[a, b]], axis=-1).max(1)
        nearest = int(distance.argmin())
        found.append(
            free[nearest]
            if distance[nearest] <= np.linalg.norm(centres[a] - centres[b])
            else None
        )
    return found


def unseen_camera(
    result: edit3r.RunResult, views: edit3r.Views, placed: list[int], target: int
) -> edit3r.Cameras:
    """Where view `target` stands in the result, relative to the nearest of the `placed` views."""
    true, found = (
        views.c2w[0, :, :3, 3].double(),
        result.cameras.c2w[0, :, :3, 3].double(),
    )
    unit = float(torch.pdist(found).sum() / torch.pdist(true[placed]).sum())
    nearest = int((true[placed] - true[target]).norm(dim=1).argmin())
    return camera_beside(result, views, (placed[nearest], nearest), target, unit)


def camera_beside(
    result: edit3r.RunResult,
    views: edit3r.Views,
    near: tuple[int, int],
    target: int,
    unit: float,
) -> edit3r.Cameras:
    """View `target` from where it stands beside a view, whose numbers in `views` and result are
    `near`.
    """
    step = (
        torch.linalg.inv(views.c2w[0, near[0]].double()) @ views.c2w[0, target].double()
    )
    step[:3, 3] *= unit
    pose = (result.cameras.c2w[0, near[1]].double() @ step).float()
    return edit3r.Cameras(
        pose[None, None], views.intrinsics[:, [target]], views.image_size
    )


@torch.no_grad()
def drawn(result: edit3r.RunResult, camera: edit3r.Cameras) -> np.ndarray:
    image = result.rasterizer.render(result.gaussians, camera).images
    return image[0, 0].clamp(0, 1).permute(1, 2, 0).numpy()


def as_numpy(views: edit3r.Views, view: int) -> np.ndarray:
    return views.images[0, view].permute(1, 2, 0).numpy()


def disagreement(
    photos: Float[Tensor, "view 3 height width"],
    edited: Float[Tensor, "view 3 height width"],
) -> float | None:
    """How differently the edits changed what view 0 and another view both show [sRGB]; 0: alike.

    The same spots are found by SIFT matches between the unedited photos that agree with one
    epipolar geometry (MAGSAC), so a wrong edit cannot hide in them; there, the two changes of
    colour are compared (mean absolute difference over matches, channels and views). None where too
    few spots are found.
    """
    change = (edited - photos).detach().float().cpu().permute(0, 2, 3, 1).numpy()
    grey = [cv2.cvtColor(to_bytes(photo), cv2.COLOR_RGB2GRAY) for photo in photos]
    smooth = [cv2.blur(np.ascontiguousarray(image), (PATCH, PATCH)) for image in change]
    sift = cv2.SIFT.create()
    points, described = zip(*(sift.detectAndCompute(image, None) for image in grey))
    differences = []
    for other in range(1, len(photos)):
        spots = _matched(points[0], described[0], points[other], described[other])
        if len(spots) >= FEWEST_MATCHES:
            (x, y), (x2, y2) = spots.round().astype(int).transpose(1, 2, 0)
            differences.append(np.abs(smooth[0][y, x] - smooth[other][y2, x2]).mean())
    return float(np.mean(differences)) if differences else None


def _matched(
    points0, described0, points1, described1
) -> Float[np.ndarray, "match 2 2"]:
    """Pixels of mutual nearest descriptors on one fundamental matrix; empty where few are."""
    if described0 is None or described1 is None:
        return np.zeros((0, 2, 2))
    matches = cv2.BFMatcher(crossCheck=True).match(described0, described1)
    pairs = [(points0[m.queryIdx].pt, points1[m.trainIdx].pt) for m in matches]
    spots = np.array(pairs).reshape(-1, 2, 2)
    if len(spots) < FEWEST_MATCHES:
        return spots
    kept = agreeing(spots[:, 0], spots[:, 1], 1.0)
    return spots[:0] if kept is None else spots[kept]
