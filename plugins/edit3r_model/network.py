"""The whole network: a backbone and a head, from pictures to Gaussians."""

from jaxtyping import Float
from torch import Tensor, nn

from edit3r.interfaces import Backbone, GaussianHead
from edit3r.types import Gaussians


class GaussianNetwork(nn.Module):
    """Backbone, then head. Any backbone goes with any head that reads its levels.

    images [0, 1] ──► backbone ──► features ──► head ──► Gaussians
    intrinsics ──────────┘                       ▲
    images ──────────────────────────────────────┘
    """

    def __init__(self, backbone: Backbone, head: GaussianHead) -> None:
        super().__init__()
        self.backbone = backbone
        self.head = head

    def forward(
        self, images: Float[Tensor, "batch view 3 height width"], intrinsics: Float[Tensor, "batch view 3 3"]
    ) -> Gaussians:
        return self.head(self.backbone(images, intrinsics), images)

    def initial_name(self, name: str) -> str:
        """Delegates to the part, see `edit3r_model.initialise`."""
        part, _, rest = name.partition(".")
        module = getattr(self, part)
        return f"{part}.{module.initial_name(rest)}" if hasattr(module, "initial_name") else name

    def initial_leaf(self, name: str, leaf: nn.Module) -> None:
        part, _, rest = name.partition(".")
        if hasattr(getattr(self, part), "initial_leaf"):
            getattr(self, part).initial_leaf(rest, leaf)
