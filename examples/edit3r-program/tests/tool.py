"""A stand-in for a program: every photo becomes a wall of Gaussians two units away, seen by cameras side by side."""

import sys
from pathlib import Path

import torch

from edit3r.geometry.cameras import intrinsics_from_fov, pixel_scales, pixels_to_gaussians
from edit3r.io.cameras import posed_cameras, write_cameras
from edit3r.io.images import load_photos
from edit3r.io.ply import save_ply
from edit3r.types import Cameras

photos, result = map(Path, sys.argv[1:])
images = load_photos(sorted(photos.iterdir())).views.images
count, size = images.shape[1], tuple(images.shape[-2:])
c2w = torch.eye(4).repeat(1, count, 1, 1)
c2w[0, :, 0, 3] = torch.arange(count) * 0.1
cameras = Cameras(c2w, intrinsics_from_fov(0.9, size).expand(1, count, 3, 3), size)
depths = torch.full((1, count, *size), 2.0)
scales = pixel_scales(depths, cameras.intrinsics, 0.5)
save_ply(result / "scene.ply", pixels_to_gaussians(images, depths, cameras, scales, torch.full_like(depths, 0.9)))
write_cameras(result / "cameras.json", posed_cameras(cameras, [f"{i:03}.png" for i in range(count)]))
