"""Every number that says how good an image, a set of images, a depth map or an edit is.

Unless a signature says otherwise, images are NumPy arrays `[height, width, 3]` and sets of images
`[view, height, width, 3]`, sRGB in [0, 1]; masks are in [0, 1], 1 where an edit belongs.
Similarities by CLIP and the networks behind the distances between sets of images are in `features`;
means over scenes, and how sure they are, in `intervals`.
"""

from collections.abc import Iterable

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter
from torch import Tensor

from edit3r.contract.types import Cameras
from edit3r.kit.compute.changes import change_uptake
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.geometry.warping import shared_surface, warp

Image = Float[np.ndarray, "height width 3"]
Images = Float[np.ndarray, "view height width 3"]
Masks = Float[np.ndarray, "view height width"]
Region = Bool[np.ndarray, "height width"]
Regions = Bool[np.ndarray, "view height width"]
TorchImage = Float[Tensor, "3 height width"]
DepthMap = Float[Tensor, "height width"]
DepthMaps = Float[Tensor, "frame height width"]
Features = Float[np.ndarray, "n feature"]

LOW_PASS = 0.015
"""Standard deviation of the low-pass before changes are measured [image widths]: a rendering that
is a little blurred or shifted has not been edited. No figure kept.
"""


REGIONS = ("edit", "band", "background")

BAND = 0.05  # width of the band around an edit [image widths]; no figure kept

NAN = float("nan")


# ---- one image against another ----


def regions(masks: Masks) -> dict[str, Regions]:
    """Where the edit belongs, the band of width BAND around that, and the background."""
    inside = masks > 0
    radius = max(1, round(BAND * masks.shape[2]))
    near = dilate(torch.from_numpy(inside).float(), radius).numpy() > 0
    return dict(zip(REGIONS, (inside, near & ~inside, ~near)))


def sharpness(image: Image, photo: Image) -> float:
    """Return the variance of the Laplacian of `image` over that of `photo`, both in grey
    (Pech-Pacheco et al. 2000).

    In [0, inf): 1 is as sharp as the photo, less is blurred, more is noise or finer texture; NaN
    for a flat photo.
    """
    of_image, of_photo = (
        cv2.Laplacian(_grey(own.astype(np.float64)), cv2.CV_64F).var()
        for own in (image, photo)
    )
    return float(of_image / of_photo) if of_photo > 1e-12 else NAN


def _grey(image: Image) -> Float[np.ndarray, "height width"]:
    """Brightness as scikit-image's `rgb2gray` weights it.

    That multiplies matrices, whose last digit depends on how the image lies in memory.
    """
    red, green, blue = np.moveaxis(image, -1, 0)
    return 0.2125 * red + 0.7154 * green + 0.0721 * blue


# ---- what an edit did ----
# Distances to the unedited photos reward doing nothing; these do not.


def edit_strength(shown: Images, photos: Images, masks: Masks | None = None) -> float:
    """Mean absolute change from photo to `shown` in the masks, low-passed [sRGB]; NaN: empty."""
    weight = np.ones(photos.shape[:3]) if masks is None else masks
    return _weighted_change(shown, photos, weight)


def change_outside(shown: Images, photos: Images, masks: Masks) -> float:
    """Return the mean absolute change outside the masks, low-passed [sRGB], errors of
    reconstruction included.

    NaN when they leave nothing outside.
    """
    return _weighted_change(shown, photos, (masks == 0).astype(np.float64))


def edit_uptake(
    shown: Images, before: Images, asked: Images, masks: Masks | None = None
) -> float:
    """Return the share of the change asked for that `shown` has inside the masks: the projection of
    its change on that.

    1: all of it; 0: none, something unrelated, or no change asked for; below 0: the opposite. Blur
    counts for nothing.
    """
    weight = np.ones(1) if masks is None else masks[..., None]
    return change_uptake(shown - before, asked - before, weight)


