"""Layers of networks, and sums, whose answers do not depend on the number of threads."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt8
from torch import Tensor, nn

__all__ = ["Conv2d", "GroupNorm", "bilinear", "one_thread", "weighted_smooth"]

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


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread of torch inside (also a decorator): sums by index else differ."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@one_thread()
def bilinear(
    x: Float[Tensor, "batch channel height width"], size: tuple[int, int]
) -> Float[Tensor, "batch channel height2 width2"]:
    """Resize between pixel centres; torch's own rounds otherwise where threads share a picture."""
    return F.interpolate(x, size, mode="bilinear", align_corners=False)


PARTS = 2  # of the columns: each number of parts rounds otherwise, so every machine takes this one
ALONE = threading.Lock()  # the number of OpenCV's threads belongs to the whole process


def weighted_smooth(
    values: Float[np.ndarray, "height width"],
    weights: Float[np.ndarray, "height width"],
    guide: UInt8[np.ndarray, "height width 3"],
    strength: float,
    colour: float,
) -> Float[np.ndarray, "height width"]:
    """Mean of `values` by `weights` along the edges of the guide.

    The fast global smoother (Min et al. 2014): `colour` is the 8-bit difference at which the
    smoothness `strength` falls to 1/e. The same bits for any number of threads.
    """
    with ALONE:
        threads = cv2.getNumThreads()
        cv2.setNumThreads(PARTS)
        try:
            smoother = cv2.ximgproc.createFastGlobalSmootherFilter(
                guide, strength, colour
            )
            total = smoother.filter(weights)
            smooth = smoother.filter(values * weights)
        finally:
            cv2.setNumThreads(threads)
    return smooth / np.maximum(total, 1e-8)
