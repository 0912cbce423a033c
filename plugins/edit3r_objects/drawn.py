"""Gaussians chosen by what is drawn over a scene from anywhere: strokes of a brush, lassos."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from pydantic import Field, TypeAdapter, ValidationError
from scipy.spatial import cKDTree
from skimage.color import rgb2lab
from skimage.segmentation import random_walker
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians, Rendering
from edit3r.kit.geometry.cameras import project
from edit3r.kit.geometry.warping import warp
from edit3r_objects.lifting import lift

__all__ = ["Drawn", "choose_drawn", "read_drawn"]

# The numbers of this block: docs/notes/objects.md.
LOOKED_AT = 384  # longer side of the picture in which a stroke is read [pixels]
BEHIND = 0.4  # relative difference of depth from which a Gaussian is behind a surface
RIM = 0.018  # where a hand strays from the thing [longer sides]
REACH = 0.01  # how far a step of growing goes [share of the middle distance from the camera]
NEXT = 1.5  # the same at least, so that a coarse scene grows [distances to the next Gaussian]
SAMPLED = 2000  # Gaussians of which that distance is taken
MOST = 200  # strokes
MOST_PLACES = 2000  # of one of them

Number = Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=-1, le=2)]
Vector = tuple[Number, Number, Number]


@dataclass(frozen=True)
class Drawn:
    """One stroke or lasso, on a picture of the scene from a camera of one's own.

    Shares are of the picture's width and height; (0, 0) is its top left corner.
    """

    kind: Literal["lasso", "brush"]
    places: Annotated[
        list[tuple[Share, Share]], Field(min_length=1, max_length=MOST_PLACES)
    ]
    right: Vector  # the camera's axes and its centre in the world
    down: Vector
    forward: Vector
    centre: Vector
    lens: tuple[Number, Number, Number, Number]  # fx, fy, cx, cy as shares
    aspect: Annotated[float, Field(ge=0.1, le=10)]  # width / height of the picture
    radius: Annotated[float, Field(ge=0, le=0.5)] = 0.02  # of a brush [longer sides]
    minus: bool = False  # takes away from what was drawn before

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the picture [pixels]."""
        height = LOOKED_AT / max(self.aspect, 1)
        return max(8, round(height)), max(8, round(height * self.aspect))

    @property
    def camera(self) -> Cameras:
        """Raises InputError for axes that do not stand at right angles."""
        axes = torch.tensor(
            [self.right, self.down, self.forward], dtype=torch.float64
        ).T
        square = torch.allclose(
            axes.T @ axes, torch.eye(3, dtype=torch.float64), atol=1e-2
        )
        if not square or torch.det(axes) < 0 or min(self.lens[:2]) <= 0:
            raise InputError("drawn: not a camera that could see the scene.")
        c2w, intrinsics = torch.eye(4), torch.eye(3)
        c2w[:3, :3] = axes.float()
        c2w[:3, 3] = torch.tensor(self.centre)
        fx, fy, cx, cy = self.lens
        intrinsics[0, 0], intrinsics[1, 1] = fx, fy
        intrinsics[0, 2], intrinsics[1, 2] = cx, cy
        return Cameras(c2w[None, None], intrinsics[None, None], self.size)

    @property
    def mask(self) -> Float[Tensor, "height width"]:
        """1 under the brush, or inside the lasso."""
        height, width = self.size
        mask = np.zeros(self.size, np.float32)
        line = [*self.places, self.places[-1]]  # one place alone is a dot
        places = np.rint(np.multiply(line, (width, height))).astype(np.int32)
        if self.kind == "lasso":
            cv2.fillPoly(mask, [places], 1)
        else:
            thick = max(1, round(2 * self.radius * max(self.size)))
            cv2.polylines(mask, [places], False, 1, thick)
        return torch.from_numpy(mask)


_DRAWN = TypeAdapter(list[Drawn])


