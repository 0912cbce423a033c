"""All metrics of one benchmark item, from what a method shows at the scene's frames, and the score
made of them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from edit3r.config import Settings
from edit3r.contract.interfaces import Loss, LossInputs
from edit3r.contract.types import Cameras
from edit3r.plugins.registry import Registry
from edit3r_measure import metrics
from edit3r_measure.bench_manifest import LoadedItem
from edit3r_measure.features import (
    ClipSimilarity,
    EffnetFeatures,
    FeatureNetwork,
    InceptionFeatures,
    crops,
    direction_similarity,
    prompt_quality,
)

METRICS: Mapping[str, tuple[str, str]] = {
    "score": ("↑", ".3f"),
    "psnr": ("↑", ".2f"),
    "psnr-in-edit": ("↑", ".2f"),
    "ssim": ("↑", ".3f"),
    "lpips": ("↓", ".3f"),
    "perceptual": ("↓", ".3f"),
    "edit-uptake": ("↑", ".3f"),
    "edit-uptake-2d": ("↑", ".3f"),
    "edit-strength": ("", ".3f"),  # neither is better: it says what the edit was like
    "edit-strength-2d": ("", ".3f"),
    "change-outside": ("↓", ".3f"),
    "consistency-2d": ("↓", ".3f"),
    "consistency-warped": ("↓", ".3f"),
    "consistency-held-back": ("↓", ".3f"),
    "matches": ("↑", ".1f"),
    "epipolar-error": ("↓", ".2f"),
    "order-change": ("↓", ".4f"),
    "sharpness": ("", ".3f"),  # 1 is best
    "blur": ("↓", ".3f"),
    "clip-iqa": ("↑", ".3f"),
    "clip-iqa-sharp": ("↑", ".3f"),
    "clip-t2i": ("↑", ".3f"),
    "clip-t2i-prompt": ("↑", ".3f"),
    "clip-direction": ("↑", ".3f"),
    "c-fid": ("↓", ".1f"),
    "c-kid": ("↓", ".3f"),
    "c-fid-effnet": ("↓", ".0f"),
    "c-kid-effnet": ("↓", ".3f"),
}
"""Each metric with its better direction and its number format, in the order of reports."""

AGAINST_TRUTH = ("psnr", "ssim", "lpips", "perceptual")

BY_REGION: Mapping[str, tuple[str, str]] = {
    f"{name}-in-{region}{frames}": METRICS[name]
    for name in AGAINST_TRUTH
    for frames in ("", "-inputs")
    for region in metrics.REGIONS
    if (name, region, frames) != ("psnr", "edit", "")
}
"""The measures against the truth by region: at held-back views, and at those that the method was
given.
"""

LEFT_ALONE = (
    0.005  # change of the 2D edit below which the editor did nothing [sRGB, low-passed]
)
NOT_CARRIED = 0.15  # share of the 2D edit below which the scene counts as unchanged
# Change of the 2D edit from which it counts as one, where no truth says how strong it should be
# [sRGB, low-passed]
FULL_STRENGTH = 0.04
# disagreement between views, or change outside the masks, at which nothing is left of that share
# [sRGB]
SPOILED = 0.1
PHOTOS_KEPT = 8  # scenes whose photos' features are kept for the scene's other edits


class MetricSettings(Settings):
    """Which networks metrics are measured with; what is not given is not measured."""

    effnet: bool = Field(
        True,
        description="C-FID and C-KID variants on EfficientNet features; needs the extra train",
    )
    inception: str = Field(
        "",
        description="TorchScript file inception-2015-12-05.pt for C-FID and C-KID; '': without",
    )
    clip: str = Field(
        "", description="CLIP model or folder for t2i and direction; '': without"
    )
    lpips: bool = Field(
        False, description="LPIPS against the truth; needs the extra lpips"
    )


@dataclass(frozen=True)
class MethodOutput:
    """What a method shows at the item's frames, inputs first; held-back frames only where poses are
    known.
    """

    images: Float[Tensor, "frame 3 height width"]  # renderings in [0, 1]
    edited: Float[Tensor, "view 3 height width"]  # the 2D edits of the inputs
    depths: Float[
        Tensor, "frame height width"
    ]  # of the renderings, in the unit of `cameras`
    cameras: Cameras  # batch 1, as rendered
    has_truth: bool  # whether the item's truth is what the editor was to show
    reordered: Float[Tensor, "some 3 height width"] | None = (
        None  # reference and held-back frames, inputs permuted
    )


class MetricNetworks:
    """The networks that metrics need; what is not asked for is absent and not measured."""

    def __init__(self, settings: MetricSettings, registry: Registry) -> None:
        """Load them. Raises MissingDependencyError when the package of one is not installed."""
        self.features: list[FeatureNetwork] = (
            [InceptionFeatures(settings.inception)] if settings.inception else []
        )
        if settings.effnet:
            self.features.append(EffnetFeatures())
        self.clip = ClipSimilarity(settings.clip) if settings.clip else None
        wanted = {"lpips": settings.lpips, "perceptual": settings.effnet}
        self.distances: dict[str, Loss] = {
            name: registry.build("loss", name) for name, use in wanted.items() if use
        }
        self._of_photos: dict[tuple, np.ndarray] = {}

    def photo_features(
        self, network: FeatureNetwork, photos: Float[Tensor, "frame 3 height width"]
    ) -> Float[np.ndarray, "piece feature"]:
        """Return the features of a scene's photos, which are kept for its other edits."""
        key = (network.suffix, photos.numpy().tobytes())
        if key not in self._of_photos:
            if len(self._of_photos) > PHOTOS_KEPT:
                self._of_photos.clear()
            self._of_photos[key] = network(crops(photos))
        return self._of_photos[key]


