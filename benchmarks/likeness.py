"""How alike a rendering and its photo are, as the benchmarks that decide say it: four figures.

PSNR and SSIM ask each pixel; LPIPS (edit3r/kit/compute/lpips.py, shift-tolerant) and the share of
detail say what a person sees. Needs `pip install "edit3r[stlpips]"`. Photos that no run was given
are shown from where they stand beside the nearest one that it placed.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from itertools import pairwise

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

import edit3r
from edit3r.kit.compute.lpips import lpips_distance
from edit3r.kit.compute.metrics import Image, psnr, ssim

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
