"""Sharpen camera poses by rendering: Adam on small rigid motions until the rendering looks like the photo.

After the evaluation of pose-free splatting (Ye et al., NoPoSplat, ICLR 2025), with SSIM in place of its learned
perceptual terms. Rasterizers give gradients to Gaussians, not to cameras, so the scene moves before a fixed camera.
"""

from dataclasses import dataclass, replace

import torch
from edit3r_refiners.adam import Adam
from jaxtyping import Float
from kornia.losses import ssim_loss
from torch import Tensor

from edit3r.geometry.cameras import invert_rigid
from edit3r.geometry.harmonics import basis, colour_to_dc
from edit3r.geometry.rotations import matrices_to_quats
from edit3r.interfaces import Rasterizer
from edit3r.reporting import track
from edit3r.types import Cameras, Gaussians, Views

SSIM_WINDOW = 11


@dataclass(frozen=True)
class RefinementOptions:
    """How long and how fast to search."""

    steps: int = 200
    rotation_rate: float = 0.005  # [radians per step]
    translation_rate: float = 0.005  # per step, as a share of the median distance to the Gaussians
    ssim_weight: float = 1.0  # of (1 - SSIM) / 2 beside the mean squared error


def refine_cameras(
    cameras: Cameras,
    gaussians: Gaussians,
    views: Views,
    rasterizer: Rasterizer,
    options: RefinementOptions | None = None,
) -> Cameras:
    """`cameras` moved so that renderings of `gaussians` match `views` better; view 0 stays where it is.

    The pose with the smallest loss seen is returned, so the result is never worse than the start by that measure.
    """
    options = options or RefinementOptions()
    c2w = cameras.c2w.clone()
    todo = [(scene, view) for scene in range(len(c2w)) for view in range(1, cameras.count)]
    for scene, view in track(todo, "refining poses"):
        part = Gaussians(*(getattr(gaussians, name)[scene : scene + 1] for name in _PER_SCENE))
        lens = Cameras(torch.eye(4).to(c2w)[None, None], cameras.intrinsics[scene, view, None, None], views.image_size)
        w2c = _search(invert_rigid(c2w[scene, view]), part, lens, views.images[scene, view], rasterizer, options)
        c2w[scene, view] = invert_rigid(w2c)
    return replace(cameras, c2w=c2w)


_PER_SCENE = ("means", "scales", "quats", "opacities", "harmonics")


def _search(
    w2c: Float[Tensor, "4 4"],
    gaussians: Gaussians,
    lens: Cameras,
    photo: Float[Tensor, "3 height width"],
    rasterizer: Rasterizer,
    options: RefinementOptions,
) -> Float[Tensor, "4 4"]:
    """World-to-camera pose with the smallest loss met on the way."""
    unit = gaussians.means.norm(dim=-1).median()
    turn, shift = (torch.zeros(3, dtype=w2c.dtype, device=w2c.device, requires_grad=True) for _ in range(2))
    optimizer = Adam((turn, shift), (options.rotation_rate, options.translation_rate))
    best, best_loss = w2c, float("inf")
    for _ in range(options.steps + 1):
        with torch.enable_grad():
            motion = rigid_motion(turn, shift * unit)
            scene = in_camera_frame(gaussians, motion @ w2c)
            loss = _difference(rasterizer.render(scene, lens).images[0, 0], photo, options.ssim_weight)
            gradients = torch.autograd.grad(loss, (turn, shift))
        if loss.item() < best_loss:
            best, best_loss = w2c, loss.item()
        optimizer.step(gradients)
        with torch.no_grad():  # the step becomes part of the pose, and the next one starts from nothing
            w2c = rigid_motion(turn, shift * unit) @ w2c
            turn.zero_(), shift.zero_()
    return best


def _difference(image: Tensor, photo: Tensor, ssim_weight: float) -> Tensor:
    """Mean squared error plus the weighted loss of structure."""
    window = min(SSIM_WINDOW, *(size - (size + 1) % 2 for size in photo.shape[-2:]))
    image = image.clamp(0, 1)
    return (image - photo).square().mean() + ssim_weight * ssim_loss(image[None], photo[None], window)


def rigid_motion(turn: Float[Tensor, "3"], shift: Float[Tensor, "3"]) -> Float[Tensor, "4 4"]:
    """Rotation by the vector `turn` [radians] (matrix exponential), then `shift`; differentiable at zero."""
    zero = torch.zeros_like(turn[0])
    x, y, z = turn
    cross = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero)).view(3, 3)
    top = torch.cat((torch.linalg.matrix_exp(cross), shift[:, None]), 1)
    return torch.cat((top, top.new_tensor([[0, 0, 0, 1]])))


def in_camera_frame(gaussians: Gaussians, w2c: Float[Tensor, "4 4"]) -> Gaussians:
    """The Gaussians as seen by the camera at the origin: centres and orientations moved, colours fixed as seen now.

    Differentiable in `w2c` through centres and orientations; view-dependent colour is evaluated for this pose and then
    held, so the harmonics need no rotation.
    """
    rotation, shift = w2c[:3, :3], w2c[:3, 3]
    means = gaussians.means @ rotation.T + shift
    with torch.no_grad():
        directions = torch.nn.functional.normalize(means, dim=-1) @ rotation
        colours = torch.einsum("bgk,bgkc->bgc", basis(directions, gaussians.degree), gaussians.harmonics) + 0.5
    quats = multiply(matrices_to_quats(rotation), gaussians.quats)
    return replace(gaussians, means=means, quats=quats, harmonics=colour_to_dc(colours.clamp(min=0))[:, :, None])


def multiply(a: Float[Tensor, "*batch 4"], b: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Hamilton product of wxyz quaternions: the rotation `b`, then `a`."""
    w1, x1, y1, z1 = a.unbind(-1)
    w2, x2, y2, z2 = b.unbind(-1)
    return torch.stack(
        (
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ),
        -1,
    )
