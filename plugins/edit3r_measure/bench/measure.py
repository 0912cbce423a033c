"""All metrics of one item, from what a method shows at the scene's frames."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.interfaces import Loss, LossInputs
from edit3r.types import Cameras
from edit3r_measure.bench.loading import LoadedItem
from edit3r_measure.evaluation.changes import change_outside, edit_strength, edit_uptake
from edit3r_measure.evaluation.clip import ClipSimilarity, direction_similarity
from edit3r_measure.evaluation.consistency import warped_difference
from edit3r_measure.evaluation.features import FeatureNetwork, crops
from edit3r_measure.evaluation.frechet import frechet_distance
from edit3r_measure.evaluation.kernel_distance import kernel_distance
from edit3r_measure.evaluation.metrics import covered_psnr, psnr, ssim

__all__ = ["Instruments", "Shown", "measure", "measure_failure"]


@dataclass(frozen=True)
class Shown:
    """What a method shows. Frames F are the item's, inputs first; held-back ones only where poses are known."""

    images: Float[Tensor, "frame 3 height width"]  # renderings in [0, 1]
    edited: Float[Tensor, "view 3 height width"]  # the 2D edits of the inputs
    depths: Float[Tensor, "frame height width"]  # of the renderings, in the unit of `cameras`
    cameras: Cameras  # batch 1, as rendered
    has_truth: bool  # whether the item's truth is what the editor was to show


@dataclass(frozen=True)
class Instruments:
    """Networks that metrics need; what is absent is not measured."""

    features: tuple[FeatureNetwork, ...] = ()
    clip: ClipSimilarity | None = None
    lpips: Loss | None = None
    _of_photos: dict[tuple, np.ndarray] = field(default_factory=dict)

    def photo_features(self, network: FeatureNetwork, images: Tensor) -> np.ndarray:
        """Features of a scene's photos, kept for its other edits."""
        key = (network.suffix, images.numpy().tobytes())
        if key not in self._of_photos:
            if len(self._of_photos) > 8:
                self._of_photos.clear()
            self._of_photos[key] = network(crops(images))
        return self._of_photos[key]


def measure(item: LoadedItem, shown: Shown, instruments: Instruments) -> dict[str, float]:
    """Metric name to value; NaN where one means nothing for this item."""
    return {
        **_changes(item, shown),
        **_consistency(item, shown),
        **(_truth(item, shown.images, instruments.lpips) if shown.has_truth else {}),
        **_distributions(item, shown, instruments),
        **_clip(item, shown, instruments),
    }


def measure_failure(item: LoadedItem, has_truth: bool) -> dict[str, float]:
    """A failed item shows nothing: black pictures against the truth, none of the wish; the rest is not known."""
    if not has_truth:
        return {"edit-uptake-2d": 0.0}
    return {**_truth(item, torch.zeros_like(item.truth), None), "edit-uptake": 0.0}


def _changes(item: LoadedItem, shown: Shown) -> dict[str, float]:
    """Of all frames whose mask is known; the uptake against the reference's own 2D edit, at its camera."""
    photos, images, masks = _arrays(item.photos.images[0], shown.images, item.masks)
    known = [f for f in range(len(images)) if masks is None or np.isfinite(masks[f]).all()]
    photos, images = photos[known], images[known]
    masks = None if masks is None else masks[known]
    edited = shown.edited[:1].permute(0, 2, 3, 1).numpy()
    return {
        "edit-strength": edit_strength(images, photos, masks),
        "change-outside": float("nan") if masks is None else change_outside(images, photos, masks),
        "edit-uptake-2d": edit_uptake(images[:1], photos[:1], edited, None if masks is None else masks[:1]),
        "edit-strength-2d": edit_strength(edited, photos[:1], None if masks is None else masks[:1]),
    }


def _consistency(item: LoadedItem, shown: Shown) -> dict[str, float]:
    """Along true depth where it is known, else along the method's own."""
    true = item.depths is not None and item.cameras is not None
    depths, cameras = (item.depths, item.cameras) if true else (shown.depths, shown.cameras)
    masks = item.masks if item.masks is None or bool(item.masks.isfinite().all()) else item.masks.nan_to_num(1.0)
    inputs, held_back = range(item.inputs), range(item.inputs, len(shown.images))
    warped = [(a, b) for a in inputs for b in inputs if a != b]
    held = [pair for a in inputs for b in held_back for pair in ((a, b), (b, a))]
    return {
        "consistency-warped": warped_difference(shown.images, depths, cameras, warped, masks),
        "consistency-held-back": warped_difference(shown.images, depths, cameras, held, masks),
    }


def _truth(item: LoadedItem, shown: Float[Tensor, "frame 3 height width"], lpips: Loss | None) -> dict[str, float]:
    """Means over the held-back frames: pictures of places that the method was given no picture of."""
    chosen = slice(item.inputs, None)
    photos, images, masks = _arrays(item.photos.images[0], shown, item.masks)
    truth = item.truth.permute(0, 2, 3, 1).numpy()
    photos, images, truth = photos[chosen], images[chosen], truth[chosen]
    inside = np.ones(truth.shape[:3]) if masks is None else masks[chosen]
    result = {
        "psnr": np.mean([psnr(a, b) for a, b in zip(images, truth)]),
        "psnr-in-edit": np.mean([covered_psnr(a, b, m > 0) for a, b, m in zip(images, truth, inside)]),
        "ssim": np.mean([ssim(a, b) for a, b in zip(images, truth)]),
        "edit-uptake": edit_uptake(images, photos, truth, inside),
    }
    if lpips is not None:
        result["lpips"] = lpips(LossInputs(rendered=shown[None, chosen], target=item.truth[None, chosen]))
    return {name: float(value) for name, value in result.items()}


def _distributions(item: LoadedItem, shown: Shown, instruments: Instruments) -> dict[str, float]:
    """C-FID and C-KID: renderings of this edit against the photos of its own scene, by pieces."""
    result = {}
    for network in instruments.features:
        photos = instruments.photo_features(network, item.photos.images[0])
        rendered = network(crops(shown.images))
        result[f"c-fid{network.suffix}"] = frechet_distance(rendered, photos)
        result[f"c-kid{network.suffix}"] = kernel_distance(rendered, photos)
    return result


def _clip(item: LoadedItem, shown: Shown, instruments: Instruments) -> dict[str, float]:
    if instruments.clip is None:
        return {}
    record = item.record
    after = record.description or record.prompt
    result = {"clip-t2i": float(instruments.clip(shown.images, [after]).mean())}
    if record.before:
        photos = item.photos.images[0]
        direction = direction_similarity(instruments.clip, photos, shown.images, record.before, after)
        result["clip-direction"] = float(direction.mean())
    return result


def _arrays(*tensors: Tensor | None) -> Iterator[np.ndarray | None]:
    """Channels last for pictures; masks as they are."""
    for tensor in tensors:
        if tensor is None:
            yield None
        else:
            yield (tensor.permute(0, 2, 3, 1) if tensor.ndim == 4 else tensor).double().numpy()


METRIC_ORDER: Sequence[str] = (
    "psnr",
    "psnr-in-edit",
    "ssim",
    "lpips",
    "edit-uptake",
    "edit-uptake-2d",
    "edit-strength",
    "edit-strength-2d",
    "change-outside",
    "consistency-warped",
    "consistency-held-back",
    "clip-t2i",
    "clip-direction",
    "c-fid",
    "c-kid",
    "c-fid-effnet",
    "c-kid-effnet",
)
"""As reports list them."""
