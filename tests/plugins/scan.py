"""A small scan of two balls on a floor, as other programs make one."""

import torch

from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.harmonics import colour_to_dc

RED, GREEN, FLOOR = (0.8, 0.2, 0.2), (0.2, 0.7, 0.2), (0.55, 0.5, 0.45)


def ball(centre, colour, count=300, radius=0.35, seed=0):
    generator = torch.Generator().manual_seed(seed)
    points = torch.nn.functional.normalize(
        torch.randn(count, 3, generator=generator), dim=1
    )
    return torch.tensor(centre) + radius * points, torch.tensor(colour).expand(count, 3)


def scan(degree=0, seed=0):
    """Red ball, green ball and floor; y is down, the floor below at y = 0.4."""
    generator = torch.Generator().manual_seed(seed)
    parts = [
        ball((-0.5, 0.0, 0.0), RED, seed=seed + 1),
        ball((0.5, 0.0, 0.0), GREEN, seed=seed + 2),
    ]
    across = torch.linspace(-1.2, 1.2, 20)
    floor = torch.cartesian_prod(across, torch.tensor([0.42]), across)
    parts.append((floor, torch.tensor(FLOOR).expand(len(floor), 3)))
    means = torch.cat([points for points, _ in parts])
    colours = torch.cat([colours for _, colours in parts])
    count = len(means)
    scales = torch.full((count, 3), 0.05)
    scales[-len(floor) :] = torch.tensor([0.08, 0.01, 0.08])
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1
    harmonics = torch.zeros(count, (degree + 1) ** 2, 3)
    shades = 0.1 * torch.rand(count, 1, generator=generator) - 0.05
    harmonics[:, 0] = colour_to_dc((colours + shades).clamp(0, 1))
    if degree:
        harmonics[:, 1:] = 0.05 * torch.randn(
            count, (degree + 1) ** 2 - 1, 3, generator=generator
        )
    return Gaussians(
        means[None],
        scales[None],
        quats[None],
        torch.full((1, count), 0.95),
        harmonics[None],
    )


def of_ball(gaussians, number):
    """Which Gaussians are the red (0) or the green (1) ball's."""
    index = torch.arange(gaussians.count)
    return (index >= 300 * number) & (index < 300 * (number + 1))
