"""gsplat's CUDA kernels behind the same interface and settings."""

import importlib.util

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError, MissingDependencyError, SettingsError
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians, Rendering
from edit3r.kit.geometry.cameras import invert_rigid, to_pixels
from edit3r.kit.geometry.rotations import normalise_quats
from edit3r_rasterizers.settings import (
    RasterizerSettings,
    check_scene,
    resolve_background,
)

_BUILT_IN = ("max_alpha", "min_alpha", "min_transmittance")
"""Settings that are constants of gsplat's kernels."""


class GsplatRasterizer(Rasterizer):
    """Renders float32 Gaussians on an NVIDIA GPU; sums gradients with atomics, so their last bits
    vary.

    Differentiable in `c2w` too, but not in the intrinsics: gsplat has no gradient for them.
    """

    Settings = RasterizerSettings
    settings: RasterizerSettings

    def __init__(self, settings: RasterizerSettings) -> None:
        _require_cuda()
        _require_built_in(settings)
        self.settings = settings

    def render(
        self,
        gaussians: Gaussians,
        cameras: Cameras,
        background: Float[Tensor, "*#batch_camera 3"] | None = None,
    ) -> Rendering:
        """Render; `background` (anything that broadcasts to `[B, C, 3]`, differentiable) replaces
        the setting.

        Raises InputError for input that is not finite or not on a CUDA device.
        """
        _check_device(gaussians)
        check_scene(gaussians, cameras)
        backgrounds = resolve_background(
            background, self.settings.background, gaussians, cameras
        )
        scenes = [
            self._render_scene(gaussians, cameras, scene, near)
            for scene, near in enumerate(self.settings.near_planes(gaussians))
        ]
        colours, alphas, depths = (torch.stack(images) for images in zip(*scenes))
        return Rendering(
            colours + (1 - alphas) * backgrounds[..., None, None], alphas, depths
        )

    def _render_scene(
        self, gaussians: Gaussians, cameras: Cameras, scene: int, near: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Premultiplied colour [C, 3, H, W], alpha and expected depth [C, 1, H, W] of one scene."""
        height, width = cameras.image_size
        dtype = gaussians.means.dtype
        if gaussians.count == 0:
            empty = gaussians.means.new_zeros(cameras.count, 5, height, width)
            return empty[:, :3], empty[:, 3:4], empty[:, 4:]
        from gsplat import rasterization

        images, alphas, _ = rasterization(
            means=gaussians.means[scene].float(),
            quats=normalise_quats(gaussians.quats[scene].float()),
            scales=gaussians.scales[scene].float(),
            opacities=gaussians.opacities[scene].float(),
            colors=gaussians.harmonics[scene].float(),
            viewmats=invert_rigid(cameras.c2w[scene]).float(),
            Ks=to_pixels(cameras.intrinsics[scene], cameras.image_size).float(),
            width=width,
            height=height,
            near_plane=near,
            far_plane=self.settings.far_plane,
            eps2d=self.settings.eps2d,
            sh_degree=gaussians.degree,
            render_mode="RGB+ED",
        )
        images = images.movedim(-1, 1).to(dtype)
        alphas = alphas.movedim(-1, 1).to(dtype)
        return images[:, :3], alphas, images[:, 3:]


def _check_device(gaussians: Gaussians) -> None:
    device = gaussians.means.device
    if device.type != "cuda":
        raise InputError(
            f"rasterizer 'gsplat' renders on a CUDA device, the Gaussians are on {device}; "
            "move them with .to('cuda'), or use 'numba'."
        )


def _require_cuda() -> None:
    """Raise MissingDependencyError with what to use instead when gsplat cannot run here."""
    if not torch.cuda.is_available():
        raise MissingDependencyError(
            "rasterizer 'gsplat' needs an NVIDIA GPU with CUDA and this machine has none; use "
            "'numba' instead, which renders the same pictures on the CPU."
        )
    if importlib.util.find_spec("gsplat") is None:
        raise MissingDependencyError(
            "rasterizer 'gsplat' needs gsplat; install with: pip install \"edit3r[gsplat]\", or "
            "use 'numba'."
        )


def _require_built_in(settings: RasterizerSettings) -> None:
    for name in _BUILT_IN:
        fixed = RasterizerSettings.model_fields[name].default
        if getattr(settings, name) != fixed:
            raise SettingsError(
                f"rasterizer.{name}: gsplat's kernels have {fixed:g} built in, got "
                f"{getattr(settings, name):g}; leave it at its default, or use 'numba' or 'torch'."
            )