def measure(
    item: LoadedItem, output: MethodOutput, networks: MetricNetworks
) -> dict[str, float]:
    """Return every metric by name, NaN where one means nothing for this item."""
    found = {
        **_changes(item, output),
        **_consistency(item, output),
        **_looks(item, output),
    }
    if output.has_truth:
        found |= _against_truth(item, output.images, networks.distances)
    if output.reordered is not None:
        kept = output.images[
            [0, *range(item.inputs, item.inputs + len(output.reordered) - 1)]
        ]
        found["order-change"] = float((output.reordered - kept).abs().mean())
    for network in (
        networks.features
    ):  # pieces of this edit's renderings against those of its own scene's photos
        photos, rendered = (
            networks.photo_features(network, item.photos.images[0]),
            network(crops(output.images)),
        )
        found[f"c-fid{network.suffix}"] = metrics.frechet_distance(rendered, photos)
        found[f"c-kid{network.suffix}"] = metrics.kernel_distance(rendered, photos)
    if networks.clip is not None:
        before, after = (
            item.record.before,
            item.record.description or item.record.prompt,
        )
        described, instructed = (
            networks.clip(output.images, [after, item.record.prompt]).mean(0).tolist()
        )
        found |= {"clip-t2i": described, "clip-t2i-prompt": instructed}
        found["clip-iqa"] = prompt_quality(
            networks.clip, output.images, "Good photo.", "Bad photo."
        )
        found["clip-iqa-sharp"] = prompt_quality(
            networks.clip, output.images, "Sharp photo.", "Blurry photo."
        )
        if before:
            moved = direction_similarity(
                networks.clip, item.photos.images[0], output.images, before, after
            )
            found["clip-direction"] = float(moved.mean())
    return found


def measure_failure(
    item: LoadedItem, has_truth: bool, networks: MetricNetworks
) -> dict[str, float]:
    """Return the metrics of a failure: black images against the truth, nothing of the edit; the
    rest is not known.
    """
    if not has_truth:
        return {"edit-uptake-2d": 0.0}
    return {
        **_against_truth(item, torch.zeros_like(item.truth), networks.distances),
        "edit-uptake": 0.0,
    }


