"""The CPU rasterizer: kernels compiled by numba, with a hand-derived backward pass."""

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.errors import InputError
from edit3r.interfaces import Rasterizer
from edit3r.types import Cameras, Gaussians, Rendering
from edit3r_rasterizers.checks import check_cameras, check_finite, resolve_background
from edit3r_rasterizers.frames import Frame, Pictures, Scene, differentiate, draw, project_scene
from edit3r_rasterizers.records import TileGrid, pack_camera
from edit3r_rasterizers.settings import BORDER, RasterizerSettings
from edit3r_rasterizers.threads import thread_count


class NumbaSettings(RasterizerSettings):
    """The shared settings, and the number of threads."""

    threads: int = Field(0, ge=0, le=256, description="CPU threads; 0: as many as torch and numba are set to use.")


class NumbaRasterizer(Rasterizer):
    """Renders float32 Gaussians on the CPU; the same bits for any number of threads.

    float64 is computed from float32 copies and returned as float64; another device is refused. Cameras get no
    gradient: use `torch` to differentiate poses.
    """

    Settings = NumbaSettings

    def __init__(self, settings: NumbaSettings) -> None:
        self.settings = settings

    def render(
        self, gaussians: Gaussians, cameras: Cameras, background: Float[Tensor, "*#batch_camera 3"] | None = None
    ) -> Rendering:
        """Render; `background` (anything that broadcasts to `[B, C, 3]`, differentiable) replaces the setting.

        Raises InputError for input that is not finite or not on the CPU, or for cameras that ask for a gradient.
        """
        _check_device(gaussians)
        check_cameras(gaussians, cameras)
        if torch.is_grad_enabled() and (cameras.c2w.requires_grad or cameras.intrinsics.requires_grad):
            raise InputError("rasterizer 'numba' has no gradient for cameras; detach them, or use 'torch'.")
        single = gaussians.to(torch.float32)
        backgrounds = resolve_background(background, self.settings.background, single, cameras)
        fields = single.means, single.scales, single.quats, single.opacities, single.harmonics
        outputs = _Rasterize.apply(self.settings, cameras, *fields, backgrounds)
        return Rendering(*outputs).to(gaussians.means.dtype)


def _check_device(gaussians: Gaussians) -> None:
    device = gaussians.means.device
    if device.type != "cpu":
        raise InputError(
            f"rasterizer 'numba' renders on the CPU, the Gaussians are on {device}; "
            f"use 'gsplat' or 'torch' there, or move the Gaussians with .to('cpu')."
        )


class _Rasterize(torch.autograd.Function):
    """B scenes with C cameras each, one after the other."""

    @staticmethod
    def forward(ctx, settings, cameras, means, scales, quats, opacities, harmonics, backgrounds):
        batch, count = cameras.c2w.shape[:2]
        grid = TileGrid(*cameras.image_size)
        images = torch.empty(batch, count, 3, grid.height, grid.width)
        alphas, depths = (torch.empty(batch, count, 1, grid.height, grid.width) for _ in range(2))
        threads, frames = thread_count(settings.threads), []
        fields = means, scales, quats, opacities, harmonics
        scenes = [Scene(*(_array(field[b]) for field in fields)) for b in range(batch)]
        for b in range(batch):
            for c in range(count):
                camera = pack_camera(cameras.c2w[b, c], cameras.intrinsics[b, c], grid, BORDER)
                frame = project_scene(settings, threads, scenes[b], camera, grid)
                if frame is None:
                    check_finite(Gaussians(*(field.detach() for field in fields)))
                draw(settings, threads, frame, _array(backgrounds[b, c]), _pictures((images, alphas, depths), b, c))
                frames += [frame] if any(ctx.needs_input_grad) else []
        ctx.settings, ctx.scenes, ctx.frames = settings, scenes, frames
        ctx.save_for_backward(images, alphas, depths)
        return images, alphas, depths

    @staticmethod
    def backward(ctx, *gradients):
        outputs = ctx.saved_tensors
        batch, count = outputs[0].shape[:2]
        threads = thread_count(ctx.settings.threads)
        by_scenes = [scene.zeros_like() for scene in ctx.scenes]
        by_backgrounds = torch.zeros(batch, count, 3)
        for index, frame in enumerate(ctx.frames):
            b, c = divmod(index, count)
            seen, by_seen = _pictures(outputs, b, c), _pictures(gradients, b, c)
            differentiate(ctx.settings, threads, ctx.scenes[b], frame, seen, by_seen, by_scenes[b])
            by_backgrounds[b, c] = _by_background(gradients[0][b, c], frame)
        by_fields = [torch.from_numpy(np.stack(arrays)) for arrays in zip(*(scene.arrays for scene in by_scenes))]
        return None, None, *(by_fields or [None] * 5), by_backgrounds


def _by_background(by_image: Tensor, frame: Frame) -> Float[Tensor, "3"]:
    left = torch.from_numpy(frame.transmittances)
    return torch.einsum("chw,hw->c", by_image.double(), left.double())


def _pictures(outputs: tuple[Tensor, Tensor, Tensor], scene: int, camera: int) -> Pictures:
    """One camera's pictures; views of the tensors' memory where that is contiguous."""
    image, alpha, depth = (_array(output[scene, camera]) for output in outputs)
    return Pictures(image, alpha[0], depth[0])


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()