def read_drawn(content: Any) -> tuple[Drawn, ...]:
    """Strokes from plain data, as JSON holds them; raises InputError for what is none."""
    try:
        strokes = _DRAWN.validate_python(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(f"drawn: {place}: {first['msg']}.") from None
    if not 0 < len(strokes) <= MOST:
        raise InputError(f"drawn: expected 1 to {MOST} strokes, got {len(strokes)}.")
    return tuple(strokes)


def choose_drawn(
    gaussians: Gaussians,
    strokes: Sequence[Drawn],
    rasterizer: Rasterizer,
    grown: int = 0,
) -> Bool[Tensor, "gaussian"]:
    """The Gaussians of one scene (batch 1) that show what was drawn, not what lies behind it.

    Strokes count in their order. `grown` steps take in what lies around, and where negative leave
    out what lies at the rim.
    """
    chosen = torch.zeros(gaussians.count, dtype=torch.bool)
    # What is drawn from one place is one shape: a Gaussian half in each of two strokes is in it.
    for _, alike in groupby(strokes, lambda one: replace(one, places=[], radius=0)):
        some = list(alike)
        camera = some[0].camera
        mask = torch.stack([stroke.mask for stroke in some]).amax(0)
        shown = rasterizer.render(gaussians, camera)
        mask = _to_the_edge(mask, shown, some[0].kind)
        own = lift(gaussians, camera, mask[None], rasterizer)
        own &= ~_behind(gaussians, camera, shown, mask)
        chosen = chosen & ~own if some[0].minus else chosen | own
    if grown and chosen.any() and not chosen.all():
        chosen = _grown(gaussians, chosen, grown, strokes[-1])
    return chosen


def _behind(
    gaussians: Gaussians,
    camera: Cameras,
    shown: Rendering,
    mask: Float[Tensor, "height width"],
) -> Bool[Tensor, "gaussian"]:
    """Which Gaussians lie clearly behind the surface that the picture shows at their place, and
    behind all that it shows of the thing.
    """
    if not mask.any():
        return torch.zeros(gaussians.count, dtype=torch.bool)
    places, depth = project(
        gaussians.means[0], camera.intrinsics[0, 0], camera.c2w[0, 0]
    )
    depths = shown.depths[0, :, 0]
    surface = warp(depths[None], places[None, None], mode="nearest")[0, 0, 0]
    farthest = depths[0][mask > 0.5].max()
    return (depth > (1 + BEHIND) * surface) & (depth > farthest)


def _to_the_edge(
    mask: Float[Tensor, "height width"], shown: Rendering, kind: str
) -> Float[Tensor, "height width"]:
    """What is drawn, up to the edge that the picture shows in its rim.

    Nobody draws along an outline exactly. A lasso is drawn around the thing, so that its rim lies
    within; a brush strays to both sides. Random walks from what is surely in and out decide (Grady
    2006), and where there is no edge they meet half-way.
    """
    drawn = mask.numpy().astype(np.uint8)
    within, without = (
        cv2.distanceTransform(one, cv2.DIST_L2, 5) for one in (drawn, 1 - drawn)
    )
    rim = RIM * max(mask.shape) * (1 if kind == "lasso" else 0.5)
    rim = min(rim, 0.5 * float(within.max()))
    inside = within > rim
    outside = (drawn == 0) & (without > (0 if kind == "lasso" else rim))
    if not inside.any() or not outside.any():
        return mask
    seeds = inside + 2 * outside
    image = shown.images[0, 0].clamp(0, 1).permute(1, 2, 0).numpy(force=True)
    probabilities = random_walker(rgb2lab(image), seeds, mode="bf", channel_axis=-1)
    return torch.from_numpy((probabilities == 1).astype(np.float32))


def _grown(
    gaussians: Gaussians, chosen: Bool[Tensor, "gaussian"], steps: int, seen: Drawn
) -> Bool[Tensor, "gaussian"]:
    points = gaussians.means[0].numpy(force=True)
    here = chosen.numpy()
    far = (points[here] - np.array(seen.centre)) @ np.array(seen.forward)
    apart = cKDTree(points).query(points[here][:SAMPLED], 2)[0][:, 1]
    step = max(REACH * float(np.median(far)), NEXT * float(np.median(apart)), 1e-9)
    reach = abs(steps) * step
    source, rest = (here, ~here) if steps > 0 else (~here, here)
    gaps = cKDTree(points[source]).query(points[rest], distance_upper_bound=reach)[0]
    near = np.zeros_like(here)
    near[rest] = np.isfinite(gaps)
    return torch.from_numpy(here | near if steps > 0 else here & ~near)
