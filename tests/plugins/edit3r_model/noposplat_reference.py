"""An independent float64 calculation of the published network, straight from an official state
dict.

Deliberately plain: one view and one head at a time, explicit softmax, rotation channel by channel,
interpolation as matrices, the published order of operations. It shares no code with the plugin.
"""

import math
import re
from dataclasses import dataclass
from itertools import product

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
    shapes = {"backbone.mask_token": (1, 1, s.decoder_width)}

    def weight(name, *shape, bias=True):
        shapes[f"{name}.weight"] = shape
        if bias:
            shapes[f"{name}.bias"] = shape[:1]

    def block(name, w, norms):
        for norm in norms:
            weight(f"{name}.{norm}", w)
        weight(f"{name}.attn.qkv", 3 * w, w)
        weight(f"{name}.attn.proj", w, w)
        weight(f"{name}.mlp.fc1", 4 * w, w)
        weight(f"{name}.mlp.fc2", w, 4 * w)

    width, decoder_width = s.width, s.decoder_width
    weight("backbone.patch_embed.proj", width, 3, 16, 16)
    for i in range(s.depth):
        block(f"backbone.enc_blocks.{i}", width, ("norm1", "norm2"))
    weight("backbone.enc_norm", width)
    weight("backbone.decoder_embed", decoder_width, width)
    for stack, i in product(("dec_blocks", "dec_blocks2"), range(s.decoder_depth)):
        name = f"backbone.{stack}.{i}"
        block(name, decoder_width, ("norm1", "norm2", "norm3", "norm_y"))
        for part in ("projq", "projk", "projv", "proj"):
            weight(f"{name}.cross_attn.{part}", decoder_width, decoder_width)
    weight("backbone.dec_norm", decoder_width)
    weight("backbone.intrinsic_encoder", width, 9)
    for role in ("1", "2"):
        _dpt_shapes(s, f"downstream_head{role}.dpt", weight)
        _dpt_shapes(s, f"gaussian_param_head{role.strip('1')}.dpt", weight)
    return shapes


def _dpt_shapes(s: Sizes, dpt: str, weight) -> None:
    tokens = (s.width, *[s.decoder_width] * 3)
    f, (first, second, _, last) = s.feature, s.layers
    for k, layer in enumerate(s.layers):
        fuse = f"{dpt}.scratch.refinenet{k + 1}"
        weight(f"{dpt}.act_postprocess.{k}.0", layer, tokens[k], 1, 1)
        weight(f"{dpt}.scratch.layer{k + 1}_rn", f, layer, 3, 3, bias=False)
        weight(f"{dpt}.scratch.layer_rn.{k}", f, layer, 3, 3, bias=False)
        weight(f"{fuse}.out_conv", f, f, 1, 1)
        for unit, conv in product((1, 2), (1, 2)):
            weight(f"{fuse}.resConfUnit{unit}.conv{conv}", f, f, 3, 3)
    weight(f"{dpt}.act_postprocess.0.1", first, first, 4, 4)
    weight(f"{dpt}.act_postprocess.1.1", second, second, 2, 2)
    weight(f"{dpt}.act_postprocess.3.1", last, last, 3, 3)
    if dpt.startswith("downstream"):
        weight(f"{dpt}.head.0", s.point, f, 3, 3)
        weight(f"{dpt}.head.2", s.point, s.point, 3, 3)
        weight(f"{dpt}.head.4", 3, s.point, 1, 1)
    else:
        weight(f"{dpt}.input_merger.0", f, 3, 7, 7)
        weight(f"{dpt}.head.0", f, f, 3, 3, bias=False)
        weight(f"{dpt}.head.4", s.channels, f, 1, 1)


