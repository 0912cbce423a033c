"""The trainable part of `edit3r`: encoder of the photos, transport of the edit, fusion of the views.

photos, matched depth --> SourceEncoder --> tokens, corrections of depth, opacity, scale
                                              |
edited, photos --> local colour maps --> EditTransport (reference -> view) --> EditFusion --> choice of colours
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.geometry.warping import Correspondences, find_correspondences, warp
from edit3r_model.small.edit_fusion import CANDIDATES, EditFusion, FusedEdit
from edit3r_model.small.edit_transport import EditTransport
from edit3r_model.small.local_colour import CHANNELS, fit_colour_maps
from edit3r_model.small.source_encoder import STRIDE, SourceEncoder, SourceFeatures

KEY_STRIDE = 4
"""Network pixels per side of what the reference offers to attention."""

GRID = 8
"""The network's pictures have sides that are multiples of this [pixels]."""


@dataclass(frozen=True)
class NetworkInputs:
    """B scenes of V views on the network's grid; view 0 is the reference."""

    photos: Float[Tensor, "batch view 3 height width"]  # unedited, in [0, 1]
    edited: Float[Tensor, "batch view 3 height width"]  # in [0, 1]
    depths: Float[Tensor, "batch view height width"]  # matched; median of view 0 about 1
    confidence: Float[Tensor, "batch view height width"]  # in [0, 1]
    c2w: Float[Tensor, "batch view 4 4"]  # same unit as depths
    intrinsics: Float[Tensor, "batch view 3 3"]  # normalised


@dataclass(frozen=True)
class NetworkOutputs:
    """Corrections and colour decisions per view on the network's grid."""

    depth_correction: Float[Tensor, "batch view height width"]  # added to log depth
    opacity_correction: Float[Tensor, "batch view height width"]  # added to the logit
    scale_correction: Float[Tensor, "batch view height width"]  # added to the log scale
    disagreement: Float[Tensor, "batch view height width"]  # added to the logit near an edit, <= 0; 0 for the reference
    maps: Float[Tensor, "batch view 12 height width"]  # carried affine colour maps; 0 for the reference
    choice: Float[Tensor, "batch view 3 height width"]  # convex weights of the colour candidates


class MatchedEditNetwork(nn.Module):
    """About a million parameters at the default width."""

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.width = width
        self.encoder = SourceEncoder(width)
        self.transport = EditTransport(width)
        self.fusion = EditFusion(width)
        self.to(memory_format=torch.channels_last)  # a quarter quicker on a CPU

    def forward(self, inputs: NetworkInputs) -> NetworkOutputs:
        matches = find_correspondences(inputs.depths, inputs.intrinsics, inputs.c2w)
        features = self.encoder(inputs.photos, inputs.depths, inputs.confidence, matches)
        depths = inputs.depths * features.depth_correction.detach().exp()
        matches = find_correspondences(depths, inputs.intrinsics, inputs.c2w)
        fused = [self._fuse(inputs, features, matches, view) for view in range(1, inputs.photos.shape[1])]
        return _outputs(features, fused)

    def _fuse(self, inputs: NetworkInputs, features: SourceFeatures, matches: Correspondences, view: int) -> FusedEdit:
        """Carry the reference's edit to one view and weigh it against the view's own."""
        photos, edited, places = inputs.photos, inputs.edited, matches.coordinates[:, view]
        colours = torch.cat((photos[:, 0], edited[:, 0], edited[:, 0] - photos[:, 0]), 1)
        carried = self.transport(
            features.tokens[:, view],
            F.avg_pool2d(features.tokens[:, 0], KEY_STRIDE // STRIDE),
            _token_coordinates(places, STRIDE),
            fit_colour_maps(photos[:, 0], edited[:, 0], KEY_STRIDE, sigma=0.7),
            F.avg_pool2d(colours, KEY_STRIDE),
        )
        inside = matches.inside[:, view, None]
        pulled = warp(colours[:, None, 3:], places[:, None])[:, 0] * inside
        return self.fusion(
            features.tokens[:, view],
            photos[:, view],
            edited[:, view],
            fit_colour_maps(photos[:, view], edited[:, view], STRIDE, sigma=1.0),
            carried,
            torch.cat((pulled, inside), 1),
        )


def _outputs(features: SourceFeatures, fused: list[FusedEdit]) -> NetworkOutputs:
    """Join the views; the reference keeps its own colours."""
    first = fused[0]
    own = torch.zeros_like(first.choice)
    own[:, 0] = 1
    maps = torch.stack([torch.zeros_like(first.maps), *(f.maps for f in fused)], 1)
    choice = torch.stack([own, *(f.choice for f in fused)], 1)
    less = torch.stack([torch.zeros_like(first.opacity_correction), *(f.opacity_correction for f in fused)], 1)
    assert maps.shape[2] == CHANNELS and choice.shape[2] == CANDIDATES
    return NetworkOutputs(
        features.depth_correction,
        features.opacity_correction,
        features.scale_correction,
        less[:, :, 0],
        maps,
        choice,
    )


def _token_coordinates(
    coordinates: Float[Tensor, "batch height width 2"], stride: int
) -> Float[Tensor, "batch height2 width2 2"]:
    """Coordinates of the tokens: the mean over each `stride` x `stride` cell."""
    return F.avg_pool2d(coordinates.permute(0, 3, 1, 2), stride).permute(0, 2, 3, 1)


def network_grid(image_size: tuple[int, int], longest: int) -> tuple[int, int]:
    """(height, width) nearest to the photo's shape with the longer side `longest`, in multiples of GRID."""
    height, width = image_size
    scale = longest / max(height, width)
    return tuple(max(GRID * 2, GRID * round(side * scale / GRID)) for side in (height, width))
