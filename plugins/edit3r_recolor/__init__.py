"""Recolouring as an editor, and the region-wise composite colour transform the training recipe shares with it."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_editors():
    return (
        Component(
            "recolor",
            "edit3r_recolor.editor:RecolorEditor",
            "recolours an object or the picture from plain words, the same in every view; no model",
            parts=("segmenter",),
            citation="Edit3r, section 3.2 (region-wise recoloring)",
        ),
    )


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "recolor",
            "edit3r_recolor.command:RecolorCommand",
            "recolour the objects of a folder of photos, alike in every view, as training data",
        ),
    ]
