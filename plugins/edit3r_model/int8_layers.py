"""Layers for inference on a CPU in int8, through oneDNN.

The weights have one scale per output channel; activations are quantised as they come with one scale
each. The layers hold no parameters, so they cannot be trained.
"""

from functools import cache

import cv2
import torch
from jaxtyping import Float
from torch import Tensor, nn

ROWS_HINT = 512
"""Typical number of tokens a linear sees; oneDNN chooses its layout for it, any other number gives
equal results.
"""

_LEVELS = 254
"""Steps between the smallest and the largest value; one less than uint8 has, so that rounding never
overflows.
"""

_int8_ops = torch.ops.onednn
# Scale and zero point of a float are 1 and 0; nothing follows.
_FLOAT_OUTPUT: tuple = (1.0, 0, torch.float32, "none", [])


class _Int8Layer(nn.Module):
    """What int8 layers share: scales of the weights, bias, and results in float32."""

    def __init__(
        self, layer: nn.Linear | nn.Conv2d, scales: Float[Tensor, "out"]
    ) -> None:
        super().__init__()
        bias = None if layer.bias is None else layer.bias.detach().float()
        zeros = torch.zeros(len(scales), dtype=torch.int32)
        for name, value in {"scales": scales, "zeros": zeros, "bias": bias}.items():
            self.register_buffer(name, value, persistent=False)

    def _weights(self) -> tuple:
        """What oneDNN's products are given of the weights."""
        return self._weight, self.scales, self.zeros, self.bias


class Int8Linear(_Int8Layer):
    """Linear layer on int8 products, float32 in and out."""

    def __init__(self, linear: nn.Linear) -> None:
        weight, scales = quantise_weight(linear.weight.detach())
        super().__init__(linear, scales)
        self.in_features, self.out_features = linear.in_features, linear.out_features
        self._weight = _int8_ops.qlinear_prepack(
            weight, [ROWS_HINT, linear.in_features]
        )

    def forward(self, x: Float[Tensor, "*batch in"]) -> Float[Tensor, "*batch out"]:
        values = quantise_input(x.reshape(-1, self.in_features).contiguous())
        result = _int8_ops.qlinear_pointwise(
            *values, *self._weights(), *_FLOAT_OUTPUT, "none"
        )
        return result.view(*x.shape[:-1], self.out_features)


class Int8Conv(_Int8Layer):
    """Convolution on int8 products, float32 in and out, channels-last."""

    def __init__(self, conv: nn.Conv2d) -> None:
        weight, scales = quantise_weight(conv.weight.detach())
        super().__init__(conv, scales)
        self.geometry = conv.stride, conv.padding, conv.dilation, conv.groups
        # The input's scale is passed again with each call; packing only needs some value.
        self._weight = _int8_ops.qconv_prepack(
            weight, scales, 1.0, _LEVELS // 2, *self.geometry
        )

    def forward(
        self, x: Float[Tensor, "batch channel h w"]
    ) -> Float[Tensor, "batch out h2 w2"]:
        values = quantise_input(x.contiguous(memory_format=torch.channels_last))
        return _int8_ops.qconv_pointwise(
            *values, *self._weights(), *self.geometry, *_FLOAT_OUTPUT, ""
        )


@cache
def weight_levels() -> int:
    """Return the largest int8 weight whose products are right on this processor, 127 or 63.

    Processors without VNNI add two products in 16 bits, which overflow: 2 * 255 * 127 is more than
    32767, 2 * 255 * 63 is less (oneDNN's page "Nuances of int8 computations"). The product itself
    tells, not what a processor says it is.
    """
    size = 128
    values = torch.full((1, size), 255, dtype=torch.uint8)
    weight = torch.full((size, size), 127, dtype=torch.int8)
    ones, zeros = torch.ones(size), torch.zeros(size, dtype=torch.int32)
    packed = _int8_ops.qlinear_prepack(weight, [ROWS_HINT, size])
    sums = _int8_ops.qlinear_pointwise(
        values, 1.0, 0, packed, ones, zeros, None, *_FLOAT_OUTPUT, "none"
    )
    return 127 if (sums == size * 255 * 127).all() else 63


def quantise_weight(
    weight: Float[Tensor, "out *rest"],
) -> tuple[Tensor, Float[Tensor, "out"]]:
    """Return (int8 weight, scale per output channel), symmetric around 0."""
    scales = weight.float().flatten(1).abs().amax(1).clamp(min=1e-12) / weight_levels()
    levels = weight.flatten(1) / scales[:, None]
    return levels.view_as(weight).round().to(torch.int8), scales


def quantise_input(x: Float[Tensor, "*shape"]) -> tuple[Tensor, float, int]:
    """Return (uint8 values, scale, zero point) with the whole range of `x`, zero included, on 255
    levels.

    `x` is contiguous or channels-last; the values have its layout.
    """
    if not x.is_contiguous():
        values, scale, zero = quantise_input(x.permute(0, 2, 3, 1))
        return values.permute(0, 3, 1, 2), scale, zero
    low, high = min(x.min().item(), 0.0), max(x.max().item(), 0.0)
    scale = max((high - low) / _LEVELS, 1e-12)
    zero = round(-low / scale)
    # OpenCV scales, rounds and narrows in one pass, four times faster than torch's conversion to
    # uint8. The absolute value it takes as well changes nothing: the zero point leaves at most a
    # rounding error below zero.
    rows = x.reshape(-1, x.shape[-1]).numpy()
    levels = cv2.convertScaleAbs(rows, alpha=1 / scale, beta=zero)
    return torch.from_numpy(levels).view(x.shape), scale, zero
