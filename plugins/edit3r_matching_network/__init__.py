"""Pose and depth by a small trained network, without feature detection: soft correlation between the views' tokens."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_matchers() -> list[Component]:
    return [
        Component(
            name="network",
            target="edit3r_matching_network.matcher:NetworkMatcher",
            summary="small trained network: soft matches and depth, then a two-view adjustment (weights ship)",
            min_views=2,
        ),
    ]


@hookimpl
def register_trainers() -> list[Component]:
    return [
        Component(
            name="geometry",
            target="edit3r_matching_network.trainer:GeometryTrainer",
            summary="teaches the network of matcher 'network' matches, depth and pose, from data with depths",
        ),
    ]
