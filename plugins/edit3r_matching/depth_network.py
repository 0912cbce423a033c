"""A small network that weighs depth hypotheses: costs and learned features in, a probability of each plane out.

It sees, at a quarter of the images' size, the matching costs and their semi-global aggregation, and the correlation of
learned features (group-wise, Guo et al. 2019) between the view and its warped neighbours. A light 3D U-Net adds to the
aggregated costs what it has learnt; untrained it adds nothing, so that the answer is that of semi-global matching.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.layers import Conv2d, GroupNorm, bilinear
from edit3r.training.checkpoint import load_weights
from edit3r_matching.cameras import CalibratedImage
from edit3r_matching.front import FRONT_CHANNELS, Front, imagenet_front, standardised
from edit3r_matching.plane_sweep import Neighbour

STRIDE = 4
"""Pixels per cell side."""
GROUPS = 8
CLASSICAL = 3
"""Volumes of classical costs: mean and least matching cost of a cell, aggregated cost."""
LEAST = -12.0
"""Log-probability below which planes do not differ."""
SHIPPED = Path(__file__).parent / "weights" / "depth.safetensors"


class DepthNetwork(nn.Module):
    """0.13 million weights that learn, behind a frozen front that has seen real photos."""

    def __init__(self, width: int = 8, channels: int = 32, guide: int = 4) -> None:
        super().__init__()
        quarter, eighth = FRONT_CHANNELS[1:]
        self.front = Front()
        self.features = nn.Sequential(
            _conv(quarter + eighth + 3 * STRIDE**2, 64), _conv(64, 48), Conv2d(48, channels, 3, padding=1)
        )
        self.guide = Conv2d(channels, guide, 1)
        self.regulariser = Regulariser(CLASSICAL + GROUPS + 1 + guide, width)
        self.sharpness = nn.Parameter(torch.tensor(2.0))  # log of what aggregated costs are multiplied with

    def forward(
        self,
        images: Float[Tensor, "batch view 3 height width"],
        grids: Float[Tensor, "batch other plane h w 2"],
        classical: Float[Tensor, "batch 3 plane h w"],
    ) -> Float[Tensor, "batch plane h w"]:
        """Log-probability of every plane at every cell of view 0.

        `grids`: where the cells' centres appear in the other views if they lie on each plane, -1 to 1 inside.
        """
        features = self.features_of(images.flatten(0, 1)).unflatten(0, images.shape[:2])
        return self.weigh(features.unbind(1), grids, classical)

    def weigh(
        self,
        features: Sequence[Float[Tensor, "batch channel h w"]],
        grids: Float[Tensor, "batch other plane h w 2"],
        classical: Float[Tensor, "batch 3 plane h w"],
    ) -> Float[Tensor, "batch plane h w"]:
        """The same from the features of the views, view 0 first; others may have other sizes."""
        guide = self.guide(features[0])[:, :, None].expand(-1, -1, classical.shape[2], -1, -1)
        volume = torch.cat((classical, correlation(features, grids), guide), 1)
        logits = self.regulariser(volume)[:, 0] - self.sharpness.exp() * classical[:, 2]
        return logits.log_softmax(1)

    def features_of(self, images: Float[Tensor, "image 3 height width"]) -> Float[Tensor, "image channel h w"]:
        """Features of each cell; sides are multiples of 8."""
        images = standardised(images)
        with torch.no_grad():
            _, quarter, eighth = self.front(images)
        eighth = bilinear(eighth, quarter.shape[-2:])
        return self.features(torch.cat((quarter, eighth, F.pixel_unshuffle(images, STRIDE)), 1))


class Regulariser(nn.Module):
    """3D U-Net of separable convolutions over planes, rows and columns; its last layer starts at 0."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.enter = Block3d(inputs, width)
        self.down = nn.ModuleList([Block3d(width, 2 * width, 2), Block3d(2 * width, 3 * width, 2)])
        self.deep = nn.ModuleList([Block3d(2 * width, 2 * width), Block3d(3 * width, 3 * width)])
        self.up = nn.ModuleList([Block3d(5 * width, 2 * width), Block3d(3 * width, width)])
        self.leave = nn.Conv3d(width, 1, 3, padding=1)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def forward(self, x: Float[Tensor, "batch channel plane h w"]) -> Float[Tensor, "batch 1 plane h w"]:
        fine = self.enter(x)
        middle = self.deep[0](self.down[0](fine))
        coarse = self.deep[1](self.down[1](middle))
        middle = self.up[0](_joined(coarse, middle))
        return self.leave(self.up[1](_joined(middle, fine)))