def score(found: Mapping[str, float], failure: str = "") -> float:
    """Return one number in [0, 1] for an edit: arrived x sqrt(agrees x stays put); 0 for a failure.

    No single virtue wins: C-FID, C-KID and consistency reward doing nothing, strength rewards
    destroying the scene. Arrived is the uptake of the true change at held-back views; without
    truth, the uptake of the 2D edit at its own view times min(1, its strength / FULL_STRENGTH).
    Agrees is 1 - (mean of both consistencies) / SPOILED, and 0 where no point is seen twice. Stays
    put is 1 - change outside / SPOILED, and 1 for global edits. All are held in [0, 1]. What is not
    in it: whether the edit is the one that was asked for where there is no truth (CLIP), and how
    sharp it is (PSNR, SSIM, C-KID).
    """
    if failure:
        return 0.0
    if "edit-uptake" in found:
        arrived = _share(found["edit-uptake"])
    else:
        arrived = _share(found["edit-uptake-2d"]) * min(
            1.0, found["edit-strength-2d"] / FULL_STRENGTH
        )
    known = [
        value
        for name in ("warped", "held-back")
        if math.isfinite(value := found[f"consistency-{name}"])
    ]
    agrees = _share(1 - sum(known) / len(known) / SPOILED) if known else 0.0
    outside = found["change-outside"]
    stays_put = 1.0 if math.isnan(outside) else _share(1 - outside / SPOILED)
    return arrived * math.sqrt(agrees * stays_put)


def remark(found: Mapping[str, float]) -> str:
    """Return in words what the numbers of an edit without failure hide: that nothing was edited, or
    nothing arrived.
    """
    wished, shown = (
        found.get("edit-strength-2d", math.nan),
        found.get("edit-uptake-2d", math.nan),
    )
    if wished < LEFT_ALONE:
        return "the 2D editor left the reference as it was."
    if shown < NOT_CARRIED:
        return f"edit ran, scene unchanged: the scene shows {shown:.0%} of the 2D edit (mean change {wished:.3f})."
    return ""


def _share(value: float) -> float:
    return min(1.0, max(0.0, value))


def _changes(item: LoadedItem, output: MethodOutput) -> dict[str, float]:
    """Measure all frames whose mask is known, and the reference's own 2D edit at its camera."""
    photos, images = _array(item.photos.images[0]), _array(output.images)
    masks = None if item.masks is None else _array(item.masks)
    if masks is not None:
        known = np.isfinite(masks).all((1, 2))
        photos, images, masks = photos[known], images[known], masks[known]
    reference = None if masks is None else masks[:1]
    edited = output.edited[:1].permute(0, 2, 3, 1).numpy()
    return {
        "edit-strength": metrics.edit_strength(images, photos, masks),
        "change-outside": float("nan")
        if masks is None
        else metrics.change_outside(images, photos, masks),
        "edit-uptake-2d": metrics.edit_uptake(
            images[:1], photos[:1], edited, reference
        ),
        "edit-strength-2d": metrics.edit_strength(edited, photos[:1], reference),
    }


def _consistency(item: LoadedItem, output: MethodOutput) -> dict[str, float]:
    """Compare the frames along true depth where it is known, else along the method's own."""
    true = item.depths is not None and item.cameras is not None
    depths, cameras = (
        (item.depths, item.cameras) if true else (output.depths, output.cameras)
    )
    masks = None if item.masks is None else item.masks.nan_to_num(1.0)
    inputs, held_back = range(item.inputs), range(item.inputs, len(output.images))
    warped = [(a, b) for a in inputs for b in inputs if a != b]
    held = [pair for a in inputs for b in held_back for pair in ((a, b), (b, a))]
    return {
        "consistency-2d": metrics.warped_difference(
            output.edited, depths, cameras, warped, masks
        ),
        "consistency-warped": metrics.warped_difference(
            output.images, depths, cameras, warped, masks
        ),
        "consistency-held-back": metrics.warped_difference(
            output.images, depths, cameras, held, masks
        ),
        **_matching(_array(output.images), cameras),
    }


