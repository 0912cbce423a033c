"""Layers for inference on a CPU, with the activation that follows fused in.

Packed: oneDNN's own memory layouts. Stored: weights of half the size. Int8: int8 weights with one scale per output
channel, and activations quantised as they come with one scale each.
"""

from typing import Literal

import cv2
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

ROWS_HINT = 512
"""Typical number of tokens a linear sees; oneDNN chooses its layout for it, any other number gives equal results."""

_LEVELS = 254
"""Steps between the smallest and the largest value; one less than uint8 has, so that rounding never overflows."""

_ops, _int8_ops = torch.ops.mkldnn, torch.ops.onednn
Activation = Literal["none", "gelu", "relu"]


class PackedLinear(nn.Module):
    """A linear layer (and its activation) in float32 or bfloat16. Holds no parameters, so it cannot be trained."""

    def __init__(self, linear: nn.Linear, dtype: torch.dtype, activation: Activation = "none") -> None:
        super().__init__()
        self.in_features, self.out_features, self.dtype = linear.in_features, linear.out_features, dtype
        self.activation = activation
        with torch.no_grad():
            self._weight = _ops._reorder_linear_weight(linear.weight.detach().to(dtype), ROWS_HINT)
            self.register_buffer("bias", linear.bias.detach().to(dtype), persistent=False)

    def forward(self, x: Float[Tensor, "*batch in"]) -> Float[Tensor, "*batch out"]:
        flat = x.reshape(-1, self.in_features).to(self.dtype).contiguous()
        result = _ops._linear_pointwise(flat, self._weight, self.bias, self.activation, [], "none")
        return result.view(*x.shape[:-1], self.out_features)


class StoredLinear(nn.Module):
    """A linear layer that holds its weights in bfloat16 and multiplies in float32; for CPUs that only emulate bfloat16.

    Widening the weights anew for each call takes a tenth of the products' time at 500 tokens.
    """

    def __init__(self, linear: nn.Linear, activation: Activation = "none") -> None:
        super().__init__()
        self.activation = activation
        self.register_buffer("weight", linear.weight.detach().bfloat16(), persistent=False)
        self.register_buffer("bias", linear.bias.detach().float(), persistent=False)

    def forward(self, x: Float[Tensor, "*batch in"]) -> Float[Tensor, "*batch out"]:
        result = F.linear(x.float(), self.weight.float(), self.bias)
        return result if self.activation == "none" else getattr(F, self.activation)(result)


class FusedConv(nn.Module):
    """A convolution in channels-last layout, held in `dtype` and computed in `arithmetic` (default: the same)."""

    def __init__(
        self,
        conv: nn.Conv2d,
        dtype: torch.dtype,
        activation: Activation = "none",
        arithmetic: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.geometry = conv.padding, conv.stride, conv.dilation, conv.groups
        self.activation, self.arithmetic = activation, arithmetic or dtype
        weight = conv.weight.detach().to(dtype).contiguous(memory_format=torch.channels_last)
        self.register_buffer("weight", weight, persistent=False)
        bias = None if conv.bias is None else conv.bias.detach().to(self.arithmetic)
        self.register_buffer("bias", bias, persistent=False)

    def forward(self, x: Float[Tensor, "batch channel h w"]) -> Float[Tensor, "batch out h2 w2"]:
        x = x.to(self.arithmetic).contiguous(memory_format=torch.channels_last)
        weight = self.weight.to(self.arithmetic)
        return _ops._convolution_pointwise(x, weight, self.bias, *self.geometry, self.activation, [], "")


class _Int8Layer(nn.Module):
    """What int8 layers share: scales of the weights, bias, and how results are made float32 again."""

    def __init__(self, layer: nn.Linear | nn.Conv2d, scales: Float[Tensor, "out"], activation: Activation) -> None:
        super().__init__()
        self.register_buffer("scales", scales, persistent=False)
        self.register_buffer("zeros", torch.zeros(len(scales), dtype=torch.int32), persistent=False)
        bias = None if layer.bias is None else layer.bias.detach().float()
        self.register_buffer("bias", bias, persistent=False)
        self.float_output = 1.0, 0, torch.float32, activation, []  # scale and zero point of a float are 1 and 0


class Int8Linear(_Int8Layer):
    """Linear layer on int8 products, float32 in and out, with the activation that follows fused in."""

    def __init__(self, linear: nn.Linear, activation: Activation = "none") -> None:
        weight, scales = quantise_weight(linear.weight.detach())
        super().__init__(linear, scales, activation)
        self.in_features, self.out_features = linear.in_features, linear.out_features
        self._weight = _int8_ops.qlinear_prepack(weight, [ROWS_HINT, linear.in_features])

    def forward(self, x: Float[Tensor, "*batch in"]) -> Float[Tensor, "*batch out"]:
        values = quantise_input(x.reshape(-1, self.in_features).contiguous())
        weights = self._weight, self.scales, self.zeros, self.bias
        result = _int8_ops.qlinear_pointwise(*values, *weights, *self.float_output, "none")
        return result.view(*x.shape[:-1], self.out_features)


class Int8Conv(_Int8Layer):
    """Convolution on int8 products, float32 in and out, channels-last, with the activation that follows fused in."""

    def __init__(self, conv: nn.Conv2d, activation: Activation = "none") -> None:
        weight, scales = quantise_weight(conv.weight.detach())
        super().__init__(conv, scales, activation)
        self.geometry = conv.stride, conv.padding, conv.dilation, conv.groups
        # The input's scale is passed again with each call; packing only needs some value.
        self._weight = _int8_ops.qconv_prepack(weight, scales, 1.0, _LEVELS // 2, *self.geometry)

    def forward(self, x: Float[Tensor, "batch channel h w"]) -> Float[Tensor, "batch out h2 w2"]:
        values = quantise_input(x.contiguous(memory_format=torch.channels_last))
        weights = self._weight, self.scales, self.zeros, self.bias
        return _int8_ops.qconv_pointwise(*values, *weights, *self.geometry, *self.float_output, "")


def quantise_weight(weight: Float[Tensor, "out *rest"]) -> tuple[Tensor, Float[Tensor, "out"]]:
    """Return (int8 weight, scale per output channel), symmetric around 0."""
    scales = weight.float().flatten(1).abs().amax(1).clamp(min=1e-12) / 127
    shape = (-1, *(1 for _ in weight.shape[1:]))
    return (weight / scales.view(shape)).round().to(torch.int8), scales


def quantise_input(x: Float[Tensor, "*shape"]) -> tuple[Tensor, float, int]:
    """Return (uint8 values, scale, zero point) with the whole range of `x`, zero included, on 255 levels.

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
