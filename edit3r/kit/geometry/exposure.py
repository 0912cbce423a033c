"""Exposure and white balance of photos of one scene, estimated together from what they share.

A photo's colours become the reference's (view 0) by a gain and an offset for each channel, on sRGB
values: exposure and white balance are gains of linear light, and a gain stays a gain under a power
law such as sRGB's. Offsets stand for haze and for the ends of a camera's curve.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Views, along
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.geometry.warping import nearest_views, shared_surface, warp

# The numbers of this block: docs/notes/classical.md.
SIDE = 128  # pixels of the longer side at which photos are compared
EXPOSED = (0.03, 0.97)  # sRGB values outside are clipped and tell nothing
NEAR_VIEWS = 6  # others with which each of many photos is compared
MIN_PIXELS = 200  # that two photos must share to say anything about each other
MIN_CORRELATION = 0.6  # of what they share; below, they show other things
# of a mid grey [sRGB], below which a photo's exposure is the reference's
MIN_CHANGE = 0.02
MAX_LEFT = 2 / 3  # share of the photos' differences that remains in one light, at most
MAX_GAIN = 4.0
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of red, green and blue (Rec. 709)

Images = Float[Tensor, "batch view 3 height width"]


@dataclass(frozen=True)
class Exposure:
    """How each photo's colours become the reference's: `gain * colour + offset` [sRGB]."""

    gain: Float[Tensor, "batch view 3 1 1"]
    offset: Float[Tensor, "batch view 3 1 1"]

    @property
    def change(self) -> float:
        """The most that a mid grey of any photo changes [sRGB]."""
        return float((0.5 * self.gain + self.offset - 0.5).abs().amax())

    def to_reference(self, images: Images) -> Images:
        """Photos as they would look in the reference's exposure, in [0, 1]."""
        return (self.gain * images + self.offset).clamp(0, 1)

    def to_own(self, images: Images) -> Images:
        """Images in the reference's exposure as each photo would show them."""
        return (images - self.offset) / self.gain

    @property
    def of_lightness(self) -> "Exposure":
        """The same for all channels, as a grey changes: light without its tint."""
        grey = self.gain.new_tensor(LUMINANCE).view(3, 1, 1)
        values = (
            (value * grey).sum(2, keepdim=True) for value in (self.gain, self.offset)
        )
        return Exposure(*(value.expand_as(self.gain) for value in values))

    def select(self, indices: list[int]) -> "Exposure":
        return along(self, "view", indices)


@dataclass(frozen=True)
class ExposureOfEdit:
    """How edited photos' colours become the reference's: what was edited may follow other light
    than the photos, as a drawing does.
    """

    photos: Exposure
    edit: Exposure
    region: Bool[Tensor, "batch view height width"]  # where `edit` counts

    def to_reference(self, images: Images) -> Images:
        """Edited photos as they would look in the reference's exposure, in [0, 1]."""
        return self._either(
            self.edit.to_reference(images), self.photos.to_reference(images)
        )

    def to_own(self, images: Images) -> Images:
        """Images of the edited scene in the reference's exposure as each photo would show them."""
        return self._either(self.edit.to_own(images), self.photos.to_own(images))

    def select(self, indices: list[int]) -> "ExposureOfEdit":
        photos, edit = self.photos.select(indices), self.edit.select(indices)
        return along(self, "view", indices, photos=photos, edit=edit)

    def _either(self, edit: Images, photos: Images) -> Images:
        region = self.region.to(edit)
        if size_of(region) != size_of(edit):
            region = F.interpolate(region, size_of(edit), mode="nearest")
        return torch.where(region[:, :, None] > 0, edit, photos)


@dataclass(frozen=True)
class _Pair:
    """What two photos say about each other's light, by the colours of what both show."""

    first: int
    second: int
    own: Float[Tensor, "pixel 3"]  # in the first
    other: Float[Tensor, "pixel 3"]  # in the second

    @property
    def weight(self) -> float:
        return math.sqrt(len(self.own))

    @property
    def tells(self) -> bool:
        """Whether the two share enough, and show the same but for their exposure."""
        if len(self.own) < MIN_PIXELS:
            return False
        greys = torch.stack((self.own.mean(1), self.other.mean(1)))
        return float(torch.corrcoef(greys)[0, 1]) >= MIN_CORRELATION