def random_state(sizes: Sizes, seed: int) -> dict[str, torch.Tensor]:
    """Random weights lively enough that every part shows in the result: no zero biases, no unit
    norms.
    """
    generator = torch.Generator().manual_seed(seed)
    state = {}
    for key, shape in official_shapes(sizes).items():
        state[key] = torch.randn(shape, generator=generator)
        if len(shape) > 1:
            gain = 1.2 if key.startswith("backbone") else 0.8
            state[key] *= gain / math.prod(shape[1:]) ** 0.5
        else:
            state[key] = 0.2 * state[key] + ("norm" in key and key.endswith("weight"))
    for key in list(state):
        if found := re.fullmatch(r"(.+)\.layer(\d)_rn\.weight", key):
            state[f"{found[1]}.layer_rn.{int(found[2]) - 1}.weight"] = state[key]
    return state


class Reference:
    """Runs in float64; images [B, V, 3, H, W] in [0, 1], normalised intrinsics [B, V, 3, 3]."""

    def __init__(self, state: dict[str, torch.Tensor], sizes: Sizes) -> None:
        self.w = {key: value.double() for key, value in state.items()}
        self.s = sizes

    def tokens(self, images, intrinsics):
        """All levels, [B, V, N, C] each, without the intrinsics token."""
        images, intrinsics = images.double(), intrinsics.double()
        grid = [side // 16 for side in images.shape[-2:]]
        positions = [(r, c) for r in range(grid[0]) for c in range(grid[1])]
        positions.append((grid[0], 0))
        scenes = []
        for scene, lenses in zip(images, intrinsics):
            pairs = zip(scene, lenses)
            encoded = [self._encode(image, lens, positions) for image, lens in pairs]
            levels = self._decode(encoded, positions)
            scenes.append([torch.stack([x[:-1] for x in level]) for level in levels])
        return [torch.stack(level) for level in zip(*scenes)]

    def _encode(self, image, intrinsics, positions):
        w = self.w
        kernel = w["backbone.patch_embed.proj.weight"].flatten(1)
        patches = (image * 2 - 1).unfold(1, 16, 16).unfold(2, 16, 16)  # 3 n m 16 16
        patches = patches.permute(1, 2, 0, 3, 4).flatten(2).flatten(0, 1)
        tokens = patches @ kernel.T + w["backbone.patch_embed.proj.bias"]
        lens = self._linear("backbone.intrinsic_encoder", intrinsics.reshape(1, 9))
        x = torch.cat((tokens, lens))
        for i in range(self.s.depth):
            name = f"backbone.enc_blocks.{i}"
            x = self._attend_to_itself(name, x, positions, self.s.heads)
            x = x + self._mlp(f"{name}.mlp", self._norm(f"{name}.norm2", x))
        return self._norm("backbone.enc_norm", x)

    def _decode(self, encoded, positions):
        levels = [encoded]
        current = [self._linear("backbone.decoder_embed", x) for x in encoded]
        for i in range(self.s.decoder_depth):
            following = []
            for view, x in enumerate(current):
                others = [x for j, x in enumerate(current) if j != view]
                name = f"backbone.dec_blocks{'' if view == 0 else '2'}.{i}"
                following.append(self._decoder_block(name, x, others, positions))
            current = following
            levels.append(current)
        levels[-1] = [self._norm("backbone.dec_norm", x) for x in current]
        return levels

    def _decoder_block(self, name, x, others, positions):
        cross, heads = f"{name}.cross_attn", self.s.decoder_heads
        x = self._attend_to_itself(name, x, positions, heads)
        y = self._norm(f"{name}.norm_y", torch.cat(others))
        q = self._linear(f"{cross}.projq", self._norm(f"{name}.norm2", x))
        k, v = (self._linear(f"{cross}.{part}", y) for part in ("projk", "projv"))
        read = positions * len(others)
        mixed = self._attention(q, k, v, positions, read, heads)
        x = x + self._linear(f"{cross}.proj", mixed)
        return x + self._mlp(f"{name}.mlp", self._norm(f"{name}.norm3", x))

    def _attend_to_itself(self, name, x, positions, heads):
        qkv = self._linear(f"{name}.attn.qkv", self._norm(f"{name}.norm1", x))
        mixed = self._attention(*qkv.chunk(3, -1), positions, positions, heads)
        return x + self._linear(f"{name}.attn.proj", mixed)

    def _attention(self, q, k, v, positions_q, positions_k, heads):
        results = []
        for qh, kh, vh in zip(*(x.chunk(heads, 1) for x in (q, k, v))):
            qh, kh = _rotate(qh, positions_q), _rotate(kh, positions_k)
            scores = qh @ kh.T / math.sqrt(qh.shape[1])
            results.append(scores.softmax(1) @ vh)
        return torch.cat(results, 1)

    def _linear(self, name, x):
        return x @ self.w[f"{name}.weight"].T + self.w[f"{name}.bias"]

    def _norm(self, name, x):
        weight, bias = self.w[f"{name}.weight"], self.w[f"{name}.bias"]
        return F.layer_norm(x, x.shape[-1:], weight, bias, 1e-6)

    def _mlp(self, name, x):
        hidden = self._linear(f"{name}.fc1", x)
        exact_gelu = hidden * 0.5 * (1 + torch.erf(hidden / math.sqrt(2)))
        return self._linear(f"{name}.fc2", exact_gelu)

    def raw(self, levels, images):
        """(points [B,V,3,H,W], parameters [B,V,83,H,W]) from `tokens`' levels."""
        depth = self.s.decoder_depth
        hooks = [levels[i] for i in (0, depth // 2, depth * 3 // 4, depth)]
        batch, views = images.shape[:2]
        grid = [side // 16 for side in images.shape[-2:]]
        points, parameters = [], []
        for b, v in product(range(batch), range(views)):
            role = "" if v == 0 else "2"
            maps = [x[b, v].T.reshape(1, -1, *grid) for x in hooks]
            pixels = images[b, v, None].double() * 2 - 1
            points.append(self._points(f"downstream_head{role or '1'}.dpt", maps))
            name = f"gaussian_param_head{role}.dpt"
            parameters.append(self._parameters(name, maps, pixels))
        rows = (torch.cat(x).unflatten(0, (batch, views)) for x in (points, parameters))
        return tuple(rows)

    def _points(self, name, maps):
        x = _double(self._conv(f"{name}.head.0", self._trunk(name, maps), 1))
        x = self._conv(f"{name}.head.2", x, 1).relu()
        return self._conv(f"{name}.head.4", x, 0)

    def _parameters(self, name, maps, pixels):
        seen = self._conv(f"{name}.input_merger.0", pixels, 3).relu()
        x = _double(self._trunk(name, maps)) + seen
        x = self._conv(f"{name}.head.0", x, 1).relu()
        return self._conv(f"{name}.head.4", x, 0)

    def _trunk(self, name, maps):
        layers = []
        for k in range(4):
            x = self._conv(f"{name}.act_postprocess.{k}.0", maps[k], 0)
            last = f"{name}.act_postprocess.{k}.1"
            if k < 2:
                weight, bias = self.w[f"{last}.weight"], self.w[f"{last}.bias"]
                x = F.conv_transpose2d(x, weight, bias, stride=weight.shape[-1])
            if k == 3:
                x = self._conv(last, x, 1, stride=2)
            layers.append(self._conv(f"{name}.scratch.layer_rn.{k}", x, 1))
        path = self._fuse(f"{name}.scratch.refinenet4", layers[3])
        path = path[..., : maps[0].shape[2], : maps[0].shape[3]]
        for k in (2, 1, 0):
            path = self._fuse(f"{name}.scratch.refinenet{k + 1}", path, layers[k])
        return path

    def _fuse(self, name, x, other=None):
        if other is not None:
            x = x + self._unit(f"{name}.resConfUnit1", other)
        refined = self._unit(f"{name}.resConfUnit2", x)
        return self._conv(f"{name}.out_conv", _double(refined), 0)

    def _unit(self, name, x):
        hidden = self._conv(f"{name}.conv1", x.relu(), 1).relu()
        return x + self._conv(f"{name}.conv2", hidden, 1)

    def _conv(self, name, x, padding, stride=1):
        weight, bias = self.w[f"{name}.weight"], self.w.get(f"{name}.bias")
        return F.conv2d(x, weight, bias, stride, padding)


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
