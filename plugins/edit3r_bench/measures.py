"""All metrics of one benchmark item, from what a method shows at the scene's frames, and the score
made of them.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import permutations, product
from pathlib import Path
from statistics import fmean
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r import Registry
from edit3r.contract.interfaces import LossInputs
from edit3r.contract.settings import Settings
from edit3r.kit.compute.metrics import psnr, ssim
from edit3r.kit.files.configs import read_yaml
from edit3r_bench import metrics
from edit3r_bench.features import (
    ClipSimilarity,
    EffnetFeatures,
    FeatureNetwork,
    InceptionFeatures,
    crops,
    directional_similarity,
)
from edit3r_bench.item import MethodOutput
from edit3r_bench.manifest import Images, LoadedItem
from edit3r_bench.options import MetricSettings

Found = dict[str, float]
"""Values by the name of the measure; NaN where one means nothing."""


class MeasureForm(Settings):
    """A measure as reports show it."""

    better: Literal["↑", "↓", ""]  # "": neither is
    form: str  # of its numbers
    about: str


def _read_measures() -> dict[str, MeasureForm]:
    content = read_yaml(Path(__file__).with_name("measures.yaml"))
    return {name: MeasureForm(**values) for name, values in content.items()}


METRICS = _read_measures()
"""The measures of the main table, in the order of reports."""

BY_REGION = {
    f"{name}-in-{region}": METRICS[name]
    for name in ("psnr", "ssim", "lpips", "perceptual")
    for region in metrics.REGIONS
    if (name, region) != ("psnr", "edit")
}
"""The measures against the truth by region."""

# The numbers of this block: no figures kept.
# Change of the 2D edit below which the editor did nothing [sRGB, low-passed]
LEFT_ALONE = 0.005
NOT_CARRIED = 0.15  # share of the 2D edit below which the scene counts as unchanged
# Change of the 2D edit from which it counts as one, where no truth says how strong it should be
# [sRGB, low-passed]
FULL_STRENGTH = 0.04
# Disagreement between views, or change outside the masks, at which nothing is left of that share
# [sRGB]
SPOILED = 0.1


class MetricNetworks:
    """The networks that metrics need; what is not asked for is absent and not measured."""

    def __init__(self, settings: MetricSettings, registry: Registry) -> None:
        """Load them. Raises MissingDependencyError when the package of one is not installed."""
        self.features: list[FeatureNetwork] = []
        self.distances = {}
        self.clip = ClipSimilarity(settings.clip) if settings.clip else None
        if settings.inception:
            self.features.append(InceptionFeatures(settings.inception))
        if settings.lpips:
            self.distances["lpips"] = registry.build("loss", "lpips")
        if not settings.no_effnet:
            self.features.append(EffnetFeatures())
            self.distances["perceptual"] = registry.build("loss", "perceptual")


def measure(item: LoadedItem, output: MethodOutput, networks: MetricNetworks) -> Found:
    """Return every metric by name, NaN where one means nothing for this item."""
    values = {
        **_changes(item, output),
        **_consistency(item, output),
        "sharpness": _sharpness(item, output),
        **_features(item, output, networks),
    }
    if output.has_truth:
        values |= _against_truth(item, output.images, networks.distances)
    if networks.clip is not None:
        values |= _by_clip(item, output, networks.clip)
    return values


def measure_failure(
    item: LoadedItem, has_truth: bool, networks: MetricNetworks
) -> Found:
    """Of a failure: black images against the truth, nothing of the edit; the rest is not known."""
    if not has_truth:
        return {"edit-uptake-2d": 0.0}
    black = torch.zeros_like(item.photos.images[0])
    return {**_against_truth(item, black, networks.distances), "edit-uptake": 0.0}


def score(metrics: Mapping[str, float], failure: str = "") -> float:
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
    if "edit-uptake" in metrics:
        arrived = _share(metrics["edit-uptake"])
    else:
        strength = min(1.0, metrics["edit-strength-2d"] / FULL_STRENGTH)
        arrived = _share(metrics["edit-uptake-2d"]) * strength
    differences = [metrics["consistency-warped"], metrics["consistency-held-back"]]
    known = [value for value in differences if math.isfinite(value)]
    agrees = _share(1 - fmean(known) / SPOILED) if known else 0.0
    outside = metrics["change-outside"]
    stays_put = 1.0 if math.isnan(outside) else _share(1 - outside / SPOILED)
    return arrived * math.sqrt(agrees * stays_put)


def _share(value: float) -> float:
    return min(1.0, max(0.0, value))


def remark(metrics: Mapping[str, float]) -> str:
    """What the numbers hide, in words: that nothing was edited, or that nothing of it arrived."""
    strength = metrics.get("edit-strength-2d", math.nan)
    shown = metrics.get("edit-uptake-2d", math.nan)
    if strength < LEFT_ALONE:
        return "the 2D editor left the reference unchanged."
    if shown < NOT_CARRIED:
        return (
            f"edit ran, scene unchanged: the scene shows {shown:.0%} of the 2D edit (mean change "
            f"{strength:.3f})."
        )
    return ""


def _changes(item: LoadedItem, output: MethodOutput) -> Found:
    """Measure all frames whose mask is known, and the reference's own 2D edit at its camera."""
    photos = _array(item.photos.images[0])
    images = _array(output.images)
    edited = _array(output.edited[:1])
    masks = reference = None
    outside = math.nan
    if item.masks is not None:
        masks = _array(item.masks)
        known = np.isfinite(masks).all((1, 2))
        photos, images, masks = photos[known], images[known], masks[known]
        reference = masks[:1]
        outside = metrics.change_outside(images, photos, masks)
    return {
        "edit-strength": metrics.edit_strength(images, photos, masks),
        "change-outside": outside,
        "edit-uptake-2d": metrics.edit_uptake(
            images[:1], photos[:1], edited, reference
        ),
        "edit-strength-2d": metrics.edit_strength(edited, photos[:1], reference),
    }


