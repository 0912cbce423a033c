"""The readable reference: front-to-back compositing of splats, tile by tile, with plain tensor operations."""

from dataclasses import fields

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from edit3r.interfaces import Rasterizer
from edit3r.types import Cameras, Gaussians, Rendering
from edit3r_rasterizers.checks import check_scene, resolve_background
from edit3r_rasterizers.settings import MIN_TOTAL_ALPHA, RasterizerSettings
from edit3r_rasterizers.torch_projection import Splats, project_scene

TILE = 16
"""Side of the square of pixels composited at once [pixels]."""
CHUNK = 4096
"""Splats composited at once: bounds the memory to TILE^2 * CHUNK numbers whatever the scene."""


class TorchRasterizer(Rasterizer):
    """Renders on the Gaussians' device and in their dtype; differentiable, in the cameras too."""

    class Settings(RasterizerSettings):
        pass

    def __init__(self, settings: RasterizerSettings) -> None:
        self.settings = settings

    def render(
        self, gaussians: Gaussians, cameras: Cameras, background: Float[Tensor, "*#batch_camera 3"] | None = None
    ) -> Rendering:
        """Render; `background` (anything that broadcasts to `[B, C, 3]`, differentiable) replaces the setting.

        Raises InputError for input that is not finite.
        """
        check_scene(gaussians, cameras)
        backgrounds = resolve_background(background, self.settings.background, gaussians, cameras)
        pictures = [
            [self._render_one(gaussians, cameras, scene, camera) for camera in range(cameras.count)]
            for scene in range(gaussians.means.shape[0])
        ]
        height, width = cameras.image_size
        empty = gaussians.means.new_zeros(*cameras.c2w.shape[:2], 5, height, width)
        sums = torch.stack([torch.stack(row) for row in pictures]) if empty.numel() else empty
        transmittance = sums[:, :, 4:]
        alphas = 1 - transmittance
        return Rendering(
            images=sums[:, :, :3] + transmittance * backgrounds[..., None, None],
            alphas=alphas,
            depths=sums[:, :, 3:4] / alphas.clamp(min=MIN_TOTAL_ALPHA),
        )

    def _render_one(
        self, gaussians: Gaussians, cameras: Cameras, scene: int, camera: int
    ) -> Float[Tensor, "5 height width"]:
        """Weighted sums of colour and depth, then the transmittance left."""
        c2w, intrinsics = cameras.c2w[scene, camera], cameras.intrinsics[scene, camera]
        splats = project_scene(gaussians, scene, c2w, intrinsics, cameras.image_size, self.settings)
        dtype = gaussians.means.dtype
        height, width = cameras.image_size
        rows = [
            [
                self._tile(splats, left, top, min(TILE, width - left), min(TILE, height - top), dtype)
                for left in range(0, width, TILE)
            ]
            for top in range(0, height, TILE)
        ]
        return torch.cat([torch.cat(row, -1) for row in rows], -2)

    def _tile(
        self, splats: Splats, left: int, top: int, width: int, height: int, dtype: torch.dtype
    ) -> Float[Tensor, "5 height width"]:
        """Composite the splats that touch one tile in `dtype`; recomputed in the backward pass instead of kept."""
        origin = splats.means.new_tensor([left, top])
        size = splats.means.new_tensor([width, height])
        offsets = splats.means.detach() - origin
        touches = ((offsets + splats.extents >= 0) & (offsets - splats.extents <= size)).all(-1)
        index = touches.nonzero().squeeze(-1)
        values = [getattr(splats, field.name)[index] for field in fields(Splats)[:-1]]
        values[0] = values[0] - origin  # before rounding to dtype, so that a wide picture costs no accuracy
        ys, xs = torch.meshgrid(_centres(height, origin), _centres(width, origin), indexing="ij")
        pixels = torch.stack((xs.flatten(), ys.flatten()), -1).to(dtype)
        values = [value.to(dtype) for value in values]
        if torch.is_grad_enabled():
            sums = checkpoint(self._composite, pixels, *values, use_reentrant=False)
        else:
            sums = self._composite(pixels, *values)
        return sums.reshape(5, height, width)

    def _composite(self, pixels: Float[Tensor, "pixel 2"], *values: Tensor) -> Float[Tensor, "5 pixel"]:
        """Front-to-back sums of one tile over all its splats, chunk by chunk."""
        sums = pixels.new_zeros(4, len(pixels))
        transmittance = pixels.new_ones(len(pixels))
        open_pixels = torch.ones_like(transmittance, dtype=torch.bool)
        for start in range(0, max(len(values[0]), 1), CHUNK):  # once for no splats too: the result keeps its graph
            chunk = [value[start : start + CHUNK] for value in values]
            alphas = self._alphas(pixels, *chunk[:-1])
            after = transmittance[:, None] * (1 - alphas).cumprod(-1)
            kept = open_pixels[:, None] & (after.detach() > self.settings.min_transmittance)
            alphas = torch.where(kept, alphas, torch.zeros_like(alphas))
            through = transmittance[:, None] * (1 - alphas).cumprod(-1)
            through = torch.cat((transmittance[:, None], through), -1)
            sums = sums + ((alphas * through[:, :-1]) @ chunk[-1]).T
            transmittance = through[:, -1]
            open_pixels = open_pixels & kept.all(-1)
        return torch.cat((sums, transmittance[None]))

    def _alphas(
        self,
        pixels: Float[Tensor, "pixel 2"],
        means: Float[Tensor, "splat 2"],
        slope: Float[Tensor, "splat"],
        narrowness: Float[Tensor, "splat"],
        flatness: Float[Tensor, "splat"],
        opacities: Float[Tensor, "splat"],
    ) -> Float[Tensor, "pixel splat"]:
        """Alpha of every splat at every pixel, 0 where it is skipped (see `Splats` for the exponent)."""
        x, y = (pixels[:, None] - means).unbind(-1)
        exponent = 0.5 * ((narrowness * (x - slope * y)).square() + (flatness * y).square())
        alphas = (opacities * torch.exp(-exponent)).clamp(max=self.settings.max_alpha)
        return torch.where(alphas.detach() >= self.settings.min_alpha, alphas, torch.zeros_like(alphas))


def _centres(count: int, like: Tensor) -> Float[Tensor, "count"]:
    """Pixel centres 0.5, 1.5, ... [pixels]."""
    return torch.arange(count, dtype=like.dtype, device=like.device) + 0.5