def _weighted_change(shown: Images, photos: Images, weight: Masks) -> float:
    if not weight.any():
        return NAN
    sigma = LOW_PASS * photos.shape[2]
    change = gaussian_filter(shown - photos, (0, sigma, sigma, 0))
    return float(np.average(np.abs(change).mean(-1), weights=weight))


# ---- whether the views of one scene agree ----


def warped_difference(
    images: Float[Tensor, "frame 3 height width"],
    depths: DepthMaps,
    cameras: Cameras,
    pairs: Iterable[tuple[int, int]],
    masks: DepthMaps | None = None,
) -> float:
    """Return the mean absolute difference [sRGB] of pixels that two frames both see, over `pairs`
    (from, to) of them.

    `depths` camera z, 0 unknown; `cameras` batch 1; `masks` weight the first frame's pixels. 0 when
    all agree, nearly: pixels are interpolated. NaN when no pixel is seen twice.
    """
    difference = 0.0
    weight = 0.0
    for a, b in pairs:
        both = cameras.select([a, b])
        warped, seen = warped_image(images[b], depths[a], depths[b], both)
        counted = seen.to(images.dtype)
        if masks is not None:
            counted = counted * masks[a]
        difference += float(((warped - images[a]).abs().mean(0) * counted).sum())
        weight += float(counted.sum())
    return difference / weight if weight > 0 else NAN


def warped_image(
    image: TorchImage, depth: DepthMap, other_depth: DepthMap, cameras: Cameras
) -> tuple[TorchImage, Bool[Tensor, "height width"]]:
    """The second camera's `image` as the first, of `depth`, sees it, and where both see it."""
    depths = torch.stack((depth, other_depth))
    grid, seen = shared_surface(depths, cameras.intrinsics[0], cameras.c2w[0])
    return warp(image, grid), seen


# ---- two sets of images, by the features of a network ----


def frechet_distance(first: Features, second: Features) -> float:
    """Return the Fréchet distance of two sets of features (Heusel et al. 2017), FID's mathematics,
    in float64.

    |m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2)), the root's trace as the nuclear norm of the product
    of the centred sets. Few images bias it upwards: compare equal counts only. Raises ValueError
    below two rows.
    """
    a, b = _checked_features(first, second)
    means = a.mean(0) - b.mean(0)
    a = (a - a.mean(0)) / np.sqrt(len(a) - 1)
    b = (b - b.mean(0)) / np.sqrt(len(b) - 1)
    root = np.linalg.norm(a @ b.T, "nuc")
    distance = (means**2).sum() + (a**2).sum() + (b**2).sum() - 2 * root
    return float(max(distance, 0.0))


def kernel_distance(first: Features, second: Features) -> float:
    """Return the unbiased squared maximum mean discrepancy (Binkowski et al. 2018), KID's
    mathematics, in float64.

    The kernel is (x·y / features + 1)^3 over all rows; equal distributions give about 0. ValueError
    below two rows.
    """
    a, b = _checked_features(first, second)
    across = _kernel(a, b).mean()
    return float(_mean_of_others(a) + _mean_of_others(b) - 2 * across)


def _checked_features(*sets: Features) -> list[Features]:
    a, b = arrays = [np.asarray(features, np.float64) for features in sets]
    if min(len(a), len(b)) < 2 or a.shape[1:] != b.shape[1:]:
        raise ValueError(
            f"expected two sets of at least 2 features of one width, got {a.shape} and {b.shape}"
        )
    return arrays


def _kernel(a: Features, b: Features) -> Float[np.ndarray, "a b"]:
    return (a @ b.T / a.shape[1] + 1) ** 3


def _mean_of_others(features: Features) -> float:
    """Return the mean kernel of all pairs of different rows."""
    kernel = _kernel(features, features)
    return (kernel.sum() - np.trace(kernel)) / (len(features) * (len(features) - 1))
