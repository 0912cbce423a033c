"""Geometry without learned weights: relative poses and dense depths that the photos alone tell."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_matchers():
    return [
        Component(
            "classical",
            "edit3r_matching.matchers:ClassicalMatcher",
            "relative poses by rootSIFT and essential matrices, depths by plane sweep and semi-global aggregation",
            min_views=2,
        ),
        Component(
            "posed",
            "edit3r_matching.matchers:PosedMatcher",
            "depth by plane sweep from the poses that the views carry; without poses, what its matcher says",
            parts=("matcher",),
            min_views=2,
        ),
    ]


@hookimpl
def register_reconstructors():
    return [
        Component(
            "classical",
            "edit3r_matching.reconstructor:ClassicalReconstructor",
            "one Gaussian a pixel at the depth a matcher measured; no learned weights",
            parts=("matcher",),
            min_views=2,
        )
    ]


@hookimpl
def register_trainers():
    return [
        Component(
            "depth",
            "edit3r_matching.depth_trainer:DepthTrainer",
            "teaches the network of matcher 'classical' which depth is right, from data with depths",
        )
    ]
