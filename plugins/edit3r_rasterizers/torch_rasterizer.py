"""The readable reference: EWA splatting (Zwicker et al. 2001), composited front to back with plain
tensor operations.

Projection is computed in float64 where the device has it: positions in a wide image and needles
need more than 24 bits.
"""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians, Rendering
from edit3r.kit.geometry.harmonics import basis
from edit3r.kit.geometry.rotations import quats_to_matrices
from edit3r_rasterizers.settings import (
    BORDER,
    MAX_COLOUR,
    MIN_TOTAL_ALPHA,
    RasterizerSettings,
    check_scene,
    resolve_background,
)

TILE = 16
"""Side of the square of pixels composited at once [pixels]."""
CHUNK = 4096
"""Splats composited at once: bounds the memory to TILE^2 * CHUNK numbers whatever the scene."""


@dataclass(frozen=True)
class Splats:
    """The Gaussians that one camera sees, projected, front to back.

    With d = pixel - mean the exponent is (inv_std_x * (d_x - x_per_y * d_y))^2 / 2 + (inv_std_y *
    d_y)^2 / 2: the conic (inverse of the 2D covariance [[a, b], [b, c]]) in factors, d_y with
    variance c and d_x given d_y with variance a - b^2 / c. No large terms cancel, which they do in
    the usual quadratic form of a needle.
    """

    means: Float[Tensor, "splat 2"]  # [pixels]
    x_per_y: Float[Tensor, "splat"]  # b / c
    inv_std_x: Float[Tensor, "splat"]  # 1 / sqrt(a - b^2 / c) [1 / pixels]
    inv_std_y: Float[Tensor, "splat"]  # 1 / sqrt(c) [1 / pixels]
    opacities: Float[Tensor, "splat"]
    features: Float[Tensor, "splat 4"]  # colour >= 0, then camera z [scene units]
    # half size of the box outside of which alpha < min_alpha [pixels]; no gradient
    extents: Float[Tensor, "splat 2"]


