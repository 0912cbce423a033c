"""Objects of a finished scene, each its own Gaussians: `edit3r objects`."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "objects",
            "edit3r_objects.command:ObjectsCommand",
            "take hold of things in a finished scene: remove, move, recolour, copy",
        )
    ]
