"""The terms of the paper's objective (section 3.3); their weights are set in the training
configuration.

The paper does not publish its weights: those in `configs/training` are this project's own.
"""

from itertools import combinations
from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.errors import SettingsError
from edit3r.contract.interfaces import Loss, LossInputs
from edit3r.kit.compute.lpips import lpips_distances
from edit3r.kit.compute.perceptual import (
    CLIP_MEAN,
    CLIP_STD,
    efficientnet_input,
    frozen_efficientnet,
)
from edit3r.kit.weights.load import ChosenWeights, foreign, load_pretrained
from edit3r_training import CLIP

if TYPE_CHECKING:
    from transformers import CLIPVisionModelWithProjection

COMPARED_BLOCKS = (0, 2, 4, 10)
"""Blocks of EfficientNet-lite0 whose outputs `PerceptualLoss` compares: strides 2, 4, 8 and 16."""

Scalar = Float[Tensor, ""]
Means = Float[Tensor, "batch gaussian 3"]
Images = Float[Tensor, "batch view 3 height width"]


class MseLoss(Loss):
    """Mean squared difference of images averaged over `cell` x `cell` pixels (L_MSE).

    It sees colour, exposure and illumination and tolerates small errors of reprojection.
    """

    class Settings(edit3r.Settings):
        cell: int = Field(4, ge=1, le=64)
        """pixels averaged along each side before comparing; 1: plain MSE"""

    settings: Settings

    def __call__(self, inputs: LossInputs) -> Scalar:
        rendered, target = images_to_compare(inputs, "mse")
        difference = (rendered - target).flatten(0, 1)
        cell = min(self.settings.cell, *difference.shape[-2:])
        return F.avg_pool2d(difference, cell, ceil_mode=True).square().mean()


class CenterLoss(Loss):
    """Smooth L1 distance of every Gaussian's centre to its reference (L_center)."""

    class Settings(edit3r.Settings):
        beta: float = Field(1.0, gt=0)
        """distance at which the square turns linear [scene units]"""

    settings: Settings

    def __call__(self, inputs: LossInputs) -> Scalar:
        ours, theirs = means_to_compare(inputs, "center")
        return F.smooth_l1_loss(ours, theirs, beta=self.settings.beta)


class PointDistillationLoss(Loss):
    """Mean distance of every centre to its reference, each cloud in the unit of its own mean
    distance from view 0.

    Point distillation of NoPoSplat's first stage from another model's points; the nearest and
    farthest are left out.
    """

    class Settings(edit3r.Settings):
        outliers: float = Field(0.002, ge=0, lt=0.5)
        """share of the reference's points left out at each end"""

    settings: Settings

    def __call__(self, inputs: LossInputs) -> Scalar:
        ours, theirs = map(_in_own_unit, means_to_compare(inputs, "point-distillation"))
        rank = theirs.norm(dim=-1).argsort(1).argsort(1)
        count = theirs.shape[1]
        dropped = int(self.settings.outliers * count)
        kept = (rank >= dropped) & (rank < count - dropped)
        return (ours - theirs)[kept].norm(dim=-1).mean()


def _in_own_unit(means: Means) -> Means:
    """Points in the unit of their mean distance from view 0; all of them there stay there."""
    unit = means.norm(dim=-1).mean(1)[:, None, None]
    return means / torch.where(unit > 0, unit, 1.0)


class GeometryLoss(Loss):
    """Mean pairwise Chamfer-L1 distance of at most `samples` random centres a view (L_geom).

    Views do not show quite the same surface, so even the truth has a distance: with a reference its
    own is subtracted, which leaves the gradient as it is and makes the reference worth 0.
    """

    class Settings(edit3r.Settings):
        samples: int = Field(512, ge=1, le=8192)
        """centres drawn from each view"""

    settings: Settings

    def __call__(self, inputs: LossInputs) -> Scalar:
        require_fields(inputs, "geometry", "gaussians")
        assert inputs.gaussians is not None  # required
        chosen = self._sample(inputs.gaussians.view_index.cpu())
        value = pairwise_chamfer(inputs.gaussians.means, chosen)
        if inputs.reference is None:
            return value
        return value - pairwise_chamfer(inputs.reference.means, chosen).detach()

    def _sample(self, view_index: Int[Tensor, " gaussian"]) -> list[Tensor]:
        """Indices of the centres drawn from each view."""
        chosen = []
        for view in view_index[view_index >= 0].unique():
            own = torch.nonzero(view_index == view).flatten()
            chosen.append(own[torch.randperm(len(own))[: self.settings.samples]])
        return chosen


def pairwise_chamfer(means: Means, views: list[Int[Tensor, " chosen"]]) -> Scalar:
    """L_geom = 1 / (V (V - 1)) sum_{i < j} Chamfer_L1(mu_i, mu_j), as the paper writes it."""
    count = len(views)
    total = means.sum() * 0
    for a, b in combinations(views, 2):
        total = total + chamfer_l1(means[:, a], means[:, b])
    return total / max(count * (count - 1), 1)


