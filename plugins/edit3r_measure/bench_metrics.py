"""All metrics of one benchmark item, from what a method shows at the scene's frames, and the score made of them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.config import Settings
from edit3r.interfaces import Loss, LossInputs
from edit3r.registry import Registry
from edit3r.types import Cameras
from edit3r_measure import metrics
from edit3r_measure.bench_manifest import LoadedItem
from edit3r_measure.features import (
    ClipSimilarity,
    EffnetFeatures,
    FeatureNetwork,
    InceptionFeatures,
    crops,
    direction_similarity,
)

METRICS: Mapping[str, tuple[str, str]] = {
    "score": ("↑", ".3f"),
    "psnr": ("↑", ".2f"),
    "psnr-in-edit": ("↑", ".2f"),
    "ssim": ("↑", ".3f"),
    "lpips": ("↓", ".3f"),
    "edit-uptake": ("↑", ".3f"),
    "edit-uptake-2d": ("↑", ".3f"),
    "edit-strength": ("", ".3f"),  # neither is better: it says what the edit was like
    "edit-strength-2d": ("", ".3f"),
    "change-outside": ("↓", ".3f"),
    "consistency-warped": ("↓", ".3f"),
    "consistency-held-back": ("↓", ".3f"),
    "clip-t2i": ("↑", ".3f"),
    "clip-direction": ("↑", ".3f"),
    "c-fid": ("↓", ".1f"),
    "c-kid": ("↓", ".3f"),
    "c-fid-effnet": ("↓", ".0f"),
    "c-kid-effnet": ("↓", ".3f"),
}
"""Each metric with its better direction and its number format, in the order of reports."""

FULL_STRENGTH = 0.04
"""Change of the 2D edit from which it counts as one, where no truth says how strong it should be [sRGB, low-passed]."""

SPOILED = 0.1
"""Disagreement between views, or change outside the masks, at which nothing is left of that share [sRGB]."""

PHOTOS_KEPT = 8
"""Scenes whose photos' features are kept for the scene's other edits."""


class MetricSettings(Settings):
    """Which networks metrics are measured with; what is not given is not measured."""

    effnet: bool = Field(True, description="C-FID and C-KID variants on EfficientNet features; needs the extra train")
    inception: str = Field("", description="TorchScript file inception-2015-12-05.pt for C-FID and C-KID; '': without")
    clip: str = Field("", description="CLIP model or folder for t2i and direction; '': without")
    lpips: bool = Field(False, description="LPIPS against the truth; needs the extra lpips")


@dataclass(frozen=True)
class MethodOutput:
    """What a method shows at the item's frames, inputs first; held-back frames only where poses are known."""

    images: Float[Tensor, "frame 3 height width"]  # renderings in [0, 1]
    edited: Float[Tensor, "view 3 height width"]  # the 2D edits of the inputs
    depths: Float[Tensor, "frame height width"]  # of the renderings, in the unit of `cameras`
    cameras: Cameras  # batch 1, as rendered
    has_truth: bool  # whether the item's truth is what the editor was to show


class MetricNetworks:
    """The networks that metrics need; what is not asked for is absent and not measured."""

    def __init__(self, settings: MetricSettings, registry: Registry) -> None:
        """Load them. Raises MissingDependencyError when the package of one is not installed."""
        self.features: list[FeatureNetwork] = [InceptionFeatures(settings.inception)] if settings.inception else []
        if settings.effnet:
            self.features.append(EffnetFeatures())
        self.clip = ClipSimilarity(settings.clip) if settings.clip else None
        self.lpips: Loss | None = registry.build("loss", "lpips") if settings.lpips else None
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


def measure(item: LoadedItem, output: MethodOutput, networks: MetricNetworks) -> dict[str, float]:
    """Return every metric by name, NaN where one means nothing for this item."""
    found = {**_changes(item, output), **_consistency(item, output)}
    if output.has_truth:
        found |= _against_truth(item, output.images, networks.lpips)
    for network in networks.features:  # pieces of this edit's renderings against those of its own scene's photos
        photos, rendered = networks.photo_features(network, item.photos.images[0]), network(crops(output.images))
        found[f"c-fid{network.suffix}"] = metrics.frechet_distance(rendered, photos)
        found[f"c-kid{network.suffix}"] = metrics.kernel_distance(rendered, photos)
    if networks.clip is not None:
        before, after = item.record.before, item.record.description or item.record.prompt
        found["clip-t2i"] = float(networks.clip(output.images, [after]).mean())
        if before:
            moved = direction_similarity(networks.clip, item.photos.images[0], output.images, before, after)
            found["clip-direction"] = float(moved.mean())
    return found


