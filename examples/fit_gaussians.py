"""Fit Gaussians to an image, on the CPU: python examples/fit_gaussians.py IMAGE OUT."""

import sys

import numpy as np
import torch
from edit3r_rasterizers.functional import rasterization
from PIL import Image


def fit(
    image: torch.Tensor, count: int, steps: int
) -> tuple[torch.Tensor, list[float]]:
    """Return an image [H, W, 3] in [0, 1] as Gaussians draw it, and the error at every step."""
    height, width, _ = image.shape
    places = torch.rand(count, 3) - torch.tensor([0.5, 0.5, -0.5])  # around z = 1
    parts = {
        "means": places * torch.tensor([width / height, 1.0, 1.0]),
        "quats": torch.rand(count, 4),
        "log_scales": torch.full((count, 3), -3.5),
        "logits": torch.zeros(count),
        "colors": torch.rand(count, 3),
    }
    Ks = torch.tensor([[[height, 0, width / 2], [0, height, height / 2], [0, 0, 1]]])
    adam = torch.optim.Adam([part.requires_grad_() for part in parts.values()], lr=0.02)
    errors = []
    for _ in range(steps):
        images, _, _ = rasterization(
            means=parts["means"],
            quats=parts["quats"],
            scales=parts["log_scales"].exp(),
            opacities=parts["logits"].sigmoid(),
            colors=parts["colors"],
            viewmats=torch.eye(4)[None],
            Ks=Ks,
            width=width,
            height=height,
        )
        error = (images[0] - image).square().mean()
        adam.zero_grad()
        error.backward()
        adam.step()
        errors.append(error.item())
    return images[0].detach(), errors


if __name__ == "__main__":
    photo = Image.open(sys.argv[1]).convert("RGB")
    photo.thumbnail((256, 256))
    shown, errors = fit(torch.tensor(np.asarray(photo) / 255).float(), 2000, 300)
    Image.fromarray((shown.clamp(0, 1) * 255).byte().numpy()).save(sys.argv[2])
    print(f"mean squared error {errors[0]:.4f} -> {errors[-1]:.5f}")