def chamfer_l1(
    a: Float[Tensor, "batch point 3"], b: Float[Tensor, "batch point2 3"]
) -> Scalar:
    """Mean L1 distance to the nearest point of the other set, both ways."""
    distances = torch.cdist(a, b, p=1)
    return distances.min(2).values.mean() + distances.min(1).values.mean()


class PerceptualLoss(Loss):
    """Mean squared distance of channel-normalised features of EfficientNet-lite0, averaged over
    four strides.

    It plays the part of LPIPS, but its numbers do not compare with LPIPS; it installs from the
    package index.
    """

    class Settings(edit3r.Settings):
        size: int = Field(128, ge=32, le=512)
        """images are resized to this before comparing [pixels]"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._network = frozen_efficientnet()

    def __call__(self, inputs: LossInputs) -> Scalar:
        rendered, target = images_to_compare(inputs, "perceptual")
        predicted = self._features(rendered)
        with torch.no_grad():
            wished = self._features(target)
        gaps = [F.mse_loss(p, w) * p.shape[1] for p, w in zip(predicted, wished)]
        return sum(gaps[1:], start=gaps[0]) / len(gaps)

    def _features(
        self, images: Float[Tensor, "batch view 3 height width"]
    ) -> list[Float[Tensor, "image c h w"]]:
        """Feature maps of all images at four strides, each pixel's features of length 1."""
        x = efficientnet_input(images.flatten(0, 1), self.settings.size)
        network = self._network.to(x.device)
        x = network._swish(network._bn0(network._conv_stem(x)))
        features = []
        for index, block in enumerate(network._blocks[: COMPARED_BLOCKS[-1] + 1]):
            x = block(x)
            if index in COMPARED_BLOCKS:
                features.append(x / (x.square().sum(1, keepdim=True) + 1e-6).sqrt())
        return features


class LpipsLoss(Loss):
    """Mean LPIPS of the shift-tolerant AlexNet; the paper takes the VGG of Zhang et al. 2018."""

    def __call__(self, inputs: LossInputs) -> Scalar:
        rendered, target = images_to_compare(inputs, "lpips")
        return lpips_distances(rendered.flatten(0, 1), target.flatten(0, 1)).mean()


class ClipLoss(Loss):
    """Mean over images of 1 - cosine similarity of CLIP's image embeddings (L_CLIP)."""

    class Settings(edit3r.Settings):
        model: str = "openai/clip-vit-base-patch32"
        """folder or hub name of a CLIP model"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._model = _frozen_clip(settings.model)

    def __call__(self, inputs: LossInputs) -> Scalar:
        rendered, target = images_to_compare(inputs, "clip")
        predicted = self._embed(rendered.flatten(0, 1))
        with torch.no_grad():
            wished = self._embed(target.flatten(0, 1))
        return 1 - F.cosine_similarity(predicted, wished, dim=-1).mean()

    def _embed(
        self, images: Float[Tensor, "image 3 height width"]
    ) -> Float[Tensor, "image feature"]:
        side = self._model.config.image_size
        assert isinstance(side, int)  # CLIP's images are squares
        x = F.interpolate(images, (side, side), mode="bicubic", antialias=True)
        mean, std = (x.new_tensor(v)[:, None, None] for v in (CLIP_MEAN, CLIP_STD))
        self._model.to(x.device)  # type: ignore[arg-type]  # a decorator hides its type
        return self._model(pixel_values=(x - mean) / std).image_embeds


def _frozen_clip(name: str) -> "CLIPVisionModelWithProjection":
    vision = foreign("transformers", "CLIPVisionModelWithProjection")
    network = load_pretrained(
        vision, ChosenWeights(name, "losses.clip.model", known=(CLIP,))
    )
    return network.eval().requires_grad_(False)


def images_to_compare(inputs: LossInputs, loss: str) -> tuple[Images, Images]:
    """What was rendered, and what it should show. Raises as `require_fields` does."""
    require_fields(inputs, loss, "rendered", "target")
    assert inputs.rendered is not None and inputs.target is not None  # required
    return inputs.rendered, inputs.target


def means_to_compare(inputs: LossInputs, loss: str) -> tuple[Means, Means]:
    """Centres of the prediction and of its reference. Raises as `require_fields` does."""
    require_fields(inputs, loss, "gaussians", "reference")
    assert inputs.gaussians is not None and inputs.reference is not None  # required
    return inputs.gaussians.means, inputs.reference.means


def require_fields(inputs: LossInputs, loss: str, *names: str) -> None:
    """Raise SettingsError unless the step has the fields `names` that the loss compares."""
    missing = [name for name in names if getattr(inputs, name) is None]
    if missing:
        raise SettingsError(
            f"loss {loss!r} compares {' and '.join(names)}, but this training step has no "
            f"{missing[0]}; take the loss out of the configuration or use data that brings it "
            "(depths give a reference)."
        )