def measure_failure(item: LoadedItem, has_truth: bool) -> dict[str, float]:
    """Return the metrics of a failure: black images against the truth, nothing of the edit; the rest is not known."""
    if not has_truth:
        return {"edit-uptake-2d": 0.0}
    return {**_against_truth(item, torch.zeros_like(item.truth), None), "edit-uptake": 0.0}


def score(found: Mapping[str, float], failure: str = "") -> float:
    """Return one number in [0, 1] for an edit: arrived x sqrt(agrees x stays put); 0 for a failure.

    No single virtue wins: C-FID, C-KID and consistency reward doing nothing, strength rewards destroying the scene.
    Arrived is the uptake of the true change at held-back views; without truth, the uptake of the 2D edit at its own
    view times min(1, its strength / FULL_STRENGTH). Agrees is 1 - (mean of both consistencies) / SPOILED, and 0 where
    no point is seen twice. Stays put is 1 - change outside / SPOILED, and 1 for global edits. All are held in [0, 1].
    What is not in it: whether the edit is the one that was asked for where there is no truth (CLIP), and how sharp it
    is (PSNR, SSIM, C-KID).
    """
    if failure:
        return 0.0
    if "edit-uptake" in found:
        arrived = _share(found["edit-uptake"])
    else:
        arrived = _share(found["edit-uptake-2d"]) * min(1.0, found["edit-strength-2d"] / FULL_STRENGTH)
    known = [value for name in ("warped", "held-back") if math.isfinite(value := found[f"consistency-{name}"])]
    agrees = _share(1 - sum(known) / len(known) / SPOILED) if known else 0.0
    outside = found["change-outside"]
    stays_put = 1.0 if math.isnan(outside) else _share(1 - outside / SPOILED)
    return arrived * math.sqrt(agrees * stays_put)


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
        "change-outside": float("nan") if masks is None else metrics.change_outside(images, photos, masks),
        "edit-uptake-2d": metrics.edit_uptake(images[:1], photos[:1], edited, reference),
        "edit-strength-2d": metrics.edit_strength(edited, photos[:1], reference),
    }


def _consistency(item: LoadedItem, output: MethodOutput) -> dict[str, float]:
    """Compare the frames along true depth where it is known, else along the method's own."""
    true = item.depths is not None and item.cameras is not None
    depths, cameras = (item.depths, item.cameras) if true else (output.depths, output.cameras)
    masks = None if item.masks is None else item.masks.nan_to_num(1.0)
    inputs, held_back = range(item.inputs), range(item.inputs, len(output.images))
    warped = [(a, b) for a in inputs for b in inputs if a != b]
    held = [pair for a in inputs for b in held_back for pair in ((a, b), (b, a))]
    return {
        "consistency-warped": metrics.warped_difference(output.images, depths, cameras, warped, masks),
        "consistency-held-back": metrics.warped_difference(output.images, depths, cameras, held, masks),
    }


def _against_truth(
    item: LoadedItem, shown: Float[Tensor, "frame 3 height width"], lpips: Loss | None
) -> dict[str, float]:
    """Return means over the held-back frames, of which the method was given no image."""
    held = slice(item.inputs, None)
    photos, images = _array(item.photos.images[0][held]), _array(shown[held])
    truth = item.truth[held].permute(0, 2, 3, 1).numpy()
    inside = np.ones(truth.shape[:3]) if item.masks is None else _array(item.masks[held])
    result = {
        "psnr": np.mean([metrics.psnr(a, b) for a, b in zip(images, truth)]),
        "psnr-in-edit": np.mean([metrics.psnr(a, b, m > 0) for a, b, m in zip(images, truth, inside)]),
        "ssim": np.mean([metrics.ssim(a, b) for a, b in zip(images, truth)]),
        "edit-uptake": metrics.edit_uptake(images, photos, truth, inside),
    }
    if lpips is not None:
        result["lpips"] = lpips(LossInputs(rendered=shown[None, held], target=item.truth[None, held]))
    return {name: float(value) for name, value in result.items()}


def _array(tensor: Float[Tensor, "frame *shape"]) -> Float[np.ndarray, "frame *shape"]:
    """Return images `[frame, 3, height, width]` with channels last and masks `[frame, height, width]`, in float64."""
    return (tensor.permute(0, 2, 3, 1) if tensor.ndim == 4 else tensor).double().numpy()
