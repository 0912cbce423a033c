"""3x3 convolution after Winograd, F(4x4, 3x3): 36 products where the plain form needs 144.

Lavin and Gray, Fast Algorithms for Convolutional Neural Networks (2016). A 6x6 patch of input d and a kernel g give a
4x4 patch of output A^T [(G g G^T) * (B^T d B^T^T)] A; the products over channels are 36 matrix products. Rounding is
about seven times that of the plain form (1e-5 of the largest output in float32).
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r_model.fast_layers import Activation

TILE, PATCH = 4, 6
TILES_AT_ONCE = 64
"""Patches transformed together; large enough for fast products, small enough to stay in the cache."""

# Interpolation points 0, 1, -1, 2, -2 and infinity.
_INPUT = (
    (4, 0, -5, 0, 1, 0),
    (0, -4, -4, 1, 1, 0),
    (0, 4, -4, -1, 1, 0),
    (0, -2, -1, 2, 1, 0),
    (0, 2, -1, -2, 1, 0),
    (0, 4, 0, -5, 0, 1),
)
_KERNEL = (
    (1 / 4, 0, 0),
    (-1 / 6, -1 / 6, -1 / 6),
    (-1 / 6, 1 / 6, -1 / 6),
    (1 / 24, 1 / 12, 1 / 6),
    (1 / 24, -1 / 12, 1 / 6),
    (0, 0, 1),
)
_OUTPUT = ((1, 1, 1, 1, 1, 0), (0, 1, -1, 2, -2, 0), (0, 1, 1, 4, 4, 0), (0, 1, -1, 8, -8, 1))


class WinogradConv(nn.Module):
    """Float32 3x3 convolution with stride 1, channels-last, with a ReLU on request; inference only."""

    def __init__(self, conv: nn.Conv2d, activation: Activation = "none") -> None:
        super().__init__()
        if (conv.kernel_size, conv.stride, conv.dilation, conv.groups) != ((3, 3), (1, 1), (1, 1), 1):
            raise ValueError("WinogradConv: expected a 3x3 convolution with stride 1, no dilation and one group")
        if activation not in ("none", "relu"):
            raise ValueError(f"WinogradConv: no activation {activation!r}")
        self.relu = activation == "relu"
        self.padding = conv.padding  # (rows, columns)
        kernel, source, target = (torch.tensor(m, dtype=torch.float64) for m in (_KERNEL, _INPUT, _OUTPUT))
        transformed = torch.einsum("ia,jb,ocab->ijco", kernel, kernel, conv.weight.detach().double())
        self.register_buffer("kernels", transformed.flatten(0, 1).float(), persistent=False)  # [36, in, out]
        self.register_buffer("source", torch.kron(source, source).float(), persistent=False)  # [36, 36]
        self.register_buffer("target", torch.kron(target, target).float(), persistent=False)  # [16, 36]
        self.register_buffer("bias", None if conv.bias is None else conv.bias.detach().float(), persistent=False)

    def forward(self, x: Float[Tensor, "batch channel h w"]) -> Float[Tensor, "batch out h w"]:
        return torch.cat([self._image(image) for image in x.permute(0, 2, 3, 1)]).permute(0, 3, 1, 2)

    def _image(self, x: Float[Tensor, "h w channel"]) -> Float[Tensor, "1 h w out"]:
        above, left = self.padding
        height, width = x.shape[0] + 2 * above - 2, x.shape[1] + 2 * left - 2
        rows, columns = -(-height // TILE), -(-width // TILE)
        # To whole tiles, and by the convolution's own padding.
        right, below = left + columns * TILE - width, above + rows * TILE - height
        padded = F.pad(x, (0, 0, left, right, above, below)) if any((left, right, above, below)) else x
        result = x.new_empty(rows * TILE, columns * TILE, self.kernels.shape[-1])
        step = max(1, TILES_AT_ONCE // columns)
        for row in range(0, rows, step):
            count = min(step, rows - row)
            result[row * TILE : (row + count) * TILE] = self._rows(padded[row * TILE :], count, columns)
        result = result[:height, :width]
        if self.bias is not None:
            result += self.bias
        return (result.relu_() if self.relu else result)[None]

    def _rows(self, x: Float[Tensor, "h w channel"], rows: int, columns: int) -> Float[Tensor, "h2 w2 out"]:
        """The first `rows` rows of tiles from the top of `x`, which is channels-last."""
        down, right, channel = x.stride()
        shape = (PATCH, PATCH, rows, columns, x.shape[2])
        patches = x.as_strided(shape, (down, right, TILE * down, TILE * right, channel), x.storage_offset())
        tiles = rows * columns
        spread = (self.source @ patches.reshape(PATCH * PATCH, -1)).view(PATCH * PATCH, tiles, -1)
        products = torch.bmm(spread, self.kernels)
        folded = self.target @ products.flatten(1)
        return (
            folded.view(TILE, TILE, rows, columns, -1).permute(2, 0, 3, 1, 4).reshape(rows * TILE, columns * TILE, -1)
        )
