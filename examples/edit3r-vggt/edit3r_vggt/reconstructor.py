"""Reconstructor `vggt`: a network of the hub, images in, points and poses out, as a plugin."""

import torch

import edit3r
from edit3r.contract.interfaces import FindsGeometry, Geometry, Reconstructor
from edit3r.contract.types import Cameras, Reconstruction, Views
from edit3r.kit.geometry import cameras as kit
from edit3r.kit.geometry.rotations import quats_to_matrices

PATCH = 14  # sides of its images are multiples of this [pixels]


def load(weights: str) -> torch.nn.Module:
    from vggt.models.vggt import VGGT

    return VGGT.from_pretrained(weights)


class VggtReconstructor(Reconstructor, FindsGeometry):
    """One Gaussian a pixel, where the network sees it."""

    class Settings(edit3r.Settings):
        weights: str = "facebook/VGGT-1B"
        """name on the hub, or a folder"""
        size: int = 518
        """longer side of the images that the network sees [pixels]"""

    def __init__(self, settings: Settings) -> None:
        self.settings, self.model = settings, load(settings.weights).eval()

    @torch.no_grad()
    def find_geometry(self, views: Views) -> Geometry:
        scale = self.settings.size / max(views.image_size) / PATCH
        size = tuple(max(1, round(scale * side)) * PATCH for side in views.image_size)
        told = self.model.to(views.images.device)(views.at(size).images)
        poses = told["pose_enc"].float()  # world to camera: place, xyzw, fields of view
        w2c = torch.eye(4).to(poses).repeat(*poses.shape[:2], 1, 1)
        w2c[..., :3, :3] = quats_to_matrices(poses[..., [6, 3, 4, 5]])
        w2c[..., :3, 3] = poses[..., :3]
        lens = torch.eye(3).to(poses).repeat(*poses.shape[:2], 1, 1)
        lens[..., :2, 2] = 0.5
        focal = 0.5 / (poses[..., [8, 7]] / 2).tan()
        lens[..., 0, 0], lens[..., 1, 1] = focal.unbind(-1)
        c2w = kit.relative_to_first(kit.invert_rigid(w2c))
        sure = 1 - 1 / told["depth_conf"].float().clamp(min=1)
        depths, placed = told["depth"][..., 0].float(), sure[:, :, 0, 0] >= 0
        return Geometry(c2w, depths, sure, placed, lens).at(views.image_size)

    def __call__(self, views, source=None, geometry=None, grid=None) -> Reconstruction:
        size = grid or views.image_size
        geometry = (geometry or self.find_geometry(source or views)).at(size)
        views, depths = geometry.calibrated(views).at(size), geometry.depths
        cameras = Cameras(geometry.c2w, views.intrinsics, size)
        scales = kit.pixel_scales(depths, views.intrinsics, 0.6)
        opacities = torch.full_like(depths, 0.9)
        made = kit.pixels_to_gaussians(views.images, depths, cameras, scales, opacities)
        return Reconstruction(made, cameras, measured=geometry.measured)
