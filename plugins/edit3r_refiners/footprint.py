"""Where in a picture Gaussians may show, and which Gaussians may show at given places."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from edit3r.geometry.cameras import from_pixels, invert_rigid, to_pixels
from edit3r.interfaces import Rasterizer
from edit3r.types import Cameras, Gaussians

CELL = 2  # [pixels]
SPARE = 0.5  # pixels around, for rounding
NEAR = 5  # a Gaussian nearer than this many times its reach may show anywhere: its outline is no ellipse
BLOCK = 16  # neighbours in the list that are tried as one first; one per pixel, they lie side by side

Cells = Bool[Tensor, "row column"]
"""Squares of CELL pixels a side; those at the right and at the bottom may be cut."""

_PROBE = 128  # side of the picture that the rasterizer is asked for [pixels]
_PROBE_SIZE = 8.0  # standard deviation of the Gaussian in it [pixels]


@dataclass(frozen=True)
class Footprint:
    """How far a rasterizer draws: `deviations` times sqrt(variance in the picture + `smoothing`)."""

    deviations: float
    smoothing: float  # [square pixels]


class Outlines:
    """Gaussians of one scene (batch 1) as squares around their centres in any picture, outside which they do not show.

    The variance along x that splatting gives a Gaussian is |dx / dposition|^2 times its largest variance at most, and
    dx / dposition is the row of the pinhole camera's Jacobian, (fx, skew, x - cx) / z.
    """

    def __init__(self, gaussians: Gaussians, footprint: Footprint) -> None:
        least = footprint.deviations * footprint.smoothing**0.5 + SPARE
        self._each = _Balls(
            gaussians.means[0].T.contiguous(), footprint.deviations * gaussians.scales[0].amax(-1), least
        )

    def cells(self, cameras: Cameras, index: int) -> Cells:
        """Those of one camera's picture that any of them may show in."""
        rows, columns = _grid(cameras.image_size)
        x, y, far = self._each.placed(cameras, index)
        x, y, far = (values[far >= 0] for values in (x, y, far))
        left, right = (x - far).clamp_(0, columns).long(), (x + far).add_(1).clamp_(0, columns).long()
        top, bottom = (y - far).clamp_(0, rows).long(), (y + far).add_(1).clamp_(0, rows).long()
        top, bottom, corners = top * (columns + 1), bottom * (columns + 1), (rows + 1) * (columns + 1)
        # Each square counts in the sum over all that is above and to the left, from its first to its last corner.
        more = torch.cat((top + left, bottom + right)).bincount(minlength=corners)
        less = torch.cat((top + right, bottom + left)).bincount(minlength=corners)
        return (more - less).view(rows + 1, columns + 1).cumsum(0).cumsum(1)[:-1, :-1] > 0

    def meeting(self, cameras: Cameras, index: int, cells: Cells) -> Int[Tensor, "found"]:
        """Which of them may show in any of `cells` of one camera's picture, in rising order."""
        if not cells.any():
            return torch.zeros(0, dtype=torch.long, device=cells.device)
        steps = cv2.distanceTransform((~cells).to("cpu", torch.uint8).numpy(), cv2.DIST_C, 3)
        steps = torch.from_numpy(steps).to(self._each.sizes)  # along the longer of x and y [cells]
        means, sizes, blocks = self._blocks
        tried = blocks.meeting(cameras, index, steps).nonzero()[:, 0]
        members = _Balls(means[:, tried].flatten(1), sizes[tried].flatten(), self._each.least)
        found = members.meeting(cameras, index, steps).nonzero()[:, 0]
        found = tried[found // BLOCK] * BLOCK + found % BLOCK
        return found[: torch.searchsorted(found, len(self._each.sizes))]

    @cached_property
    def _blocks(self) -> tuple[Float[Tensor, "3 block member"], Float[Tensor, "block member"], "_Balls"]:
        """Centres and sizes of BLOCK neighbours each, the last filled up with its last member; and each as one."""
        each = self._each
        filled = -len(each.sizes) % BLOCK
        means = torch.cat((each.means, each.means[:, -1:].expand(-1, filled)), 1).unflatten(1, (-1, BLOCK))
        sizes = torch.cat((each.sizes, each.sizes[-1:].expand(filled))).unflatten(0, (-1, BLOCK))
        low, high = means.aminmax(dim=2)
        centres = (low + high) / 2
        spread = (high - centres).norm(dim=0) * (1 + 1e-5) + 1e-6 * centres.norm(dim=0)  # and rounding
        return means, sizes, _Balls(centres, sizes.amax(1), each.least + SPARE, spread)


@dataclass(frozen=True)
class _Balls:
    """Round Gaussians, or groups of such with their centres within `spread` of the group's."""

    means: Float[Tensor, "3 ball"]
    sizes: Float[Tensor, "ball"]  # of a group, its largest
    least: float  # half side of the square around one of no size [pixels]
    spread: Float[Tensor, "ball"] | float = 0.0

    def meeting(self, cameras: Cameras, index: int, steps: Float[Tensor, "row column"]) -> Bool[Tensor, "ball"]:
        """Which may show in a cell where `steps`, the way to the nearest wanted cell, is 0."""
        rows, columns = steps.shape
        x, y, far = self.placed(cameras, index)
        # From outside the picture, its nearest cell is nearer to all others than the centre is.
        place = y.clamp_(0, rows - 1).int().mul_(columns).add_(x.clamp_(0, columns - 1).int())
        return steps.flatten().index_select(0, place) <= far.add_(1)

    def placed(self, cameras: Cameras, index: int) -> tuple[Tensor, Tensor, Tensor]:
        """Centre (x, y) and half side [cells]: infinite for those that may show anywhere, or (negative) nowhere."""
        lens = to_pixels(cameras.intrinsics, cameras.image_size)[0, index]
        lens[:2] /= CELL
        w2c = invert_rigid(cameras.c2w[0, index])
        shift = lens @ w2c[:3, 3]
        x, y, z = ((lens @ w2c[:3, :3]) @ self.means).unbind()
        x, y, z = x.add_(shift[0]), y.add_(shift[1]), z.add_(shift[2])
        nearest = z - self.spread
        per_z, per_nearest = (values.clamp(min=1e-12).reciprocal_() for values in (z, nearest))
        x, y = x.mul_(per_z), y.mul_(per_z)
        aside = torch.maximum((x - lens[0, 2]).abs_(), (y - lens[1, 2]).abs_())
        aside = aside.add_(float(torch.maximum(lens[0, :2].norm(), lens[1, 1])))
        # A point d away from the centre shows at most `aside` d / nearest away from where the centre does.
        apart = aside * self.spread * per_nearest
        far = (aside + apart).mul_(self.sizes).mul_(per_nearest).add_(apart).add_(self.least / CELL)
        far = torch.where(nearest < NEAR * self.sizes, torch.inf, far)
        return x, y, torch.where(z + self.spread <= 0, -torch.inf, far)


def cells_of(pixels: Bool[Tensor, "height width"]) -> Cells:
    """The cells that hold any of `pixels`."""
    return torch.nn.functional.max_pool2d(pixels[None].float(), CELL, ceil_mode=True)[0] > 0


def pixels_of(cells: Cells, image_size: tuple[int, int]) -> Bool[Tensor, "height width"]:
    """All pixels of the cells."""
    height, width = image_size
    return cells.repeat_interleave(CELL, 0).repeat_interleave(CELL, 1)[:height, :width]


def _grid(image_size: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of cells."""
    return -(-image_size[0] // CELL), -(-image_size[1] // CELL)


def measured_footprint(rasterizer: Rasterizer, like: Tensor) -> Footprint | None:
    """How far `rasterizer` draws, read from its pictures of a point and of a Gaussian; None: cannot be told.

    It is asked because rasterizers and their settings differ. `like` gives device and type.
    """
    point, disc = (_drawn_radius(rasterizer, size, like) for size in (1e-3, _PROBE_SIZE))
    if not 0 < disc < _PROBE // 2 - 1:  # it is culled, or shows to the picture's border
        return None
    # Between the last pixel that shows and the next lies the true bound; both figures take the next.
    deviations = max(0.0, (disc + 1) ** 2 - point**2) ** 0.5 / _PROBE_SIZE
    return Footprint(deviations, ((point + 1) / max(deviations, 1e-6)) ** 2)


def _drawn_radius(rasterizer: Rasterizer, size: float, like: Tensor) -> float:
    """The distance along x of the last pixel centre that an opaque Gaussian of deviation `size` shows at [pixels]."""
    lens = from_pixels(torch.tensor([[_PROBE, 0, _PROBE / 2], [0, _PROBE, _PROBE / 2], [0, 0, 1.0]]), (_PROBE,) * 2)
    cameras = Cameras(torch.eye(4)[None, None], lens[None, None], (_PROBE, _PROBE)).to(like)
    one = Gaussians(
        torch.tensor([[[0, 0, 1.0]]]),
        torch.full((1, 1, 3), size / _PROBE),
        torch.tensor([[[1.0, 0, 0, 0]]]),
        torch.ones(1, 1),
        torch.zeros(1, 1, 1, 3),
    ).to(like)
    with torch.no_grad():
        shown = rasterizer.render(one, cameras).alphas[0, 0, 0] > 0
    return float((shown.any(0).nonzero() + 0.5 - _PROBE / 2).abs().max()) if shown.any() else 0.0
