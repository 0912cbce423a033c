"""Layers of networks whose answers do not depend on the number of threads."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.kit.compute.layers import bilinear

SMALL = 1 << 16  # values; ATen has 20480


class GroupNorm(nn.GroupNorm):
    """Group normalisation that gives the same bits for any number of threads.

    Over tensors in channels-last order torch adds up in another order for each number of threads;
    over contiguous ones it does not. The answer keeps the order of the input.
    """

    def forward(
        self, x: Float[Tensor, "batch channel *shape"]
    ) -> Float[Tensor, "batch channel *shape"]:
        normalised = super().forward(x.contiguous())
        last = (
            x.dim() == 4
            and not x.is_contiguous()
            and x.is_contiguous(memory_format=torch.channels_last)
        )
        return (
            normalised.contiguous(memory_format=torch.channels_last)
            if last
            else normalised
        )


class Conv2d(nn.Conv2d):
    """A convolution that gives the same bits for any number of threads.

    torch leaves what it finds small to a library that adds up in another order for each number of
    threads (ATen's `use_mkldnn`): a 1x1 kernel where there is one thread, which a dilation (of no
    effect on one pixel) prevents, and a single small image, which is therefore computed twice, as
    two.
    """

    def _conv_forward(
        self,
        x: Float[Tensor, "batch channel height width"],
        weight: Tensor,
        bias: Tensor | None,
    ) -> Float[Tensor, "batch channel2 height2 width2"]:
        dilation = (2, 2) if self.kernel_size == (1, 1) else self.dilation
        single = len(x) == 1 and x.numel() <= SMALL
        twice = torch.cat((x, x)) if single else x
        return F.conv2d(
            twice, weight, bias, self.stride, self.padding, dilation, self.groups
        )[: len(x)]


def guided_upsample(
    maps: Float[Tensor, "batch channel height width"],
    guide: Float[Tensor, "batch 3 height2 width2"],
    radius: int = 1,
    eps: float = 1e-4,
) -> Float[Tensor, "batch channel height2 width2"]:
    """Maps at the guide's size, locally linear in its grey value (fast guided filter, 2015).

    The coefficients are found on the coarse grid, in windows of `radius` [coarse pixels]; `eps` is
    the variance of the guide below which it counts as flat. Maps already at the guide's size come
    back unchanged.
    """
    if maps.shape[-2:] == guide.shape[-2:]:
        return maps
    grey, size = guide.mean(1, keepdim=True), (guide.shape[2], guide.shape[3])
    coarse = F.interpolate(grey, maps.shape[-2:], mode="area")
    mean_guide, mean_maps = _box(coarse, radius), _box(maps, radius)
    variance = _box(coarse * coarse, radius) - mean_guide**2
    slope = (_box(coarse * maps, radius) - mean_guide * mean_maps) / (variance + eps)
    offset = mean_maps - slope * mean_guide
    slope, offset = (bilinear(_box(x, radius), size) for x in (slope, offset))
    fine = slope * grey + offset
    # A linear extrapolation may leave the range of what it came from.
    low, high = (bilinear(pool, size) for pool in (-_peak(-maps), _peak(maps)))
    return torch.minimum(torch.maximum(fine, low), high)


def _box(x: Float[Tensor, "b c h w"], radius: int) -> Float[Tensor, "b c h w"]:
    return F.avg_pool2d(
        F.pad(x, (radius,) * 4, mode="replicate"), 2 * radius + 1, stride=1
    )


def _peak(x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
    return F.max_pool2d(F.pad(x, (1, 1, 1, 1), mode="replicate"), 3, stride=1)
