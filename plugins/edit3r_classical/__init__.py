"""Geometry and segmentation without learned weights: what two real photos alone can tell."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_matchers():
    return [
        Component(
            "classical",
            "edit3r_classical.matcher:ClassicalMatcher",
            "relative poses by rootSIFT and essential matrices, depths by plane sweep and semi-global aggregation",
            min_views=2,
        )
    ]


@hookimpl
def register_reconstructors():
    return [
        Component(
            "classical",
            "edit3r_classical.reconstructor:ClassicalReconstructor",
            "one Gaussian a pixel at the depth a matcher measured; no learned weights",
            parts=("matcher",),
            min_views=2,
        )
    ]


@hookimpl
def register_segmenters():
    return [
        Component(
            "classical",
            "edit3r_classical.segmenter:ClassicalSegmenter",
            "offline stand-in for SAM2: colour and texture regions; its quality fields are proxies",
        )
    ]
