"""What one photo alone shows, where others see through its place: a walker, a car, a bird.

Two photos agree on a surface and its colour, a third shows something else there that it measured
with no other photo, and that could stand nowhere before the surface without hiding it from the two.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Gaussians, Views
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.geometry.warping import nearest_views, warp

__all__ = ["find_transients", "without_transients"]

LONGEST = 172  # size at which photos are compared [pixels]
NEAR_VIEWS = 4  # others that tell of a photo what passed
ALIKE, UNLIKE = 0.1, 0.12  # difference of colours [sRGB, mean of channels]
SAME_SURFACE = 0.06  # relative difference of depth at which two photos show one surface
IN_FRONT = 0.03  # and from which one surface stands before another
# Of the pixels around one, the share that must be told by others, and unlike them
TOLD, MOST = 0.12, 0.6
# A thing's least share of its photo; of its pixels the share that no other photo measured, and that
# could stand nowhere
LEAST, UNMEASURED, NOWHERE = 0.002, 0.7, 0.5
# What was found is part of an unmeasured piece of up to so many times its area, of which others
# show what lies behind so large a share
MOST_GROWTH, BEHIND = 20.0, 0.5
# The largest share of a photo that is a thing: far trees beside a near trunk are as little measured
# and as unlike what others guess there
LARGEST = 0.15
FEW = 3  # photos of which guesses that agree tell of a place too
MOST_TELLING = 3  # others that must show what lies behind, where there are more
PLACES = 9  # along a ray, before the surface that others show
NEAREST = 0.8  # where they begin [depth of the nearest 2 % of what was measured]
MARGIN = 0.016  # around what was found [long sides]

Maps = Float[Tensor, "view height width"]
Mask = Bool[Tensor, "height width"]


def find_transients(
    geometry: Geometry, photos: Views
) -> Bool[Tensor, "batch view height width"] | None:
    """Pixels of what passed while `photos` were taken, at their size; None: nothing, or fewer than
    three photos, which cannot tell, as photos of which nothing was measured.
    """
    measured = geometry.confidence >= 0.5
    if (
        int(geometry.registered.sum(1).min()) < 3
        or not measured.flatten(1).any(1).all()
    ):
        return None
    share = min(1.0, LONGEST / max(photos.image_size))
    height, width = (max(1, round(share * side)) for side in photos.image_size)
    size = height, width
    views = geometry.calibrated(photos).at(size).to("cpu")
    geometry = replace(geometry.at(size).to("cpu"), intrinsics=views.intrinsics)
    masks = torch.stack(
        [
            _Scene.of(views, geometry, scene).find_transients()
            for scene in range(len(views.images))
        ]
    )
    if not masks.any():
        return None
    masks = masks.to(photos.images.device)
    return F.interpolate(masks.float(), photos.image_size, mode="nearest-exact") > 0


def without_transients(
    gaussians: Gaussians,
    masks: Bool[Tensor, "batch view height width"],
    c2w: Float[Tensor, "batch view 4 4"],
    intrinsics: Float[Tensor, "batch view 3 3"],
) -> Gaussians:
    """The Gaussians without those that a photo saw within its mask."""
    opacities = gaussians.opacities.clone()
    for view in masks.any(0).flatten(1).any(1).nonzero()[:, 0].tolist():
        pixels, depth = project(gaussians.means, intrinsics[:, view], c2w[:, view])
        inside = warp(masks[:, view, None].float(), pixels[:, None], "nearest", "zeros")
        seen = (inside[:, 0, 0] > 0) & (depth > 0) & (gaussians.view_index == view)
        opacities = torch.where(seen, 0, opacities)
    kept = (opacities > 0).any(0) | (gaussians.opacities <= 0).all(0)
    return replace(gaussians, opacities=opacities).select(kept)


@dataclass(frozen=True)
class _Scene:
    """Photos of one scene at the size of their depths."""

    images: Float[Tensor, "view 3 height width"]
    depths: Maps
    points: Float[Tensor, "view height width 3"]
    measured: Bool[Tensor, "view height width"]
    c2w: Float[Tensor, "view 4 4"]
    intrinsics: Float[Tensor, "view 3 3"]
    # least and most of each channel around each pixel: photos lie a pixel or two beside each other
    least: Float[Tensor, "view 3 height width"]
    most: Float[Tensor, "view 3 height width"]
    near: list[list[int]]  # the others that are asked about each view

    @staticmethod
    def of(views: Views, geometry: Geometry, scene: int) -> "_Scene":
        images, there = views.images[scene], geometry.registered[scene]
        points = unproject(geometry.depths, views.intrinsics, geometry.c2w)[scene]
        near = nearest_views(geometry.c2w, geometry.depths, NEAR_VIEWS)
        return _Scene(
            images,
            geometry.depths[scene],
            points,
            (geometry.confidence[scene] >= 0.5) & there[:, None, None],
            geometry.c2w[scene],
            views.intrinsics[scene],
            -F.max_pool2d(-images, 5, 1, 2),
            F.max_pool2d(images, 5, 1, 2),
            [
                [b for b in row if there[b]] if there[a] else []
                for a, row in enumerate(near)
            ],
        )

    def find_transients(self) -> Bool[Tensor, "view height width"]:
        """What passed, in each view."""
        agreed = {
            (b, c): self._agree(b, c) for b, row in enumerate(self.near) for c in row
        }
        masks = []
        for view, others in enumerate(self.near):
            sure = {
                b: torch.stack([agreed[b, c] for c in self.near[b] if c != view]).any(0)
                for b in others
                if set(self.near[b]) - {view}
            }
            masks.append(self._passing_in(view, sure))
        radius = max(1, round(MARGIN * max(self.depths.shape[1:])))
        return dilate(torch.stack(masks).float(), radius) > 0

    def _seen(self, points: Tensor, view: int) -> tuple[Tensor, Tensor]:
        """Where world points lie in a view, and their camera z."""
        return project(points, self.intrinsics[view], self.c2w[view])

    def _agree(self, one: int, other: int) -> Mask:
        """Pixels of `one` whose place and colour `other` shows too."""
        shape = self.depths.shape[1:]
        grid, z = self._seen(self.points[one].flatten(0, 1), other)
        shown = torch.cat(
            (self.depths[other][None], self.least[other], self.most[other])
        )
        got = warp(shown, grid.unflatten(0, shape), "nearest", "zeros")
        depth, least, most = got.split((1, 3, 3))
        same = (z.view(shape) / depth[0].clamp(min=1e-9) - 1).abs() < SAME_SURFACE
        if len(self.images) > FEW:
            same &= self.measured[one]
        return same & (_beyond(self.images[one], least, most) < ALIKE)

    def _passing_in(self, view: int, sure: dict[int, Mask]) -> Mask:
        """What passed in one view; `sure` are pixels of others that some third view agrees with."""
        tell = torch.zeros_like(self.measured[view], dtype=torch.int32)
        alike = torch.zeros_like(self.measured[view])
        surface = torch.full_like(self.depths[view], torch.inf)
        for other, mask in sure.items():
            depth, colour = self._drawn(other, mask, view)
            seen = depth < torch.inf
            off = _beyond(colour, self.least[view], self.most[view])
            tell, alike = tell + seen, alike | (seen & (off < UNLIKE))
            surface = torch.minimum(surface, depth)
        told = tell >= max(1, min(MOST_TELLING, len(sure) - 1))
        before = self.measured[view] & (self.depths[view] < (1 - IN_FRONT) * surface)
        found = torch.zeros_like(told)
        for piece in _pieces(told & ~alike & ~before, told):
            known = piece & (surface < torch.inf)
            unmeasured = 1 - float(self.measured[view][piece].float().mean())
            if unmeasured >= UNMEASURED and known.any():
                nowhere = self._could_stand_nowhere(view, known, surface, sure)
                found |= piece & (nowhere >= NOWHERE)
        return _grown(found, ~self.measured[view], told)

    def _drawn(self, other: int, mask: Mask, view: int) -> tuple[Tensor, Tensor]:
        """Depth (infinite: none) and colour of what `other` shows, drawn into `view` by points."""
        height, width = mask.shape
        grid, z = self._seen(self.points[other][mask], view)
        inside = (z > 0) & ((grid > 0) & (grid < 1)).all(-1)
        order = z[inside].argsort(descending=True)  # the nearest are written last
        column, row = (grid[inside][order] * grid.new_tensor([width, height])).long().T
        place = (row * width + column).numpy()
        depth = np.full(height * width, np.inf, np.float32)
        colour = np.zeros((height * width, 3), np.float32)
        depth[place] = z[inside][order].numpy()
        colour[place] = self.images[other][:, mask].T[inside][order].numpy()
        drawn = torch.from_numpy(depth).view(height, width)
        nearest = -F.max_pool2d(-drawn.clamp(max=1e9)[None, None], 5, 1, 2)[0, 0]
        drawn[drawn > (1 + IN_FRONT) * nearest] = torch.inf  # seen through gaps
        return drawn, torch.from_numpy(colour).T.view(3, height, width)

    def _could_stand_nowhere(
        self, view: int, piece: Mask, surface: Tensor, sure: dict[int, Mask]
    ) -> float:
        """Share of a piece's rays on which another view sees through all before the surface."""
        far = 1 / surface[piece]
        near = self.depths[self.measured].quantile(0.02) * NEAREST
        centre = self.c2w[view, :3, 3]
        rays = (self.points[view] - centre)[piece] / self.depths[view][piece][:, None]
        nowhere = torch.ones_like(far, dtype=torch.bool)
        for share in torch.linspace(0.1, 0.9, PLACES).tolist():
            inverse = torch.maximum(torch.lerp(far, 1 / near, share), 1.05 * far)
            free = torch.zeros_like(nowhere)
            for other, mask in sure.items():
                grid, z = self._seen(centre + rays / inverse[:, None], other)
                known = self.depths[other] * (mask | self.measured[other])
                seen = warp(known[None], grid[None], "nearest", "zeros")[0, 0]
                free |= (z > 0) & (seen > (1 + IN_FRONT) * z)
            nowhere &= free
        return float(nowhere.float().mean())


