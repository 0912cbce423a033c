"""What a scene is written as, for people and for other programs."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "render",
            "edit3r_outputs.render:RenderCommand",
            "pictures, a video and a viewer page from a saved scene (3DGS PLY)",
        ),
        Component(
            "export",
            "edit3r_outputs.export:ExportCommand",
            "a saved scene as SPZ, SOG, splat, compressed PLY or GLB, for other programs",
        ),
    ]
