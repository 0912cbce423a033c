"""The default reconstructor: pose and depth from matching the unedited photos, edits fused by a small network."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_reconstructors() -> list[Component]:
    return [
        Component(
            name="edit3r",
            target="edit3r_matched.reconstructor:Edit3rReconstructor",
            summary="matched geometry repaired by a small network that carries and fuses the edits (weights ship)",
            parts=("matcher",),
            min_views=2,
            citation="Edit3r: Instant 3D Scene Editing from Sparse Unposed Images",
        ),
    ]
