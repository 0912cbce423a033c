"""The network of the benchmark's baseline: plain eager float32 layers in the published order,
nothing done for speed.

It reads the weights of the plugin's network under the plugin's names, so both compute the same
thing; only the way differs: contiguous layouts, rotation in separate steps, keys and values of a
concatenated memory, interpolation before the 1x1 convolution, whole maps at once. Attention is
torch's fused kernel, as the published code allows.
"""

import torch
import torch.nn.functional as F
from torch import Tensor


class PlainNetwork:
    """Tokens and raw maps of two or more views from a state dict with names `backbone.*` and
    `head.*`.
    """

    def __init__(
        self,
        state: dict[str, Tensor],
        depth: int,
        decoder_depth: int,
        head_width: int = 64,
    ) -> None:
        self.state, self.depth, self.decoder_depth, self.head_width = (
            state,
            depth,
            decoder_depth,
            head_width,
        )

    def __call__(self, images: Tensor, intrinsics: Tensor) -> tuple[Tensor, Tensor]:
        """(raw points [V,3,H,W], raw parameters [V,83,H,W]) of one scene, images [V,3,H,W] in [0,
        1].
        """
        levels = self.levels(images, intrinsics)
        grid = images.shape[-2] // 16, images.shape[-1] // 16
        maps = [
            x[:, :-1].transpose(1, 2).unflatten(-1, grid).contiguous() for x in levels
        ]
        pixels = images * 2 - 1
        parts = [
            self._heads(role, [m[own] for m in maps], pixels[own])
            for role, own in _ROLES
        ]
        return tuple(torch.cat(x) for x in zip(*parts))

    def levels(self, images: Tensor, intrinsics: Tensor) -> list[Tensor]:
        grid = images.shape[-2] // 16, images.shape[-1] // 16
        angles = self._angles(grid)
        tokens = (
            self._conv("backbone.patch_embed", images * 2 - 1, stride=16)
            .flatten(2)
            .transpose(1, 2)
        )
        x = torch.cat(
            (
                tokens,
                self._linear(
                    "backbone.intrinsics_embed", intrinsics.flatten(1)[:, None]
                ),
            ),
            1,
        )
        for i in range(self.depth):
            x = self._block(f"backbone.encoder.{i}", x, angles)
        x = self._norm("backbone.encoder_norm", x)
        kept, x = [x], self._linear("backbone.decoder_embed", x)
        wanted = (
            self.decoder_depth // 2,
            self.decoder_depth * 3 // 4,
            self.decoder_depth,
        )
        for i in range(self.decoder_depth):
            x = torch.cat([self._decode(i, x, view, angles) for view in range(len(x))])
            if i + 1 in wanted:
                kept.append(x)
        kept[-1] = self._norm("backbone.decoder_norm", x)
        return kept

    def _decode(self, level: int, tokens: Tensor, view: int, angles: Tensor) -> Tensor:
        name = f"backbone.decoders.{min(view, 1)}.{level}"
        others = [i for i in range(len(tokens)) if i != view]
        memory = self._norm(f"{name}.norm_memory", tokens[others].flatten(0, 1)[None])
        x = self._attend(name, tokens[view, None], angles)
        query = self._linear(f"{name}.cross_attn.query", self._norm(f"{name}.norm2", x))
        key, value = self._linear(f"{name}.cross_attn.key_value", memory).chunk(2, -1)
        mixed = self._mix(query, key, value, angles, angles.repeat(1, len(others), 1))
        x = x + self._linear(f"{name}.cross_attn.proj", mixed)
        return x + self._mlp(name, self._norm(f"{name}.norm3", x))

    def _block(self, name: str, x: Tensor, angles: Tensor) -> Tensor:
        x = self._attend(name, x, angles)
        return x + self._mlp(name, self._norm(f"{name}.norm2", x))

    def _attend(self, name: str, x: Tensor, angles: Tensor) -> Tensor:
        query, key, value = self._linear(
            f"{name}.attn.qkv", self._norm(f"{name}.norm1", x)
        ).chunk(3, -1)
        return x + self._linear(
            f"{name}.attn.proj", self._mix(query, key, value, angles, angles)
        )

    def _mix(
        self, query: Tensor, key: Tensor, value: Tensor, at: Tensor, memory_at: Tensor
    ) -> Tensor:
        query, key, value = (
            x.unflatten(-1, (-1, self.head_width)).transpose(1, 2)
            for x in (query, key, value)
        )
        mixed = F.scaled_dot_product_attention(
            _rotate(query, at), _rotate(key, memory_at), value
        )
        return mixed.transpose(1, 2).flatten(2)

    def _mlp(self, name: str, x: Tensor) -> Tensor:
        return self._linear(
            f"{name}.mlp.fc2", F.gelu(self._linear(f"{name}.mlp.fc1", x))
        )

    def _angles(self, grid: tuple[int, int]) -> Tensor:
        """[2, token, channels per axis]: what rows and columns turn by."""
        rows, columns = torch.meshgrid(*(torch.arange(n) for n in grid), indexing="ij")
        at = torch.stack(
            (
                torch.cat((rows.flatten(), torch.tensor([grid[0]]))),
                F.pad(columns.flatten(), (0, 1)),
            )
        )
        pairs = self.head_width // 4
        return (at[..., None] * 100.0 ** (-torch.arange(pairs) / pairs)).repeat(1, 1, 2)

    def _heads(
        self, role: int, maps: list[Tensor], pixels: Tensor
    ) -> tuple[Tensor, Tensor]:
        name = f"head.centres.{role}"
        half = self._conv(f"{name}.conv1", self._trunk(name, maps), padding=1)
        points = self._conv(
            f"{name}.out", F.relu(self._conv(f"{name}.conv2", _double(half), padding=1))
        )
        name = f"head.attributes.{role}"
        seen = F.relu(self._conv(f"{name}.shortcut", pixels, padding=3))
        fused = self._conv(
            f"{name}.conv", _double(self._trunk(name, maps)) + seen, padding=1
        )
        return points, self._conv(f"{name}.out", F.relu(fused))

    def _trunk(self, name: str, maps: list[Tensor]) -> Tensor:
        layers = []
        for k, x in enumerate(maps):
            x = self._conv(f"{name}.trunk.reassemble.{k}.0", x)
            if k < 2:
                weight, bias = self._weights(f"{name}.trunk.reassemble.{k}.1")
                x = F.conv_transpose2d(x, weight, bias, stride=weight.shape[-1])
            if k == 3:
                x = self._conv(f"{name}.trunk.reassemble.3.1", x, stride=2, padding=1)
            layers.append(self._conv(f"{name}.trunk.project.{k}", x, padding=1))
        path = self._fuse(f"{name}.trunk.fuse.3", layers[3])[
            ..., : maps[0].shape[-2], : maps[0].shape[-1]
        ]
        for k in (2, 1, 0):
            path = self._fuse(
                f"{name}.trunk.fuse.{k}",
                path + self._unit(f"{name}.trunk.fuse.{k}.skip", layers[k]),
            )
        return path

    def _fuse(self, name: str, x: Tensor) -> Tensor:
        return self._conv(f"{name}.out", _double(self._unit(f"{name}.refine", x)))

    def _unit(self, name: str, x: Tensor) -> Tensor:
        inner = self._conv(f"{name}.conv1", F.relu(x), padding=1)
        return x + self._conv(f"{name}.conv2", F.relu(inner), padding=1)

    def _weights(self, name: str) -> tuple[Tensor, Tensor | None]:
        return self.state[f"{name}.weight"], self.state.get(f"{name}.bias")

    def _linear(self, name: str, x: Tensor) -> Tensor:
        return F.linear(x, *self._weights(name))

    def _norm(self, name: str, x: Tensor) -> Tensor:
        weight, bias = self._weights(name)
        return F.layer_norm(x, weight.shape, weight, bias, 1e-6)

    def _conv(self, name: str, x: Tensor, stride: int = 1, padding: int = 0) -> Tensor:
        return F.conv2d(x, *self._weights(name), stride, padding)


_ROLES = ((0, slice(0, 1)), (1, slice(1, None)))


def _double(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)


def _rotate(x: Tensor, angles: Tensor) -> Tensor:
    """Rows turn the first half of the channels, columns the second; pairs are a quarter of the head
    apart.
    """
    turned = []
    for part, angle in zip(x.chunk(2, -1), angles):
        first, second = part.chunk(2, -1)
        turned.append(
            part * angle.cos() + torch.cat((-second, first), -1) * angle.sin()
        )
    return torch.cat(turned, -1)
