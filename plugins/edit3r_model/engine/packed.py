"""Layers for inference on a CPU: oneDNN's own memory layouts, activations fused in, weights of half the size."""

from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

ROWS_HINT = 512
"""Typical number of tokens a linear sees; oneDNN chooses its layout for it, any other number gives equal results."""

_ops = torch.ops.mkldnn
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
        return _ops._linear_pointwise(flat, self._weight, self.bias, self.activation, [], "none").view(
            *x.shape[:-1], self.out_features
        )

    def extra_repr(self) -> str:
        return f"{self.in_features} -> {self.out_features}, {self.dtype}, activation={self.activation}"


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
    """A convolution in channels-last layout, with the activation that follows fused in.

    Held in `dtype`, computed in `arithmetic` (default: the same).
    """

    def __init__(
        self,
        conv: nn.Conv2d,
        dtype: torch.dtype,
        activation: Activation = "none",
        arithmetic: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.stride, self.padding, self.dilation, self.groups = conv.stride, conv.padding, conv.dilation, conv.groups
        self.activation, self.arithmetic = activation, arithmetic or dtype
        weight = conv.weight.detach().to(dtype).contiguous(memory_format=torch.channels_last)
        self.register_buffer("weight", weight, persistent=False)
        bias = None if conv.bias is None else conv.bias.detach().to(self.arithmetic)
        self.register_buffer("bias", bias, persistent=False)

    def forward(self, x: Float[Tensor, "batch channel h w"]) -> Float[Tensor, "batch out h2 w2"]:
        x = x.to(self.arithmetic).contiguous(memory_format=torch.channels_last)
        return _ops._convolution_pointwise(
            x,
            self.weight.to(self.arithmetic),
            self.bias,
            self.padding,
            self.stride,
            self.dilation,
            self.groups,
            self.activation,
            [],
            "",
        )
