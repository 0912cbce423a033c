"""A backbone and a head as one network: given its weights, in the precision that was asked for."""

from collections.abc import Iterator, Mapping

from jaxtyping import Float
from torch import Tensor, nn

from edit3r import build
from edit3r.contract.interfaces import Backbone, GaussianHead
from edit3r.contract.reporting import note, progress, warn
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Gaussians, Reconstruction, Views
from edit3r.kit import asking
from edit3r.kit.files.atomic import sha256_of
from edit3r_model.checkpoints import LoadedWeights, fill, load_weights
from edit3r_model.engine import EnginePlan, prepare_leaf
from edit3r_model.memory import draw_leaf, leaf_names

UNTRAINED = ("untrained", "random")
"""Names of no weights at all: the parts keep or draw initial ones."""


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
        self,
        images: Float[Tensor, "batch view 3 height width"],
        intrinsics: Float[Tensor, "batch view 3 3"],
    ) -> Gaussians:
        return self.reconstruct(Views(images, intrinsics)).gaussians

    def reconstruct(self, views: Views) -> Reconstruction:
        """A single pass, with the cameras that the backbone predicts, if it does."""
        features = asking.features(self.backbone, views.images, views.intrinsics)
        gaussians = asking.gaussians(self.head, features, views.images, views, None)
        return Reconstruction(
            gaussians, features.cameras, per_pixel=self.head.per_pixel
        )


def built(parts: Mapping[str, PartChoice]) -> GaussianNetwork:
    """The network of the chosen parts."""
    backbone, head = parts["backbone"], parts["head"]
    body = build("backbone", backbone.name, **backbone.settings)
    return GaussianNetwork(
        body, build("head", head.name, {"backbone": body}, **head.settings)
    )


def load_network(
    network: GaussianNetwork, weights: str, plan: EnginePlan, seed: int
) -> GaussianNetwork:
    """Give a network its weights, in evaluation mode, in the precision and on the device of `plan`.

    Every layer is converted as soon as it has weights, so that the network never exists twice.
    `seed` is for weights that are drawn rather than loaded.
    """
    if weights in UNTRAINED:
        note("reconstructor.weights", {"source": weights})
        warn(
            "the network is untrained, its weights are random: its results are useful for tests "
            "and training only."
        )
        leaves = _drawn(network, seed)
    else:
        loaded = load_weights(weights)
        _report(loaded)
        leaves = fill(network, loaded, seed)
    total = len(leaf_names(network))
    for done, (name, leaf) in enumerate(leaves, start=1):
        prepare_leaf(name, leaf, plan)
        progress("loading weights", done, total)
    return network.eval()


def _drawn(network: nn.Module, seed: int) -> Iterator[tuple[str, nn.Module]]:
    """Initial weights, leaf by leaf; leaves that have weights already keep them."""
    for name in leaf_names(network):
        leaf = network.get_submodule(name)
        if next(leaf.parameters(recurse=False)).is_meta:
            draw_leaf(name, leaf, seed)
        yield name, leaf


def _report(loaded: LoadedWeights) -> None:
    """Note what the weights are for the run's manifest, and warn of parts that are random."""
    record = {"sha256": sha256_of(loaded.path), "licence": loaded.licence}
    note(
        "reconstructor.weights",
        {"source": loaded.source, "kind": loaded.kind, **record},
    )
    note("weights.reconstructor", {"file": loaded.path.name, **record})
    if loaded.drawn:
        warn(
            f"{loaded.source} initialises the network for training; it does not hold "
            f"{', '.join(loaded.drawn)}, which are random: the Gaussians' colours and shapes mean "
            "nothing yet."
        )