def _matching(images: metrics.Images, cameras: Cameras) -> dict[str, float]:
    """Match every two frames; the error is the median over the matches of all of them."""
    pairs = list(combinations(range(len(images)), 2))
    found = [metrics.matched_points(images[a], images[b]) for a, b in pairs]
    errors = np.concatenate(
        [
            metrics.epipolar_distances(*points, cameras.select(pair))
            for points, pair in zip(found, map(list, pairs))
        ]
    )
    return {
        "matches": len(errors) / len(pairs),
        "epipolar-error": float(np.median(errors)) if len(errors) else math.nan,
    }


def _looks(item: LoadedItem, output: MethodOutput) -> dict[str, float]:
    """Return means over all frames of what is judged by each image alone, or beside its photo."""
    images, photos = _array(output.images), _array(item.photos.images[0])
    return {
        "sharpness": float(
            np.mean([metrics.sharpness(*pair) for pair in zip(images, photos)])
        ),
        "blur": float(np.mean([metrics.blur(image) for image in images])),
    }


def _against_truth(
    item: LoadedItem,
    shown: Float[Tensor, "frame 3 height width"],
    distances: Mapping[str, Loss],
) -> dict[str, float]:
    """Return means over the held-back frames, of which the method was given no image, and by region
    over the inputs.
    """
    held = slice(item.inputs, None)
    images, truth = _array(shown), item.truth.permute(0, 2, 3, 1).numpy()
    inside = np.ones(truth.shape[:3]) if item.masks is None else _array(item.masks)
    photos = _array(item.photos.images[0])
    found = {
        "edit-uptake": metrics.edit_uptake(
            images[held], photos[held], truth[held], inside[held]
        )
    }
    found |= _distances(images[held], truth[held], None, distances)
    for region, covered in metrics.regions(inside).items():
        for frames, part in (("", held), ("-inputs", slice(item.inputs))):
            values = _distances(images[part], truth[part], covered[part], distances)
            found |= {
                f"{name}-in-{region}{frames}": value for name, value in values.items()
            }
    return found


def _distances(
    images: metrics.Images,
    truth: metrics.Images,
    covered: Bool[np.ndarray, "view height width"] | None,
    distances: Mapping[str, Loss],
) -> dict[str, float]:
    """Return means over the views, of the `covered` pixels if given; views where nothing is covered
    do not count.

    Networks see the truth with only the covered pixels replaced; their distance is divided by the
    share of these.
    """
    areas = [None] * len(truth) if covered is None else list(covered)
    views = [
        view for view in zip(images, truth, areas) if view[2] is None or view[2].any()
    ]
    if not views:
        return dict.fromkeys(("psnr", "ssim", *distances), math.nan)
    found = {
        name: float(np.mean([measure(*view) for view in views]))
        for name, measure in PLAIN.items()
    }
    shown = np.stack(
        [
            image if area is None else np.where(area[..., None], image, wished)
            for image, wished, area in views
        ]
    )
    share = (
        1.0
        if covered is None
        else float(np.mean([area.mean() for _, _, area in views]))
    )
    pair = [
        torch.from_numpy(x).permute(0, 3, 1, 2)[None].float()
        for x in (shown, np.stack([v[1] for v in views]))
    ]
    inputs = LossInputs(rendered=pair[0], target=pair[1])
    return found | {
        name: float(distance(inputs)) / share for name, distance in distances.items()
    }


PLAIN = {"psnr": metrics.psnr, "ssim": metrics.ssim}


def _array(tensor: Float[Tensor, "frame *shape"]) -> Float[np.ndarray, "frame *shape"]:
    """Return images `[frame, 3, height, width]` with channels last and masks `[frame, height,
    width]`, in float64.
    """
    return (tensor.permute(0, 2, 3, 1) if tensor.ndim == 4 else tensor).double().numpy()
