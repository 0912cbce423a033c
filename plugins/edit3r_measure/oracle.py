"""The stand-in editor of the offline benchmark: it knows the edited truth and makes the views disagree about it.

No editor that runs without weights can add or remove objects. So the images that a perfect editor would return are
taken from the generator and then made to disagree as those of real 2D editors do: other colours, other texture,
slightly moved structure in each view. It is not an editor, and results say so by its name.
"""

import hashlib
import math
from dataclasses import dataclass, replace
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.config import Settings
from edit3r.interfaces import Editor
from edit3r.types import EditRequest, Views

ORACLE = "oracle"
"""Name by which `edit3r bench run --editor` asks for it; it is no plugin, since it needs the truth of the item."""

NOISE_CELLS = 6
"""Cells of the texture and warp noise along each side of the image."""


class OracleSettings(Settings):
    """How much the views disagree."""

    disagreement: float = Field(0.5, ge=0, le=1, description="0: every view shows the truth; 1: hardly alike")
    reference: Literal["exact", "spoiled"] = Field(
        "exact",
        description="exact: the first view shows the truth, the others disagree with it, so the truth is what the "
        "reference says; spoiled: all views are off alike, and their average is nearest to the truth",
    )


@dataclass(frozen=True)
class Disagreement:
    """How one view differs from the truth."""

    hue: float  # rotation of the colours around grey [radians]
    gain: tuple[float, float, float]  # factor of each channel
    offset: tuple[float, float, float]  # added to each channel [sRGB]
    texture: float  # standard deviation of smooth noise [sRGB]
    warp: float  # largest displacement [image widths]
    noise_seed: int


class OracleEditor(Editor):
    """Returns the truth of its item's input views, spoiled; ignores prompt and masks."""

    def __init__(self, truth: Float[Tensor, "view 3 height width"], settings: OracleSettings) -> None:
        self.truth = truth
        self.settings = settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        """Return the truth of each view, made to disagree in all views but an exact reference."""
        exact = 1 if self.settings.reference == "exact" else 0
        images = list(self.truth[:exact])
        for view in range(exact, views.count):
            own = draw_disagreement((request.prompt, request.seed, view), self.settings.disagreement)
            images.append(spoil(self.truth[view], own))
        return replace(views, images=torch.stack(images)[None])


def draw_disagreement(key: tuple, amount: float) -> Disagreement:
    """Draw a view's disagreement from a hash of `key`, scaled by `amount` in [0, 1]."""
    digest = hashlib.sha256(repr(key).encode("utf-8")).digest()
    generator = torch.Generator().manual_seed(int.from_bytes(digest[:8], "big") >> 1)
    unit = (2 * torch.rand(7, generator=generator) - 1).tolist()
    return Disagreement(
        hue=amount * 0.35 * math.pi * unit[0],
        gain=tuple(1 + amount * 0.5 * u for u in unit[1:4]),
        offset=tuple(amount * 0.2 * u for u in unit[4:7]),
        texture=amount * 0.12,
        warp=amount * 0.02,
        noise_seed=int(torch.randint(2**31, (1,), generator=generator)),
    )


def spoil(image: Float[Tensor, "3 height width"], own: Disagreement) -> Float[Tensor, "3 height width"]:
    """Return `image` warped, recoloured and textured, in [0, 1]."""
    noise = _smooth_noise(own.noise_seed, image)
    moved = _warp(image, own.warp * noise[:2].clamp(-1, 1))
    turned = torch.einsum("ij,jhw->ihw", _hue_rotation(own.hue).to(image), moved)
    gain, offset = (image.new_tensor(values)[:, None, None] for values in (own.gain, own.offset))
    return (turned * gain + offset + own.texture * noise[2:]).clamp(0, 1)


def _hue_rotation(angle: float) -> Float[Tensor, "3 3"]:
    """Return the rotation of RGB around the grey axis."""
    cosine, sine = math.cos(angle), math.sin(angle) / math.sqrt(3)
    same = cosine + (1 - cosine) / 3
    ahead, behind = (1 - cosine) / 3 - sine, (1 - cosine) / 3 + sine
    return torch.tensor([[same, ahead, behind], [behind, same, ahead], [ahead, behind, same]])


def _smooth_noise(seed: int, like: Float[Tensor, "3 height width"]) -> Float[Tensor, "5 height width"]:
    """Return smooth fields of standard deviation about 1."""
    coarse = torch.randn(1, 5, NOISE_CELLS, NOISE_CELLS, generator=torch.Generator().manual_seed(seed))
    return F.interpolate(coarse.to(like), size=like.shape[-2:], mode="bicubic", align_corners=False)[0] / 0.8


def _warp(
    image: Float[Tensor, "3 height width"], shift: Float[Tensor, "2 height width"]
) -> Float[Tensor, "3 height width"]:
    """Resample `image` at x + shift [image widths and heights]."""
    identity = torch.eye(2, 3, dtype=image.dtype, device=image.device)[None]
    grid = F.affine_grid(identity, [1, *image.shape], align_corners=False) + 2 * shift.permute(1, 2, 0)
    return F.grid_sample(image[None], grid, padding_mode="reflection", align_corners=False)[0].clamp(0, 1)
