"""The stand-in editor of the offline benchmark: it knows the edited truth and makes the views
disagree about it.

No editor that runs without weights can add or remove objects. So the images that a perfect editor
would return are taken from the generator and then made to disagree as those of real 2D editors do:
other colours, other texture, slightly moved structure in each view. It is not an editor, and
results say so by its name.
"""

import hashlib
import math
from dataclasses import replace
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from scipy.ndimage import gaussian_filter
from torch import Tensor

from edit3r.contract.interfaces import Editor
from edit3r.contract.settings import Settings
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.geometry.cameras import pixel_grid
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.geometry.warping import warp

Image = Float[Tensor, "3 height width"]

# Name by which `edit3r bench run --editor` asks for it; it is no plugin, since it needs the truth
# of the item
ORACLE = "oracle"
FAULTS = ("blurred", "shifted", "coloured")  # what may be wrong with a reference
NOISE_CELLS = 6  # cells of the texture and warp noise along each side of the image


class OracleSettings(Settings):
    """How much the views disagree."""

    # 0: every view shows the truth; 1: hardly alike.
    disagreement: float = Field(0.5, ge=0, le=1)
    # exact: the first view shows the truth, the others disagree with it, so the truth is what the
    # reference says. off-in-half: in half of the edits it is blurred, shifted or off in colour.
    # spoiled: all views are off alike, and their average is nearest to the truth.
    reference: Literal["exact", "spoiled", "off-in-half"] = "exact"


class OracleEditor(Editor):
    """Returns the truth of its item's input views, spoiled; ignores prompt and masks."""

    settings: OracleSettings

    def __init__(
        self, truth: Float[Tensor, "view 3 height width"], settings: OracleSettings
    ) -> None:
        self.truth = truth
        self.settings = settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        """Return the truth of each view, made to disagree in all views but an exact reference."""
        exact = 0 if self.settings.reference == "spoiled" else 1
        images = list(self.truth[:exact])
        if self.settings.reference == "off-in-half":
            images[0] = slightly_off(images[0], fault_of(request.prompt, request.seed))
        for view in range(exact, views.count):
            key = (request.prompt, request.seed, view)
            images.append(spoil(self.truth[view], key, self.settings.disagreement))
        return replace(views, images=torch.stack(images)[None])


def fault_of(prompt: str, seed: int) -> str:
    """What is wrong with the reference of this edit, by a hash: nothing in half, else FAULTS."""
    digest = hashlib.sha256(repr((prompt, seed)).encode("utf-8")).digest()
    return FAULTS[digest[1] % len(FAULTS)] if digest[0] % 2 else ""


def slightly_off(image: Image, fault: str) -> Image:
    """Return `image` with one of FAULTS, or as it is for "".

    `blurred` by a deviation of 0.012 image widths, `shifted` to the right by 0.01 of them,
    `coloured` by 1.15, 1 and 0.85 times red, green and blue.
    """
    if fault == "blurred":
        sigma = 0.012 * image.shape[-1]
        return torch.from_numpy(gaussian_filter(image.numpy(), (0, sigma, sigma)))
    if fault == "shifted":
        return _moved(image, image.new_tensor([-0.01, 0.0]))
    if fault == "coloured":
        gains = image.new_tensor([1.15, 1.0, 0.85])
        return (image * gains[:, None, None]).clamp(0, 1)
    return image


def spoil(image: Image, key: tuple, amount: float) -> Image:
    """Return `image` warped, recoloured and textured by a draw from a hash of `key`, in [0, 1].

    At `amount` 1 hues turn by up to 0.35 half turns, channels change by up to half and 0.2 more,
    smooth texture has a deviation of 0.12 and points move by about 0.02 image widths.
    """
    if amount == 0:
        return image
    digest = hashlib.sha256(repr(key).encode("utf-8")).digest()
    generator = torch.Generator().manual_seed(int.from_bytes(digest[:8], "big") >> 1)
    unit = 2 * torch.rand(7, generator=generator) - 1
    noise = _smooth_noise(int(torch.randint(2**31, (1,), generator=generator)), image)
    shift = amount * 0.02 * noise[:2].clamp(-1, 1).permute(1, 2, 0)
    moved = _moved(image, shift).clamp(0, 1)
    rotation = _hue_rotation(amount * 0.35 * math.pi * float(unit[0])).to(image)
    turned = torch.einsum("ij,jhw->ihw", rotation, moved)
    gain = (1 + amount * 0.5 * unit[1:4]).to(image)[:, None, None]
    offset = (amount * 0.2 * unit[4:]).to(image)[:, None, None]
    return (turned * gain + offset + amount * 0.12 * noise[2:]).clamp(0, 1)


def _moved(image: Image, shift: Float[Tensor, "*pixels 2"]) -> Image:
    """Return what lies at each pixel's place and `shift` [image sides]."""
    grid = pixel_grid(size_of(image), like=image)
    return warp(image, grid + shift, padding="reflection")


def _hue_rotation(angle: float) -> Float[Tensor, "3 3"]:
    """Return the rotation of RGB around the grey axis by `angle` [radians]."""
    cosine, sine = math.cos(angle), math.sin(angle) / math.sqrt(3)
    same = cosine + (1 - cosine) / 3
    ahead, behind = (1 - cosine) / 3 - sine, (1 - cosine) / 3 + sine
    return torch.tensor(
        [[same, ahead, behind], [behind, same, ahead], [ahead, behind, same]]
    )


def _smooth_noise(seed: int, like: Image) -> Float[Tensor, "5 height width"]:
    """Return smooth fields of standard deviation about 1."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.randn(1, 5, NOISE_CELLS, NOISE_CELLS, generator=generator)
    size = like.shape[-2:]
    return F.interpolate(coarse.to(like), size, mode="bicubic")[0] / 0.8