class TorchRasterizer(Rasterizer):
    """Renders on the Gaussians' device and in their dtype; differentiable, in the cameras too."""

    Settings = RasterizerSettings
    settings: RasterizerSettings

    def render(
        self,
        gaussians: Gaussians,
        cameras: Cameras,
        background: Float[Tensor, "*#batch_camera 3"] | None = None,
    ) -> Rendering:
        """Render; `background` (anything that broadcasts to `[B, C, 3]`, differentiable) replaces
        the setting.

        Raises InputError for input that is not finite.
        """
        check_scene(gaussians, cameras)
        backgrounds = resolve_background(
            background, self.settings.background, gaussians, cameras
        )
        nears = self.settings.near_planes(gaussians)
        shape = (*cameras.c2w.shape[:2], 5, *cameras.image_size)
        images = [
            self._render_one(gaussians, cameras, scene, camera, nears[scene])
            for scene in range(shape[0])
            for camera in range(shape[1])
        ]
        sums = gaussians.means.new_zeros(shape)
        if images:
            sums = torch.stack(images).view(shape)
        transmittance = sums[:, :, 4:]
        alphas = 1 - transmittance
        return Rendering(
            images=sums[:, :, :3] + transmittance * backgrounds[..., None, None],
            alphas=alphas,
            depths=sums[:, :, 3:4] / alphas.clamp(min=MIN_TOTAL_ALPHA),
        )

    def _render_one(
        self,
        gaussians: Gaussians,
        cameras: Cameras,
        scene: int,
        camera: int,
        near: float,
    ) -> Float[Tensor, "5 height width"]:
        """Weighted sums of colour and depth, then the transmittance left."""
        c2w, intrinsics = cameras.c2w[scene, camera], cameras.intrinsics[scene, camera]
        splats = project_scene(
            gaussians, scene, c2w, intrinsics, cameras.image_size, self.settings, near
        )
        dtype = gaussians.means.dtype
        height, width = cameras.image_size
        rows = []
        for top in range(0, height, TILE):
            tall = min(TILE, height - top)
            row = [
                self._tile(splats, (left, top), (min(TILE, width - left), tall), dtype)
                for left in range(0, width, TILE)
            ]
            rows.append(torch.cat(row, -1))
        return torch.cat(rows, -2)

    def _tile(
        self,
        splats: Splats,
        corner: tuple[int, int],
        size: tuple[int, int],
        dtype: torch.dtype,
    ) -> Float[Tensor, "5 height width"]:
        """Composite the splats that touch one tile in `dtype`; recomputed in the backward pass
        instead of kept. `corner` and `size` are x, then y.
        """
        width, height = size
        origin, end = splats.means.new_tensor([corner, size])
        offsets, reach = splats.means.detach() - origin, splats.extents
        touches = ((offsets + reach >= 0) & (offsets - reach <= end)).all(-1)
        index = touches.nonzero().squeeze(-1)
        values = [getattr(splats, field.name)[index] for field in fields(Splats)[:-1]]
        # before rounding to dtype, so that a wide image costs no accuracy
        values[0] = values[0] - origin
        centres = (_centres(side, origin) for side in (height, width))
        ys, xs = torch.meshgrid(*centres, indexing="ij")
        pixels = torch.stack((xs.flatten(), ys.flatten()), -1).to(dtype)
        values = [value.to(dtype) for value in values]
        if torch.is_grad_enabled():
            sums = checkpoint(self._composite, pixels, *values, use_reentrant=False)
        else:
            sums = self._composite(pixels, *values)
        return sums.reshape(5, height, width)

    def _composite(
        self, pixels: Float[Tensor, "pixel 2"], *values: Tensor
    ) -> Float[Tensor, "5 pixel"]:
        """Front-to-back sums of one tile over all its splats, chunk by chunk."""
        sums = pixels.new_zeros(4, len(pixels))
        transmittance = pixels.new_ones(len(pixels))
        open_pixels = torch.ones_like(transmittance, dtype=torch.bool)
        # once for no splats too: the result keeps its graph
        for start in range(0, max(len(values[0]), 1), CHUNK):
            chunk = [value[start : start + CHUNK] for value in values]
            alphas = self._alphas(pixels, *chunk[:-1])
            after = transmittance[:, None] * (1 - alphas).cumprod(-1)
            lit = after.detach() > self.settings.min_transmittance
            kept = open_pixels[:, None] & lit
            alphas = torch.where(kept, alphas, torch.zeros_like(alphas))
            through = transmittance[:, None] * (1 - alphas).cumprod(-1)
            through = torch.cat((transmittance[:, None], through), -1)
            sums = sums + ((alphas * through[:, :-1]) @ chunk[-1]).T
            transmittance = through[:, -1]
            open_pixels = open_pixels & kept.all(-1)
        return torch.cat((sums, transmittance[None]))

    def _alphas(
        self, pixels: Float[Tensor, "pixel 2"], *splats: Tensor
    ) -> Float[Tensor, "pixel splat"]:
        """Alpha of every splat at every pixel, 0 where it is skipped (exponents: see `Splats`)."""
        means, x_per_y, inv_std_x, inv_std_y, opacities = splats
        x, y = (pixels[:, None] - means).unbind(-1)
        across, down = inv_std_x * (x - x_per_y * y), inv_std_y * y
        exponent = 0.5 * (across.square() + down.square())
        alphas = (opacities * torch.exp(-exponent)).clamp(max=self.settings.max_alpha)
        shown = alphas.detach() >= self.settings.min_alpha
        return torch.where(shown, alphas, torch.zeros_like(alphas))


def _centres(count: int, like: Tensor) -> Float[Tensor, "count"]:
    """Return the pixel centres 0.5, 1.5, ... [pixels]."""
    return torch.arange(count, dtype=like.dtype, device=like.device) + 0.5


