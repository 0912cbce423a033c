"""Attention across views (GaussCtrl, section "attention-based latent code alignment").

    attention_i = (1 - w) softmax(Q_i K_i^T) V_i + w mean_j softmax(Q_i K_j^T) V_j,   j over the reference views

Queries of every view also look at keys and values of a few reference views, so that all views settle on one look.
"""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


class CrossViewAttention:
    """A diffusers attention processor for self-attention over a batch ordered (guidance half, view)."""

    def __init__(self, views: int, references: int, weight: float) -> None:
        self.views, self.references, self.weight = views, min(references, views), weight

    def __call__(self, attn: Any, hidden_states: Float[Tensor, "batch token channel"], *_: Any, **__: Any) -> Tensor:
        query, key, value = (_heads(to(hidden_states), attn.heads) for to in (attn.to_q, attn.to_k, attn.to_v))
        own = F.scaled_dot_product_attention(query, key, value)
        others = [
            F.scaled_dot_product_attention(query, self._of_view(key, view), self._of_view(value, view))
            for view in range(self.references)
        ]
        mixed = torch.lerp(own, torch.stack(others).mean(0), self.weight)
        projected = attn.to_out[0](mixed.transpose(1, 2).flatten(2))
        return attn.to_out[1](projected)

    def _of_view(self, tensor: Float[Tensor, "batch head token dim"], view: int) -> Tensor:
        """Every view's entry replaced by `view`'s of the same guidance half."""
        return tensor.unflatten(0, (-1, self.views))[:, view].repeat_interleave(self.views, dim=0)


def look_across_views(unet: Any, views: int, references: int, weight: float) -> None:
    """Replace the processors of all self-attentions; with weight 0 they compute what they did."""
    across = CrossViewAttention(views, references, weight)
    unet.set_attn_processor(
        {
            name: across if name.endswith("attn1.processor") else processor
            for name, processor in unet.attn_processors.items()
        }
    )


def _heads(tensor: Float[Tensor, "batch token channel"], heads: int) -> Float[Tensor, "batch head token dim"]:
    return tensor.unflatten(-1, (heads, -1)).transpose(1, 2)
