"""Network layers whose answers do not depend on the number of threads."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

__all__ = ["GroupNorm", "pointwise"]


class GroupNorm(nn.GroupNorm):
    """Group normalisation that gives the same bits for any number of threads.

    Over tensors in channels-last order torch adds up in another order for each number of threads; over contiguous ones
    it does not. The answer keeps the order of the input.
    """

    def forward(self, x: Float[Tensor, "batch channel *shape"]) -> Float[Tensor, "batch channel *shape"]:
        normalised = super().forward(x.contiguous())
        last = x.dim() == 4 and not x.is_contiguous() and x.is_contiguous(memory_format=torch.channels_last)
        return normalised.contiguous(memory_format=torch.channels_last) if last else normalised


def pointwise(inputs: int, outputs: int) -> nn.Conv2d:
    """Return a 1x1 convolution that gives the same bits for any number of threads.

    Without the dilation, which changes nothing for one pixel, torch takes another library when it has one thread only
    (ATen's `use_mkldnn`).
    """
    return nn.Conv2d(inputs, outputs, 1, dilation=2)