def _beyond(colours: Tensor, least: Tensor, most: Tensor) -> Tensor:
    """How far colours lie outside of a range, mean of the channels."""
    return ((colours - most).clamp(min=0) + (least - colours).clamp(min=0)).mean(0)


def _grown(seeds: Mask, unmeasured: Mask, known_behind: Mask) -> Mask:
    """What was `found`, and the unmeasured pieces that much of was found: the rest of a thing may
    look like what others show behind it. Where others show nothing behind, a piece is no thing's
    rest, and nothing of one that is too large is a thing.
    """
    _, labels = cv2.connectedComponents(_opened(unmeasured))
    behind = dilate(known_behind[None].float(), 2)[0] > 0
    area, seeded, shown = (
        np.bincount(labels[mask], minlength=labels.max() + 1)
        for mask in (np.ones_like(labels, bool), seeds.numpy(), behind.numpy())
    )
    grown = (seeded * MOST_GROWTH >= area) & (shown >= BEHIND * area)
    grown[0] = False
    large = area > LARGEST * labels.size
    remaining = seeds.numpy() & ~(grown & large)[labels]
    return torch.from_numpy(remaining | (grown & ~large)[labels])


def _opened(mask: Mask) -> np.ndarray:
    """The mask without what is thinner than three pixels."""
    square = np.ones((3, 3), np.uint8)
    return cv2.morphologyEx(mask.numpy().astype(np.uint8), cv2.MORPH_OPEN, square)


def _pieces(unlike: Mask, told: Mask) -> list[Mask]:
    """Connected pieces where most of what is told is `unlike`, without small and thin ones."""
    among, around = (
        F.avg_pool2d(mask.float()[None, None], 5, 1, 2)[0, 0] for mask in (unlike, told)
    )
    dense = (around > TOLD) & (among > MOST * around)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(_opened(dense))
    large = boxes[:, cv2.CC_STAT_AREA] >= LEAST * unlike.numel()
    return [
        torch.from_numpy(labels == piece) for piece in range(1, count) if large[piece]
    ]