def estimate_exposure(views: Views, geometry: Geometry) -> Exposure | None:
    """Return the exposure of the photos; None where all have that of the reference.

    Two photos tell the ratio of their gains by the spread of the colours that they share, which
    noise in both leaves true, and their offsets by the middles. All pairs are settled together by
    least squares. A photo keeps its own exposure where it shares too little with the others; all do
    where one light explains less than a third of what they differ.
    """
    lights = [_of_scene(views, geometry, scene) for scene in range(len(views.images))]
    gain, offset = (torch.stack(values)[..., None, None] for values in zip(*lights))
    if bool((gain == 1).all()):
        return None
    return Exposure(gain.to(views.images), offset.to(views.images))


def exposure_of_edit(
    photos: Exposure,
    edited: Views,
    region: Bool[Tensor, "batch view height width"],
    geometry: Geometry,
) -> Exposure | ExposureOfEdit:
    """Return how edited photos become the reference's, given how the photos do.

    What an edit draws or paints may follow a photo's light in full (what a removed thing hid), in
    lightness (black and white) or not at all (paper), so in the `region` that was edited the light
    counts in which the photos then agree best about the surfaces that they share; the photos' own
    where they share none.
    """
    plain = Exposure(torch.ones_like(photos.gain), torch.zeros_like(photos.offset))
    ways = [photos, photos.of_lightness, plain]
    # not cut off at 1: white that gets lighter is not the white of the reference
    shown = [way.gain * edited.images + way.offset for way in ways]
    maps = _reduced(edited, torch.cat([*shown, region[:, :, None].to(shown[0])], 2))
    geometry = geometry.at(_reduced_size(edited))
    unlike = torch.zeros(len(ways), dtype=torch.float64)
    for scene in range(len(maps)):
        for pair in _near_pairs(geometry, scene):
            first, second = _of_both(maps, edited, geometry, scene, pair)
            both = (first[:, -1] > 0.5) & (second[:, -1] > 0.5)
            apart = (first - second)[both, :-1].abs().sum(0)
            unlike += apart.unflatten(0, (len(ways), 3)).sum(1)
    best = ways[int(unlike.argmin())]  # of equal ones the first
    return photos if best is photos else ExposureOfEdit(photos, best, region)


def _of_scene(
    views: Views, geometry: Geometry, scene: int
) -> tuple[Float[Tensor, "view 3"], Float[Tensor, "view 3"]]:
    """Gains and offsets of one scene of the batch."""
    count = views.count
    geometry = geometry.at(_reduced_size(views))
    images = _reduced(views, views.images)
    pairs = [
        _Pair(first, second, *_shared(images, views, geometry, scene, [first, second]))
        for first, second in _near_pairs(geometry, scene)
    ]
    pairs = [pair for pair in pairs if pair.tells]
    middles = [(one.own.median(0).values, one.other.median(0).values) for one in pairs]
    # In one light gain * spread of both are alike, and gain * middle + offset.
    ratios = [_log_ratio(pair, *both) for pair, both in zip(pairs, middles)]
    gain = _settled(pairs, ratios, count).exp().clamp(1 / MAX_GAIN, MAX_GAIN)
    apart = [
        gain[pair.second] * other - gain[pair.first] * own
        for pair, (own, other) in zip(pairs, middles)
    ]
    offset = _settled(pairs, apart, count)
    change = (0.5 * gain + offset - 0.5).abs().amax(1)
    own_light = (change < MIN_CHANGE) | ~_linked(pairs, count)
    if not _explains(gain, offset, pairs):
        own_light[:] = True
    gain[own_light] = 1.0
    offset[own_light] = 0.0
    return gain, offset


def _log_ratio(
    pair: _Pair, middle: Float[Tensor, "3"], middle_other: Float[Tensor, "3"]
) -> Float[Tensor, "3"]:
    """Logarithm of the second photo's spread of colours over the first's."""
    spread = (pair.own - middle).abs().mean(0).clamp(min=1e-4)
    other = (pair.other - middle_other).abs().mean(0).clamp(min=1e-4)
    return (other / spread).log()


