"""A stand-in with steps, strength and the faults of a diffusion editor, but no model and no idea what a prompt means.

Tests, demonstrations and robustness measurements use it where a real editor would need weights. Prompt and seed are
hashed into one global change of colour and tone; `disagreement` adds what real 2D editors do wrong between views:
other colours, other textures, slightly moved structure. The loop below imitates a sampler (noise in, one step after
the other towards the result), so that step counts and progress bars mean something.
"""

import hashlib
from dataclasses import dataclass, replace

import kornia
import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r import reporting
from edit3r.config import Settings
from edit3r.geometry.cameras import pixel_grid
from edit3r.geometry.warping import warp
from edit3r.interfaces import Editor
from edit3r.types import EditRequest, Views

SHOWN = 7.5 / 10.5  # share of a look that is seen at full strength: the photo holds the rest back
STEP_RATE = 0.35  # share of the remaining way a step goes: 10 steps leave 1 % of the noise
TEXTURE_CELLS = 12  # cells of the texture and warp noise along each side of the image


@dataclass(frozen=True)
class Look:
    """What the imagined model draws."""

    hue: float  # rotation [turns]
    saturation: float  # factor
    gamma: float
    tint: tuple[float, float, float]  # added to RGB
    texture: float  # standard deviation of the added colour texture
    warp: float  # largest displacement [image widths]
    noise_seed: int  # of texture and warp


class MockDiffusionEditor(Editor):
    """Deterministic stand-in for a diffusion editor; says so on every run."""

    class Settings(Settings):
        steps: int = Field(20, ge=1, le=1000, description="sampler steps; fewer than about 10 leave noise")
        strength: float = Field(0.8, ge=0, le=1, description="share of the change that is applied; 0 returns the photo")
        disagreement: float = Field(
            0.3, ge=0, le=1, description="how much the views differ in colour, texture and structure; 0: not at all"
        )

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        reporting.warn(
            "editor 'mock-diffusion' is a stand-in: it changes colours and textures from a hash of the prompt and "
            "does not understand it. Use a real editor for real results."
        )
        shared = sample_look(_generator(request.prompt, request.seed))
        results = []
        for view in range(views.count):
            own = sample_look(_generator(request.prompt, request.seed, view))
            look = disagreeing(shared, own, self.settings.disagreement)
            results.append(self._sample(views.images[:, view], look, request.seed, f"view {view + 1}"))
        return replace(views, images=torch.stack(results, 1))

    def _sample(
        self, images: Float[Tensor, "batch 3 height width"], look: Look, seed: int, label: str
    ) -> Float[Tensor, "batch 3 height width"]:
        """Walk from a noisy photo to the guided result, as a sampler would."""
        target = images + self.settings.strength * SHOWN * (apply_look(images, look) - images)
        noise = torch.randn(images.shape[1:], generator=torch.Generator().manual_seed(seed)).to(images)
        current = images + self.settings.strength * noise
        for _ in reporting.track(range(self.settings.steps), f"mock diffusion, {label}"):
            current = current + STEP_RATE * (target - current)
        if self.settings.strength == 0:
            return images
        return current.clamp(0, 1)


def sample_look(generator: torch.Generator) -> Look:
    """Draw a clearly visible change of colour and tone, with texture and warp at the size for full disagreement."""
    unit = (2 * torch.rand(6, generator=generator) - 1).tolist()
    return Look(
        hue=0.5 * unit[0],
        saturation=1.1 + 0.5 * unit[1],
        gamma=2 ** (0.7 * unit[2]),
        tint=(0.15 * unit[3], 0.15 * unit[4], 0.15 * unit[5]),
        texture=0.12,
        warp=0.02,
        noise_seed=int(torch.randint(2**31, (1,), generator=generator)),
    )


def disagreeing(shared: Look, own: Look, amount: float) -> Look:
    """Make the look of one view: the shared one at `amount` 0, mostly its own, with texture and warp, at 1."""

    def mix(a: float, b: float) -> float:
        return (1 - amount) * a + amount * b

    return Look(
        hue=mix(shared.hue, own.hue),
        saturation=mix(shared.saturation, own.saturation),
        gamma=mix(shared.gamma, own.gamma),
        tint=tuple(mix(a, b) for a, b in zip(shared.tint, own.tint)),
        texture=amount * own.texture,
        warp=amount * own.warp,
        noise_seed=own.noise_seed,
    )


def apply_look(images: Float[Tensor, "batch 3 height width"], look: Look) -> Float[Tensor, "batch 3 height width"]:
    """Warp, recolour and texture images; the result is in [0, 1]."""
    fields = _smooth_noise(look.noise_seed, 5, images)
    result = images
    if look.warp > 0:
        places = pixel_grid(images.shape[-2:], images) + look.warp * fields[:2].clamp(-1, 1).permute(1, 2, 0)
        result = warp(images, places.expand(len(images), -1, -1, -1), padding="reflection")
    result = kornia.enhance.adjust_hue(result, 2 * torch.pi * look.hue)
    result = kornia.enhance.adjust_saturation_with_gray_subtraction(result, look.saturation)
    result = kornia.enhance.adjust_gamma(result, look.gamma)
    tint = images.new_tensor(look.tint)[:, None, None]
    return (result + tint + look.texture * fields[2:]).clamp(0, 1)


def _smooth_noise(
    seed: int, channels: int, like: Float[Tensor, "batch 3 height width"]
) -> Float[Tensor, "channel height width"]:
    """Draw smooth fields of standard deviation about 1, the same at any image size up to resampling."""
    coarse = torch.randn(1, channels, TEXTURE_CELLS, TEXTURE_CELLS, generator=torch.Generator().manual_seed(seed))
    fields = F.interpolate(coarse.to(like), size=like.shape[-2:], mode="bicubic", align_corners=False)
    return fields[0] / 0.8  # interpolation between cells lowers the deviation of white noise


def _generator(*key: object) -> torch.Generator:
    """Make a generator seeded by a hash of `key` that is the same in every process."""
    digest = hashlib.sha256(repr(key).encode("utf-8")).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:8], "big") >> 1)
