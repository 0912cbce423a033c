"""A stand-in with steps, strength and the faults of a diffusion editor, but no model and no idea
what a prompt means.

Tests, demonstrations and robustness measurements use it where a real editor would need weights.
Prompt and seed are hashed into one global change of colour and tone; `disagreement` adds what real
2D editors do wrong between views: other colours, other textures, slightly moved structure. The loop
below imitates a sampler (noise in, one step after the other towards the result), so that step
counts and progress bars mean something.
"""

import hashlib
from dataclasses import replace

import kornia
import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract import reporting
from edit3r.contract.interfaces import Editor
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.geometry.cameras import pixel_grid
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.geometry.warping import warp

# The numbers of this block: no figures kept.
# share of a look that is seen at full strength: the photo holds the rest back
SHOWN = 7.5 / 10.5
# share of the remaining way a step goes: 10 steps leave 1 % of the noise
STEP_RATE = 0.35
TEXTURE_CELLS = 12  # cells of the texture and warp noise along each side of the image
# at full disagreement: deviation of the colour texture, displacement [image widths]
TEXTURE, WARP = 0.12, 0.02


class MockDiffusionEditor(Editor):
    """Deterministic stand-in for a diffusion editor; says so on every run."""

    class Settings(edit3r.Settings):
        steps: int = Field(20, ge=1, le=1000)
        """sampler steps; fewer than about 10 leave noise"""
        strength: float = Field(0.8, ge=0, le=1)
        """share of the change that is applied; 0 returns the photo"""
        disagreement: float = Field(0.3, ge=0, le=1)
        """how much the views differ in colour, texture and structure; 0: not at all"""

    settings: Settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        reporting.warn(
            "editor 'mock-diffusion' is a stand-in: it changes colours and textures from a hash of "
            "the prompt and does not understand it. Use a real editor for real results."
        )
        shared = torch.rand(6, generator=_generator(request.prompt, request.seed))
        apart, results = self.settings.disagreement, []
        for view in range(views.count):
            generator = _generator(request.prompt, request.seed, view)
            images = views.images[:, view]
            target = with_look(images, shared, generator, apart)
            label = f"view {view + 1}"
            results.append(self._sample(images, target, request.seed, label))
        return replace(views, images=torch.stack(results, 1))

    def _sample(
        self,
        images: Float[Tensor, "batch 3 height width"],
        look: Float[Tensor, "batch 3 height width"],
        seed: int,
        label: str,
    ) -> Float[Tensor, "batch 3 height width"]:
        """Walk from a noisy photo to the guided result, as a sampler would."""
        target = images + self.settings.strength * SHOWN * (look - images)
        generator = torch.Generator().manual_seed(seed)
        noise = torch.randn(images.shape[1:], generator=generator).to(images)
        current, steps = images + self.settings.strength * noise, self.settings.steps
        for _ in reporting.track(range(steps), f"mock diffusion, {label}"):
            current = current + STEP_RATE * (target - current)
        return images if self.settings.strength == 0 else current.clamp(0, 1)


def with_look(
    images: Float[Tensor, "batch 3 height width"],
    shared: Float[Tensor, "6"],
    generator: torch.Generator,
    apart: float,
) -> Float[Tensor, "batch 3 height width"]:
    """Edit a view by a look `apart` of the way from the `shared` one to its own, in [0, 1]."""
    look = torch.lerp(shared, torch.rand(6, generator=generator), apart)
    return coloured(disturbed(images, generator, apart), 2 * look - 1)


def coloured(
    images: Float[Tensor, "batch 3 height width"], look: Float[Tensor, "6"]
) -> Float[Tensor, "batch 3 height width"]:
    """Change hue, saturation, gamma and tint of all colours by numbers in [-1, 1]."""
    hue, saturation, gamma, *tint = look.tolist()
    result = kornia.enhance.adjust_hue(images, torch.pi * hue)
    saturated = kornia.enhance.adjust_saturation_with_gray_subtraction
    result = saturated(result, 1.1 + 0.5 * saturation)
    result = kornia.enhance.adjust_gamma(result, 2 ** (0.7 * gamma))
    return (result + 0.15 * images.new_tensor(tint)[:, None, None]).clamp(0, 1)


def disturbed(
    images: Float[Tensor, "batch 3 height width"],
    generator: torch.Generator,
    amount: float,
) -> Float[Tensor, "batch 3 height width"]:
    """Move points and add smooth texture, the same at any image size up to resampling."""
    if amount == 0:
        return images
    cells = (1, 5, TEXTURE_CELLS, TEXTURE_CELLS)
    coarse = torch.randn(cells, generator=generator).to(images)
    # interpolation between cells lowers the deviation of white noise
    fields = F.interpolate(coarse, images.shape[-2:], mode="bicubic")[0] / 0.8
    shift = amount * WARP * fields[:2].clamp(-1, 1).permute(1, 2, 0)
    places = (pixel_grid(size_of(images), images) + shift).expand(
        len(images), -1, -1, -1
    )
    moved = warp(images, places, padding="reflection")
    return (moved + amount * TEXTURE * fields[2:]).clamp(0, 1)


def _generator(*key: object) -> torch.Generator:
    """Make a generator seeded by a hash of `key` that is the same in every process."""
    digest = hashlib.sha256(repr(key).encode("utf-8")).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:8], "big") >> 1)
