"""Plugin ffgs: says what it offers and which weights it loads; ffgs and torch load when it is
built.
"""

from edit3r import Component, hookimpl
from edit3r.contract.weights import Weights

EDIT3R_API = 1

ANYSPLAT = Weights(
    "anysplat",
    "Gaussians and cameras of unposed photos (AnySplat)",
    5_000_000_000,
    "MIT, fine-tuned from VGGT-1B (CC BY-NC 4.0)",
    "no",
    "hub:lhjiang/anysplat",
    "d2e8c343672646041ad4ea518184968f94362f01",  # pinned by ffgs 0.1.0.dev1, with the SHA-256
    (
        (
            "model.safetensors",
            "1c4de2ba5a29c540b899af901bf02107395b5f0617655d347e262f814b4c0c7c",
        ),
    ),
)


@hookimpl
def register_reconstructors():
    return [
        Component(
            "ffgs",
            "edit3r_ffgs.reconstructor:FfgsReconstructor",
            "AnySplat, or any pose-free network that ffgs saved; not for commercial use",
            requires=("ffgs", "torchvision"),
            extra="edit3r-ffgs",
            licence="Apache-2.0; AnySplat's code and weights CC BY-NC 4.0",
            needs_network=True,
            min_views=2,
            weights=(ANYSPLAT,),
            citation="Jiang et al., AnySplat, ACM TOG 2025",
        )
    ]
