"""A network in the files of TensorFlow.js (a graph as JSON, its numbers beside it), run by torch.

Only the operations of convolutional detectors are known. Nothing of the file is executed.
"""

import base64
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from edit3r.contract.errors import InputError, one_line
from edit3r.kit.files.text import read_json

DAMAGE = (
    KeyError,
    ValueError,
    TypeError,
    IndexError,
    AttributeError,
    RuntimeError,
    OSError,
)
"""What reading or running a file that is not whole can raise."""


class TfjsGraph:
    """The graph of a `.json` file whose numbers lie in one file of the same name and `.bin`."""

    def __init__(self, path: Path) -> None:
        """Raises InputError for files that cannot be read."""
        self.path = path
        try:
            content = read_json(path)
            nodes = content["modelTopology"]["node"]
            self._nodes = {node["name"]: node for node in nodes}
            self._consts = _numbers(
                content["weightsManifest"], path.with_suffix(".bin")
            )
            unknown = (
                {node["op"] for node in nodes}
                - set(OPERATIONS)
                - {"Const", "Placeholder"}
            )
        except DAMAGE as error:
            raise InputError(
                f"{path}: is no whole graph of TensorFlow.js ({one_line(error, 120)})."
            ) from None
        if unknown:
            raise InputError(
                f"{path}: asks for {', '.join(sorted(unknown))}, which is not known."
            )

    def run(self, inputs: Mapping[str, Tensor], outputs: list[str]) -> list[Tensor]:
        """The values of the nodes `outputs`. Raises InputError where the graph has none such."""
        known: dict[str, Any] = {**self._consts, **inputs}
        try:
            for name in outputs:
                self._compute(name, known)
            return [known[name] for name in outputs]
        except DAMAGE as error:
            raise InputError(
                f"{self.path}: does not compute {', '.join(outputs)} ({one_line(error, 120)}); "
                "it is damaged or another network."
            ) from None

    def _compute(self, wanted: str, known: dict[str, Any]) -> None:
        """Fill in the value of a node and all that it needs, without recursion."""
        waiting = [wanted]
        while waiting:
            name = waiting[-1]
            node = self._nodes[name]
            sources = [one.split(":")[0] for one in node.get("input", ())]
            missing = [one for one in sources if one not in known]
            if len(waiting) > len(self._nodes):
                raise ValueError("a node needs itself")
            if name not in known and missing:
                waiting += missing
                continue
            waiting.pop()
            if name not in known:
                values = [_output(known, one) for one in node["input"]]
                known[name] = OPERATIONS[node["op"]](node.get("attr", {}), *values)


def _output(known: Mapping[str, Any], name: str) -> Tensor:
    """A value by its name; "split:1" is the second of several."""
    name, _, place = name.partition(":")
    value = known[name]
    return value[int(place or 0)] if isinstance(value, tuple) else value


def _numbers(manifest: list[dict], path: Path) -> dict[str, Tensor]:
    """The constants that the manifest lists, which follow each other in the file."""
    content = path.read_bytes()
    start, found = 0, {}
    for entry in (entry for group in manifest for entry in group["weights"]):
        stored = np.dtype(entry.get("quantization", entry)["dtype"])
        count = int(np.prod(entry["shape"], dtype=np.int64))
        values = np.frombuffer(content, stored, count, start).astype(entry["dtype"])
        if np.isnan(values).any():
            raise ValueError("a number is NaN")
        found[entry["name"]] = torch.from_numpy(values.reshape(entry["shape"]))
        start += count * stored.itemsize
    if start != len(content):
        raise ValueError(f"{path.name} has {len(content)} bytes, expected {start}")
    return found


def _conv(attributes: Mapping[str, Any], x: Tensor, kernel: Tensor) -> Tensor:
    """Of `[n, h, w, c]` with `[h, w, in, out]`, not padded."""
    _expect(attributes, "padding", b"VALID")
    strides = [int(one) for one in attributes["strides"]["list"]["i"][1:3]]
    moved = F.conv2d(x.permute(0, 3, 1, 2), kernel.permute(3, 2, 0, 1), stride=strides)
    return moved.permute(0, 2, 3, 1)


def _max_pool(attributes: Mapping[str, Any], x: Tensor) -> Tensor:
    _expect(attributes, "padding", b"VALID")
    side = [int(one) for one in attributes["ksize"]["list"]["i"][1:3]]
    strides = [int(one) for one in attributes["strides"]["list"]["i"][1:3]]
    return F.max_pool2d(x.permute(0, 3, 1, 2), side, strides).permute(0, 2, 3, 1)


def _resize(attributes: Mapping[str, Any], x: Tensor, size: Tensor) -> Tensor:
    large = F.interpolate(x.permute(0, 3, 1, 2), size.tolist(), mode="bilinear")
    return large.permute(0, 2, 3, 1)


def _pad(
    attributes: Mapping[str, Any], x: Tensor, widths: Tensor, value: Any = 0.0
) -> Tensor:
    return F.pad(x, widths.flip(0).flatten().tolist(), value=float(value))


def _to_dense(
    attributes: Mapping[str, Any],
    indices: Tensor,
    size: Tensor,
    values: Tensor,
    default: Tensor,
) -> Tensor:
    dense = torch.full(size.tolist(), default.item(), dtype=values.dtype)
    if len(values):
        dense[tuple(indices.long().T)] = values
    return dense


def _expect(attributes: Mapping[str, Any], key: str, wanted: bytes) -> None:
    if base64.b64decode(attributes[key]["s"]) != wanted:
        raise ValueError(f"{key} other than {wanted.decode()}")


OPERATIONS: dict[str, Callable[..., Any]] = {
    "Add": lambda _, a, b: a + b,
    "AddV2": lambda _, a, b: a + b,
    "ConcatV2": lambda _, *values: torch.cat(values[:-1], int(values[-1])),
    "Conv2D": _conv,
    "Identity": lambda _, x: x,
    "LeakyRelu": lambda attributes, x: F.leaky_relu(x, attributes["alpha"]["f"]),
    "MaxPool": _max_pool,
    "Pad": _pad,
    "PadV2": _pad,
    "Reshape": lambda _, x, size: x.reshape(size.tolist()),
    "ResizeBilinear": _resize,
    "Sigmoid": lambda _, x: x.sigmoid(),
    "SparseToDense": _to_dense,
    "SplitV": lambda _, x, sizes, axis: x.split(sizes.tolist(), int(axis)),
    "Transpose": lambda _, x, order: x.permute(order.tolist()),
}
"""What a node computes from its attributes and its inputs."""