def project_scene(
    gaussians: Gaussians,
    scene: int,
    c2w: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    image_size: tuple[int, int],
    settings: RasterizerSettings,
    near: float,
) -> Splats:
    """One scene in one camera with normalised intrinsics; differentiable in all of `gaussians`."""
    work = working_dtype(gaussians.means)
    # subtracting first is exact far from the origin
    offsets = gaussians.means[scene].to(work) - c2w[:3, 3].to(work)
    rotation = c2w[:3, :3].to(work)
    depth = (offsets.detach() @ rotation)[:, 2]
    opacities = gaussians.opacities[scene].to(work)
    kept = (depth >= near) & (depth <= settings.far_plane)
    kept &= opacities.detach() >= settings.min_alpha
    index = kept.nonzero().squeeze(-1)
    # front to back, ties in index order
    index = index[depth[index].argsort(stable=True)]

    camera = offsets[index] @ rotation
    height, width = image_size
    size = intrinsics.new_tensor([width, height], dtype=work)
    focal = intrinsics.to(work)[[0, 1], [0, 1]] * size  # [pixels]
    centre = intrinsics.to(work)[:2, 2] * size
    tangents = camera[:, :2] / camera[:, 2:]
    rows = _image_rows(tangents, camera[:, 2], focal, centre, size, rotation)
    turns = quats_to_matrices(gaussians.quats[scene, index].to(work))
    shape = turns * gaussians.scales[scene, index, None].to(work)
    # covariance a = |across|^2 + eps2d, b = across . down, ...
    across, down = (rows @ shape).unbind(-2)
    variance_x = across.square().sum(-1) + settings.eps2d
    variance_y = down.square().sum(-1) + settings.eps2d
    down = down / variance_y.sqrt()[:, None]
    spread = torch.linalg.cross(across, down).square().sum(-1)
    widened = 1 + across.square().sum(-1) / variance_y
    variance_given_y = spread + settings.eps2d * widened
    cutoff = 2 * (opacities[index] / settings.min_alpha).log()
    variances = torch.stack((variance_x, variance_y), -1)
    colours = seen_colours(gaussians.harmonics[scene, index].to(work), offsets[index])
    return Splats(
        means=tangents * focal + centre,
        x_per_y=(across * down).sum(-1) / variance_y.sqrt(),
        inv_std_x=variance_given_y.rsqrt(),
        inv_std_y=variance_y.rsqrt(),
        opacities=opacities[index],
        features=torch.cat((colours, camera[:, 2:]), -1),
        extents=(cutoff[:, None] * variances).detach().sqrt(),
    )


def _image_rows(
    tangents: Float[Tensor, "splat 2"],
    depth: Float[Tensor, "splat"],
    focal: Float[Tensor, "2"],
    centre: Float[Tensor, "2"],
    size: Float[Tensor, "2"],
    rotation: Float[Tensor, "3 3"],
) -> Float[Tensor, "splat 2 3"]:
    """Jacobian of the image position by the world position, tangents clamped at the border."""
    margin = BORDER * 0.5 * size / focal
    low, high = -(centre / focal + margin), (size - centre) / focal + margin
    x, y = tangents.clamp(low, high).unbind(-1)
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    rows = torch.stack((one, zero, -x, zero, one, -y), -1).unflatten(-1, (2, 3))
    return (focal[:, None] * rows / depth[:, None, None]) @ rotation.T


def seen_colours(
    harmonics: Float[Tensor, "splat coefficient 3"], offsets: Float[Tensor, "splat 3"]
) -> Float[Tensor, "splat 3"]:
    """Return the colours seen along `offsets` from the camera centre to the Gaussians."""
    degree = round(harmonics.shape[1] ** 0.5) - 1
    values = basis(offsets / offsets.norm(dim=-1, keepdim=True), degree)
    return (torch.einsum("nk,nkc->nc", values, harmonics) + 0.5).clamp(0, MAX_COLOUR)


def working_dtype(like: Tensor) -> torch.dtype:
    """Return float64, or the tensor's own dtype on a device without it (Apple's mps)."""
    return like.dtype if like.device.type == "mps" else torch.float64
