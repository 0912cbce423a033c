"""Loss `stlpips`: shift-tolerant LPIPS (Ghildyal and Liu, ECCV 2022), from the weights in the
package `stlpips-pytorch`.

A VGG-16 whose pooling is blurred, trained to judge alike what is shifted by a pixel, and five heads
that weight its features. The package's code needs torchvision, which breaks transformers beside a
CPU torch; so its file alone is read, by a network written from the paper's description. It is
another distance than LPIPS: its numbers do not stand beside the paper's.
"""

import importlib.util
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Loss, LossInputs
from edit3r.contract.settings import Settings
from edit3r_training.losses import require_fields

PACKAGE = "stlpips_pytorch"
FILE = "weights/vST0.0/vgg_shift_tolerant.pth"
LAYERS = (
    ("slice1.0", "slice1.2"),
    ("slice2.6", "slice2.8"),
    ("slice3.12", "slice3.14", "slice3.16"),
    ("slice4.20", "slice4.22", "slice4.24"),
    ("slice5.28", "slice5.30", "slice5.32"),
)
"""Names of the convolutions in the file, slice by slice; a slice ends with what is compared."""
SHIFT = (-0.030, -0.088, -0.188)  # of images in [-1, 1], as LPIPS has them
SCALE = (0.458, 0.448, 0.450)
BLUR = (0.25, 0.5, 0.25)  # along each side, between pooling and halving
PADDING = 2  # pixels mirrored at each border before the blur
LEAST_SIDE = (
    32  # of images [pixels]: below, the last slices are smaller than their padding
)

Images = Float[Tensor, "image 3 height width"]


class StLpipsLoss(Loss):
    """Mean shift-tolerant LPIPS distance with VGG features; 0 for equal images."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._network = ShiftTolerantVgg(read_weights(weight_file()))

    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        require_fields(inputs, "stlpips", "rendered", "target")
        network = self._network.to(inputs.rendered.device)
        return network(
            inputs.rendered.flatten(0, 1), inputs.target.flatten(0, 1)
        ).mean()


class ShiftTolerantVgg(nn.Module):
    """The frozen network: images in [0, 1] to one distance each."""

    def __init__(self, weights: Mapping[str, Tensor]) -> None:
        super().__init__()
        for name, value in weights.items():
            self.register_buffer(_plain(name), value.float(), persistent=False)

    def forward(self, first: Images, second: Images) -> Float[Tensor, "image"]:
        distance = first.new_zeros(len(first))
        pairs = zip(self._features(first), self._features(second))
        for index, (a, b) in enumerate(pairs):
            head = getattr(self, _plain(f"lin{index}.model.1.weight"))
            distance = distance + F.conv2d((a - b).square(), head).mean((1, 2, 3))
        return distance

    def _features(self, images: Images) -> list[Float[Tensor, "image c h w"]]:
        """What each slice ends with, every pixel's features of length 1."""
        x = _at_least(LEAST_SIDE, images)
        x = (2 * x - 1 - self._shift.to(x)) / self._scale.to(x)
        found = []
        for index, names in enumerate(LAYERS):
            x = _halved(x) if index else x
            for name in names:
                weight, bias = (
                    getattr(self, _plain(f"net.{name}.{part}"))
                    for part in ("weight", "bias")
                )
                x = F.relu(F.conv2d(x, weight, bias, padding=1))
            length = (x.square().sum(1, keepdim=True) + 1e-20).sqrt()
            found.append(x / (length + 1e-10))
        return found

    @cached_property
    def _shift(self) -> Float[Tensor, "3 1 1"]:
        return torch.tensor(SHIFT)[:, None, None]

    @cached_property
    def _scale(self) -> Float[Tensor, "3 1 1"]:
        return torch.tensor(SCALE)[:, None, None]


def _halved(
    x: Float[Tensor, "image c height width"],
) -> Float[Tensor, "image c half half2"]:
    """The largest of each four neighbours, blurred, at every second place."""
    row = x.new_tensor(BLUR)
    kernel = (row[:, None] * row).expand(x.shape[1], 1, 3, 3)
    pooled = F.pad(F.max_pool2d(x, 2, stride=1), (PADDING,) * 4, mode="reflect")
    return F.conv2d(pooled, kernel, stride=2, groups=x.shape[1])


def _at_least(side: int, images: Images) -> Images:
    """Small images enlarged so that every slice is larger than its padding."""
    height, width = images.shape[-2:]
    size = (max(side, height), max(side, width))
    if size == (height, width):
        return images
    return F.interpolate(images, size, mode="bilinear")


def weight_file() -> Path:
    """The file in the installed package, whose code does not run."""
    spec = importlib.util.find_spec(PACKAGE)
    folders = list(spec.submodule_search_locations or ()) if spec else []
    if not folders:
        raise InputError(f"loss 'stlpips': {PACKAGE} is installed without its weights.")
    return Path(folders[0]) / FILE


def read_weights(file: Path) -> dict[str, Tensor]:
    """The tensors of the file that the network needs; raises InputError where one is missing or of
    another shape.
    """
    try:
        content = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # torch has no error class of its own for damaged files
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"{file}: cannot be read as weights of 'stlpips' ({reason}); install "
            "stlpips-pytorch again."
        ) from None
    convolutions = [f"net.{name}" for names in LAYERS for name in names]
    wanted = [f"{name}.{part}" for name in convolutions for part in ("weight", "bias")]
    wanted += [f"lin{index}.model.1.weight" for index in range(len(LAYERS))]
    missing = [name for name in wanted if not isinstance(content.get(name), Tensor)]
    if missing:
        raise InputError(
            f"{file}: lacks {len(missing)} of the tensors of 'stlpips', such as {missing[0]}; "
            "install stlpips-pytorch again."
        )
    return {name: content[name] for name in wanted}


def _plain(name: str) -> str:
    """A tensor's name without dots, which buffers may not have."""
    return name.replace(".", "_")