def _consistency(item: LoadedItem, output: MethodOutput) -> Found:
    """Compare the frames along true depth where it is known, else along the method's own."""
    depths, cameras = output.depths, output.cameras
    if item.depths is not None and item.cameras is not None:
        depths, cameras = item.depths, item.cameras
    masks = None if item.masks is None else item.masks.nan_to_num(1.0)
    inputs = range(item.inputs)
    held_back = range(item.inputs, len(output.images))
    between_inputs = list(permutations(inputs, 2))
    across = [*product(inputs, held_back), *product(held_back, inputs)]
    compared = {
        "consistency-2d": (output.edited, between_inputs),
        "consistency-warped": (output.images, between_inputs),
        "consistency-held-back": (output.images, across),
    }
    return {
        name: metrics.warped_difference(images, depths, cameras, pairs, masks)
        for name, (images, pairs) in compared.items()
    }


def _sharpness(item: LoadedItem, output: MethodOutput) -> float:
    """The mean over all frames, each beside its photo."""
    images, photos = _array(output.images), _array(item.photos.images[0])
    return fmean(map(metrics.sharpness, images, photos))


def _features(
    item: LoadedItem, output: MethodOutput, networks: MetricNetworks
) -> Found:
    """Compare pieces of this edit's renderings with those of its own scene's photos."""
    values = {}
    for network in networks.features:
        photos = network(crops(item.photos.images[0]))
        rendered = network(crops(output.images))
        values[f"c-fid{network.suffix}"] = metrics.frechet_distance(rendered, photos)
        values[f"c-kid{network.suffix}"] = metrics.kernel_distance(rendered, photos)
    return values


def _by_clip(item: LoadedItem, output: MethodOutput, clip: ClipSimilarity) -> Found:
    images, before = output.images, item.record.before
    after = item.record.description or item.record.prompt
    values = {"clip-t2i": float(clip(images, [after]).mean())}
    if before:
        photos = item.photos.images[0]
        moved = directional_similarity(clip, photos, images, before, after)
        values["clip-direction"] = float(moved.mean())
    return values


def _against_truth(
    item: LoadedItem, shown: Images, distances: Mapping[str, Any]
) -> Found:
    """Means over the held-back frames, which the method was not given."""
    assert item.truth is not None  # asked before
    held = slice(item.inputs, None)
    images, truth, photos = (
        _array(own[held]) for own in (shown, item.truth, item.photos.images[0])
    )
    inside = np.ones(truth.shape[:3])
    if item.masks is not None:
        inside = _array(item.masks[held])
    values = _distances(images, truth, None, distances)
    values["edit-uptake"] = metrics.edit_uptake(images, photos, truth, inside)
    for region, covered in metrics.regions(inside).items():
        own = _distances(images, truth, covered, distances)
        values |= {f"{name}-in-{region}": value for name, value in own.items()}
    return values


def _distances(
    images: metrics.Images,
    truth: metrics.Images,
    covered: metrics.Regions | None,
    distances: Mapping[str, Any],
) -> Found:
    """Return means over the views, of the `covered` pixels if given; views where nothing is covered
    do not count.

    Networks see the truth with only the covered pixels replaced; their distance is divided by the
    share of these.
    """
    areas: Sequence[np.ndarray | None] = [None] * len(truth)
    shown = images
    share = 1.0
    if covered is not None:
        used = covered.any((1, 2))
        if not used.any():
            return dict.fromkeys(("psnr", "ssim", *distances), math.nan)
        images, truth, covered = images[used], truth[used], covered[used]
        areas = list(covered)
        shown = np.where(covered[..., None], images, truth)
        share = float(covered.mean())
    values = {
        "psnr": fmean(map(psnr, images, truth, areas)),
        "ssim": fmean(map(ssim, images, truth, areas)),
    }
    rendered, target = (
        torch.from_numpy(own).permute(0, 3, 1, 2)[None].float()
        for own in (shown, truth)
    )
    inputs = LossInputs(rendered=rendered, target=target)
    for name, distance in distances.items():
        values[name] = float(distance(inputs)) / share
    return values


def _array(tensor: Float[Tensor, "frame *shape"]) -> Float[np.ndarray, "frame *shape"]:
    """Images `[frame, height, width, 3]`, masks `[frame, height, width]`, in float64."""
    if tensor.ndim == 4:
        tensor = tensor.permute(0, 2, 3, 1)
    return tensor.double().numpy()
