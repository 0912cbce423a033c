"""The matcher `network`: pose and depth of unedited photos, view 0 against each other view by the network."""

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from edit3r import config, reporting
from edit3r.cache import remembered
from edit3r.errors import MatchingError
from edit3r.geometry.cameras import scale_poses
from edit3r.geometry.maps import resize, upsample_depths
from edit3r.interfaces import MatchedGeometry, Matcher
from edit3r.stage_checks import require_matchable
from edit3r.types import Views
from edit3r_matching_network.encoder import GRID
from edit3r_matching_network.network import MatchingNetwork, load_network
from edit3r_matching_network.pair_geometry import PairGeometry, pair_geometry

MIN_SIZE = 16
"""Images with a shorter side show too little [pixels]."""
SURE = 0.5
"""Confidence above which a cell counts as matched."""
FLAT = 0.005
"""An image whose contrast (standard deviation) is below this shows nothing to match [sRGB]."""


class NetworkMatcher(Matcher):
    """Soft matches, depth and confidence by a network trained on made-up scenes, made to agree by an adjustment.

    No features are detected and nothing random is drawn. The unit of length is that of view 0's predicted depth.
    """

    class Settings(config.Settings):
        weights: str = Field("shipped", description="'shipped', 'untrained' or a file of `edit3r train`")
        network_size: int = Field(
            64, ge=32, le=256, multiple_of=8, description="longer side of the images it looks at [pixels]"
        )
        adjust: bool = Field(True, description="false: pose by Procrustes, depths as predicted")
        least_matched: float = Field(
            0.04, ge=0, le=1, description="share of a pair's cells that must match for a view to count as placed"
        )

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.matching_network: MatchingNetwork = load_network(settings.weights)

    @torch.no_grad()
    @remembered
    def match(self, views: Views) -> MatchedGeometry:
        require_matchable(views, MIN_SIZE)
        small = resize(views.images, network_size(views.image_size, self.settings.network_size))
        pairs = [self._pair(small, views.intrinsics, other) for other in range(1, views.count)]
        textured = small.std((2, 3, 4)) > FLAT
        matched = torch.stack([(pair.confidence > SURE).float().mean((2, 3)).amin(1) for pair in pairs], 1)
        placed = (matched >= self.settings.least_matched) & textured[:, :1] & textured[:, 1:]
        self._report(placed, pairs, views)
        return _joined(pairs, placed, small, views.images)

    def _pair(
        self, images: Float[Tensor, "batch view 3 h w"], intrinsics: Float[Tensor, "batch view 3 3"], other: int
    ) -> PairGeometry:
        """What the network and the adjustment say about view 0 and view `other`."""
        chosen = images[:, [0, other]], intrinsics[:, [0, other]]
        prediction = self.matching_network(chosen[0].to(next(self.matching_network.parameters())), chosen[1])
        return pair_geometry(prediction, chosen[1], chosen[0], self.settings.adjust)

    def _report(self, placed: Bool[Tensor, "batch pair"], pairs: list[PairGeometry], views: Views) -> None:
        """Note how much matched, warn of views that are left out; raises MatchingError when a scene has none left."""
        names = views.names or tuple(f"view {index}" for index in range(views.count))
        shares = [float((pair.confidence > SURE).float().mean()) for pair in pairs]
        reporting.note("matcher.matched", {f"{names[0]} {name}": round(s, 3) for name, s in zip(names[1:], shares)})
        if not bool(placed.any(1).all()):
            raise MatchingError(
                f"the network found too few matches between {names[0]} and the other photos (at best "
                f"{max(shares):.0%} of the picture); give photos that overlap more, or use matcher classical."
            )
        lost = [name for name, good in zip(names[1:], placed.all(0).tolist()) if not good]
        if lost:
            reporting.warn(f"{', '.join(lost)}: matches too little of {names[0]} to be placed, so it is left out.")


def network_size(image_size: tuple[int, int], longest: int) -> tuple[int, int]:
    """(height, width) nearest to the image's shape with the longer side `longest`, in multiples of GRID [pixels]."""
    scale = longest / max(image_size)
    return tuple(max(2 * GRID, GRID * round(side * scale / GRID)) for side in image_size)


def _joined(
    pairs: list[PairGeometry],
    placed: Bool[Tensor, "batch pair"],
    small: Float[Tensor, "batch view 3 h w"],
    images: Float[Tensor, "batch view 3 height width"],
) -> MatchedGeometry:
    """Everything in the unit of the first placed pair: each pair has view 0's depths, too."""
    c2w, depths, confidence = (torch.stack(part, 1) for part in zip(*(vars(pair).values() for pair in pairs)))
    units = _units(depths[:, :, 0].log(), placed)
    good = placed[..., None, None]
    poses = torch.where(good, scale_poses(c2w, units), torch.eye(4).to(c2w))
    poses = torch.cat((torch.eye(4).to(poses).expand(len(poses), 1, 4, 4), poses), 1)
    others = torch.where(good, depths[:, :, 1] * units[..., None, None], 1.0)
    first = _first_depths(depths[:, :, 0].log() + units.log()[..., None, None], confidence[:, :, 0], placed)
    sure = torch.cat((confidence[:, :, 0].amax(1, keepdim=True), confidence[:, :, 1] * good), 1)
    depths, sure = upsample_depths(torch.cat((first[:, None], others), 1), sure, small, images)
    return MatchedGeometry(poses, depths, sure.clamp(0, 1), torch.cat((torch.ones_like(placed[:, :1]), placed), 1))


def _units(
    log_depths: Float[Tensor, "batch pair h w"], placed: Bool[Tensor, "batch pair"]
) -> Float[Tensor, "batch pair"]:
    """Factors from each pair's unit to that of the scene's first placed pair, from view 0's depths in each unit."""
    first = placed.int().argmax(1)
    reference = log_depths[torch.arange(len(log_depths)), first]
    return (reference[:, None] - log_depths).flatten(2).median(2).values.exp()


def _first_depths(
    log_depths: Float[Tensor, "batch pair h w"],
    confidence: Float[Tensor, "batch pair h w"],
    placed: Bool[Tensor, "batch pair"],
) -> Float[Tensor, "batch h w"]:
    """View 0's depths: over the placed pairs the mean of their logs, weighted by confidence."""
    weights = (confidence + 0.01) * placed[..., None, None]
    return ((log_depths * weights).sum(1) / weights.sum(1)).exp()