class Block3d(nn.Module):
    """A 3x3 convolution within planes, a 3-tap one across, normalisation and activation."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.within = nn.Conv3d(inputs, outputs, (1, 3, 3), (1, stride, stride), (0, 1, 1), bias=False)
        self.across = nn.Conv3d(outputs, outputs, (3, 1, 1), (stride, 1, 1), (1, 0, 0), bias=False)
        self.norm = nn.GroupNorm(4, outputs)

    def forward(self, x: Float[Tensor, "batch channel plane h w"]) -> Float[Tensor, "batch c p h2 w2"]:
        return F.silu(self.norm(self.across(self.within(x))))


def _joined(coarse: Tensor, fine: Tensor) -> Tensor:
    return torch.cat((F.interpolate(coarse, fine.shape[2:], mode="nearest"), fine), 1)


def _conv(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(Conv2d(inputs, outputs, 3, padding=1), GroupNorm(8, outputs), nn.SiLU())


def correlation(
    features: Sequence[Float[Tensor, "batch channel h w"]], grids: Float[Tensor, "batch other plane h w 2"]
) -> Float[Tensor, "batch group plane h w"]:
    """Cosine of view 0's features with the others', by groups of channels, and the share of the others that see it."""
    own, *others = (F.normalize(maps.unflatten(1, (GROUPS, -1)), dim=2) for maps in features)
    total, seen = 0, 0
    for other, grid in zip(others, grids.unbind(1)):
        inside = (grid.abs() < 1).all(-1).to(own.dtype)[:, None]
        warped = F.grid_sample(other.flatten(1, 2), grid.flatten(1, 2), align_corners=False)
        warped = warped.unflatten(2, grid.shape[1:3]).unflatten(1, (GROUPS, -1))
        total, seen = total + (own[:, :, :, None] * warped).sum(2) * inside, seen + inside
    return torch.cat((total / seen.clamp(min=1), seen / len(others)), 1)


def cell_costs(
    cost: Float[np.ndarray, "height width plane"], total: Float[np.ndarray, "height width plane"]
) -> Float[np.ndarray, "3 plane h w"]:
    """The classical volumes by cell, from matching costs and their semi-global aggregation."""
    relative = (total - total.min(axis=2, keepdims=True)) / 8  # paths
    cells = [_cells(cost).mean((1, 3)), _cells(cost).min((1, 3)), _cells(relative).mean((1, 3))]
    return np.ascontiguousarray(np.stack(cells).transpose(0, 3, 1, 2))


def _cells(volume: Float[np.ndarray, "height width plane"]) -> Float[np.ndarray, "h 4 w 4 plane"]:
    """Whole cells only up to the last row and column, which are repeated."""
    height, width, planes = volume.shape
    pad = ((0, -height % STRIDE), (0, -width % STRIDE), (0, 0))
    volume = np.pad(volume, pad, mode="edge") if any(after for _, after in pad) else volume
    return volume.reshape(volume.shape[0] // STRIDE, STRIDE, volume.shape[1] // STRIDE, STRIDE, planes)


def cell_grids(
    reference: CalibratedImage, neighbours: Sequence[Neighbour], inverse_depths: Float[np.ndarray, "plane"]
) -> Float[np.ndarray, "other plane h w 2"]:
    """Where the cells' centres appear in each neighbour, -1 to 1 inside, float32; far outside behind the camera."""
    height, width = (-(-side // STRIDE) for side in reference.size)
    y, x = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")
    rays = np.stack([x * STRIDE, y * STRIDE, np.ones_like(x)]).reshape(3, -1)
    rays = np.linalg.inv(reference.intrinsics) @ rays
    grids = []
    for neighbour in neighbours:
        k, pose = neighbour.image.intrinsics, neighbour.pose
        points = (k @ pose.rotation @ rays)[None] + (k @ pose.translation)[:, None] * inverse_depths[:, None, None]
        size = np.array(_padded(neighbour.image.size)[::-1])[:, None]
        place = 2 * points[:, :2] / np.maximum(points[:, 2:], 1e-6) / size - 1
        place = np.where(points[:, 2:] > 1e-6, place, 2).clip(-2, 2)
        grids.append(place.transpose(0, 2, 1).reshape(-1, height, width, 2).astype(np.float32))
    return np.stack(grids)


def _padded(size: tuple[int, int]) -> tuple[int, int]:
    """Sides up to the next multiple of what the front halves three times."""
    return size[0] + -size[0] % (2 * STRIDE), size[1] + -size[1] % (2 * STRIDE)


@torch.no_grad()
def plane_log_probabilities(
    network: DepthNetwork,
    reference: CalibratedImage,
    neighbours: Sequence[Neighbour],
    inverse_depths: Float[np.ndarray, "plane"],
    cost: Float[np.ndarray, "height width plane"],
    total: Float[np.ndarray, "height width plane"],
) -> Float[np.ndarray, "plane h w"]:
    """The network's answer for each cell of `reference`, from its matching costs and their aggregation."""
    images = [reference, *(neighbour.image for neighbour in neighbours)]
    grids = torch.from_numpy(cell_grids(reference, neighbours, inverse_depths))
    classical = torch.from_numpy(cell_costs(cost, total))
    features = [network.features_of(_padded_image(image)) for image in images]
    rows, columns = classical.shape[2:]
    features[0] = features[0][..., :rows, :columns]
    return network.weigh(features, grids[None], classical[None])[0].numpy()


def at_pixels(cells: Float[np.ndarray, "plane h w"], size: tuple[int, int]) -> Float[np.ndarray, "height width plane"]:
    """Log-probabilities of cells carried to the pixels of an image of `size`, at least LEAST: bilinear in between."""
    grid = (cells.shape[2] * STRIDE, cells.shape[1] * STRIDE)
    fine = [cv2.resize(values, grid, interpolation=cv2.INTER_LINEAR) for values in np.maximum(cells, LEAST)]
    return np.ascontiguousarray(np.stack(fine, -1)[: size[0], : size[1]])


def _padded_image(image: CalibratedImage) -> Float[Tensor, "1 3 height width"]:
    height, width = _padded(image.size)
    pad = ((0, height - image.size[0]), (0, width - image.size[1]), (0, 0))
    return torch.from_numpy(np.pad(image.pixels, pad, mode="edge").transpose(2, 0, 1)[None])


@cache
def load_depth_network(weights: str) -> DepthNetwork:
    """The network with the weights of a file, or 'shipped', 'untrained' or 'imagenet-front' (untrained beside it)."""
    network = DepthNetwork()
    if weights == "imagenet-front":
        network.front = imagenet_front()
    elif weights != "untrained":
        load_weights(network, SHIPPED if weights == "shipped" else weights)
    return network.requires_grad_(False).eval()
