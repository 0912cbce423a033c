"""Where an edit's words look: cross-attention of a denoising network, summed up while it runs.

EditSplat (Lee et al. 2025, section 3.3) takes these maps from InstructPix2Pix to find the Gaussians that an edit is
about.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

__all__ = ["WordAttention", "listening", "word_count"]


class WordAttention:
    """A diffusers attention processor that also adds up how much each place looks at the words."""

    def __init__(self, words: int, halves: int) -> None:
        """`words` follow the start token; `halves`: guidance copies in a batch, the first of them reads the words."""
        self.words, self.halves = words, halves
        self.maps: dict[int, Float[Tensor, "token"]] = {}  # by number of places in the grid

    def __call__(
        self,
        attn: Any,
        hidden_states: Float[Tensor, "batch token channel"],
        encoder_hidden_states: Float[Tensor, "batch word channel"],
        *_: Any,
        **__: Any,
    ) -> Tensor:
        query = _heads(attn.to_q(hidden_states), attn.heads)
        key, value = (_heads(to(encoder_hidden_states), attn.heads) for to in (attn.to_k, attn.to_v))
        shares = (query.float() @ key.float().transpose(-1, -2) * attn.scale).softmax(-1)
        self._add(shares)
        projected = attn.to_out[0]((shares.to(value) @ value).transpose(1, 2).flatten(2))
        return attn.to_out[1](projected)

    def picture(self, size: tuple[int, int]) -> Float[Tensor, "height width"]:
        """Mean over the network's grids, each at most 1, at `size`; zeros before anything was seen."""
        grids = []
        for places, total in self.maps.items():
            rows = max(1, round((places * size[0] / size[1]) ** 0.5))
            while places % rows:  # the grid's own rows divide its places; rounding may miss them by one
                rows -= 1
            grid = (total / total.amax().clamp(min=1e-12)).view(1, 1, rows, places // rows)
            grids.append(F.interpolate(grid, size, mode="bilinear", align_corners=False)[0, 0])
        return torch.stack(grids).mean(0) if grids else torch.zeros(size)

    def _add(self, shares: Float[Tensor, "batch head token word"]) -> None:
        reading = shares[: len(shares) // self.halves]
        looked = reading[..., 1 : 1 + self.words].sum(-1).mean((0, 1)).detach().cpu()
        places = len(looked)
        self.maps[places] = self.maps.get(places, torch.zeros(places)) + looked


@contextmanager
def listening(unet: Any, words: int, halves: int) -> Iterator[WordAttention]:
    """Inside the block every cross-attention of `unet` adds to the result; it computes what it did."""
    own = unet.attn_processors
    listener = WordAttention(words, halves)
    replaced = {name: listener if name.endswith("attn2.processor") else one for name, one in own.items()}
    unet.set_attn_processor(replaced)
    try:
        yield listener
    finally:
        unet.set_attn_processor(own)


def word_count(tokenizer: Any, prompt: str) -> int:
    """Tokens of the prompt between start and end, as far as the model reads."""
    ids = tokenizer(prompt, truncation=True, max_length=tokenizer.model_max_length).input_ids
    return max(1, len(ids) - 2)


def _heads(tensor: Float[Tensor, "batch token channel"], heads: int) -> Float[Tensor, "batch head token dim"]:
    return tensor.unflatten(-1, (heads, -1)).transpose(1, 2)
