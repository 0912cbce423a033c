"""Every number that says how good an image, a set of images, a depth map or an edit is.

Unless a signature says otherwise, images are NumPy arrays `[height, width, 3]` and sets of images
`[view, height, width, 3]`, sRGB in [0, 1]; masks are in [0, 1], 1 where an edit belongs.
Similarities by CLIP and the networks behind the distances between sets of images are in `features`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter
from skimage.color import rgb2gray
from skimage.measure import blur_effect
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from torch import Tensor

from edit3r.compute.changes import change_uptake
from edit3r.contract.types import Cameras
from edit3r.geometry.cameras import invert_rigid, to_pixels
from edit3r.geometry.maps import dilate
from edit3r.geometry.warping import find_correspondences, warp

Image = Float[np.ndarray, "height width 3"]
Images = Float[np.ndarray, "view height width 3"]
Masks = Float[np.ndarray, "view height width"]
Features = Float[np.ndarray, "n feature"]

# Standard deviations tried for the best-blurred copy [pixels]
BLURS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)

LOW_PASS = 0.015
"""Standard deviation of the low-pass before changes are measured [image widths]: a rendering that
is a little blurred or shifted has not been edited.
"""

# A warped point whose depth differs from what the other view sees by more than this share is hidden
# there
DEPTH_TOLERANCE = 0.03

REGIONS = ("edit", "band", "background")

BAND = 0.05  # width of the band around an edit [image widths]
# a match counts when its descriptor is nearer than this share of the second nearest's distance
# (Lowe 2004)
RATIO = 0.8

KERNEL_DEGREE, KERNEL_OFFSET = 3, 1.0  # of KID's polynomial kernel
DRAWS, CONFIDENCE = 2000, 0.95  # of the bootstrap


# One image against another.


def psnr(
    image: np.ndarray,
    target: np.ndarray,
    covered: Bool[np.ndarray, "height width"] | None = None,
) -> float:
    """Return the peak signal-to-noise ratio [dB] of `image` clipped to [0, 1], over the `covered`
    pixels if given.

    Any equal shapes; infinite if they are equal, NaN when nothing is covered.
    """
    if covered is not None:
        if not covered.any():
            return float("nan")
        image, target = image[covered], target[covered]
    with np.errstate(divide="ignore"):
        return float(
            peak_signal_noise_ratio(target, np.clip(image, 0, 1), data_range=1.0)
        )


def ssim(
    image: Image,
    target: Image,
    covered: Bool[np.ndarray, "height width"] | None = None,
    gaussian: bool = False,
) -> float:
    """Return the mean structural similarity in [-1, 1] (Wang et al. 2004, mean over channels).

    In windows of 7x7 pixels, or as much as fits, or weighted by a Gaussian of 1.5 pixels in 11x11.
    Over the windows whose middle is a `covered` pixel if given, NaN when none is. Raises ValueError
    where no window fits.
    """
    window = 11 if gaussian else min(7, *target.shape[:2])
    if not 3 <= window <= min(target.shape[:2]):
        raise ValueError(
            f"ssim: expected pictures of at least {max(3, window)} pixels a side, got "
            f"{target.shape[:2]}"
        )
    clipped = np.clip(image, 0, 1).astype(target.dtype)
    weights = (
        {"gaussian_weights": True}
        if gaussian
        else {"win_size": window - 1 + window % 2}
    )
    mean, values = structural_similarity(
        clipped, target, **weights, channel_axis=-1, data_range=1.0, full=True
    )
    if covered is None:
        return float(mean)
    return float(values[covered].mean()) if covered.any() else float("nan")


def regions(masks: Masks) -> dict[str, Bool[np.ndarray, "view height width"]]:
    """Return where the edit belongs, the band of width BAND around that, and the background; each
    pixel is in one.
    """
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
    grey = (rgb2gray(picture.astype(np.float64)) for picture in (image, photo))
    of_image, of_photo = (cv2.Laplacian(picture, cv2.CV_64F).var() for picture in grey)
    return float(of_image / of_photo) if of_photo > 1e-12 else float("nan")


def blur(image: Image) -> float:
    """Return the blur effect in [0, 1], 0 sharp (Crete et al. 2007, scikit-image): no reference, no
    weights.
    """
    return float(blur_effect(image, channel_axis=-1))


def best_blurred_copy(
    photos: Iterable[Image],
    target: Image,
    covered: Bool[np.ndarray, "height width"] | None = None,
) -> tuple[float, float]:
    """Return the highest PSNR [dB] that any photo reaches under any Gaussian blur, and the SSIM of
    that copy.

    It is what knowing no geometry gives. The PSNR counts the `covered` pixels only, if given, the
    SSIM all.
    """
    copies = (
        gaussian_filter(photo, (sigma, sigma, 0)) for photo in photos for sigma in BLURS
    )
    score, copy = max(
        ((psnr(copy, target, covered), copy) for copy in copies),
        key=lambda scored: scored[0],
    )
    return score, ssim(copy, target)


# What an edit did. Distances to the unedited photos reward doing nothing; these do not.


def edit_strength(shown: Images, photos: Images, masks: Masks | None = None) -> float:
    """Return the mean absolute change from photo to `shown` inside the masks, low-passed [sRGB];
    NaN for empty ones.
    """
    return _weighted_change(
        shown, photos, np.ones(photos.shape[:3]) if masks is None else masks
    )


def change_outside(shown: Images, photos: Images, masks: Masks) -> float:
    """Return the mean absolute change outside the masks, low-passed [sRGB], errors of
    reconstruction included.

    NaN when they leave nothing outside.
    """
    return _weighted_change(shown, photos, (masks == 0).astype(np.float64))


def edit_uptake(
    shown: Images, before: Images, wished: Images, masks: Masks | None = None
) -> float:
    """Return the share of the wished change that `shown` has inside the masks: the projection of
    its change on that.

    1: all of it; 0: none, something unrelated, or no change wished; below 0: the opposite. Blur
    counts for nothing.
    """
    return change_uptake(
        shown - before,
        wished - before,
        np.ones(1) if masks is None else masks[..., None],
    )


def _weighted_change(shown: Images, photos: Images, weight: Masks) -> float:
    total = float(weight.sum())
    if total == 0:
        return float("nan")
    sigma = LOW_PASS * photos.shape[2]
    difference = gaussian_filter(shown - photos, (0, sigma, sigma, 0))
    return float((np.abs(difference).mean(-1) * weight).sum() / total)


# Whether the views of one scene agree.


def warped_difference(
    images: Float[Tensor, "frame 3 height width"],
    depths: Float[Tensor, "frame height width"],
    cameras: Cameras,
    pairs: Iterable[tuple[int, int]],
    masks: Float[Tensor, "frame height width"] | None = None,
) -> float:
    """Return the mean absolute difference [sRGB] of pixels that two frames both see, over `pairs`
    (from, to) of them.

    `depths` camera z, 0 unknown; `cameras` batch 1; `masks` weight the first frame's pixels. 0 when
    all agree, nearly: pixels are interpolated. NaN when no pixel is seen twice.
    """
    difference, weight = 0.0, 0.0
    for a, b in pairs:
        warped, seen = warped_image(
            images[b], depths[a], depths[b], cameras.select([a, b])
        )
        counted = seen.to(images.dtype) * (1 if masks is None else masks[a])
        difference += float(((warped - images[a]).abs().mean(0) * counted).sum())
        weight += float(counted.sum())
    return difference / weight if weight > 0 else float("nan")


def warped_image(
    image: Float[Tensor, "3 height width"],
    depth: Float[Tensor, "height width"],
    other_depth: Float[Tensor, "height width"],
    cameras: Cameras,
) -> tuple[Float[Tensor, "3 height width"], Bool[Tensor, "height width"]]:
    """Return the second camera's `image` as the first sees it, and where both see one point;
    `depth` is the first's.
    """
    found = find_correspondences(
        torch.stack((depth, other_depth))[None], cameras.intrinsics, cameras.c2w
    )
    coordinates, same_depth = (
        found.coordinates[0, 0],
        (found.depth_ratio[0, 0].exp() - 1).abs() <= DEPTH_TOLERANCE,
    )
    return warp(image, coordinates), (found.inside[0, 0] > 0) & (depth > 0) & same_depth


def matched_points(
    first: Image, second: Image
) -> tuple[Float[np.ndarray, "match 2"], Float[np.ndarray, "match 2"]]:
    """Return where the same SIFT features lie in two images [pixels, centre of the top-left pixel
    at (0.5, 0.5)].

    A match is each other's nearest and passes the ratio test.
    """
    sift, matcher = cv2.SIFT_create(), cv2.BFMatcher()
    found = [
        sift.detectAndCompute((image.clip(0, 1) * 255).round().astype(np.uint8), None)
        for image in (first, second)
    ]
    (points, features), (others, other_features) = found
    if min(len(points), len(others)) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    back = {
        match.queryIdx: match.trainIdx
        for match in matcher.match(other_features, features)
    }
    pairs = [
        (best.queryIdx, best.trainIdx)
        for best, next_best in matcher.knnMatch(features, other_features, k=2)
        if best.distance < RATIO * next_best.distance
        and back.get(best.trainIdx) == best.queryIdx
    ]
    places = [np.array([p.pt for p in own]) + 0.5 for own in (points, others)]
    return tuple(
        own[[pair[i] for pair in pairs]].reshape(-1, 2) for i, own in enumerate(places)
    )


def epipolar_distances(
    first: Float[np.ndarray, "match 2"],
    second: Float[np.ndarray, "match 2"],
    cameras: Cameras,
) -> Float[np.ndarray, "match"]:
    """Return each point's mean distance in both images from its match's epipolar line [pixels]; 0
    is best.
    """
    k = to_pixels(cameras.intrinsics[0].double(), cameras.image_size)
    c2w = cameras.c2w[0].double()
    motion = invert_rigid(c2w[1]) @ c2w[0]
    x, y, z = motion[:3, 3].tolist()
    essential = motion.new_tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ motion[:3, :3]
    fundamental = (
        torch.linalg.inv(k[1]).T @ essential @ torch.linalg.inv(k[0])
    ).numpy()
    a, b = (
        np.column_stack((points, np.ones(len(points)))) for points in (first, second)
    )
    lines, back = a @ fundamental.T, b @ fundamental
    residual = np.abs((b * lines).sum(1))
    return (residual / np.hypot(*lines.T[:2]) + residual / np.hypot(*back.T[:2])) / 2


# Two sets of images, by the features of a network.


def frechet_distance(first: Features, second: Features) -> float:
    """Return the Fréchet distance of two sets of features (Heusel et al. 2017), FID's mathematics,
    in float64.

    |m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2)), the root's trace as the nuclear norm of the product of the centred
    sets. Few images bias it upwards: compare equal counts only. Raises ValueError below two rows.
    """
    a, b = _feature_sets(first, second)
    mean_a, mean_b = a.mean(0), b.mean(0)
    a, b = (a - mean_a) / np.sqrt(len(a) - 1), (b - mean_b) / np.sqrt(len(b) - 1)
    root = np.linalg.svd(a @ b.T, compute_uv=False).sum()
    distance = (
        np.square(mean_a - mean_b).sum()
        + np.square(a).sum()
        + np.square(b).sum()
        - 2 * root
    )
    return float(max(distance, 0.0))


def kernel_distance(first: Features, second: Features) -> float:
    """Return the unbiased squared maximum mean discrepancy (Binkowski et al. 2018), KID's
    mathematics, in float64.

    The kernel is (x·y / features + 1)^3 over all rows; equal distributions give about 0. ValueError
    below two rows.
    """
    a, b = _feature_sets(first, second)
    return float(_mean_of_others(a) + _mean_of_others(b) - 2 * _kernel(a, b).mean())


def _feature_sets(*sets: Features) -> list[Features]:
    a, b = arrays = [np.asarray(features, np.float64) for features in sets]
    if min(len(a), len(b)) < 2 or a.shape[1:] != b.shape[1:]:
        raise ValueError(
            f"expected two sets of at least 2 features of one width, got {a.shape} and {b.shape}"
        )
    return arrays


def _kernel(
    a: Float[np.ndarray, "a feature"], b: Float[np.ndarray, "b feature"]
) -> Float[np.ndarray, "a b"]:
    return (a @ b.T / a.shape[1] + KERNEL_OFFSET) ** KERNEL_DEGREE


def _mean_of_others(features: Features) -> float:
    """Return the mean kernel of all pairs of different rows."""
    kernel = _kernel(features, features)
    return (kernel.sum() - np.trace(kernel)) / (len(features) * (len(features) - 1))


# How sure a mean is.


@dataclass(frozen=True)
class Interval:
    """A mean and where it lies with 95 % confidence; low = high = mean for a single scene's worth
    of data.
    """

    mean: float
    low: float
    high: float
    scenes: int  # that had a value


def bootstrap_mean(
    values: Mapping[str, Sequence[float]], seed: int = 0
) -> Interval | None:
    """Return the mean over scenes of each scene's mean with a percentile interval, whole scenes
    drawn; NaN is left out.

    `values` are by scene; None when no scene has a value.
    """
    finite = {
        scene: [v for v in of_scene if np.isfinite(v)]
        for scene, of_scene in values.items()
    }
    means = np.array([np.mean(of_scene) for of_scene in finite.values() if of_scene])
    if len(means) == 0:
        return None
    picks = np.random.default_rng(seed).integers(len(means), size=(DRAWS, len(means)))
    edge = (1 - CONFIDENCE) / 2
    low, high = np.quantile(means[picks].mean(1), (edge, 1 - edge))
    return Interval(float(means.mean()), float(low), float(high), len(means))
