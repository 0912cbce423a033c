"""An independent float64 calculation of the published network, straight from an official state
dict.

Deliberately plain: one view and one head at a time, explicit softmax, rotation channel by channel,
interpolation as matrices, the published order of operations. It shares no code with the plugin.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F


@dataclass(frozen=True)
class Sizes:
    width: int
    depth: int
    heads: int
    decoder_width: int
    decoder_depth: int
    decoder_heads: int
    feature: int
    point: int
    layers: tuple[int, int, int, int]
    channels: int = 83


FULL = Sizes(1024, 24, 16, 768, 12, 12, 256, 128, (96, 192, 384, 768))


def official_shapes(s: Sizes) -> dict[str, tuple[int, ...]]:
    """Every key of an official checkpoint of these sizes, with its shape."""
    shapes: dict[str, tuple[int, ...]] = {
        "backbone.mask_token": (1, 1, s.decoder_width)
    }

    def linear(name, inputs, outputs):
        shapes[f"{name}.weight"], shapes[f"{name}.bias"] = (outputs, inputs), (outputs,)

    def norm(name, width):
        shapes[f"{name}.weight"] = shapes[f"{name}.bias"] = (width,)

    def conv(name, inputs, outputs, kernel, bias=True, transposed=False):
        shapes[f"{name}.weight"] = (
            *((inputs, outputs) if transposed else (outputs, inputs)),
            kernel,
            kernel,
        )
        if bias:
            shapes[f"{name}.bias"] = (outputs,)

    conv("backbone.patch_embed.proj", 3, s.width, 16)
    for i in range(s.depth):
        block, w = f"backbone.enc_blocks.{i}", s.width
        norm(f"{block}.norm1", w), norm(f"{block}.norm2", w)
        linear(f"{block}.attn.qkv", w, 3 * w), linear(f"{block}.attn.proj", w, w)
        linear(f"{block}.mlp.fc1", w, 4 * w), linear(f"{block}.mlp.fc2", 4 * w, w)
    norm("backbone.enc_norm", s.width)
    linear("backbone.decoder_embed", s.width, s.decoder_width)
    for stack in ("dec_blocks", "dec_blocks2"):
        for i in range(s.decoder_depth):
            block, w = f"backbone.{stack}.{i}", s.decoder_width
            for name in ("norm1", "norm2", "norm3", "norm_y"):
                norm(f"{block}.{name}", w)
            linear(f"{block}.attn.qkv", w, 3 * w), linear(f"{block}.attn.proj", w, w)
            for name in ("projq", "projk", "projv", "proj"):
                linear(f"{block}.cross_attn.{name}", w, w)
            linear(f"{block}.mlp.fc1", w, 4 * w), linear(f"{block}.mlp.fc2", 4 * w, w)
    norm("backbone.dec_norm", s.decoder_width)
    linear("backbone.intrinsic_encoder", 9, s.width)
    for name in (
        "downstream_head1",
        "downstream_head2",
        "gaussian_param_head",
        "gaussian_param_head2",
    ):
        dpt, tokens = f"{name}.dpt", (s.width, *[s.decoder_width] * 3)
        for k in range(4):
            conv(
                f"{dpt}.scratch.layer{k + 1}_rn", s.layers[k], s.feature, 3, bias=False
            )
            conv(f"{dpt}.scratch.layer_rn.{k}", s.layers[k], s.feature, 3, bias=False)
            conv(f"{dpt}.scratch.refinenet{k + 1}.out_conv", s.feature, s.feature, 1)
            for unit in (1, 2):
                for c in (1, 2):
                    conv(
                        f"{dpt}.scratch.refinenet{k + 1}.resConfUnit{unit}.conv{c}",
                        s.feature,
                        s.feature,
                        3,
                    )
            conv(f"{dpt}.act_postprocess.{k}.0", tokens[k], s.layers[k], 1)
        conv(f"{dpt}.act_postprocess.0.1", s.layers[0], s.layers[0], 4, transposed=True)
        conv(f"{dpt}.act_postprocess.1.1", s.layers[1], s.layers[1], 2, transposed=True)
        conv(f"{dpt}.act_postprocess.3.1", s.layers[3], s.layers[3], 3)
        if name.startswith("downstream"):
            (
                conv(f"{dpt}.head.0", s.feature, s.point, 3),
                conv(f"{dpt}.head.2", s.point, s.point, 3),
            )
            conv(f"{dpt}.head.4", s.point, 3, 1)
        else:
            conv(f"{dpt}.input_merger.0", 3, s.feature, 7)
            conv(f"{dpt}.head.0", s.feature, s.feature, 3, bias=False)
            conv(f"{dpt}.head.4", s.feature, s.channels, 1)
    return shapes


def random_state(sizes: Sizes, seed: int) -> dict[str, torch.Tensor]:
    """Random weights lively enough that every part shows in the result: no zero biases, no unit
    norms.
    """
    generator = torch.Generator().manual_seed(seed)
    state = {}
    for key, shape in official_shapes(sizes).items():
        if len(shape) > 1:
            fan_in = math.prod(shape[1:])
            gain = 1.2 if key.startswith("backbone") else 0.8
            state[key] = torch.randn(shape, generator=generator) * (gain / fan_in**0.5)
        else:
            state[key] = 0.2 * torch.randn(shape, generator=generator) + (
                "norm" in key and key.endswith("weight")
            )
    for key in list(state):
        if ".scratch.layer" in key and "_rn.weight" in key:
            head, _, rest = key.partition(".scratch.layer")
            state[f"{head}.scratch.layer_rn.{int(rest[0]) - 1}.weight"] = state[key]
    return state


class Reference:
    """Runs in float64; images [B, V, 3, H, W] in [0, 1], normalised intrinsics [B, V, 3, 3]."""

    def __init__(self, state: dict[str, torch.Tensor], sizes: Sizes) -> None:
        self.w = {key: value.double() for key, value in state.items()}
        self.s = sizes

    def tokens(self, images, intrinsics):
        """All levels, [B, V, N, C] each, without the intrinsics token."""
        images, intrinsics = images.double(), intrinsics.double()
        batch, views, _, height, width = images.shape
        grid = (height // 16, width // 16)
        positions = [(r, c) for r in range(grid[0]) for c in range(grid[1])] + [
            (grid[0], 0)
        ]
        encoded = [
            [
                self._encode(images[b, v], intrinsics[b, v], positions)
                for v in range(views)
            ]
            for b in range(batch)
        ]
        scenes = [self._decode(scene, positions) for scene in encoded]
        count = len(scenes[0])
        return [
            torch.stack(
                [torch.stack([x[:-1] for x in scene[level]]) for scene in scenes]
            )
            for level in range(count)
        ]

    def _encode(self, image, intrinsics, positions):
        w = self.w
        kernel = w["backbone.patch_embed.proj.weight"].flatten(1)
        patches = (image * 2 - 1).unfold(1, 16, 16).unfold(2, 16, 16)  # 3 n m 16 16
        patches = patches.permute(1, 2, 0, 3, 4).flatten(2).flatten(0, 1)
        tokens = patches @ kernel.T + w["backbone.patch_embed.proj.bias"]
        x = torch.cat(
            (
                tokens,
                self._linear("backbone.intrinsic_encoder", intrinsics.reshape(1, 9)),
            )
        )
        for i in range(self.s.depth):
            name = f"backbone.enc_blocks.{i}"
            x = x + self._self_attention(
                f"{name}.attn", self._norm(f"{name}.norm1", x), positions, self.s.heads
            )
            x = x + self._mlp(f"{name}.mlp", self._norm(f"{name}.norm2", x))
        return self._norm("backbone.enc_norm", x)

    def _decode(self, encoded, positions):
        levels = [encoded]
        current = [self._linear("backbone.decoder_embed", x) for x in encoded]
        for i in range(self.s.decoder_depth):
            following = []
            for view, x in enumerate(current):
                others = [current[j] for j in range(len(current)) if j != view]
                name = f"backbone.dec_blocks{'' if view == 0 else '2'}.{i}"
                following.append(
                    self._decoder_block(
                        name, x, torch.cat(others), positions, len(others)
                    )
                )
            current = following
            levels.append(current)
        levels[-1] = [self._norm("backbone.dec_norm", x) for x in current]
        return levels

    def _decoder_block(self, name, x, memory, positions, others):
        heads = self.s.decoder_heads
        x = x + self._self_attention(
            f"{name}.attn", self._norm(f"{name}.norm1", x), positions, heads
        )
        y = self._norm(f"{name}.norm_y", memory)
        q = self._linear(f"{name}.cross_attn.projq", self._norm(f"{name}.norm2", x))
        k, v = (
            self._linear(f"{name}.cross_attn.projk", y),
            self._linear(f"{name}.cross_attn.projv", y),
        )
        mixed = self._attention(q, k, v, positions, positions * others, heads)
        x = x + self._linear(f"{name}.cross_attn.proj", mixed)
        return x + self._mlp(f"{name}.mlp", self._norm(f"{name}.norm3", x))

    def _self_attention(self, name, x, positions, heads):
        q, k, v = self._linear(f"{name}.qkv", x).chunk(3, -1)
        return self._linear(
            f"{name}.proj", self._attention(q, k, v, positions, positions, heads)
        )

    def _attention(self, q, k, v, positions_q, positions_k, heads):
        size = q.shape[1] // heads
        results = []
        for h in range(heads):
            part = slice(h * size, (h + 1) * size)
            qh, kh = _rotate(q[:, part], positions_q), _rotate(k[:, part], positions_k)
            scores = qh @ kh.T / math.sqrt(size)
            weights = (scores - scores.amax(1, keepdim=True)).exp()
            results.append(weights / weights.sum(1, keepdim=True) @ v[:, part])
        return torch.cat(results, 1)

    def _linear(self, name, x):
        return x @ self.w[f"{name}.weight"].T + self.w[f"{name}.bias"]

    def _norm(self, name, x):
        centred = x - x.mean(-1, keepdim=True)
        variance = (centred**2).mean(-1, keepdim=True)
        return (
            centred / (variance + 1e-6).sqrt() * self.w[f"{name}.weight"]
            + self.w[f"{name}.bias"]
        )

    def _mlp(self, name, x):
        hidden = self._linear(f"{name}.fc1", x)
        return self._linear(
            f"{name}.fc2", hidden * 0.5 * (1 + torch.erf(hidden / math.sqrt(2)))
        )

    def raw(self, levels, images):
        """(points [B,V,3,H,W], parameters [B,V,83,H,W]) from `tokens`' levels."""
        depth = self.s.decoder_depth
        hooks = [levels[i] for i in (0, depth // 2, depth * 3 // 4, depth)]
        batch, views, _, height, width = images.shape
        grid = (height // 16, width // 16)
        points, parameters = [], []
        for b in range(batch):
            for v in range(views):
                maps = [x[b, v].T.reshape(1, -1, *grid) for x in hooks]
                points.append(
                    self._points(f"downstream_head{1 if v == 0 else 2}.dpt", maps)
                )
                pixels = images[b, v, None].double() * 2 - 1
                parameters.append(
                    self._parameters(
                        f"gaussian_param_head{'' if v == 0 else '2'}.dpt", maps, pixels
                    )
                )
        return tuple(
            torch.cat(x).unflatten(0, (batch, views)) for x in (points, parameters)
        )

    def _points(self, name, maps):
        x = _double(self._conv(f"{name}.head.0", self._trunk(name, maps), 1))
        return self._conv(
            f"{name}.head.4", self._conv(f"{name}.head.2", x, 1).clamp(min=0), 0
        )

    def _parameters(self, name, maps, pixels):
        x = _double(self._trunk(name, maps)) + self._conv(
            f"{name}.input_merger.0", pixels, 3
        ).clamp(min=0)
        return self._conv(
            f"{name}.head.4", self._conv(f"{name}.head.0", x, 1).clamp(min=0), 0
        )

    def _trunk(self, name, maps):
        layers = []
        for k in range(4):
            x = self._conv(f"{name}.act_postprocess.{k}.0", maps[k], 0)
            if k < 2:
                x = self._grow(f"{name}.act_postprocess.{k}.1", x)
            if k == 3:
                x = self._conv(f"{name}.act_postprocess.{k}.1", x, 1, stride=2)
            layers.append(self._conv(f"{name}.scratch.layer_rn.{k}", x, 1))
        path = self._fuse(f"{name}.scratch.refinenet4", layers[3])[
            ..., : maps[0].shape[2], : maps[0].shape[3]
        ]
        for k in (2, 1, 0):
            path = self._fuse(f"{name}.scratch.refinenet{k + 1}", path, layers[k])
        return path

    def _fuse(self, name, x, other=None):
        if other is not None:
            x = x + self._unit(f"{name}.resConfUnit1", other)
        return self._conv(
            f"{name}.out_conv", _double(self._unit(f"{name}.resConfUnit2", x)), 0
        )

    def _unit(self, name, x):
        return x + self._conv(
            f"{name}.conv2",
            self._conv(f"{name}.conv1", x.clamp(min=0), 1).clamp(min=0),
            1,
        )

    def _conv(self, name, x, padding, stride=1):
        return F.conv2d(
            x, self.w[f"{name}.weight"], self.w.get(f"{name}.bias"), stride, padding
        )

    def _grow(self, name, x):
        weight, (rows, columns) = self.w[f"{name}.weight"], x.shape[2:]
        k = weight.shape[-1]
        grown = torch.einsum("bchw,cdij->bdhiwj", x, weight).reshape(
            1, -1, rows * k, columns * k
        )
        return grown + self.w[f"{name}.bias"][:, None, None]

    def gaussians(self, images, intrinsics):
        """Dictionary of the published outputs; harmonics [B, G, 25, 3], quats xyzw, covariances [B,
        G, 3, 3].
        """
        points, parameters = self.raw(self.tokens(images, intrinsics), images)
        return to_gaussians(points, parameters)


def to_gaussians(points, parameters):
    def rows(maps):
        return maps.permute(0, 1, 3, 4, 2).reshape(maps.shape[0], -1, maps.shape[2])

    raw, p = rows(points), rows(parameters)
    distance = raw.norm(dim=-1, keepdim=True)
    quats = p[..., 4:8] / (p[..., 4:8].norm(dim=-1, keepdim=True) + 1e-8)
    scales = (0.001 * torch.log1p(p[..., 1:4].exp())).clamp(max=0.3)
    harmonics = p[..., 8:].reshape(*p.shape[:2], 3, 25).permute(0, 1, 3, 2).clone()
    for level in range(1, 5):
        harmonics[..., level**2 : (level + 1) ** 2, :] *= 0.1 * 0.25**level
    return {
        "means": raw / distance.clamp(min=1e-8) * (distance.exp() - 1),
        "opacities": 1 / (1 + (-p[..., 0]).exp()),
        "scales": scales,
        "quats": quats,
        "covariances": _covariances(scales, quats),
        "harmonics": harmonics,
    }


def _covariances(scales, quats):
    x, y, z, w = quats.unbind(-1)
    two = 2 / ((quats**2).sum(-1) + 1e-8)
    rotation = torch.stack(
        [
            1 - two * (y * y + z * z), two * (x * y - z * w), two * (x * z + y * w),
            two * (x * y + z * w), 1 - two * (x * x + z * z), two * (y * z - x * w),
            two * (x * z - y * w), two * (y * z + x * w), 1 - two * (x * x + y * y),
        ],
        -1,
    ).unflatten(-1, (3, 3))  # fmt: skip
    return rotation @ torch.diag_embed(scales**2) @ rotation.mT


def _rotate(x, positions):
    """Channel pairs (j, j + D/2) inside the row half and inside the column half, D being half the
    head's width.
    """
    half = x.shape[1] // 2
    result = x.clone()
    for axis in (0, 1):
        for j in range(half // 2):
            a, b = axis * half + j, axis * half + j + half // 2
            angle = torch.tensor(
                [p[axis] * 100.0 ** (-2 * j / half) for p in positions],
                dtype=torch.float64,
            )
            result[:, a] = x[:, a] * angle.cos() - x[:, b] * angle.sin()
            result[:, b] = x[:, b] * angle.cos() + x[:, a] * angle.sin()
    return result


def _double(x):
    rows, columns = (_doubling(size) for size in x.shape[2:])
    return rows @ x @ columns.T


def _doubling(size):
    """Matrix that places 2 size samples evenly from the first to the last, corners kept."""
    matrix = torch.zeros(2 * size, size, dtype=torch.float64)
    for i in range(2 * size):
        at = i * (size - 1) / (2 * size - 1)
        low = min(int(at), size - 1)
        matrix[i, low] += 1 - (at - low)
        matrix[i, min(low + 1, size - 1)] += at - low
    return matrix
