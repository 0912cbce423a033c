"""Remove Gaussians that the edit attends to most, so that the second fit is not held back by what they were.

EditSplat's attention-guided trimming (Lee et al. 2025, section 3.3): attention maps of the edit are carried to the
Gaussians by their blending weights, and a share of the most attended is pruned before refitting.
"""

from dataclasses import replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.harmonics import DC
from edit3r.interfaces import Editor, Rasterizer
from edit3r.types import Cameras, EditRequest, Gaussians, Views

__all__ = ["GivesAttention", "attention_maps", "attention_of", "trim"]


@runtime_checkable
class GivesAttention(Protocol):
    """An editor that can say where an edit looks."""

    def attention(self, views: Views, request: EditRequest) -> Float[Tensor, "batch view height width"]:
        """Cross-attention of the prompt's words, any scale >= 0."""


def attention_maps(
    editor: Editor, photos: Views, edits: Views, request: EditRequest
) -> tuple[Float[Tensor, "batch view height width"], str]:
    """Where the edit happens, in [0, 1] with the most at 1, and what tells it.

    The editor's own attention; else the masks; else how much each pixel changed.
    """
    if isinstance(editor, GivesAttention):
        maps, told_by = editor.attention(photos, request), "the editor's cross-attention"
    elif request.masks is not None:
        maps, told_by = request.masks, "the masks, the editor gives no attention"
    else:
        maps, told_by = (edits.images - photos.images).abs().mean(2), "the change of each pixel, no attention or masks"
    return maps / maps.amax().clamp(min=1e-12), told_by


def attention_of(
    gaussians: Gaussians, cameras: Cameras, maps: Float[Tensor, "batch view h w"], rasterizer: Rasterizer
) -> Float[Tensor, "batch gaussian"]:
    """Mean of the maps over the pixels each Gaussian draws, weighted by transmittance times alpha; 0: draws none.

    A picture is linear in the colours, so both sums are gradients by the constant harmonic of grey Gaussians.
    """
    grey = torch.zeros_like(gaussians.harmonics[:, :, :1]).requires_grad_(True)
    with torch.enable_grad():
        pictures = rasterizer.render(replace(gaussians, harmonics=grey), cameras).images
        # Two channels, two sums, one backward pass.
        total = (pictures[:, :, 0] * maps).sum() + pictures[:, :, 1].sum()
        (gradient,) = torch.autograd.grad(total, grey)
    attended, drawn = gradient[:, :, 0, 0] / DC, gradient[:, :, 0, 1] / DC
    return torch.where(drawn > 1e-6, attended / drawn.clamp(min=1e-6), torch.zeros_like(drawn))


def trim(attention: Float[Tensor, "gaussian"], share: float, threshold: float) -> Bool[Tensor, "gaussian"]:
    """Which to keep: all but the most attended `share` of those whose attention is at least `threshold`."""
    attended = attention >= threshold
    count = round(share * int(attended.sum()))
    order = torch.where(attended, attention, -1.0).argsort(descending=True, stable=True)
    kept = torch.ones_like(attended)
    kept[order[:count]] = False
    return kept
