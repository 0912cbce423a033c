"""Layers with int8 weights (one scale per output channel) and activations quantised as they come (one scale each)."""

import cv2
import torch
from jaxtyping import Float
from torch import Tensor, nn

from edit3r_model.engine.packed import ROWS_HINT, Activation

_ops = torch.ops.onednn
_LEVELS = 254
"""Steps between the smallest and the largest value; one less than uint8 has, so that rounding never overflows."""


class Int8Linear(nn.Module):
    """Linear layer on int8 products, float32 in and out, with the activation that follows fused in."""

    def __init__(self, linear: nn.Linear, activation: Activation = "none") -> None:
        super().__init__()
        self.in_features, self.out_features, self.activation = linear.in_features, linear.out_features, activation
        weight, scales = quantise_weight(linear.weight.detach())
        self._weight = _ops.qlinear_prepack(weight, [ROWS_HINT, linear.in_features])
        self.register_buffer("scales", scales, persistent=False)
        self.register_buffer("zeros", torch.zeros(len(scales), dtype=torch.int32), persistent=False)
        self.register_buffer("bias", linear.bias.detach().float(), persistent=False)

    def forward(self, x: Float[Tensor, "*batch in"]) -> Float[Tensor, "*batch out"]:
        values, scale, zero = quantise_input(x.reshape(-1, self.in_features).contiguous())
        result = _ops.qlinear_pointwise(
            values,
            scale,
            zero,
            self._weight,
            self.scales,
            self.zeros,
            self.bias,
            1.0,
            0,
            torch.float32,
            self.activation,
            [],
            "none",
        )
        return result.view(*x.shape[:-1], self.out_features)


class Int8Conv(nn.Module):
    """Convolution on int8 products, float32 in and out, channels-last, with the activation that follows fused in."""

    def __init__(self, conv: nn.Conv2d, activation: Activation = "none") -> None:
        super().__init__()
        self.stride, self.padding, self.dilation, self.groups = conv.stride, conv.padding, conv.dilation, conv.groups
        self.activation = activation
        weight, scales = quantise_weight(conv.weight.detach())
        # The input's scale is passed again with each call; packing only needs some value.
        self._weight = _ops.qconv_prepack(
            weight, scales, 1.0, _LEVELS // 2, self.stride, self.padding, self.dilation, self.groups
        )
        self.register_buffer("scales", scales, persistent=False)
        self.register_buffer("zeros", torch.zeros(len(scales), dtype=torch.int32), persistent=False)
        bias = None if conv.bias is None else conv.bias.detach().float()
        self.register_buffer("bias", bias, persistent=False)

    def forward(self, x: Float[Tensor, "batch channel h w"]) -> Float[Tensor, "batch out h2 w2"]:
        values, scale, zero = quantise_input(x.contiguous(memory_format=torch.channels_last))
        return _ops.qconv_pointwise(
            values,
            scale,
            zero,
            self._weight,
            self.scales,
            self.zeros,
            self.bias,
            self.stride,
            self.padding,
            self.dilation,
            self.groups,
            1.0,
            0,
            torch.float32,
            self.activation,
            [],
            "",
        )


def quantise_weight(weight: Float[Tensor, "out *rest"]) -> tuple[Tensor, Float[Tensor, "out"]]:
    """(int8 weight, scale per output channel), symmetric."""
    scales = weight.float().flatten(1).abs().amax(1).clamp(min=1e-12) / 127
    shape = (-1, *(1 for _ in weight.shape[1:]))
    return (weight / scales.view(shape)).round().to(torch.int8), scales


def quantise_input(x: Float[Tensor, "*shape"]) -> tuple[Tensor, float, int]:
    """(uint8 values, scale, zero point) with the whole range of `x`, zero included, on 255 levels.

    `x` is contiguous or channels-last; the values have its layout.
    """
    if not x.is_contiguous():
        values, scale, zero = quantise_input(x.permute(0, 2, 3, 1))
        return values.permute(0, 3, 1, 2), scale, zero
    low, high = (value.item() for value in torch.aminmax(x))
    low, high = min(low, 0.0), max(high, 0.0)
    scale = max((high - low) / _LEVELS, 1e-12)
    zero = round(-low / scale)
    # OpenCV scales, rounds and narrows in one pass, four times faster than torch's conversion to uint8. The absolute
    # value it takes as well changes nothing: the zero point leaves at most a rounding error below zero.
    values = cv2.convertScaleAbs(x.reshape(-1, x.shape[-1]).numpy(), alpha=1 / scale, beta=zero)
    return torch.from_numpy(values).view(x.shape), scale, zero
