"""The full network of `noposplat`: a backbone and a head, from images to Gaussians, and what is
needed to build it.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from edit3r.config import make_settings
from edit3r.contract.interfaces import Backbone, GaussianHead
from edit3r.contract.types import Gaussians
from edit3r_model.backbone import AsymmetricViT
from edit3r_model.dpt_head import DptGaussianHead


@dataclass(frozen=True)
class PartConfig:
    """Which component a part is, and the settings that give it its shape."""

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class NetworkConfig:
    """Everything needed to build the network that a weight file fills."""

    backbone: PartConfig
    head: PartConfig
    resolution: int = (
        256  # side of the square with the area the network was trained at [pixels]
    )

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> "NetworkConfig":
        """Read what `dataclasses.asdict` gave; raises KeyError, TypeError or ValueError for
        anything else.
        """
        parts = (PartConfig(**content[kind]) for kind in ("backbone", "head"))
        return cls(*parts, int(content.get("resolution", 256)))


class GaussianNetwork(nn.Module):
    """Backbone, then head. Any backbone goes with any head that reads its levels.

    images [0, 1] ──► backbone ──► features ──► head ──► Gaussians
    intrinsics ──────────┘                       ▲
    images ──────────────────────────────────────┘

    Its `state_dict` holds `config` as extra state, so that a file of it, such as `edit3r train`
    writes, says what network to build.
    """

    def __init__(
        self, backbone: Backbone, head: GaussianHead, config: NetworkConfig
    ) -> None:
        super().__init__()
        self.backbone = backbone
        self.head = head
        self.config = config

    def forward(
        self,
        images: Float[Tensor, "batch view 3 height width"],
        intrinsics: Float[Tensor, "batch view 3 3"],
    ) -> Gaussians:
        return self.head(self.backbone(images, intrinsics), images)

    def get_extra_state(self) -> UInt8[Tensor, "byte"]:
        """Return `config` as the bytes of a JSON text; a tensor, because weight files hold nothing
        else.
        """
        return torch.frombuffer(
            bytearray(json.dumps(asdict(self.config)).encode()), dtype=torch.uint8
        )

    def set_extra_state(self, state: UInt8[Tensor, "byte"]) -> None:
        """Ignore the config of loaded weights: this network is built already."""


def empty_network(config: NetworkConfig, **backbone: Any) -> GaussianNetwork:
    """Build the published network of `config`'s sizes without memory for weights.

    `backbone` overrides settings of the backbone.
    """
    settings = {**config.backbone.settings, **backbone, "seed": None}
    body = AsymmetricViT(make_settings(AsymmetricViT.Settings, settings, "backbone"))
    head_settings = make_settings(
        DptGaussianHead.Settings, {**config.head.settings, "seed": None}, "head"
    )
    return GaussianNetwork(body, DptGaussianHead(head_settings, body), config)
