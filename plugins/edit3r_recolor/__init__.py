"""Recolouring as an editor and as a command; what other plugins may use of it is
`edit3r_recolor.api`.
"""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_editors() -> Component:
    return Component(
        "recolor",
        "edit3r_recolor.editor:RecolorEditor",
        "recolours things or the whole image from plain words, the same in every view; no model",
        actions=("paint",),
        citation="Edit3r, section 3.2 (region-wise recoloring)",
    )


@hookimpl
def register_commands() -> Component:
    return Component(
        "recolor",
        "edit3r_recolor.command:RecolorCommand",
        "recolour the objects of a folder of photos, alike in every view, as training data",
    )
