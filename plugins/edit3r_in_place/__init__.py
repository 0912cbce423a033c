"""Edits of a scene that is there, in its own Gaussians."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_reconstructors() -> list[Component]:
    return [
        Component(
            "in-place",
            "edit3r_in_place.in_place:InPlaceReconstructor",
            "the edit goes into the given scene: colours of chosen Gaussians alone change, removed "
            "things are taken out",
            parts=("rasterizer",),
        )
    ]


@hookimpl
def register_selectors() -> list[Component]:
    return [
        Component(
            "in-scene",
            "edit3r_in_place.in_scene:InSceneSelector",
            "marks and words on few pictures of a given scene, carried to all by its Gaussians",
            parts=("segmenter",),
        )
    ]
