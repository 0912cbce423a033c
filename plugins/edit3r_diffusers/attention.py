"""Attention processors for a denoising network: across views, and listening to where an edit's
words look.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


class CrossViewAttention:
    """A diffusers attention processor for self-attention over a batch ordered (guidance half,
    view).

    As in GaussCtrl (section "attention-based latent code alignment"), over the reference views j:

        attention_i = (1 - w) softmax(Q_i K_i^T) V_i + w mean_j softmax(Q_i K_j^T) V_j

    Queries of every view also look at keys and values of a few reference views, so that all views
    settle on one look.
    """

    def __init__(self, views: int, references: int, weight: float) -> None:
        self.views, self.references, self.weight = views, min(references, views), weight

    def __call__(
        self,
        attn: Any,
        hidden_states: Float[Tensor, "batch token channel"],
        *_: Any,
        **__: Any,
    ) -> Float[Tensor, "batch token channel"]:
        query, key, value = (
            _heads(to(hidden_states), attn.heads)
            for to in (attn.to_q, attn.to_k, attn.to_v)
        )
        own = F.scaled_dot_product_attention(query, key, value)
        others = []
        for view in range(self.references):
            read = self._of_view(key, view), self._of_view(value, view)
            others.append(F.scaled_dot_product_attention(query, *read))
        mixed = torch.lerp(own, torch.stack(others).mean(0), self.weight)
        projected = attn.to_out[0](mixed.transpose(1, 2).flatten(2))
        return attn.to_out[1](projected)

    def _of_view(
        self, tensor: Float[Tensor, "batch head token dim"], view: int
    ) -> Float[Tensor, "batch head token dim"]:
        """Replace every view's entry by `view`'s of the same guidance half."""
        of_view = tensor.unflatten(0, (-1, self.views))[:, view]
        return of_view.repeat_interleave(self.views, dim=0)


def look_across_views(unet: Any, views: int, references: int, weight: float) -> None:
    """Replace the processors of all self-attentions; with weight 0 they compute what they did."""
    across = CrossViewAttention(views, references, weight)
    _replace_processors(unet, "attn1", across)


def _replace_processors(unet: Any, kind: str, processor: Any) -> None:
    """Give all attentions of a kind another processor: attn1 looks at itself, attn2 at words."""
    processors = {
        name: processor if name.endswith(f"{kind}.processor") else own
        for name, own in unet.attn_processors.items()
    }
    unet.set_attn_processor(processors)


def _heads(
    tensor: Float[Tensor, "batch token channel"], heads: int
) -> Float[Tensor, "batch head token dim"]:
    return tensor.unflatten(-1, (heads, -1)).transpose(1, 2)


class WordAttention:
    """A diffusers attention processor that also adds up how much each place looks at the words.

    EditSplat (Lee et al. 2025, section 3.3) takes these maps from InstructPix2Pix to find the
    Gaussians that an edit is about.
    """

    def __init__(self, words: int, halves: int) -> None:
        """`words` follow the start token; the first of `halves` (guidance) reads them."""
        self.words, self.halves = words, halves
        # by number of places in the grid
        self.maps: dict[int, Float[Tensor, "token"]] = {}

    def __call__(
        self,
        attn: Any,
        hidden_states: Float[Tensor, "batch token channel"],
        encoder_hidden_states: Float[Tensor, "batch word channel"],
        *_: Any,
        **__: Any,
    ) -> Float[Tensor, "batch token channel"]:
        query = _heads(attn.to_q(hidden_states), attn.heads)
        key, value = (
            _heads(to(encoder_hidden_states), attn.heads)
            for to in (attn.to_k, attn.to_v)
        )
        alike = query.float() @ key.float().transpose(-1, -2) * attn.scale
        shares = alike.softmax(-1)
        self._add(shares)
        read = (shares.to(value) @ value).transpose(1, 2).flatten(2)
        projected = attn.to_out[0](read)
        return attn.to_out[1](projected)

    def image(self, size: tuple[int, int]) -> Float[Tensor, "height width"]:
        """Mean of the network's grids, each at most 1, at `size`; zeros before one was seen."""
        grids = []
        for places, total in self.maps.items():
            rows = max(1, round((places * size[0] / size[1]) ** 0.5))
            while places % rows:  # rounding may miss the grid's own rows by one
                rows -= 1
            grid = total / total.amax().clamp(min=1e-12)
            grid = grid.view(1, 1, rows, places // rows)
            grids.append(F.interpolate(grid, size, mode="bilinear")[0, 0])
        return torch.stack(grids).mean(0) if grids else torch.zeros(size)

    def _add(self, shares: Float[Tensor, "batch head token word"]) -> None:
        reading = shares[: len(shares) // self.halves]
        looked = reading[..., 1 : 1 + self.words].sum(-1).mean((0, 1)).detach().cpu()
        places = len(looked)
        self.maps[places] = self.maps.get(places, torch.zeros(places)) + looked


@contextmanager
def listening(unet: Any, words: int, halves: int) -> Iterator[WordAttention]:
    """Inside, every cross-attention of `unet` adds to the result; it computes what it did."""
    own, listener = unet.attn_processors, WordAttention(words, halves)
    _replace_processors(unet, "attn2", listener)
    try:
        yield listener
    finally:
        unet.set_attn_processor(own)


def word_count(tokenizer: Any, prompt: str) -> int:
    """Count the tokens of a prompt between start and end, as far as the model reads."""
    ids = tokenizer(
        prompt, truncation=True, max_length=tokenizer.model_max_length
    ).input_ids
    return max(1, len(ids) - 2)