def _explains(
    gain: Float[Tensor, "view 3"], offset: Float[Tensor, "view 3"], pairs: list[_Pair]
) -> bool:
    """Whether one light takes a third and more off what the photos differ."""
    unlike = 0.0
    left = 0.0
    for pair in pairs:
        first = gain[pair.first] * pair.own + offset[pair.first]
        second = gain[pair.second] * pair.other + offset[pair.second]
        unlike += float((pair.own - pair.other).abs().sum())
        left += float((first - second).abs().sum())
    return left <= MAX_LEFT * unlike


def _settled(
    pairs: list[_Pair], differences: list[Float[Tensor, "3"]], count: int
) -> Float[Tensor, "view 3"]:
    """Values x with x_first - x_second near each pair's difference, and x_0 = 0."""
    matrix = 1e-3 * torch.eye(count, dtype=torch.float64)
    vector = torch.zeros(count, 3, dtype=torch.float64)
    matrix[0, 0] = 1e12
    for pair, difference in zip(pairs, differences):
        ends = [pair.first, pair.second]
        signs = torch.tensor([1.0, -1.0], dtype=torch.float64)
        matrix[torch.tensor(ends)[:, None], ends] += (
            pair.weight * signs[:, None] * signs
        )
        vector[ends] += pair.weight * difference * signs[:, None]
    return torch.linalg.solve(matrix, vector)


def _linked(pairs: list[_Pair], count: int) -> Bool[Tensor, "view"]:
    """Photos that share something with view 0, also through others."""
    linked = torch.zeros(count, dtype=torch.bool)
    linked[0] = True
    for _ in range(count):
        for pair in pairs:
            ends = [pair.first, pair.second]
            linked[ends] = linked[ends].any()
    return linked


def _reduced_size(views: Views) -> tuple[int, int]:
    """(height, width) at which photos are compared."""
    height, width = views.image_size
    scale = min(1.0, SIDE / max(height, width))
    return round(scale * height), round(scale * width)


def _near_pairs(geometry: Geometry, scene: int) -> list[list[int]]:
    """Placed views with their nearest ones, each pair once."""
    nearest = nearest_views(geometry.c2w, geometry.depths, NEAR_VIEWS)
    near = {(min(a, b), max(a, b)) for a, row in enumerate(nearest) for b in row}
    pairs = map(list, sorted(near))
    return [ends for ends in pairs if geometry.registered[scene, ends].all()]


def _reduced(
    views: Views, maps: Float[Tensor, "batch view channel height width"]
) -> Float[Tensor, "batch view channel height2 width2"]:
    """Maps of the views at the size at which they are compared."""
    size = _reduced_size(views)
    return F.adaptive_avg_pool2d(maps.flatten(0, 1), size).unflatten(0, maps.shape[:2])


def _shared(
    images: Images, views: Views, geometry: Geometry, scene: int, pair: list[int]
) -> tuple[Float[Tensor, "pixel 3"], Float[Tensor, "pixel 3"]]:
    """Exposed colours of the surfaces that two views surely show, as each shows them. Images and
    geometry are at the reduced size.
    """
    first, second = _of_both(images, views, geometry, scene, pair)
    exposed = [((c > EXPOSED[0]) & (c < EXPOSED[1])).all(1) for c in (first, second)]
    return first[exposed[0] & exposed[1]], second[exposed[0] & exposed[1]]


def _of_both(
    maps: Float[Tensor, "batch view channel height width"],
    views: Views,
    geometry: Geometry,
    scene: int,
    pair: list[int],
) -> tuple[Float[Tensor, "pixel channel"], Float[Tensor, "pixel channel"]]:
    """What the maps of two views are where both surely show one surface, on the CPU: what is
    settled from it is small. Maps and geometry are at the reduced size.
    """
    intrinsics = geometry.calibrated(views).intrinsics[scene, pair]
    grid, same = shared_surface(
        geometry.depths[scene, pair], intrinsics, geometry.c2w[scene, pair]
    )
    sure = geometry.is_measured[scene, pair, None].to(maps)
    own, other = maps[scene, pair]
    seen = warp(torch.cat((other[None], sure[1:]), 1), grid[None])[0]
    same = same & (sure[0, 0] > 0) & (seen[-1] > 0.99)
    first, second = (each[:, same].T.double().cpu() for each in (own, seen[:-1]))
    return first, second
