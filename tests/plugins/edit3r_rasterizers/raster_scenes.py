"""Small scenes for the rasterizers' tests, and how their pictures are compared."""

import math
from dataclasses import replace

import naive_rasterizer
import numpy as np
import torch

from edit3r.contract.types import Cameras, Gaussians, Rendering
from edit3r.kit.geometry.cameras import intrinsics_from_fov

FIELDS = ("means", "scales", "quats", "opacities", "harmonics")


def cloud(
    count: int = 60,
    degree: int = 0,
    seed: int = 0,
    scales: tuple[float, float] = (0.02, 0.3),
    batch: int = 1,
    dtype: torch.dtype = torch.float32,
) -> Gaussians:
    """Random Gaussians in front of a camera at the origin, 2 to 4 units away."""
    draw = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=draw, dtype=torch.float64)

    means = (uniform(batch, count, 3) - 0.5) * 2 + torch.tensor([0.0, 0.0, 3.0])
    quats = torch.randn(batch, count, 4, generator=draw, dtype=torch.float64)
    harmonics = 0.5 * torch.randn(
        batch, count, (degree + 1) ** 2, 3, generator=draw, dtype=torch.float64
    )
    sizes = scales[0] + (scales[1] - scales[0]) * uniform(batch, count, 3)
    return Gaussians(means, sizes, quats, uniform(batch, count), harmonics).to(dtype)


def one(**changes) -> Gaussians:
    """A single grey ball three units ahead; fields replaced by keyword, as plain lists."""
    values = {
        "means": [0.0, 0.0, 3.0],
        "scales": [0.1, 0.1, 0.1],
        "quats": [1.0, 0.0, 0.0, 0.0],
        "opacities": 0.8,
        "harmonics": [[0.5, -0.2, 0.1]],
    } | changes
    return Gaussians(*(torch.tensor(values[name])[None, None] for name in FIELDS))


def cameras(
    size: tuple[int, int] = (40, 53),
    count: int = 1,
    batch: int = 1,
    fov: float = 1.0,
    dtype=torch.float32,
) -> Cameras:
    """Cameras on an arc around (0, 0, 3), the first at the origin."""
    poses = []
    for index in range(count):
        angle = 0.2 * index
        c2w = torch.eye(4, dtype=torch.float64)
        c2w[0, 0] = c2w[2, 2] = math.cos(angle)
        c2w[0, 2], c2w[2, 0] = math.sin(angle), -math.sin(angle)
        c2w[:3, 3] = torch.tensor([-3 * math.sin(angle), 0.0, 3 - 3 * math.cos(angle)])
        poses.append(c2w)
    intrinsics = intrinsics_from_fov(fov, size).to(torch.float64)
    shape = (batch, count, -1, -1)
    c2w, lenses = torch.stack(poses)[None], intrinsics[None, None]
    return Cameras(c2w.expand(*shape), lenses.expand(*shape), size).to(dtype)


def assert_matches_naive(
    rendering: Rendering,
    gaussians: Gaussians,
    views: Cameras,
    tolerance: float = 2e-5,
    most_fragile: float = 0.2,
    **settings,
) -> None:
    """Colour and alpha within `tolerance`, depth within 1e-4 of its size, at all pixels but the
    fragile ones.
    """
    for scene in range(views.c2w.shape[0]):
        for camera in range(views.count):
            truth = naive_rasterizer.render(gaussians, views, scene, camera, **settings)
            solid = ~truth.fragile
            assert solid.mean() >= 1 - most_fragile, (
                f"only {solid.mean():.0%} of the pixels can be compared"
            )
            image, (alpha,), (depth,) = (
                getattr(rendering, name)[scene, camera].detach().double().numpy()
                for name in ("images", "alphas", "depths")
            )
            peak = max(1.0, np.abs(truth.image).max())
            off = np.abs(image - truth.image)[:, solid].max(initial=0)
            assert off <= tolerance * peak
            assert np.abs(alpha - truth.alpha)[solid].max(initial=0) <= tolerance
            relative = np.abs(depth - truth.depth) / np.maximum(truth.depth, 1e-6)
            off = relative[solid & (truth.alpha > 0)].max(initial=0)
            assert off <= max(1e-4, tolerance)


def assert_finite(rendering: Rendering) -> None:
    for name in ("images", "alphas", "depths"):
        assert torch.isfinite(getattr(rendering, name)).all(), name


def gradients(
    rasterizer,
    gaussians: Gaussians,
    views: Cameras,
    background: torch.Tensor,
    seed: int = 0,
) -> dict:
    """Gradient of a random weighting of all outputs by every field, background and camera."""
    draw = torch.Generator().manual_seed(seed)
    leaves, poses = (
        {name: getattr(whole, name).detach().clone().requires_grad_() for name in names}
        for whole, names in ((gaussians, FIELDS), (views, ("c2w", "intrinsics")))
    )
    background = background.detach().clone().to(gaussians.means).requires_grad_()
    posed = replace(views, **poses)
    rendering = rasterizer.render(Gaussians(**leaves), posed, background)
    total = 0.0
    for picture in (rendering.images, rendering.alphas, rendering.depths):
        weights = torch.randn(picture.shape, generator=draw, dtype=torch.float64)
        total = total + (picture.double() * weights).sum()
    total.backward()
    leaves |= poses | {"background": background}
    return {name: leaf.grad for name, leaf in leaves.items()}
